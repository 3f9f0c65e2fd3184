"""Fits many surfaces: over one sphere, or each over its own map."""

from __future__ import annotations

import os
import threading
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, Callable, Generator, Iterable, Iterator, Literal, TypedDict, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike

from . import _arrays, _core
from ._arrays import Floats
from ._fit import _model, _read, _settings, fit, refuse_both
from ._model import Model, seam_of, sphere_arrays
from ._progress import Callback, Progress, callback
from ._repair import changes_of, named_change
from ._store import Store
from ._surface import Metadata, Path, meta_of, meta_of_path, opened
from .errors import SpharmError

if TYPE_CHECKING:
    from typing_extensions import Unpack


class FitSettings(TypedDict, total=False):
    """Keyword arguments of `fit` that `fit_many` and `fit_each` pass on."""

    objective: str | None
    weights: str | ArrayLike
    mask: ArrayLike | Path | None
    smoothness: float | str | None
    denoise: bool
    stderr: bool
    hold_out: float | None
    surface_distance: bool
    method: str | None
    store: Path | Store | None
    passes: int | None
    granularity: int
    start_degree: int
    accelerate: bool
    tolerance: float
    max_iterations: int
    preconditioner: str
    strict: bool
    dtype: str | None
    memory: int | str | None
    threads: int | None


@overload
def fit_many(
    surfaces: ArrayLike | Iterable[Any],
    sphere: Any = None,
    max_degree: int = 20,
    *,
    on_error: Literal["raise"] = "raise",
    fix: bool = False,
    largest_repair: float | None = None,
    wrap: int | None = None,
    cut_handles: bool = False,
    progress: Progress = None,
    **settings: Unpack[FitSettings],
) -> list[Model]: ...


@overload
def fit_many(
    surfaces: ArrayLike | Iterable[Any],
    sphere: Any = None,
    max_degree: int = 20,
    *,
    on_error: Literal["collect"],
    fix: bool = False,
    largest_repair: float | None = None,
    wrap: int | None = None,
    cut_handles: bool = False,
    progress: Progress = None,
    **settings: Unpack[FitSettings],
) -> list[Model | Exception]: ...


def fit_many(
    surfaces: ArrayLike | Iterable[Any],
    sphere: Any = None,
    max_degree: int = 20,
    *,
    on_error: Literal["raise", "collect"] = "raise",
    fix: bool = False,
    largest_repair: float | None = None,
    wrap: int | None = None,
    cut_handles: bool = False,
    progress: Progress = None,
    **settings: Unpack[FitSettings],
) -> Any:
    """Fits many surfaces, or signals: over one sphere, whose transforms and factor they share, or each over its own map.

    Parameters
    ----------
    surfaces : array_like of float, (s, n, 3) or (s, n, c), or iterable
        As for `fit`; over a sphere, each has the sphere's vertices, and files of signals are read, too.
    sphere : Surface or what `as_surface` takes, Parametrization, or ndarray of float, (n, 3), optional
        The sphere of all surfaces. Without it, each surface is mapped to a sphere of its own, as by `fit_each`.
    max_degree : int
        Highest degree L, inclusive.
    on_error : {"raise", "collect"}
        Raise the error of a surface that can't be fitted; or put the exception in its place in the list, which needs
        surfaces without a common sphere.
    fix, largest_repair, wrap, cut_handles
        As for `fit`, without a sphere.
    progress : bool or callable, optional
    **settings
        The other arguments of `fit`.

    Returns
    -------
    list of Model
        In the order of the surfaces.

    Raises
    ------
    MeshError
        As for `fit`, also if a surface with triangles has other triangles than the sphere. Arrays of positions have no
        triangles of their own.

    Examples
    --------
    >>> import spharm_rs as sp
    >>> subjects = [sp.example_surface(3, seed)[0] for seed in range(3)]
    >>> models = sp.fit_many(subjects, sp.icosphere(3), 10)
    >>> len(models)
    3
    """
    _check_several(surfaces)
    if sphere is None:
        given = list(surfaces)  # type: ignore[arg-type]
        changes: Any = {"fix": fix, "largest_repair": largest_repair, "wrap": wrap, "cut_handles": cut_handles}
        found = fit_each(given, max_degree, on_error=on_error, **changes, **settings)
        shown = callback(progress)
        models = []
        for model in found:
            models.append(model)
            if shown is not None:
                shown("fit", len(models), len(given))
        return models
    if on_error != "raise":
        raise ValueError("on_error: expected 'raise', because all surfaces are fitted together over the sphere")
    changes_of(fix, largest_repair, wrap, cut_handles)
    if (name := named_change(fix, wrap, cut_handles)) is not None:
        raise ValueError(f"{name}: expected no sphere, because this option changes the surfaces")
    sphere = opened(sphere)
    directions, faces, parametrized = sphere_arrays(sphere)
    kinds = set()
    arrays: list[Floats] = []
    metas: list[Metadata] = []
    triangles: Any = None
    for surface in surfaces:  # type: ignore[union-attr]
        refuse_both("surfaces", surface)
        image = _arrays.is_image(surface) and not _arrays.has_mesh(surface)
        if image or isinstance(surface, np.ndarray):
            arrays.append(_arrays.channels("surfaces", surface))
            metas.append(None)
            kinds.add(isinstance(surface, np.ndarray) and surface.ndim == 2 and surface.shape[1] == 3)
        else:
            values, own, meta = _read(surface, sphere, True)
            arrays.append(values)
            metas.append(meta)
            kinds.add(own is not None)
            if own is None:
                continue
            if faces is not None:
                name = f"surfaces[{len(arrays) - 1}]"
                _refuse_other_triangles(name, values, own, (meta, meta_of(sphere)), directions, faces)
            elif triangles is not None and not np.array_equal(triangles, own):
                raise ValueError(f"surfaces: the triangles of surface {len(arrays) - 1} differ from those of the surfaces before it")
            triangles = own
    if len(kinds) > 1:
        raise ValueError("surfaces: expected surfaces or signals, found both")
    if not arrays:
        return []
    checked = _settings(max_degree, len(directions), **settings)
    fits = _core.fit_many(
        arrays,
        directions,
        triangles if faces is None else faces,
        metadata=(metas, meta_of(sphere)),
        surface=kinds.pop(),
        parametrized=parametrized,
        seam=seam_of(sphere),
        settings=checked,
        progress=callback(progress),
    )
    return [_model(fitted) for fitted in fits]


def _refuse_other_triangles(
    name: str, values: Floats, own: Any, metadata: tuple[Metadata, Metadata], directions: Floats, faces: Any
) -> None:
    """Refuses a surface whose triangles aren't the sphere's, as `fit` does; a surface without a file gets `name`."""
    # A wrong number of vertices is refused by the fits themselves.
    if len(values) != len(directions) or np.array_equal(own, faces):
        return
    of_surface, of_sphere = metadata
    if of_surface is None or of_surface["path"] is None:
        of_surface = meta_of_path(name)
    # `fit` compares the triangles before it fits. The positions don't matter, and those of the surface may be NaN.
    _core.fit(
        directions,
        own,
        directions,
        faces,
        metadata=(of_surface, of_sphere),
        surface=True,
        parametrized=False,
        seam=None,
        changes=changes_of(False, None, None, False),
        settings=_settings(0, len(directions), objective="vertices", surface_distance=False),
    )


@overload
def fit_each(
    surfaces: Iterable[Any],
    max_degree: int = 20,
    *,
    on_error: Literal["raise"] = "raise",
    fix: bool = False,
    largest_repair: float | None = None,
    wrap: int | None = None,
    cut_handles: bool = False,
    **settings: Unpack[FitSettings],
) -> Iterator[Model]: ...


@overload
def fit_each(
    surfaces: Iterable[Any],
    max_degree: int = 20,
    *,
    on_error: Literal["collect"],
    fix: bool = False,
    largest_repair: float | None = None,
    wrap: int | None = None,
    cut_handles: bool = False,
    **settings: Unpack[FitSettings],
) -> Iterator[Model | Exception]: ...


def fit_each(
    surfaces: Iterable[Any],
    max_degree: int = 20,
    *,
    on_error: Literal["raise", "collect"] = "raise",
    fix: bool = False,
    largest_repair: float | None = None,
    wrap: int | None = None,
    cut_handles: bool = False,
    **settings: Unpack[FitSettings],
) -> Any:
    """Maps and fits surfaces, and yields each model when it is ready, in the order of the surfaces.

    Several surfaces are fitted at a time, each by one thread. Surfaces are taken from the iterable as they are needed, so
    that a generator may read them from files. Each surface has a map of its own, so equal directions of two models are
    different places; for means, modes and tests, use `shape.correspond`.

    Parameters
    ----------
    surfaces : iterable of Surface or what `as_surface` takes
        Surfaces without spheres.
    max_degree : int
        Highest degree L, inclusive.
    on_error : {"raise", "collect"}
        Raise the error of a surface that can't be fitted; or yield the exception and go on.
    fix, largest_repair, wrap, cut_handles
        As for `fit`.
    **settings
        The other arguments of `fit`; ``threads`` is the number of surfaces that are fitted at a time, by default the number
        of CPUs, and each may take ``memory``.

    Yields
    ------
    Model
        Or, with ``on_error="collect"``, the exception of a surface that can't be fitted.

    Examples
    --------
    >>> import spharm_rs as sp
    >>> meshes = [sp.example_surface(3, seed)[0] for seed in range(3)]
    >>> [model.max_degree for model in sp.fit_each(meshes, 10)]
    [10, 10, 10]
    """
    _check_several(surfaces)
    collects = _arrays.on_error(on_error)
    changes_of(fix, largest_repair, wrap, cut_handles)
    each: dict[str, Any] = {**settings, "max_degree": max_degree}
    each.update(fix=fix, largest_repair=largest_repair, wrap=wrap, cut_handles=cut_handles)
    workers = _arrays.threads(each.pop("threads", None)) or processors()

    def work(surface: Any, check: Callback) -> Model | Exception:
        return fit(surface, threads=1, progress=check, **each)

    return in_parallel(work, surfaces, workers, (lambda _, error: error) if collects else None)


def _check_several(surfaces: Any) -> None:
    if isinstance(surfaces, (str, os.PathLike)) or not hasattr(surfaces, "__iter__"):
        raise ValueError(f"surfaces: expected several surfaces or signals, found one {type(surfaces).__name__}; give a list")


def processors() -> int:
    """Returns the number of processors that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return (os.cpu_count() or 1) if affinity is None else len(affinity(0))


class _Stopped(Exception):
    """Ends a fit whose result is no longer needed."""


_Item = TypeVar("_Item")
_Found = TypeVar("_Found")


def in_parallel(
    work: Callable[[_Item, Callback], _Found],
    items: Iterable[_Item],
    workers: int,
    failed: Callable[[_Item, Exception], _Found] | None,
) -> Generator[_Found, None, None]:
    """Applies `work` to several items at a time, and yields the results in order.

    `work` also gets a function that it must call from time to time, which stops it if its result is no longer needed.
    An error is raised or, if `failed` is given, replaced by the result of `failed`.
    """
    stopped = threading.Event()

    def check(*_: Any) -> None:
        if stopped.is_set():
            raise _Stopped

    left = iter(items)
    running: deque[tuple[_Item, Future[_Found]]] = deque()
    with ThreadPoolExecutor(workers) as pool:
        try:
            more = True
            while more or running:
                # One item more than workers, so that no worker idles while the caller uses a result.
                while more and len(running) <= workers:
                    try:
                        item = next(left)
                        running.append((item, pool.submit(work, item, check)))
                    except StopIteration:
                        more = False
                if not running:
                    break
                item, future = running.popleft()
                try:
                    found = future.result()
                except (SpharmError, ValueError, OSError) as error:
                    if failed is None:
                        raise
                    found = failed(item, error)
                yield found
        finally:
            stopped.set()
            for _, future in running:
                future.cancel()
