"""Basis stores: folders with the basis that all fits over one sphere share."""

from __future__ import annotations

import json
import os
from typing import Any

from . import _arrays, _core
from ._model import sphere_arrays
from ._progress import Progress, callback
from ._surface import Path


class Store:
    """A folder with the basis of one or more spheres, built once for all fits over them.

    Parameters
    ----------
    path : str or os.PathLike
        The folder; `build` creates it if needed.

    Examples
    --------
    >>> import tempfile, spharm_rs as sp
    >>> surface, sphere = sp.example_surface(3)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     store = sp.Store(folder)
    ...     report = store.build(sphere, 10)
    ...     model = sp.fit(surface, sphere, 10, store=store, passes=2)
    >>> report["degrees_built"]
    11
    """

    def __init__(self, path: Path) -> None:
        #: The folder.
        self.path: str = os.fspath(path)

    def __repr__(self) -> str:
        return f"Store({self.path!r})"

    def build(
        self,
        sphere: Any,
        max_degree: int,
        *,
        dtype: str = "f64",
        memory: int | str = "512MiB",
        allow_large: bool = False,
        threads: int | None = None,
        progress: Progress = None,
    ) -> dict[str, Any]:
        """Computes the basis of a sphere to a degree. Existing degrees are kept, so a build can be resumed and extended.

        Parameters
        ----------
        sphere : Surface or what `as_surface` takes, or ndarray of float, (n, 3)
        max_degree : int
            Highest degree L, inclusive; the basis takes ``8 n (L + 1)**2`` bytes of disk in f64.
        dtype : {"f64", "f32"}
        memory : int or str
            Memory budget in bytes.
        allow_large : bool
            Allow a basis larger than 64 GiB or than the free disk space.
        threads : int, optional
        progress : bool or callable, optional

        Returns
        -------
        dict
            ``scheme_key``, ``degrees_built``, ``degrees_present`` and ``bytes``.
        """
        directions, faces, _ = sphere_arrays(sphere)
        report = _core.store_build(
            self.path,
            directions,
            faces,
            _arrays.whole("max_degree", max_degree),
            dtype=str(dtype),
            memory=_arrays.size(memory) or 0,
            allow_large=bool(allow_large),
            threads=_arrays.threads(threads),
            progress=callback(progress),
        )
        found: dict[str, Any] = json.loads(report)
        return found

    def factor(
        self,
        sphere: Any,
        max_degree: int,
        *,
        dtype: str = "f64",
        basis_dtype: str = "f64",
        smoothness: float = 0.0,
        memory: int | str = "512MiB",
        allow_large: bool = False,
        threads: int | None = None,
        progress: Progress = None,
    ) -> dict[str, Any]:
        """Computes the Cholesky factor of a sphere's normal equations, so that ``fit(method="lsq")`` only solves
        triangular systems.

        Parameters
        ----------
        sphere, dtype, memory, allow_large, threads, progress
            As for `build`; the basis itself isn't needed.
        max_degree : int
            Highest degree L; the factor takes ``4 (L + 1)**4`` bytes of disk in f64.
        basis_dtype : {"f64", "f32"}
            Scalar type of the scheme with which the factor is stored.
        smoothness : float
            Penalty of the fits that use the factor.

        Returns
        -------
        dict
            ``present``, whether the factor existed already; ``condition`` and ``bytes``.
        """
        directions, faces, _ = sphere_arrays(sphere)
        report = _core.store_factor(
            self.path,
            directions,
            faces,
            _arrays.whole("max_degree", max_degree),
            dtype=str(dtype),
            basis_dtype=str(basis_dtype),
            smoothness=float(smoothness),
            memory=_arrays.size(memory) or 0,
            allow_large=bool(allow_large),
            threads=_arrays.threads(threads),
            progress=callback(progress),
        )
        found: dict[str, Any] = json.loads(report)
        return found

    def schemes(self) -> list[dict[str, Any]]:
        """Lists the sampling schemes: key, directions, highest degree, type, factors, damaged files, bytes."""
        found: list[dict[str, Any]] = json.loads(_core.store_schemes(self.path))
        return found

    def verify(self, *, threads: int | None = None, progress: Progress = None) -> list[str]:
        """Checks every byte of the files against its hash, and returns the errors; an empty list if there are none."""
        threads = _arrays.threads(threads)
        return _core.store_verify(self.path, threads=threads, progress=callback(progress))
