"""Recognises objects of pyshtools without importing it."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

#: Largest deviation of complex coefficients from those of a real function, relative to the largest coefficient.
_REAL = 1e-10


@runtime_checkable
class SHCoeffs(Protocol):
    """An ``SHCoeffs`` of pyshtools: coefficients of one function with their normalisation and phase."""

    coeffs: NDArray[Any]
    normalization: str
    csphase: int
    kind: str


def real_coefficients(given: SHCoeffs) -> NDArray[Any]:
    """Returns the coefficients of real harmonics of an object of pyshtools, (2, L + 1, L + 1)."""
    array = np.asarray(given.coeffs)
    if given.kind != "complex":
        return array
    if array.ndim != 3 or array.shape[0] != 2 or array.shape[1] != array.shape[2] or array.shape[1] == 0:
        raise ValueError(f"pyshtools: expected shape (2, L + 1, L + 1), found {array.shape}")
    if given.normalization == "unnorm":
        raise ValueError("pyshtools: expected a normalization other than 'unnorm' for complex coefficients; convert to '4pi'")
    # For a real function, c_l,-m = (-1)**m conj(c_lm).
    orders = np.arange(array.shape[1])
    off = abs(array[1] - np.where(orders % 2, -1.0, 1.0) * array[0].conj())
    off[:, 0] = abs(array[0, :, 0].imag)
    if not (np.tril(off) <= _REAL * abs(array).max()).all():
        raise ValueError(
            "pyshtools: expected complex coefficients of a real function, with c[l, -m] = (-1)**m conj(c[l, m]); "
            "found those of a complex function"
        )
    factor = np.where(orders == 0, 1, np.sqrt(2))
    return np.stack([factor * array[0].real, np.where(orders == 0, 0, -factor * array[0].imag)])
