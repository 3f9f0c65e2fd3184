"""Spectra of signals on the sphere, as in geodesy and cosmology.

Converts latitudes and longitudes to directions, and coefficients to grids; computes power, cross-power, admittance and
correlation by degree from coefficients, such as those of `spharm_rs.solve`; and estimates the spectrum of a field that
was observed on a part of the sphere.

===========================  ======================================================================================
in                           is
===========================  ======================================================================================
pyshtools ``spectrum``       `spectrum`, of an ``SHCoeffs``, or of coefficients converted by ``convert.from_pyshtools``
pyshtools ``expand``         `grid` of coefficients, and `Grid.expand` of a grid's values
pyshtools ``SHAdmitCorr``    `admittance` and `correlation`
healpy ``alm2cl``            ``spectrum(.., unit="per_lm", convention="energy")``, the C_l of cosmology
healpy ``anafast``, masked   `pseudo_spectrum`
NaMaster, spin 0             `decoupled_spectrum`, `decoupled_cross_spectrum`
===========================  ======================================================================================

Examples
--------
>>> import numpy as np, spharm_rs as sp
>>> from spharm_rs import spectra
>>> latitude, longitude = [90.0, 0.0, -45.0], [0.0, 90.0, 180.0]
>>> spectra.directions(latitude, longitude).round(3)
array([[ 0.   ,  0.   ,  1.   ],
       [ 0.   ,  1.   ,  0.   ],
       [-0.707,  0.   , -0.707]])
>>> height = np.random.default_rng(0).normal(size=25)
>>> by_degree = spectra.spectrum(height)
>>> bool(np.isclose(by_degree.power.sum(), (height**2).sum() / (4 * np.pi)))
True
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from . import _arrays
from ._arrays import Floats
from ._spectra_angles import angles, unit_vectors, warn_if_radians
from ._spectra_degree import (
    Admittance,
    Correlation,
    Spectrum,
    admittance,
    correlation,
    cross_spectrum,
    finite,
    spectrum,
)
from ._spectra_grid import Grid, grid
from ._spectra_mask import (
    BandPowers,
    PseudoSpectrum,
    coupling_matrix,
    decoupled_cross_spectrum,
    decoupled_spectrum,
    pseudo_spectrum,
)

__all__ = [
    "Admittance",
    "BandPowers",
    "Correlation",
    "Grid",
    "PseudoSpectrum",
    "Spectrum",
    "admittance",
    "correlation",
    "coupling_matrix",
    "cross_spectrum",
    "decoupled_cross_spectrum",
    "decoupled_spectrum",
    "directions",
    "grid",
    "latitude_longitude",
    "pseudo_spectrum",
    "spectrum",
]


def directions(
    latitude: ArrayLike | None = None,
    longitude: ArrayLike | None = None,
    *,
    colatitude: ArrayLike | None = None,
    degrees: bool = True,
) -> Floats:
    """Returns unit vectors from latitudes or colatitudes, and longitudes.

    Parameters
    ----------
    latitude : float or array_like of float, optional
        Of any shape that broadcasts with that of the longitudes. Geocentric, from -90 (south pole) to 90 degrees. Geodetic
        latitudes, as of maps of the Earth, differ from geocentric ones by up to 0.19 degrees.
    longitude : float or array_like of float
        East, from -360 to 360 degrees.
    colatitude : float or array_like of float, optional
        In place of latitudes: from 0 (north pole) to 180 degrees.
    degrees : bool
        Whether angles are in degrees; otherwise they are in radians.

    Returns
    -------
    ndarray of float, (n, 3)
        A row for each of the n elements of the broadcast shape, in C order, which is the order of ``values.ravel()``.

    Raises
    ------
    ValueError
        If an angle is NaN or outside its range, or if the shapes don't broadcast.

    Warns
    -----
    SpharmWarning
        If angles of 10 points or more, in degrees, are so small that they may be in radians.

    Examples
    --------
    >>> import numpy as np
    >>> from spharm_rs import spectra
    >>> spectra.directions(colatitude=[0.0, 180.0], longitude=[0.0, 0.0]).round(12)
    array([[ 0.,  0.,  1.],
           [ 0.,  0., -1.]])
    >>> spectra.directions(48.1, 11.6).shape
    (1, 3)

    The points of a grid of 3 latitudes and 4 longitudes, latitude by latitude:

    >>> north, east = np.meshgrid([45.0, 0.0, -45.0], [0.0, 90.0, 180.0, 270.0], indexing="ij")
    >>> spectra.directions(north, east).shape
    (12, 3)
    """
    if longitude is None:
        raise ValueError("longitude: expected an array of shape (n,), found None")
    if (latitude is None) == (colatitude is None):
        raise ValueError(f"latitude, colatitude: expected one of them, found {'none' if latitude is None else 'both'}")
    if latitude is not None:
        what, most, angle = "latitude", 90, angles("latitude", latitude, -90, 90, degrees)
        z, across = np.sin(angle), np.cos(angle)
    else:
        assert colatitude is not None
        what, most, angle = "colatitude", 180, angles("colatitude", colatitude, 0, 180, degrees)
        z, across = np.cos(angle), np.sin(angle)
    phi = angles("longitude", longitude, -360, 360, degrees)
    try:
        shape = np.broadcast_shapes(z.shape, phi.shape)
    except ValueError:
        raise ValueError(
            f"longitude: expected shape {z.shape}, as {what} has, or one that broadcasts with it; found {phi.shape}; "
            "for all points of a grid, give the arrays of np.meshgrid"
        ) from None
    if degrees:
        points = int(np.prod(shape))
        warn_if_radians(what, most, np.degrees(angle), np.degrees(phi), points, "give degrees=False for radians")
    z, across, phi = (np.broadcast_to(array, shape).ravel() for array in (z, across, phi))
    return unit_vectors(z, across, phi)


def latitude_longitude(directions: ArrayLike, *, degrees: bool = True) -> tuple[Floats, Floats]:
    """Returns latitudes and longitudes of directions.

    Parameters
    ----------
    directions : array_like of float, (n, 3)
        Vectors of any nonzero length.
    degrees : bool
        Whether angles are in degrees; otherwise they are in radians.

    Returns
    -------
    latitude : ndarray of float, (n,)
        Geocentric, from -90 to 90 degrees.
    longitude : ndarray of float, (n,)
        East, from -180 to 180 degrees.
    """
    at = finite("directions", _arrays.positions("directions", directions))
    zero = ~at.any(axis=1)
    if zero.any():
        raise ValueError(f"directions: expected nonzero vectors, found a zero vector in row {int(zero.argmax())}")
    latitude = np.arctan2(at[:, 2], np.hypot(at[:, 0], at[:, 1]))
    longitude = np.arctan2(at[:, 1], at[:, 0])
    return (np.degrees(latitude), np.degrees(longitude)) if degrees else (latitude, longitude)
