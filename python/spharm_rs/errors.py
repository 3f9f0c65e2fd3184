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
    """Base class of this package's exceptions. Messages state what was expected, what was found, and the remedy."""


class MeshError(SpharmError, ValueError):
    """An invalid surface, sphere, volume or model, such as a mesh that isn't closed."""


class StoreError(SpharmError, OSError):
    """A basis store that is damaged or incomplete, or too large for the disk."""


class MemoryBudgetError(SpharmError, MemoryError):
    """A memory budget, or a memory limit of the process, that is smaller than the memory needed.

    Attributes
    ----------
    budget : int
        The budget or limit, in bytes.
    needed : int
        The smallest budget that works, in bytes.
    """

    budget: int
    needed: int


class SpharmWarning(UserWarning):
    """A doubt about a result. The warnings of a fit are also in its report."""


class NotDetermined(SpharmWarning):
    """The sampling doesn't determine all coefficients; the solution of least norm, or the smoothest one, was
    returned."""


class NotConverged(SpharmWarning):
    """The iteration ended before the tolerance was met."""


class Oscillation(SpharmWarning):
    """The model deviates strongly between the vertices, where they don't determine it."""
