"""Warns of files whose 32-bit numbers are too coarse for a surface."""

from __future__ import annotations

import numpy as np

from ._arrays import Floats
from ._warnings import warn

#: Step between adjacent 32-bit coordinates, relative to the bounding box's diagonal, above which there is a warning, as
#: of ``spharm reconstruct``.
_COARSE = 1e-4

#: Endings of the formats that store 64 bits, and of those that do so if asked to.
_EXACT = (".obj", ".off", ".vtk", ".vtp", ".3mf")
_CHOICE = (".gii", ".ply")


def warn_of_rounding(path: str, vertices: Floats, double: bool) -> None:
    """Warns if a file's 32-bit numbers are too coarse for a surface that is far from the origin or very small."""
    name = path.lower().removesuffix(".gz")
    choice = name.endswith(_CHOICE)
    if len(vertices) == 0 or name.endswith(_EXACT) or (choice and double):
        return
    size = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    largest = float(np.abs(vertices).max())
    limits = np.finfo(np.float32)
    # Below the normal range of 32-bit numbers, all steps are as large as the smallest positive number.
    step = max(largest * float(limits.eps), float(limits.smallest_subnormal))
    if largest == 0 or step <= _COARSE * size:
        return
    remedy = "give double=True" if choice else "write a format with 64-bit numbers, such as .vtp"
    warn(
        [
            f"{path}: with coordinates up to {largest:.4g}, 32-bit numbers are too coarse for a surface of size "
            f"{size:.4g}: they have steps of up to {step:.4g}; {remedy}"
        ]
    )
