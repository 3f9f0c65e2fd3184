"""Angles on the sphere, and their unit vectors."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from . import _arrays
from ._arrays import Floats
from ._warnings import warn

#: Largest excess over a range, in radians, that the rounding of float32 can explain.
_ROUNDING = 1e-6


def angles(what: str, values: ArrayLike, least: float, most: float, degrees: bool, *, axis: bool = False) -> Floats:
    """Converts angles in degrees or radians to radians; refuses those outside a range in degrees; for an axis, only
    (n,)."""
    unit = "degrees" if degrees else "radians"
    array = _arrays.real(what, values, "(n,)")
    if axis and array.ndim != 1:
        raise ValueError(f"{what}: expected shape (n,), found {array.shape}")
    bad = ~np.isfinite(array)
    if bad.any():
        raise ValueError(f"{what}: expected finite {unit}, found NaN or infinity in row {int(bad.argmax())}")
    radians = np.radians(array) if degrees else array
    low, high = np.radians(least), np.radians(most)
    bad = (radians < low - _ROUNDING) | (radians > high + _ROUNDING)
    if bad.any():
        bounds = f"{least:g} to {most:g}" if degrees else f"{low:.4g} to {high:.4g}"
        raise ValueError(f"{what}: expected {unit} from {bounds}, found a number outside this range in row {int(bad.argmax())}")
    return np.clip(radians, low, high)


#: Smallest number of points for which angles that may be in radians give a warning, as by ``spharm moments --lonlat``.
_ENOUGH = 10


def warn_if_radians(what: str, most: float, first: Floats, longitude: Floats, points: int, remedy: str) -> None:
    """Warns of latitudes or colatitudes and longitudes in degrees that are so small that they may be in radians.
    ``most`` is the end of the range of the first, in degrees."""
    north, east = (float(abs(values).max(initial=0)) for values in (first, longitude))
    small = north <= np.radians(most) + _ROUNDING and east <= 2 * np.pi + _ROUNDING
    if points >= _ENOUGH and east > 0 and small:
        warn(
            [
                f"{what}, longitude: {what}s up to {north:.4g} and longitudes up to {east:.4g} look like radians, but "
                f"degrees are expected; {remedy}"
            ]
        )


def unit_vectors(z: Floats, across: Floats, longitude: Floats) -> Floats:
    """Returns unit vectors from their z, their distances from the z axis, and longitudes in radians; (..., 3)."""
    x, y = across * np.cos(longitude), across * np.sin(longitude)
    return np.stack([x, y, np.broadcast_to(z, x.shape)], axis=-1)
