"""Shared code of the reproduced tests of peers: results, quadratures, and rotations of single harmonics."""

import warnings
from dataclasses import dataclass

import numpy as np
import spharm_rs as sp
from spharm_rs import convert, spectra

BAR = 1e-10
#: Optimality that least squares must reach, far below the bar.
TOLERANCE = 1e-14


@dataclass(frozen=True)
class Result:
    """A result of a peer's test: the largest difference, relative to the largest value, and its bar."""

    quantity: str
    difference: float
    bar: float = BAR
    #: Reason for a bar other than the usual one.
    note: str = ""

    @property
    def met(self):
        return bool(self.difference <= self.bar)


def compare(quantity, found, known, bar=BAR, note=""):
    found, known = np.asarray(found), np.asarray(known)
    if found.shape != known.shape:
        raise ValueError(f"{quantity}: expected shape {known.shape}, that of the peer's result; found {found.shape}")
    scale = np.abs(known).max()
    return Result(quantity, float(np.abs(found - known).max() / (scale if scale > 0 else 1.0)), bar, note)


def grid_directions(colatitudes, longitudes):
    """Returns the directions of a grid, colatitude by colatitude, from angles in radians, (n, 3)."""
    theta, phi = np.meshgrid(colatitudes, longitudes, indexing="ij")
    return spectra.directions(colatitude=theta.ravel(), longitude=phi.ravel(), degrees=False)


def gauss_legendre(degree):
    """Returns the directions and weights of a quadrature that is exact up to twice a degree."""
    z, weights = np.polynomial.legendre.leggauss(degree + 1)
    count = 2 * degree + 1
    longitudes = np.arange(count) * 2 * np.pi / count
    return grid_directions(np.arccos(z[::-1]), longitudes), np.repeat(weights[::-1], count) * 2 * np.pi / count


def driscoll_healy(rows, columns):
    """Returns the directions and weights of Driscoll and Healy's quadrature, which begins with the north pole.

    Source: Driscoll and Healy (1994), Adv. Appl. Math. 15, 202-250, lemma 2.
    """
    theta = np.arange(rows) * np.pi / rows
    odd = np.arange(1, rows, 2)
    weights = 4 / rows * np.sin(theta) * (np.sin(np.outer(theta, odd)) / odd).sum(axis=1)
    longitudes = np.arange(columns) * 2 * np.pi / columns
    return grid_directions(theta, longitudes), np.repeat(weights, columns) * 2 * np.pi / columns


def fit(directions, values, degree, weights="uniform", tolerance=TOLERANCE):
    """Returns least-squares coefficients, (K, c) or (K,). With a quadrature's weights they are its integrals."""
    if not isinstance(weights, str):
        # Leaves out the poles, which have weight 0 and a direction for each longitude.
        directions, values, weights = (array[weights > 0] for array in (directions, values, weights))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "the sphere: [0-9]+ directions are equal", sp.SpharmWarning)
        found, _ = sp.solve(directions, values, degree, weights=weights, tolerance=tolerance)
    return found


def rotate(coefficients, rotation):
    """Returns coefficients of f(R^-1 u), (K, c) or (K,)."""
    given = np.asarray(coefficients)
    model = sp.Model(given.reshape(len(given), -1), surface=False)
    return sp.shape.rotate(model, parameters=rotation).coefficients.reshape(given.shape)


def wigner(degree, rotation):
    """Returns Wigner's matrix D of a degree, rows and columns from order -l, by rotation of each complex harmonic."""
    rows = slice(degree**2, (degree + 1) ** 2)
    unit = np.zeros(((degree + 1) ** 2, 2 * degree + 1), dtype=complex)
    unit[rows] = np.eye(2 * degree + 1)
    # The real and the imaginary part of a harmonic are real series.
    real, imaginary = (convert.to_complex(rotate(convert.from_complex(c), rotation)) for c in (unit, -1j * unit))
    return (real + 1j * imaginary)[rows]
