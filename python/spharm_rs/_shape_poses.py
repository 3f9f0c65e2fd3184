"""Rotates and aligns surfaces, and averages groups."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from typing import Any, Sequence, cast, overload

import numpy as np
from numpy.typing import ArrayLike

from . import _arrays, _core
from ._arrays import Floats
from ._landmarks import Landmarks
from ._model import Model, core, maps_differ
from ._progress import Progress, callback
from ._surface import Surface, as_surface, moved_meta
from ._warnings import warn
from .reports import FitReport


def rotation(what: str, value: Any) -> list[float]:
    """Returns the 3, 4 or 9 numbers of a rotation, a matrix row by row. SciPy's rotations are converted to matrices."""
    if value is None:
        return [1, 0, 0, 0, 1, 0, 0, 0, 1]
    if hasattr(value, "as_matrix"):
        value = value.as_matrix()
    numbers = _arrays.real(what, value, "(3,), (4,) or (3, 3)")
    if numbers.shape not in ((3,), (4,), (9,), (3, 3)):
        raise ValueError(f"{what}: expected 3 Euler angles, a quaternion or a matrix, (3,), (4,) or (3, 3); found {numbers.shape}")
    found: list[float] = numbers.ravel().tolist()
    return found


def vector(what: str, value: ArrayLike) -> list[float]:
    """Returns a vector's 3 numbers."""
    numbers = _arrays.real(what, value, "(3,)")
    if numbers.shape != (3,):
        raise ValueError(f"{what}: expected shape (3,), found {numbers.shape}")
    found: list[float] = numbers.tolist()
    return found


@dataclass(frozen=True, eq=False)
class SimilarityTransform:
    """Similarity transform of a surface: ``f'(u) = scale Q f(R.T u) + translation``, or with ``f(-R.T u)`` if antipodal.

    Attributes
    ----------
    parameters : ndarray of float, (3, 3)
        R, the rotation of the parameters.
    antipodal : bool
        Whether directions are first replaced by their opposites; this keeps a mirrored surface's normals pointing
        outwards.
    object : ndarray of float, (3, 3)
        Q, the rotation of space; a reflection if a mirror image was matched.
    scale : float
    translation : ndarray of float, (3,)
        In the surface's unit.

    Transforms are composed by ``@``: ``(a @ b).apply(x)`` is ``a.apply(b.apply(x))``.
    """

    parameters: Floats
    antipodal: bool
    object: Floats
    scale: float
    translation: Floats

    @classmethod
    def _of(cls, found: dict[str, Any]) -> SimilarityTransform:
        matrix = {name: np.array(found[name], dtype=float) for name in ("parameters", "object", "translation")}
        return cls(antipodal=found["antipodal"], scale=found["scale"], **matrix)

    @overload
    def apply(self, what: Model, *, threads: int | None = None, progress: Progress = None) -> Model: ...
    @overload
    def apply(self, what: Surface, *, threads: int | None = None, progress: Progress = None) -> Surface: ...
    @overload
    def apply(self, what: Landmarks, *, threads: int | None = None, progress: Progress = None) -> Landmarks: ...
    @overload
    def apply(self, what: ArrayLike, *, threads: int | None = None, progress: Progress = None) -> Floats: ...
    # What `as_surface` takes; a pair (vertices, faces) looks like an array to type checkers.
    @overload
    def apply(self, what: Any, *, threads: int | None = None, progress: Progress = None) -> Any: ...
    def apply(self, what: Any, *, threads: int | None = None, progress: Progress = None) -> Any:
        """Transforms a model at all its degrees; or moves a surface or points, such as landmarks, in space.

        A model of a signal, such as thickness, only turns with the parameters, ``f'(u) = f(R.T u)``, so that its values
        stay at the same points of the surface. A mirrored surface keeps its outward orientation.

        Parameters
        ----------
        what : Model, Surface or what `as_surface` takes, Landmarks, or array_like of float, (n, 3)
            Points are in the surface's unit; one point may be (3,). Transformed landmarks have no scanner frame, and
            transformed surfaces have no position in a volume (FreeSurfer's ``c_ras``, GIfTI's coordinate system).
        threads : int, optional
            For models only; the same holds for `progress`.
        progress : bool or callable, optional

        Returns
        -------
        Model, Surface, Landmarks or ndarray of float, (n, 3)
            Of the kind given; a `Surface` for a mesh of any kind.

        Raises
        ------
        ValueError
            If points have another shape, or the object is of none of these kinds.
        """
        if isinstance(what, Landmarks):
            return Landmarks(what.names, self._moved(what.points))
        if _is_points(what):
            return self._moved(what)
        if not isinstance(what, Model):
            mesh = as_surface(what)
            mirrored = bool(np.linalg.det(self.object) < 0)
            faces = mesh.faces[:, ::-1] if mirrored else mesh.faces
            turned = not np.array_equal(self.object, np.eye(3))
            stays = not turned and self.scale == 1 and not np.any(self.translation)
            meta = mesh._meta if stays else moved_meta(mesh._meta, turned, mirrored)
            return Surface._of(self._moved(mesh.vertices), faces, meta)
        own = self if what.is_surface else replace(self, object=np.eye(3), scale=1.0, translation=np.zeros(3))
        asked = {
            "parameters": rotation("parameters", own.parameters),
            "antipodal": bool(own.antipodal),
            "object": rotation("object", own.object),
            "mirrored": bool(np.linalg.det(own.object) < 0),
            "scale": float(own.scale),
            "translation": vector("translation", own.translation),
        }
        return _rotated(what, asked, threads, progress)

    @property
    def matrix(self) -> Floats:
        """Homogeneous matrix of the motion in space, (4, 4), for column vectors (x, y, z, 1)."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.scale * np.asarray(self.object, dtype=float)
        matrix[:3, 3] = self.translation
        return matrix

    def __matmul__(self, first: Any) -> SimilarityTransform:
        """Returns the transform that applies ``first`` and then this one."""
        if not isinstance(first, SimilarityTransform):
            return NotImplemented
        parameters = np.asarray(self.parameters, dtype=float) @ np.asarray(first.parameters, dtype=float)
        total = self.matrix @ first.matrix
        scale = self.scale * first.scale
        return SimilarityTransform(parameters, self.antipodal != first.antipodal, total[:3, :3] / scale, scale, total[:3, 3])

    def inverse(self) -> SimilarityTransform:
        """Returns the inverse transform."""
        back, scale = np.asarray(self.object, dtype=float).T, 1.0 / self.scale
        translation = -scale * (back @ np.asarray(self.translation, dtype=float))
        return SimilarityTransform(np.asarray(self.parameters, dtype=float).T, self.antipodal, back, scale, translation)

    def _moved(self, points: ArrayLike) -> Floats:
        values = _arrays.real("points", points, "(n, 3)")
        if values.ndim not in (1, 2) or values.shape[-1] != 3:
            raise ValueError(f"points: expected shape (n, 3), found {values.shape}")
        moved: Floats = self.scale * (values @ np.asarray(self.object, dtype=float).T) + np.asarray(self.translation, dtype=float)
        return moved


def _is_points(what: Any) -> bool:
    """Returns whether an object is an array of points, and not a model or a mesh, such as a pair (vertices, faces)."""
    if isinstance(what, (list, tuple)):
        return not (len(what) == 2 and all(np.ndim(array) == 2 for array in what))
    return hasattr(what, "__array__") and not isinstance(what, Model)


def _rotated(model: Model, asked: dict[str, Any], threads: int | None, progress: Progress) -> Model:
    found = _core.shape_rotate(core("model", model), asked, threads=_arrays.threads(threads), progress=callback(progress))
    return Model._of(found)


def rotate(
    model: Model,
    *,
    parameters: Any = None,
    object: Any = None,
    scale: float = 1.0,
    translation: ArrayLike = (0.0, 0.0, 0.0),
    threads: int | None = None,
    progress: Progress = None,
) -> Model:
    """Rotates a model in its parameters, or the surface in space: ``x`` becomes ``scale Q x + translation``.

    The result has no standard errors: a rotation mixes coefficients, and their covariances aren't known.

    A rotation is given by 3 Euler angles alpha, beta, gamma **in degrees**, ``Rz(alpha) Ry(beta) Rz(gamma)``; a
    quaternion w, x, y, z; a matrix, (3, 3); or a ``scipy.spatial.transform.Rotation``.

    pyshtools' ``SHCoeffs.rotate(alpha, beta, gamma)`` is ``parameters=[-gamma, -beta, -alpha]``; with its option
    ``body=True`` it is ``parameters=[alpha, beta, gamma]``.

    Parameters
    ----------
    model : Model
    parameters : rotation, optional
        R: the sphere rotates under the surface, which stays in place. The point at direction u is then at direction R
        u, and the model's own sphere rotates with it.
    object : rotation, optional
        Q, for surfaces only.
    scale : float
        Positive.
    translation : array_like of float, (3,)
        Applied after rotation and scale.
    threads : int, optional
    progress : bool or callable, optional

    Returns
    -------
    Model

    Examples
    --------
    >>> import numpy as np, spharm_rs as sp
    >>> surface, sphere = sp.example_surface(3)
    >>> model = sp.fit(surface, sphere, 6)
    >>> turned = sp.shape.rotate(model, object=[0, 90, 0], translation=[0, 0, 5])
    >>> x, y, z = model.evaluate([[0, 0, 1]])[0]
    >>> np.allclose(turned.evaluate([[0, 0, 1]]), [z, y, 5 - x])
    True
    """
    asked = {
        "parameters": rotation("parameters", parameters),
        "antipodal": False,
        "object": rotation("object", object),
        "mirrored": False,
        "scale": float(scale),
        "translation": vector("translation", translation),
    }
    return _rotated(model, asked, threads, progress)


@dataclass(frozen=True, eq=False)
class Alignment:
    """A model aligned to another.

    Attributes
    ----------
    model : Model
        The aligned model, at all its degrees.
    transform : SimilarityTransform
        The transform applied to the model.
    rmsd_before, rmsd_after : float
        Root mean square distance from the target over the sphere, in the surfaces' unit.
    degree : int
        Highest degree compared.
    mirrored : bool
        Whether the surface was mirrored in space.
    ends : ndarray of float
        Distance reached from each start of the search after its refinement, without scale.
    surface_distance : float, optional
        With ``pose="surfaces"``: root mean square distance between the surfaces, both ways and regardless of
        directions, without the farthest tenth.
    warnings : tuple of str
    """

    model: Model
    transform: SimilarityTransform
    rmsd_before: float
    rmsd_after: float
    degree: int
    mirrored: bool
    ends: Floats = field(repr=False)
    surface_distance: float | None = None
    warnings: tuple[str, ...] = ()


def _settings(
    method: str,
    pose: str,
    scale: bool,
    mirror: bool,
    degree: int | None,
    starts: int | None,
    templates: int | None = None,
) -> dict[str, Any]:
    if pose not in ("joint", "surfaces"):
        raise ValueError(f"pose: expected joint or surfaces, found {pose}")
    if pose == "surfaces" and method != "joint":
        raise ValueError(f"pose: 'surfaces' requires method 'joint', found method {method!r}")
    return {
        "method": "surfaces" if pose == "surfaces" else str(method),
        "scale": bool(scale),
        "mirror": bool(mirror),
        "degree": None if degree is None else _arrays.whole("degree", degree),
        "starts": None if starts is None else _arrays.whole("starts", starts, 1),
        "templates": None if templates is None else _arrays.whole("templates", templates, 1),
    }


_OF_MESHES = ", and shape.pose finds the pose of a mesh"
_MAPPED_APART = (
    "the models were mapped separately, so their parameters agree only approximately; pose='surfaces' finds the pose from the "
    "surfaces"
)


def align(
    model: Model,
    target: Model,
    method: str = "joint",
    *,
    pose: str = "joint",
    scale: bool = False,
    mirror: bool = False,
    degree: int | None = None,
    starts: int | None = None,
    threads: int | None = None,
    progress: Progress = None,
) -> Alignment:
    """Aligns a surface to another one, whatever their poses.

    Parameters
    ----------
    model, target : Model
        Models of surfaces.
    method : {"joint", "fixed", "foe"}
        ``"joint"`` searches all rotations of the parameters and of space together. ``"fixed"`` keeps the parameters,
        for vertices that correspond already. ``"foe"`` rotates both models into the frames of their first-order
        ellipsoids, for comparison with other programs.
    pose : {"joint", "surfaces"}
        Criterion for the pose in space. ``"joint"``: the distance at equal directions, minimised over both rotations
        together. ``"surfaces"``: the distance of nearest points of the surfaces; the rotation of the parameters is then
        searched in that pose. For models that were mapped separately, the least distance at equal directions is at a
        slightly or entirely wrong pose, so a warning is given.
    scale : bool
        Also scale the model to the target's size.
    mirror : bool
        Also match mirror images.
    degree : int, optional
        Highest degree to compare; by default the lower one of the models'. The transform is applied to all degrees.
    starts : int, optional
        Number of the search's local optima to refine; by default 6.
    threads : int, optional
    progress : bool or callable, optional

    Returns
    -------
    Alignment

    Examples
    --------
    >>> import spharm_rs as sp
    >>> surface, sphere = sp.example_surface(4)
    >>> model = sp.fit(surface, sphere, 8)
    >>> moved = sp.shape.rotate(model, parameters=[10, 20, 30], object=[40, 50, 60], translation=[1, 2, 3])
    >>> found = sp.shape.align(moved, model)
    >>> found.rmsd_after < 1e-9 * found.rmsd_before
    True
    """
    moving, still = core("model", model, _OF_MESHES), core("target", target, _OF_MESHES)
    noted = [_MAPPED_APART] if pose == "joint" and maps_differ(model, target) else []
    found, text = _core.shape_align(
        moving,
        still,
        _settings(method, pose, scale, mirror, degree, starts),
        threads=_arrays.threads(threads),
        progress=callback(progress),
    )
    report = json.loads(text)
    transform, ends = SimilarityTransform._of(report.pop("transform")), np.array(report.pop("ends"), dtype=float)
    return Alignment(Model._of(found), transform, ends=ends, warnings=warn(noted + report.pop("warnings")), **report)


@dataclass(frozen=True, eq=False)
class Procrustes:
    """A group of n aligned models.

    Attributes
    ----------
    models : list of Model
        The aligned models, centred at the origin, at all their degrees.
    transforms : list of SimilarityTransform
        The transform applied to each model.
    mean : Model
        The mean, in the frame of its first-order ellipsoid, up to the highest degree compared.
    report : dict
        ``degree``: highest degree compared. ``spread_before`` and ``spread_after``: the members' root mean square
        distance from their mean, in their unit, after centring alone and at the end. ``rmsd``: each member's distance,
        (n,). ``templates``: the result of each start, with ``template``, ``spread`` and ``rounds``. ``warnings``.
    """

    models: list[Model] = field(repr=False)
    transforms: list[SimilarityTransform] = field(repr=False)
    mean: Model
    report: dict[str, Any] = field(repr=False)


def cores(models: Any) -> list[_core.Model]:
    """Returns the extension module's objects for a sequence of models."""
    if isinstance(models, Model) or not hasattr(models, "__iter__"):
        raise ValueError(f"models: expected a sequence of Model, found {type(models).__name__}")
    return [core("models", model) for model in models]


def procrustes(
    models: Sequence[Model],
    method: str = "joint",
    *,
    pose: str = "joint",
    scale: bool = False,
    mirror: bool = False,
    degree: int | None = None,
    starts: int | None = None,
    templates: int | None = None,
    threads: int | None = None,
    progress: Progress = None,
) -> Procrustes:
    """Aligns a group of surfaces to its mean: generalised Procrustes analysis over rotations of parameters and space.

    Parameters
    ----------
    models : sequence of Model
        Three surfaces or more, in any poses.
    method : {"joint", "fixed"}
        As in `align`.
    pose : {"joint", "surfaces"}
        As in `align`.
    scale : bool
        Scale all models to the group's common size.
    mirror : bool
        Also match mirror images.
    degree : int, optional
        Highest degree to compare; by default the lowest of the models'. The transforms are applied to all degrees.
    starts : int, optional
        Number of local optima of each search to refine; by default 3.
    templates : int, optional
        Number of members used as starting points of the alignment; by default all of up to 20, else 5.
    threads : int, optional
    progress : bool or callable, optional

    Returns
    -------
    Procrustes
    """
    found, mean, text = _core.shape_procrustes(
        cores(models),
        _settings(method, pose, scale, mirror, degree, starts, templates),
        threads=_arrays.threads(threads),
        progress=callback(progress),
    )
    report = json.loads(text)
    transforms = [SimilarityTransform._of(transform) for transform in report.pop("transforms")]
    report["rmsd"] = np.array(report["rmsd"], dtype=float)
    warn(report["warnings"])
    return Procrustes([Model._of(model) for model in found], transforms, Model._of(mean), report)


def named(names: Sequence[str] | None, count: int) -> list[str]:
    """Returns the names of a group's members, or their numbers if no names are given."""
    if names is None:
        return [str(index) for index in range(count)]
    if isinstance(names, str) or len(names) != count:
        raise ValueError(f"names: expected {count} names, found {names!r}")
    return [str(name) for name in names]


def mean(
    models: Sequence[Model],
    *,
    degree: int | None = None,
    names: Sequence[str] | None = None,
    threads: int | None = None,
) -> Model:
    """Averages surfaces that correspond, such as those of `spharm_rs.shape.procrustes`.

    Parameters
    ----------
    models : sequence of Model
        Two or more models.
    degree : int, optional
        Highest degree; by default the lowest of the models'.
    names : sequence of str, optional
        Names of the members, for the provenance; by default their numbers from 0.
    threads : int, optional

    Returns
    -------
    Model
        The mean of the coefficients. Its report has ``distances``, each member's root mean square distance over the
        sphere, (n,); ``spread``, the root mean square of the distances; and ``warnings``.

    Examples
    --------
    >>> import numpy as np, spharm_rs as sp
    >>> spheres = [sp.Model(radius * np.eye(4)[:, 1:]) for radius in (1, 2, 6)]
    >>> bool(np.allclose(sp.shape.mean(spheres).coefficients, 3 * np.eye(4)[:, 1:]))
    True
    """
    members = cores(models)
    found, distances, warnings = _core.shape_mean(
        members,
        None if degree is None else _arrays.whole("degree", degree),
        names=named(names, len(members)),
        threads=_arrays.threads(threads),
    )
    each = np.array(distances)
    warn(warnings)
    report = {"distances": each, "spread": float(np.sqrt(np.mean(each**2))), "warnings": warnings}
    return Model._of(found, cast(FitReport, report))
