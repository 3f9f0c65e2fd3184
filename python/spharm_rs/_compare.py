"""Distances between surfaces."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from . import _arrays, _core
from ._arrays import Floats
from ._model import Model
from ._progress import Progress, callback
from ._surface import Path, Surface, as_surface


@dataclass(frozen=True, eq=False)
class Distances:
    """Distances between two surfaces.

    Attributes
    ----------
    msd, xsd : float
        Mean and maximal squared distance of corresponding vertices, with the first surface's bounding box scaled to
        volume 1 (Shen and Chung 2006, section 4.2); NaN if the meshes don't correspond.
    rms, max : float
        Root mean square and maximal distance of corresponding vertices, in the surfaces' unit.
    scale : float
        Cube root of the volume of the first surface's bounding box.
    per_vertex : ndarray of float, (n,)
        Distance of each vertex of the second surface from the corresponding vertex of the first one or, with
        ``surface_distance``, from the first surface.
    surface : dict or None
        Distances over the entire surfaces: ``mean``, ``rms``, ``percentile95``, ``hausdorff``, in the surfaces' unit.
    """

    msd: float
    xsd: float
    rms: float
    max: float
    scale: float
    per_vertex: Floats = field(repr=False)
    surface: dict[str, Any] | None = None


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
        Two models are compared at equal directions, the vertices of an icosphere; a model and a mesh at the mesh's vertices
        if the model was fitted to it, or else on an icosphere of 163,842 vertices.
    surface_distance : bool, optional
        Whether to measure the distance over the entire surfaces; by default only if their triangles differ.
    samples : int
        Approximate number of points on each surface for ``surface_distance``.
    mask : array_like of bool, (n,), or path, optional
        Vertices to compare, for meshes with the same triangles; a file as for `fit`. With ``surface_distance``, points are on
        the triangles whose three corners are kept, and their distances are those from the entire other surface.
    memory : int or str, optional
        Bytes that ``surface_distance`` may use, or ``"512MiB"``; by default the free memory.
    threads : int, optional
    progress : bool or callable, optional

    Returns
    -------
    Distances

    Raises
    ------
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
    """
    first, second = _surfaces(surface, other, threads)
    arrays = first.vertices, first.faces, second.vertices, second.faces
    kept = _arrays.mask(mask, len(first.vertices))
    corresponding = len(first.vertices) == len(second.vertices) and np.array_equal(first.faces, second.faces)
    if kept is not None and not corresponding:
        raise ValueError(f"mask: expected meshes with the same triangles, found {first!r} and {second!r}")
    between: dict[str, Any] | None = None
    each: Floats | None = None
    if not corresponding if surface_distance is None else surface_distance:
        count = _arrays.threads(threads)
        text, each = _core.surface_distance(
            *arrays,
            samples=_arrays.whole("samples", samples, 1),
            mask=kept,
            memory=_arrays.size(memory),
            threads=count,
            progress=callback(progress),
        )
        between = json.loads(text)
    if between is not None and each is not None and not corresponding:
        nan = float("nan")
        return Distances(nan, nan, nan, nan, between["scale"], each, between)
    if not corresponding and between is None:
        raise ValueError(
            f"other: the triangles of {second!r} differ from the triangles of {first!r}; "
            "without surface_distance=False, the distance between the surfaces is measured"
        )
    (msd, xsd, rms, largest, scale), _, by_vertex = _core.compare(*arrays, kept)
    return Distances(msd, xsd, rms, largest, scale, by_vertex if each is None else each, between)


#: Subdivisions of the icosphere on which models are compared: 163,842 vertices, as by ``spharm compare``.
_LEVEL = 7


def _surfaces(surface: Any, other: Any, threads: int | None) -> tuple[Surface, Surface]:
    """Returns the compared surfaces: corresponding ones for two models, and for a model over the sphere of the mesh."""
    for name, one in (("surface", surface), ("other", other)):
        if isinstance(one, Model) and not one.is_surface:
            raise ValueError(f"{name}: expected a surface, found a model of a signal, {one!r}")
    first, second = (None if isinstance(one, Model) else as_surface(one) for one in (surface, other))
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
