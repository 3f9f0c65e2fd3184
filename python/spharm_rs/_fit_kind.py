"""Tells positions of a surface from a signal of three channels."""

from __future__ import annotations

import numpy as np

from ._arrays import Floats, Triangles
from ._warnings import warn

#: ``36 pi volume**2 / area**3`` below which values are unlikely to be positions: it is 1 for a ball, 0.03 or more for
#: cortices, and 0.001 for a sheet 120 times as wide as thick.
_LEAST = 1e-3

#: Area, for coordinates of at most 1, below which all points are taken to be on a line.
_LEAST_AREA = 1e-6


def warn_of_signal(values: Floats, triangles: Triangles) -> None:
    """Warns if values at a sphere's vertices, (n, 3), are fitted as a surface but enclose hardly any volume."""
    corners = values - values.mean(axis=0)
    # Powers of the volume and the area of very large coordinates would overflow.
    corners /= np.abs(corners).max() or 1.0
    a, b, c = (corners[triangles[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    volume, area = float((a * normals).sum()) / 6, float(np.linalg.norm(normals, axis=1).sum()) / 2
    # For points on a line, volume and area are rounding errors.
    if area < _LEAST_AREA or 36 * np.pi * volume**2 < _LEAST * area**3:
        warn(
            [
                "surface: an array of shape (n, 3) is fitted as positions of a surface, but these enclose hardly any volume; "
                'for a signal of three channels, give objective="vertices"'
            ]
        )
