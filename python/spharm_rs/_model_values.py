"""Arithmetic and comparison of models, and access to the coefficients of degrees and orders."""

from __future__ import annotations

import numbers
from typing import TYPE_CHECKING, Any, Iterator, SupportsIndex

import numpy as np

from ._arrays import Floats

if TYPE_CHECKING:
    from typing_extensions import Self


class Values:
    """Operators that `Model` inherits. Sums and multiples of models are those of their coefficients, over the first
    model's sphere."""

    # Lets NumPy's numbers leave sums and products with models to the operators of `Model`.
    __array_ufunc__ = None
    __hash__ = None  # type: ignore[assignment]

    standard_errors: Floats | None

    @property
    def coefficients(self) -> Floats:
        raise NotImplementedError

    @property
    def max_degree(self) -> int:
        raise NotImplementedError

    @property
    def is_surface(self) -> bool:
        raise NotImplementedError

    def _with(self, coefficients: Floats, errors: Floats | None = None) -> Self:
        """Returns a model with other coefficients, and their standard errors if known, over the same sphere."""
        raise NotImplementedError

    def _times(self, factor: float) -> Self:
        errors = self.standard_errors
        return self._with(factor * self.coefficients, None if errors is None else abs(factor) * errors)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Any:
        return np.array(self.coefficients, dtype=dtype, copy=copy)

    def __len__(self) -> int:
        return self.max_degree + 1

    def __iter__(self) -> Iterator[Floats]:
        return (self[degree] for degree in range(len(self)))

    def __getitem__(self, index: SupportsIndex | tuple[SupportsIndex, SupportsIndex]) -> Floats:
        degree, order = index if isinstance(index, tuple) and len(index) == 2 else (index, None)
        if isinstance(degree, bool) or not isinstance(degree, (int, np.integer)):
            raise TypeError(f"model[l] or model[l, m]: expected whole numbers, found {index!r}")
        degree = int(degree)  # the squares below overflow NumPy's small integers
        if not 0 <= degree <= self.max_degree:
            raise IndexError(f"degree: expected 0 to {self.max_degree}, found {degree}")
        if order is None:
            return self.coefficients[degree**2 : (degree + 1) ** 2]
        if isinstance(order, bool) or not isinstance(order, (int, np.integer)):
            raise TypeError(f"model[l, m]: expected whole numbers, found {index!r}")
        order = int(order)
        if abs(order) > degree:
            raise IndexError(f"order: expected -{degree} to {degree} for degree {degree}, found {order}")
        found: Floats = self.coefficients[degree**2 + degree + order]
        return found

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Values):
            return NotImplemented
        return self.is_surface == other.is_surface and np.array_equal(self.coefficients, other.coefficients)

    def _combined(self, other: Any, sign: float) -> Self:
        if not isinstance(other, Values):
            return NotImplemented
        mine, theirs = self.coefficients, other.coefficients
        if mine.shape[1] != theirs.shape[1]:
            raise ValueError(f"models: expected equal numbers of channels, found {mine.shape[1]} and {theirs.shape[1]}")
        if self.is_surface != other.is_surface:
            raise ValueError("models: expected two surfaces or two signals, found one of each")
        total = np.zeros((max(len(mine), len(theirs)), mine.shape[1]))
        total[: len(mine)] = mine
        total[: len(theirs)] += sign * theirs
        return self._with(total)

    def __add__(self, other: Any) -> Self:
        return self._combined(other, 1.0)

    def __radd__(self, other: Any) -> Self:
        # sum() begins with 0.
        return self._times(1.0) if isinstance(other, int) and other == 0 else NotImplemented

    def __sub__(self, other: Any) -> Self:
        return self._combined(other, -1.0)

    def __neg__(self) -> Self:
        return self._times(-1.0)

    def __mul__(self, factor: Any) -> Self:
        if not isinstance(factor, numbers.Real):
            return NotImplemented
        if not np.isfinite(float(factor)):
            raise ValueError(f"factor: expected a finite number, found {factor}")
        return self._times(float(factor))

    __rmul__ = __mul__

    def __truediv__(self, divisor: Any) -> Self:
        if not isinstance(divisor, numbers.Real):
            return NotImplemented
        if divisor == 0:
            raise ZeroDivisionError("division of a model by zero")
        return self * (1.0 / float(divisor))
