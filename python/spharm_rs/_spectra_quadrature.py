"""Weights of grids of latitudes and longitudes, with which sums over a grid are integrals over the sphere."""

from __future__ import annotations

import numpy as np

from ._arrays import Floats

#: Deviation of angles, in degrees, up to which a grid counts as one with an exact quadrature: the rounding of float32.
_ROUNDING = 3e-5

#: A gap of longitudes, or before a pole, that is wider than this many steps isn't part of the grid's cells.
_OPEN = 1.5


def latitude_weights(latitude: Floats) -> tuple[Floats, int]:
    """Returns weights of latitudes in degrees, with the sum 2 if they span the sphere, and the degree to which they integrate
    polynomials of the sine of the latitude exactly; -1 for areas of cells. Equal latitudes share their weight."""
    theta, group, count = np.unique(90 - latitude, return_inverse=True, return_counts=True)
    ordered, degree = _gauss_legendre(theta), 2 * len(theta) - 1
    if ordered is None:
        ordered, degree = _even(theta)
    if ordered is None:
        ordered, degree = _bands(theta), -1
    weights: Floats = (ordered / count)[group]
    return weights, degree


def longitude_weights(longitude: Floats) -> tuple[Floats, int]:
    """Returns weights of longitudes in degrees, with the sum 2 pi if they go around the sphere, and the order to which they
    integrate sines and cosines exactly; -1 for widths of cells. Equal longitudes share their weight."""
    at, group, count = np.unique(longitude % 360, return_inverse=True, return_counts=True)
    gaps = np.diff(at, append=at[0] + 360)  # gap after each longitude; the last one closes the circle
    distinct = at[gaps > _ROUNDING]
    even = bool((abs(distinct - distinct[0] - np.arange(len(distinct)) * 360 / len(distinct)) < 2 * _ROUNDING).all())
    widest = int(gaps.argmax())
    if not even and gaps[widest] > _OPEN * np.sort(gaps)[-2]:
        # On a part of the circle, the cells at its ends extend as far outwards as inwards.
        before, after = np.roll(gaps, 1), gaps.copy()
        last, first = widest, (widest + 1) % len(gaps)
        after[last], before[first] = before[last], after[first]
        widths = (before + after) / 2
    else:
        widths = (np.roll(gaps, 1) + gaps) / 2
    weights: Floats = (np.radians(widths) / count)[group]
    return weights, len(distinct) - 1 if even else -1


def gauss_legendre(count: int) -> Floats:
    """Returns the latitudes of a Gauss-Legendre quadrature in degrees, from the north."""
    found: Floats = -np.degrees(np.arcsin(np.polynomial.legendre.leggauss(count)[0]))
    return found


def _gauss_legendre(theta: Floats) -> Floats | None:
    """Returns the weights of increasing colatitudes in degrees if they are the zeros of a Legendre polynomial."""
    count, radians = len(theta), np.radians(theta)
    if (np.diff(theta) <= 2 * _ROUNDING).any() or theta[0] <= _ROUNDING or theta[-1] >= 180 - _ROUNDING:
        return None
    z, across = np.cos(radians), np.sin(radians)
    before, value = np.ones(count), z
    for degree in range(2, count + 1):
        before, value = value, ((2 * degree - 1) * z * value - (degree - 1) * before) / degree
    slope = count * (before - z * value) / across**2
    # The distance to a zero, by Newton's method.
    if not (np.degrees(abs(value)) < _ROUNDING * across * abs(slope)).all():
        return None
    return np.asarray(2 / (across * slope) ** 2)


def _even(theta: Floats) -> tuple[Floats | None, int]:
    """Returns the weights of increasing, evenly spaced colatitudes in degrees, of which poles may be missing, and the degree
    to which they are exact (Driscoll and Healy 1994; Fejer)."""
    if len(theta) < 2:
        return None, -1
    count = int(round(180 * (len(theta) - 1) / (theta[-1] - theta[0]))) if theta[-1] > theta[0] else 0
    if count < 2:
        return None, -1
    first = theta[0] * count / 180
    half = abs(first - 0.5) < 0.25
    start = 0.5 if half else float(round(first))
    ideal = (start + np.arange(len(theta))) * 180 / count
    complete = start <= 1 and start + len(theta) - 1 >= count - 1
    if not complete or not (abs(theta - ideal) < _ROUNDING).all():
        return None, -1
    # In the sines of multiples of the colatitude, which are orthogonal on the grid, the integral of sin(k theta) is 2 / k.
    radians = np.radians(ideal)
    total = np.zeros(len(theta))
    for k in range(1, count, 2):
        total += np.sin(k * radians) / k
    exact = count - 1 if half or count % 2 == 0 else count - 2
    if half and count % 2:
        total += np.sin(count * radians) / (2 * count)
    # At a pole, the sine is 0 except for rounding.
    return np.asarray(np.where((ideal == 0) | (ideal == 180), 0, 4 / count * np.sin(radians) * total)), exact


def _bands(theta: Floats) -> Floats:
    """Returns the areas over 2 pi of bands around increasing colatitudes in degrees, which end midway between them."""
    middle = (theta[:-1] + theta[1:]) / 2
    ends = [0.0, 180.0]
    if len(theta) > 1:
        north, south = theta[1] - theta[0], theta[-1] - theta[-2]
        # If another latitude would fit before a pole, the grid covers only a part of the sphere.
        if theta[0] > _OPEN * north:
            ends[0] = theta[0] - north / 2
        if 180 - theta[-1] > _OPEN * south:
            ends[1] = theta[-1] + south / 2
    edges = np.cos(np.radians(np.concatenate([ends[:1], middle, ends[1:]])))
    return np.asarray(edges[:-1] - edges[1:])
