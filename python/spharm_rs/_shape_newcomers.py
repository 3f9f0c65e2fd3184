"""Warns about models that are too far from the mean of a group to belong to it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Iterable

import numpy as np

from . import _core
from ._arrays import Floats
from ._model import Model

#: A model can hardly belong to the group if its distance from the mean is more than this multiple of that of the
#: farthest member. In the worst case, normally distributed scores along a single mode, 1 new member in 150 exceeds it
#: for a group of 5, and 1 in 2,000 for a group of 8.
_FAR = 4.0

#: Smaller groups don't show how far their members may be from the mean.
_LEAST = 5

#: Share of the mean's size below which distances from the mean are rounding errors.
_ROUNDING = 1e-6


@dataclass(frozen=True, eq=False)
class Newcomer:
    """A model that was projected on modes: its name in messages, its scores, and its distance from its projection."""

    name: str
    scores: Floats
    distance: float


def doubts_of(modes: _core.Modes, mean: Model, newcomers: Iterable[Newcomer]) -> list[str]:
    """Returns warnings about models that are much farther from the mean than every member of the group."""
    if len(modes.members) < _LEAST:
        return []
    # Modes that were left out add their variance to the square of each member's distance, on average.
    left = max(modes.total_variance - float(modes.variances.sum()), 0.0)
    farthest = float(np.sqrt((modes.scores**2).sum(axis=1).max(initial=0.0) + left))
    size = float(np.linalg.norm(mean.coefficients[1:]) / np.sqrt(4 * np.pi))
    limit = _FAR * max(farthest, _ROUNDING * size)
    found = []
    for newcomer in newcomers:
        distance = float(np.hypot(np.linalg.norm(newcomer.scores), newcomer.distance))
        if distance > limit:
            found.append(
                f"{newcomer.name}: the root mean square distance from the mean is {distance:.4g}, but that of the "
                f"farthest member is {farthest:.4g}: the model may be unaligned or mirrored, in another unit, or not of "
                "the group's kind; align the model with the group first (shape.align with the modes' mean as the target)"
            )
    return found
