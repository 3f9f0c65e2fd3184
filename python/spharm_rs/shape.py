"""Analyses shapes of models from their coefficients, as ``spharm shape`` does.

>>> import spharm_rs as sp
>>> surface, sphere = sp.example_surface(4)
>>> model = sp.fit(surface, sphere, 15)
>>> measures = sp.shape.measure(model)
>>> curvature = sp.shape.geometry(model).mean_curvature
>>> smooth = sp.shape.smooth(model, fwhm=10)

A group of surfaces in any poses can be aligned; the mean, the modes of variation and group differences follow:

>>> group = [sp.fit(sp.example_surface(4, seed)[0], sphere, 6) for seed in range(6)]
>>> together = sp.shape.procrustes(group, templates=1)
>>> modes = sp.shape.pca(together.models)
>>> two = modes.shape([2])
>>> found = sp.shape.quality(together.models, modes=2, bands=20, sphere=3)
>>> found = sp.shape.group_test(together.models, groups=["a", "b"] * 3, sphere=3, level=0.2)
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any

from numpy.typing import ArrayLike

from . import _arrays, _core
from ._arrays import Floats
from ._model import Model, directions_at, sphere_arrays
from ._model import core as _model
from ._progress import Progress, callback
from ._shape_check import Check, check
from ._shape_correspond import Carried, Group, Member, correspond
from ._shape_describe import Description, Match, describe, nearest
from ._shape_inference import Cluster
from ._shape_modes import Modes, Quality, pca
from ._shape_morph import Morph, morph
from ._shape_poses import Alignment, Procrustes, SimilarityTransform, align, mean, procrustes, rotate
from ._shape_quality import Curve, GroupQuality, LandmarkErrors, quality
from ._shape_register import Pose, Registration, pose, register
from ._shape_result import TestResult
from ._shape_study import Field, group_test, measure_group
from ._surface import Surface
from ._warnings import warn

__all__ = [
    "Alignment",
    "Carried",
    "Check",
    "Cluster",
    "Curve",
    "Description",
    "Field",
    "Geometry",
    "Group",
    "GroupQuality",
    "LandmarkErrors",
    "Match",
    "Measures",
    "Member",
    "Modes",
    "Morph",
    "Pose",
    "Procrustes",
    "Quality",
    "Registration",
    "SimilarityTransform",
    "TestResult",
    "align",
    "check",
    "correspond",
    "describe",
    "even",
    "geometry",
    "group_test",
    "mean",
    "measure",
    "measure_group",
    "morph",
    "nearest",
    "pca",
    "pose",
    "procrustes",
    "quality",
    "register",
    "rotate",
    "smooth",
    "truncation_error",
]


@dataclass(frozen=True)
class Measures:
    """Area, volume and centroid of a model, in its unit.

    Attributes
    ----------
    area, volume : float
    centroid : tuple of float
        Centre of mass of the enclosed volume.
    sphericity : float
        ``(36 pi volume**2)**(1/3) / area``: 1 for a sphere, less for other shapes.
    area_change : float
        Relative change of the area between the last two grids.
    squeezed : float
        Share of the sphere where the area element is below a thousandth of its mean.
    inwards : bool
        Whether the normals of the parameterisation point inwards.
    """

    area: float
    volume: float
    centroid: tuple[float, float, float]
    sphericity: float
    area_change: float
    squeezed: float
    inwards: bool


@dataclass(frozen=True, eq=False)
class Geometry:
    """The geometry of a surface at n directions. Curvatures are positive where the surface is convex; see `geometry`.

    Attributes
    ----------
    positions, normals : ndarray of float, (n, 3)
    area_element, mean_curvature, gaussian_curvature, shape_index, curvedness : ndarray of float, (n,)
    principal_curvatures : ndarray of float, (n, 2)
        The larger curvature comes first.
    """

    positions: Floats
    normals: Floats
    area_element: Floats
    mean_curvature: Floats
    gaussian_curvature: Floats
    principal_curvatures: Floats
    shape_index: Floats
    curvedness: Floats


def _degree(model: Model, degree: int | None) -> int:
    return model.max_degree if degree is None else _arrays.whole("degree", degree)


def measure(
    model: Model,
    *,
    degree: int | None = None,
    tolerance: float = 1e-7,
    threads: int | None = None,
    progress: Progress = None,
) -> Measures:
    """Measures area, volume and centroid.

    Parameters
    ----------
    model : Model
        A model of a surface.
    degree : int, optional
        Highest degree; by default all.
    tolerance : float
        The grid is refined until the relative change of the area is at most this. Volume and centroid are exact.
    threads : int, optional
    progress : bool or callable, optional

    Returns
    -------
    Measures

    Examples
    --------
    >>> import numpy as np, spharm_rs as sp
    >>> coefficients = np.zeros((4, 3))
    >>> coefficients[3, 0] = coefficients[1, 1] = coefficients[2, 2] = (4 * np.pi / 3) ** 0.5
    >>> round(sp.shape.measure(sp.Model(coefficients)).volume, 12) == round(4 * np.pi / 3, 12)
    True
    """
    measures, problems = _measured(model, degree, tolerance, threads, progress)
    warn(problems)
    return measures


def _measured(
    model: Model, degree: int | None, tolerance: float, threads: int | None, progress: Progress
) -> tuple[Measures, list[str]]:
    """Measures a model as `measure` does. Returns the measures and the warnings, which aren't issued."""
    text, problems = _core.shape_measure(
        _model("model", model),
        _degree(model, degree),
        tolerance=float(tolerance),
        threads=_arrays.threads(threads),
        progress=callback(progress),
    )
    figures = json.loads(text)
    figures["centroid"] = tuple(figures["centroid"])
    return Measures(**figures), problems


def geometry(
    model: Model,
    at: Any = None,
    *,
    degree: int | None = None,
    threads: int | None = None,
    progress: Progress = None,
) -> Geometry:
    """Computes normals and curvatures, exactly from the coefficients, including at the poles.

    Parameters
    ----------
    model : Model
        A model of a surface.
    at : array_like of float, (n, 3), int, Surface or what `spharm_rs.as_surface` takes, optional
        Vectors of any nonzero length; or subdivisions of an icosphere; or a sphere. By default the directions at which
        the model was fitted.
    degree : int, optional
        Highest degree; by default all.
    threads : int, optional
    progress : bool or callable, optional

    Returns
    -------
    Geometry
        Normals and curvatures follow the parameterisation. If it is mirrored (``Measures.inwards``), normals point
        inwards, curvatures except the Gaussian have the opposite sign, and there is a warning.
    """
    positions, normals, columns = _core.shape_geometry(
        _model("model", model),
        directions_at(at),
        _degree(model, degree),
        threads=_arrays.threads(threads),
        progress=callback(progress),
    )
    element, mean, gaussian, _, _, index, curvedness = columns.T
    model._warn_if_mirrored(degree)
    return Geometry(positions, normals, element, mean, gaussian, columns[:, 3:5], index, curvedness)


def smooth(model: Model, *, fwhm: float | None = None, s: float | None = None) -> Model:
    """Smooths a surface or a signal by the heat kernel: degree l is multiplied by ``exp(-l (l + 1) s)``.

    Parameters
    ----------
    model : Model
    fwhm : float
        Full width at half maximum, from 0 to 180 degrees of arc on the sphere: ``4 sqrt(s ln 2)`` radians.
    s : float
        Diffusion time, as an alternative to a width.

    Returns
    -------
    Model
    """
    if (fwhm is None) == (s is None):
        raise ValueError("fwhm, s: expected exactly one of them")
    time, width = (None, math.radians(fwhm)) if fwhm is not None else (float(s or 0.0), 0.0)
    return Model._of(_core.shape_smooth(_model("model", model), time=time, width=width))


def truncation_error(model: Model) -> Floats:
    """Returns the root mean square distance of a model from its truncation to each degree, (L + 1,), in its unit.

    It is exact by Parseval: the root of the sum of the squares of all coefficients above the degree, over ``4 pi``.

    Parameters
    ----------
    model : Model
    """
    return _core.shape_tails(_model("model", model))


# Former names.
tails = truncation_error
test = group_test
Transform = SimilarityTransform


def even(
    model: Model,
    at: Any = 5,
    *,
    degree: int | None = None,
    threads: int | None = None,
    progress: Progress = None,
) -> Surface:
    """Relocates a sphere's vertices so that the surface's triangles over it have about the same area.

    Parameters
    ----------
    model : Model
        A model of a surface.
    at : int, Surface or what `spharm_rs.as_surface` takes
        Subdivisions of an icosphere; or a sphere.
    degree : int, optional
        Highest degree of the surface; by default all.
    threads : int, optional
    progress : bool or callable, optional

    Returns
    -------
    Surface
        The sphere; ``model.surface(even(model))`` is the mesh.
    """
    from ._surface import icosphere, named_icosphere

    sphere = icosphere(at) if isinstance(at, int) and not isinstance(at, bool) else named_icosphere(at)
    vertices, faces, _ = sphere_arrays(sphere)
    if faces is None:
        raise ValueError("at: expected a sphere with triangles")
    directions, _, _, folded = _core.shape_even(
        _model("model", model),
        vertices,
        faces,
        _degree(model, degree),
        steps=16,
        threads=_arrays.threads(threads),
        progress=callback(progress),
    )
    if folded:
        warn([f"{folded} triangles are flipped; choose a finer sphere for this surface"])
    return Surface(directions, faces)
