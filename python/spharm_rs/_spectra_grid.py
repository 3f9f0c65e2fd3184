"""Values of functions on grids of latitudes and longitudes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from . import _arrays
from ._arrays import Floats
from ._model import Model
from ._model_tables import channel_names
from ._spectra_angles import angles, unit_vectors
from ._spectra_degree import finite


@dataclass(frozen=True, eq=False)
class Grid:
    """Values on a grid of latitudes and longitudes.

    Attributes
    ----------
    latitude : ndarray of float, (n,)
        In degrees, in the order given; by default from the north.
    longitude : ndarray of float, (m,)
        In degrees.
    values : ndarray of float, (n, m) or (n, m, c)
    channel : list of str
        Names of the channels: x, y and z of a surface, otherwise numbers from 0; empty for values (n, m).
    """

    latitude: Floats
    longitude: Floats
    values: Floats
    channel: list[str]

    def __repr__(self) -> str:
        return f"Grid({len(self.latitude)} latitudes, {len(self.longitude)} longitudes)"

    def to_xarray(self) -> Any:
        """Returns an xarray ``DataArray`` with the coordinates latitude, longitude and, for values (n, m, c), channel."""
        import xarray

        coordinates: dict[str, Any] = {"latitude": self.latitude, "longitude": self.longitude}
        if self.values.ndim == 3:
            coordinates["channel"] = self.channel
        return xarray.DataArray(self.values, coordinates, list(coordinates))


def grid(
    coefficients: Model | ArrayLike,
    latitude: ArrayLike | None = None,
    longitude: ArrayLike | None = None,
    *,
    threads: int | None = None,
) -> Grid:
    """Evaluates functions on a grid of latitudes and longitudes, such as for a map.

    Parameters
    ----------
    coefficients : Model, or array_like of float, (K,) or (K, c)
        Such as those of `spharm_rs.solve`.
    latitude : array_like of float, (n,), optional
        In degrees, from -90 to 90; by default 2 L + 2 latitudes from 90 in steps of 180 / (2 L + 2).
    longitude : array_like of float, (m,), optional
        In degrees, from -360 to 360; by default 4 L + 4 longitudes from 0 in steps of 360 / (4 L + 4).
    threads : int, optional

    Returns
    -------
    Grid

    Notes
    -----
    The default grid is that of pyshtools' ``expand(grid="DH2", extend=False)``, from which coefficients to degree L can be
    found again.

    Examples
    --------
    >>> import numpy as np
    >>> from spharm_rs import spectra
    >>> dipole = [0, 0, np.sqrt(4 * np.pi / 3), 0]
    >>> spectra.grid(dipole, latitude=[90, 0, -30], longitude=[0, 180]).values.round(12).tolist()
    [[1.0, 1.0], [0.0, 0.0], [-0.5, -0.5]]
    >>> spectra.grid(dipole)
    Grid(4 latitudes, 8 longitudes)
    """
    if isinstance(coefficients, Model):
        model, flat = coefficients, False
    else:
        array = finite("coefficients", _arrays.channels("coefficients", coefficients))
        model, flat = Model(array, surface=False), np.ndim(coefficients) == 1
    rows = 2 * model.max_degree + 2
    step = 180.0 / rows
    north = _axis("latitude", 90 - step * np.arange(rows) if latitude is None else latitude)
    east = _axis("longitude", step * np.arange(2 * rows) if longitude is None else longitude)
    elevation = angles("latitude", north, -90, 90, degrees=True)
    azimuth = angles("longitude", east, -360, 360, degrees=True)
    at = unit_vectors(np.sin(elevation)[:, np.newaxis], np.cos(elevation)[:, np.newaxis], azimuth)
    values = model.evaluate(at.reshape(-1, 3), threads=threads)
    if flat:
        return Grid(north, east, values.reshape(len(north), len(east)), [])
    names = channel_names(values.shape[1], model.is_surface)
    return Grid(north, east, values.reshape(len(north), len(east), -1), names)


def _axis(what: str, values: ArrayLike) -> Floats:
    axis = _arrays.real(what, values, "(n,)").copy()
    if axis.size == 0:
        raise ValueError(f"{what}: expected at least one angle, found none")
    return axis
