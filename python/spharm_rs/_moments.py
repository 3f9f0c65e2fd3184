"""Sums over samples, for fits of more samples than fit into memory or onto one machine."""

from __future__ import annotations

import os
from typing import Any, Iterable, Sequence

from numpy.typing import ArrayLike

from . import _arrays, _core
from ._fit import _model, _settings
from ._model import Model
from ._progress import Progress, callback
from ._surface import Path


class Moments:
    """The sums over samples from which least-squares fits to a degree are computed; sums of parts of the samples can be
    added.

    They are the moments of the weights to degree 2L, the right-hand sides to degree L, ``sum w f**2`` and the number of
    samples. Their size depends on the degree, not on the number of samples. ``spharm moments`` computes them from files
    too large for memory, and `spharm_rs.dask` from Dask arrays.

    Parameters
    ----------
    directions : array_like of float, (n, 3)
        Vectors of any nonzero length.
    values : array_like of float, (n,) or (n, c)
    weights : array_like of float, (n,), optional
        Finite and not negative; by default 1. The standard errors of `fit` assume that they are proportional to the
        inverse variances of the values. With weights that only even out the density of the samples, such as areas,
        cos(latitude) or lower weights of dense tracks, standard errors are too small, up to three times.
    max_degree : int
        Highest degree L of fits, inclusive.
    channels : sequence of str, optional
        Names of the channels; by default numbers. If they are ``x``, ``y`` and ``z``, the model is a surface.
    whole : str, optional
        Name of the data of which these samples are a part; by default the samples are identified by their bytes.
    shard : (int, int)
        The part's number, from 0, and the number of parts. `merge` refuses duplicate parts, and data of which a part is
        missing.
    threads : int, optional
        Number of threads; by default all CPUs.
    progress : bool or callable, optional

    Examples
    --------
    >>> import numpy as np, spharm_rs as sp
    >>> directions = sp.icosphere(4).vertices
    >>> height = directions[:, 2] ** 2
    >>> parts = [sp.Moments(directions[i::2], height[i::2], max_degree=6, whole="z2", shard=(i, 2)) for i in range(2)]
    >>> moments = sp.Moments.merge(parts)
    >>> moments
    Moments(2562 samples, degree 6, 1 channel)
    >>> model = moments.fit(4)
    >>> bool(abs(model.coefficients[6, 0] - 2 / 3 * np.sqrt(4 * np.pi / 5)) < 1e-9)
    True
    """

    _inner: _core.Moments

    def __init__(
        self,
        directions: ArrayLike,
        values: ArrayLike,
        weights: ArrayLike | None = None,
        *,
        max_degree: int,
        channels: Sequence[str] | None = None,
        whole: str | None = None,
        shard: tuple[int, int] = (0, 1),
        threads: int | None = None,
        progress: Progress = None,
    ) -> None:
        at, array = _arrays.positions("directions", directions), _arrays.channels("values", values)
        if isinstance(channels, str):
            raise ValueError(f"channels: expected a list of names, found {channels!r}")
        names = map(str, range(array.shape[1])) if channels is None else channels
        index, of = shard
        self._inner = _core.Moments(
            at,
            array,
            None if weights is None else _arrays.weights(weights, len(at)),
            _arrays.whole("max_degree", max_degree),
            list(names),
            whole=whole,
            shard=(_arrays.whole("shard", index), _arrays.whole("shard", of, 1)),
            threads=_arrays.threads(threads),
            progress=callback(progress),
        )

    @classmethod
    def _of(cls, core: _core.Moments) -> Moments:
        moments = cls.__new__(cls)
        moments._inner = core
        return moments

    def __repr__(self) -> str:
        channels = "1 channel" if len(self.channels) == 1 else f"{len(self.channels)} channels"
        return f"Moments({self.samples} samples, degree {self.max_degree}, {channels})"

    def __reduce__(self) -> Any:
        return _unpickled, (self._inner.to_bytes(),)

    @property
    def max_degree(self) -> int:
        """Highest degree L of fits."""
        return self._inner.max_degree

    @property
    def channels(self) -> list[str]:
        """Names of the channels."""
        return self._inner.channels

    @property
    def samples(self) -> int:
        """Number of samples, including those of weight 0."""
        return self._inner.samples

    @property
    def weight(self) -> float:
        """Sum of the weights."""
        return self._inner.weight

    @property
    def scheme(self) -> str | None:
        """Key of the samples' sampling scheme, the same as in a store with ``dtype="f64"``.

        Files of ``spharm moments --sphere`` have a key. None for samples from arrays, and for sums over several
        schemes.
        """
        return self._inner.scheme

    @classmethod
    def merge(cls, parts: Iterable[Moments], *, partial: bool = False) -> Moments:
        """Adds the moments of parts.

        Parameters
        ----------
        parts : iterable of Moments
            Moments with the same degree and channels, and no samples in common.
        partial : bool
            Add the given parts even if other parts are missing.

        Returns
        -------
        Moments
        """
        return cls._of(_core.Moments.merge([part._inner for part in parts], partial=bool(partial)))

    def fit(
        self,
        max_degree: int | None = None,
        *,
        smoothness: float | str | None = None,
        denoise: bool = False,
        stderr: bool = False,
        tolerance: float = 1e-10,
        max_iterations: int = 3000,
        preconditioner: str = "auto",
        strict: bool = False,
        memory: int | str | None = None,
        threads: int | None = None,
        progress: Progress = None,
    ) -> Model:
        """Fits the samples by least squares.

        Parameters
        ----------
        max_degree : int, optional
            Highest degree; at most, and by default, the degree of the moments.
        stderr : bool
            Compute standard errors of the coefficients. They are valid only if the weights are proportional to the
            inverse variances of the values; see ``weights`` of this class.
        smoothness, denoise, tolerance, max_iterations, preconditioner, strict, memory, threads, progress
            As for `spharm_rs.fit`.

        Returns
        -------
        Model
            Its ``report`` has ``rms``, ``explained``, ``largest_gap``, ``scheme_key`` and ``solver``.

        Raises
        ------
        ValueError
            If `stderr`, `denoise` or ``smoothness="auto"`` is given, and the mean of the values is so large that
            rounding errors hide the residual. Subtract a constant, such as the mean, from the values of all parts.

        Warns
        -----
        SpharmWarning
            If rounding errors hide the residual, so that ``rms`` and ``explained`` are None; or if parts of the samples
            are missing.
        """
        settings = _settings(
            self.max_degree if max_degree is None else max_degree,
            0,
            smoothness=smoothness,
            denoise=denoise,
            stderr=stderr,
            tolerance=tolerance,
            max_iterations=max_iterations,
            preconditioner=preconditioner,
            strict=strict,
            memory=memory,
            threads=threads,
        )
        return _model(self._inner.fit(settings, callback(progress)))

    def save(self, path: Path, *, overwrite: bool = False) -> None:
        """Writes a file of moments, atomically; ``spharm fit --moments`` and ``spharm moments merge`` can read it.

        Parameters
        ----------
        path : str or os.PathLike
            By convention ``NAME.moments``.
        overwrite : bool
            Replace an existing file.
        """
        self._inner.write(os.fspath(path), overwrite=bool(overwrite))

    @classmethod
    def load(cls, path: Path) -> Moments:
        """Reads a file of moments, written by `save` or ``spharm moments``.

        Parameters
        ----------
        path : str or os.PathLike

        Returns
        -------
        Moments
        """
        return cls._of(_core.Moments.read(os.fspath(path)))


def _unpickled(data: bytes) -> Moments:
    return Moments._of(_core.Moments.from_bytes(data))
