"""Exceptions and warnings of this package."""

from __future__ import annotations

__all__ = [
    "MemoryBudgetError",
    "MeshError",
    "NotConverged",
    "NotDetermined",
    "Oscillation",
    "SpharmError",
    "SpharmWarning",
    "StoreError",
]


class SpharmError(Exception):
    """What this package refuses or fails at. The message says what was expected, what was found and what to do."""


class MeshError(SpharmError, ValueError):
    """A surface, sphere, volume or model that isn't what its name says, such as a mesh that isn't closed."""


class StoreError(SpharmError, OSError):
    """A basis store that is damaged, incomplete, or for which there is no space on the disk."""


class MemoryBudgetError(SpharmError, MemoryError):
    """A memory budget, or a limit of the process, below what the work takes.

    Attributes
    ----------
    budget : int
        The budget or limit, in bytes.
    needed : int
        The least that works, in bytes.
    """

    budget: int
    needed: int


class SpharmWarning(UserWarning):
    """Something about a result that its user should know. The report of a fit lists them, too."""


class NotDetermined(SpharmWarning):
    """The sampling doesn't determine all coefficients; the solution of least norm, or the smoothest, was taken."""


class NotConverged(SpharmWarning):
    """The iteration ended before the tolerance was met."""


class Oscillation(SpharmWarning):
    """The model is far off between the vertices, which leave it undetermined there."""
