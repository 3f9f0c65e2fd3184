"""Distances between surfaces."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from . import _arrays, _core
from ._arrays import Floats
from ._model import Model, mapped_apart
from ._progress import Progress, callback
from ._surface import Path, Surface, surface_of
from ._warnings import warn


@dataclass(frozen=True, eq=False, repr=False)
class Distances:
    """Distances between two surfaces: of corresponding vertices, between the surfaces, or both.

    Attributes
    ----------
    msd, xsd : float
        Mean and maximal squared distance of corresponding vertices, with the first surface's bounding box scaled to
        volume 1 (Shen and Chung 2006, section 4.2); NaN if the meshes don't correspond.
    rms, max : float
        Root mean square and maximal distance, in the surfaces' unit: of corresponding vertices or, if the meshes don't
        correspond, between the surfaces (``surface["rms"]`` and ``surface["hausdorff"]``). `corresponding` tells which.
    scale : float
        Cube root of the volume of the first surface's bounding box.
    per_vertex : ndarray of float, (n,)
        Distance of each vertex of the second surface from the corresponding vertex of the first one or, with
        ``surface_distance``, from the first surface.
    surface : dict or None
        Distances over the entire surfaces: ``mean``, ``rms``, ``percentile95``, ``hausdorff``, in the surfaces' unit.
        None if only corresponding vertices were compared.
    corresponding : bool
        Whether ``msd``, ``xsd``, ``rms`` and ``max`` are of corresponding vertices.
    """

    msd: float
    xsd: float
    rms: float
    max: float
    scale: float
    per_vertex: Floats
    surface: dict[str, Any] | None = None
    corresponding: bool = True

    def __repr__(self) -> str:
        found = [f"corresponding vertices: rms {self.rms:.4g}, max {self.max:.4g}"] if self.corresponding else []
        if self.surface is not None:
            names = ("mean", "rms", "percentile95", "hausdorff")
            found.append("between surfaces: " + ", ".join(f"{name} {self.surface[name]:.4g}" for name in names))
        return f"Distances({'; '.join(found)})"

    @property
    def mean(self) -> float:
        """Mean distance between the surfaces, in their unit; NaN if `surface` is None."""
        return self._between("mean")

    @property
    def percentile95(self) -> float:
        """95th percentile of the distances between the surfaces, in their unit; NaN if `surface` is None."""
        return self._between("percentile95")

    @property
    def hausdorff(self) -> float:
        """Hausdorff distance between the surfaces, in their unit; NaN if `surface` is None."""
        return self._between("hausdorff")

    def _between(self, name: str) -> float:
        return float("nan") if self.surface is None else float(self.surface[name])


def compare(
    surface: Any,
    other: Any,
    *,
    surface_distance: bool | None = None,
    samples: int = 100_000,
    mask: ArrayLike | Path | None = None,
    memory: int | str | None = None,
    threads: int | None = None,
    progress: Progress = None,
) -> Distances:
    """Measures the distance between two surfaces.

    Parameters
    ----------
    surface, other : Model, Surface, or what `as_surface` takes
        Two models are compared at equal directions, the vertices of an icosphere. A model and a mesh are compared at
        the mesh's vertices if the model was fitted to it, otherwise on an icosphere of 163,842 vertices. For
        ``surface_distance=True`` of closed surfaces without a mask, models are always evaluated on this icosphere,
        because the flat triangles of a coarser mesh would count as a distance. The exception are models whose handles
        were cut. If two models' surfaces were mapped separately, equal directions don't correspond, so the distance
        between the surfaces is measured.
    surface_distance : bool, optional
        Whether to measure the distance over the entire surfaces; by default only if the surfaces don't correspond: if their
        triangles differ, or for models mapped separately. With False, such models are compared at equal directions, with a
        warning. If two meshes have the same triangles but are much closer to each other than their vertices, there is a
        warning, too.
    samples : int
        Approximate number of points on each surface for ``surface_distance``.
    mask : array_like of bool, (n,), or path, optional
        Vertices to compare, for surfaces that correspond; a file as for `fit`. With ``surface_distance``, points are on
        the triangles whose three corners are kept, and their distances are those from the entire other surface.
    memory : int or str, optional
        Bytes that ``surface_distance`` may use, or ``"512MiB"``; by default the free memory. The memory for evaluating
        models isn't included.
    threads : int, optional
    progress : bool or callable, optional

    Returns
    -------
    Distances

    Raises
    ------
    ValueError
        If a mask, or ``surface_distance=False``, is given for meshes whose triangles differ; or a mask for models mapped
        separately.
    MemoryBudgetError
        If the budget is too small; the exception has ``budget`` and ``needed``.

    Examples
    --------
    >>> import spharm_rs as sp
    >>> surface, sphere = sp.example_surface(4)
    >>> model = sp.fit(surface, sphere, 15)
    >>> found = sp.compare(surface, model, surface_distance=True)
    >>> found.msd < 1e-3 and found.surface["rms"] <= found.rms
    True
    >>> other = sp.compare(surface, model.surface(5))
    >>> other.corresponding, other.rms < other.percentile95 < other.max
    (False, True)
    """
    surface_distance = None if surface_distance is None else bool(surface_distance)
    apart = isinstance(surface, Model) and isinstance(other, Model) and mapped_apart(surface, other)
    if apart and surface_distance is False:
        warn([_APART])
    elif apart and mask is not None:
        raise ValueError("mask: expected models whose directions correspond, found models of surfaces mapped separately")
    first, second = _surfaces(surface, other, threads)
    arrays = first.vertices, first.faces, second.vertices, second.faces
    kept = _arrays.mask(mask, len(first.vertices))
    corresponding = len(first.vertices) == len(second.vertices) and np.array_equal(first.faces, second.faces)
    if surface_distance is not False:
        corresponding = corresponding and not apart
    if kept is not None and not corresponding:
        raise ValueError(f"mask: expected meshes with the same triangles, found {first!r} and {second!r}")
    between: dict[str, Any] | None = None
    each: Floats | None = None
    if not corresponding if surface_distance is None else surface_distance:
        asked: Any = {"memory": _arrays.size(memory), "threads": _arrays.threads(threads), "progress": callback(progress)}
        points = _arrays.whole("samples", samples, 1)
        finer = [first, second]
        if kept is None:
            finer = [_finer(first, surface, threads), _finer(second, other, threads)]
        smooth = finer[0].vertices, finer[0].faces, finer[1].vertices, finer[1].faces
        text, each = _core.surface_distance(*smooth, samples=points, mask=kept, **asked)
        between = json.loads(text)
        if finer[1] is not second:
            _, each = _core.surface_distance(*smooth[:2], second.vertices, second.faces, samples=1, mask=None, **asked)
    if between is not None and each is not None and not corresponding:
        nan = float("nan")
        return Distances(nan, nan, between["rms"], between["hausdorff"], between["scale"], each, between, False)
    if not corresponding and between is None:
        raise ValueError(
            f"other: the triangles of {second!r} differ from the triangles of {first!r}; "
            "omit surface_distance=False to measure the distance between the surfaces"
        )
    meshes = not isinstance(surface, Model) and not isinstance(other, Model)
    (msd, xsd, rms, largest, scale), _, by_vertex, unpaired = _core.compare(*arrays, kept, meshes and between is None)
    warn([] if unpaired is None else [unpaired])
    return Distances(msd, xsd, rms, largest, scale, by_vertex if each is None else each, between)


_APART = (
    "the models' surfaces were mapped separately, so equal directions don't correspond; omit surface_distance=False to measure "
    "the distance between the surfaces"
)


def _finer(evaluated: Surface, given: Any, threads: int | None) -> Surface:
    """Returns the surface of a model on a fine icosphere, if it was evaluated at the vertices of a coarser mesh."""
    if not isinstance(given, Model) or given._inner.seam is not None or len(evaluated.vertices) >= _FINE:
        return evaluated
    # Beyond the rim of an open surface, the model is an extrapolation. A closed sphere has 2 n - 4 triangles.
    own = given.sphere
    if own is not None and len(own.faces) != 2 * len(own.vertices) - 4:
        return evaluated
    return given.surface(_LEVEL, threads=threads)


#: Subdivisions of the icosphere on which models are compared: 163,842 vertices, as by ``spharm compare``.
_LEVEL = 7
_FINE = 10 * 4**_LEVEL + 2


def _surfaces(surface: Any, other: Any, threads: int | None) -> tuple[Surface, Surface]:
    """Returns the surfaces to compare, which correspond for two models, and for a model and the mesh to which it was
    fitted."""
    for name, one in (given := (("surface", surface), ("other", other))):
        if isinstance(one, Model) and not one.is_surface:
            raise ValueError(f"{name}: expected a surface, found a model of a signal, {one!r}")
    first, second = (None if isinstance(one, Model) else surface_of(name, one) for name, one in given)
    return (
        _evaluated(surface, second, threads) if first is None else first,
        _evaluated(other, first, threads) if second is None else second,
    )


def _evaluated(model: Model, mesh: Surface | None, threads: int | None) -> Surface:
    """Returns a model's surface over its own sphere if it has the mesh's triangles there, or else on an icosphere."""
    # Over another sphere, a surface whose handles were cut has caps over the cuts.
    cut = model._inner.seam is not None
    own = model.sphere
    of_mesh = own is not None and mesh is not None and np.array_equal(own.faces, mesh.faces)
    return model.surface(None if cut or of_mesh else _LEVEL, threads=threads)
