"""Fast transforms at scattered directions."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from . import _arrays, _core
from ._arrays import Floats


class Transform:
    """Synthesis of real spherical harmonics at scattered directions, and its adjoint.

    With the basis matrix A, (n, K): `synthesis` is ``A x``, `adjoint` is ``A.T r``, and `normal` is ``A.T diag(w) A
    x``; none of them forms A. Method: Reinecke, Belkner and Carron (A&A 678, 2023).

    `solve` uses the planned transform. If a call computes moments of the directions, the transform keeps them for later
    calls with the same weights, in about ``300 * (L + 1)**2`` bytes for one channel, and more for several. Therefore two
    calls with equal values may differ by an amount within the tolerance.

    Parameters
    ----------
    directions : array_like of float, (n, 3)
        Vectors of any nonzero length.
    max_degree : int
        Highest degree L, inclusive; ``K = (L + 1)**2``.
    accuracy : float
        Relative accuracy, from 1e-13 to 1e-3.
    channels : int
        Number of channels transformed together: a larger number takes more memory and less time.
    threads : int, optional
        Number of threads; by default all CPUs.

    Examples
    --------
    >>> import numpy as np, spharm_rs as sp
    >>> transform = sp.Transform(sp.icosphere(3).vertices, 10)
    >>> transform.shape
    (642, 121)
    >>> x, r = np.ones((121, 1)), np.ones((642, 1))
    >>> bool(np.isclose(np.vdot(transform.synthesis(x), r), np.vdot(x, transform.adjoint(r))))
    True
    """

    def __init__(
        self,
        directions: ArrayLike,
        max_degree: int,
        *,
        accuracy: float = 1e-12,
        channels: int = 3,
        threads: int | None = None,
    ) -> None:
        #: Directions as given by the caller, (n, 3).
        self.directions = _arrays.positions("directions", directions)
        self._inner = _core.Transform(
            self.directions,
            _arrays.whole("max_degree", max_degree),
            accuracy=float(accuracy),
            channels=_arrays.whole("channels", channels, 1),
            threads=_arrays.threads(threads),
        )

    def __repr__(self) -> str:
        return f"Transform({self.shape[0]} directions, degree {self.max_degree})"

    @property
    def max_degree(self) -> int:
        """Highest degree L."""
        return self._inner.max_degree

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of the basis matrix: number of directions, and number of coefficients per channel."""
        return self._inner.directions, (self.max_degree + 1) ** 2

    def _call(self, method: Any, what: str, values: ArrayLike, rows: int, *more: Any) -> Floats:
        array = _arrays.channels(what, values)
        if len(array) != rows:
            raise ValueError(f"{what}: expected shape ({rows},) or ({rows}, c), found {np.shape(values)}")
        found: Floats = method(array, *more)
        return found[:, 0] if np.ndim(values) == 1 else found

    def synthesis(self, coefficients: ArrayLike) -> Floats:
        """Evaluates functions at the directions.

        Parameters
        ----------
        coefficients : array_like of float, (K,) or (K, c)

        Returns
        -------
        ndarray of float, (n,) or (n, c)
        """
        return self._call(self._inner.synthesis, "coefficients", coefficients, self.shape[1])

    def adjoint(self, samples: ArrayLike) -> Floats:
        """Applies the transpose of `synthesis`. The transpose isn't the inverse.

        Parameters
        ----------
        samples : array_like of float, (n,) or (n, c)

        Returns
        -------
        ndarray of float, (K,) or (K, c)
        """
        return self._call(self._inner.adjoint, "samples", samples, self.shape[0])

    def normal(self, coefficients: ArrayLike, weights: ArrayLike | None = None) -> Floats:
        """Applies `synthesis`, multiplies by weights, and applies `adjoint`; faster than separate calls.

        Parameters
        ----------
        coefficients : array_like of float, (K,) or (K, c)
        weights : array_like of float, (n,), optional
            Weights of the directions, finite and not negative; by default 1.

        Returns
        -------
        ndarray of float, (K,) or (K, c)
        """
        given = None if weights is None else _arrays.weights(weights, self.shape[0])
        return self._call(self._inner.normal, "coefficients", coefficients, self.shape[1], given)

    def as_linear_operator(self) -> Any:
        """Returns the basis matrix as a SciPy ``LinearOperator`` for its solvers, such as ``lsqr``."""
        from scipy.sparse.linalg import LinearOperator

        def of(method: Any) -> Any:
            return lambda x: method(np.ascontiguousarray(x))

        synthesis, adjoint = of(self.synthesis), of(self.adjoint)
        return LinearOperator(
            shape=self.shape,
            dtype=np.dtype(np.float64),
            matvec=lambda x: synthesis(np.ravel(x)),
            rmatvec=lambda x: adjoint(np.ravel(x)),
            matmat=synthesis,
            rmatmat=adjoint,
        )
