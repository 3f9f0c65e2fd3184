"""Finds poses of surfaces relative to others, and registers templates."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from typing import Any, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _arrays, _core
from ._arrays import Floats, Triangles
from ._model import Model
from ._progress import Progress, callback
from ._shape_poses import SimilarityTransform
from ._surface import Metadata, Surface, as_surface
from ._warnings import warn

Flags = NDArray[np.bool_]
Given = Union[str, "tuple[Floats, Triangles, Metadata]"]


def _level(max_degree: int) -> int:
    """Returns the icosphere's default number of subdivisions for a degree, the same as in the library."""
    return 4 if max_degree <= 15 else 5 if max_degree <= 40 else 6


def given(surface: Any) -> Given:
    """Converts a surface for the extension module: to a path, which is read when needed, or to arrays."""
    if isinstance(surface, (str, os.PathLike)):
        path = os.fspath(surface)
        if not path.endswith(".npz"):
            return path
        surface = Model.load(path)
    if isinstance(surface, Model):
        if not surface.is_surface:
            raise ValueError(f"surfaces: expected surfaces, found a {surface!r}")
        surface = surface.surface(_level(surface.max_degree))
    mesh = as_surface(surface)
    return mesh.vertices, mesh.faces, mesh._meta


@dataclass(frozen=True, eq=False)
class Pose:
    """The pose of a surface relative to another surface.

    Attributes
    ----------
    transform : SimilarityTransform
        Transform from the surface's own frame to the target's.
    distance : float
        Root mean square distance of the surfaces after the transform, both ways, without the farthest tenth; in the
        target's unit.
    second : float
        The distance for the best other pose, whose rotation differs by 15 degrees or more; infinite if none was found.
        If it is hardly larger than ``distance``, the pose is in doubt.
    warnings : tuple of str
        A warning if the mirror image fits better without ``mirror``. It has also been issued as a `SpharmWarning`.
    """

    transform: SimilarityTransform
    distance: float
    second: float
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Registration:
    """A template registered to a surface.

    Attributes
    ----------
    surface : Surface
        The template's triangles, placed on the surface, in the surface's own frame.
    reached : ndarray of bool, (n,)
        Whether each vertex has a counterpart on the surface; if not, its place is a guess.
    transform : SimilarityTransform
        Transform from the surface's own frame to the template's; the identity with ``pose=False``.
    cover : dict
        ``rms``, ``most`` (99th percentile) and ``farthest``: distances of the surface from the registered template, in
        the surface's unit. ``unreached``: share of the surface's area that the template doesn't reach. ``turned``:
        number of triangles turned over.
    warnings : tuple of str
        A warning if the mirror image fits better without ``mirror``. It has also been issued as a `SpharmWarning`.
    """

    surface: Surface
    reached: Flags = field(repr=False)
    transform: SimilarityTransform = field(repr=False)
    cover: dict[str, Any]
    warnings: tuple[str, ...] = ()


def register(
    template: Any,
    surface: Any,
    *,
    pose: bool = True,
    scale: bool = False,
    mirror: bool = False,
    masked: ArrayLike | None = None,
    threads: int | None = None,
    progress: Progress = None,
) -> Registration:
    """Moves a template onto a surface of any topology, so that its vertices lie at corresponding places.

    Parameters
    ----------
    template, surface : str, os.PathLike, Surface, Model or what `spharm_rs.as_surface` takes
        Models are evaluated on an icosphere.
    pose : bool
        First find the surface's pose; without this, both must be in the same pose.
    scale : bool
        Also scale the surface to the template's size.
    mirror : bool
        Also match mirror images.
    masked : array_like of bool, (n,), optional
        Vertices of the template without a counterpart on surfaces, such as lids of holes; the registration leaves them
        free.
    threads : int, optional
    progress : bool or callable, optional

    Returns
    -------
    Registration

    Examples
    --------
    >>> import numpy as np, spharm_rs as sp
    >>> ball = sp.icosphere(3)
    >>> found = sp.shape.register(ball, sp.Surface(sp.icosphere(4).vertices * [1.2, 1, 0.9], sp.icosphere(4).faces))
    >>> bool(found.reached.all()) and found.cover["rms"] < 0.02
    True
    """
    vertices, faces, reached, transform, cover, warnings = _core.shape_register(
        given(template),
        given(surface),
        None if masked is None else _arrays.flags("masked", masked, masked=True).tolist(),
        pose=bool(pose),
        scale=bool(scale),
        mirror=bool(mirror),
        threads=_arrays.threads(threads),
        progress=callback(progress),
    )
    moved = SimilarityTransform._of(json.loads(transform))
    return Registration(Surface(vertices, faces), reached, moved, json.loads(cover), warn(warnings))


def pose(
    surface: Any,
    target: Any,
    *,
    scale: bool = False,
    mirror: bool = False,
    threads: int | None = None,
    progress: Progress = None,
) -> Pose:
    """Finds the pose of a surface relative to another surface from their shapes alone, for any topology, triangles and
    poses.

    Parameters
    ----------
    surface, target : str, os.PathLike, Surface, Model or what `spharm_rs.as_surface` takes
        Models are evaluated on an icosphere.
    scale : bool
        Scale the surface to the target's size.
    mirror : bool
        Also match mirror images.
    threads : int, optional
    progress : bool or callable, optional

    Returns
    -------
    Pose

    Examples
    --------
    >>> import numpy as np, spharm_rs as sp
    >>> surface, _ = sp.example_surface(4)
    >>> turned = sp.Surface(surface.vertices @ [[0, 1, 0], [-1, 0, 0], [0, 0, 1]] + [9, 0, 0], surface.faces)
    >>> found = sp.shape.pose(turned, surface)
    >>> bool(np.abs(found.transform.apply(turned).vertices - surface.vertices).max() < 0.01)
    True
    """
    transform, distance, second, warnings = _core.shape_pose(
        given(surface),
        given(target),
        scale=bool(scale),
        mirror=bool(mirror),
        threads=_arrays.threads(threads),
        progress=callback(progress),
    )
    return Pose(SimilarityTransform._of(json.loads(transform)), distance, second, warn(warnings))
