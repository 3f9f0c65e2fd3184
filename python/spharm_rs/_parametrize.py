"""Maps closed surfaces to the sphere."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from typing import Any, Union

import numpy as np
from numpy.typing import ArrayLike

from . import _arrays, _core
from ._progress import Progress, callback
from ._repair import changes_of
from ._surface import Metadata, Path, Surface, as_surface, named_icosphere
from ._warnings import warn
from .reports import MapQuality, MapReport


#: Relation of a cut surface to the original surface: the original numbers of vertices, n, and of triangles, which come
#: first in the cut surface; and for each further vertex, from n on, the original vertex of which it is a copy.
Seam = Union[tuple[int, int, "_arrays.Triangles"], None]


@dataclass(frozen=True, eq=False)
class Parametrization:
    """A surface and its map to the sphere.

    Attributes
    ----------
    surface : Surface
        The given surface, or a new one if the method makes one (volumes, ``deform``, `resample`).
    sphere : Surface
        The surface's triangles with a unit vector for each of its vertices.
    report : dict
        Details of the method, and the quality of the map: ``report["quality"]["area_rms"]`` is the root mean square of
        the log area ratio, and ``["flipped"]`` the number of flipped triangles, 0. If handles were cut,
        ``report["handles"]`` has their locations.
    """

    surface: Surface
    sphere: Surface
    report: MapReport = field(repr=False)
    _seam: Seam = field(default=None, repr=False)

    @property
    def quality(self) -> MapQuality:
        """Distortion of areas, angles and lengths; see ``report``."""
        return self.report["quality"]


def _made(mapped: Any, meta: Metadata = None) -> Parametrization:
    """Returns a mapped surface with the metadata of the given surface, whose position it keeps, and issues its
    warnings."""
    found, problems = with_warnings(mapped, meta)
    warn(problems)
    return found


def with_warnings(mapped: Any, meta: Metadata = None) -> tuple[Parametrization, list[str]]:
    """Returns a mapped surface as `_made` does, and its warnings, which aren't issued."""
    vertices, faces, sphere, report, problems, seam = mapped
    return Parametrization(Surface._of(vertices, faces, meta), Surface(sphere, faces), json.loads(report), seam), problems


def _settings(
    method: str, degree: int | None, area: float, seed: int, memory: int | str | None, threads: int | None
) -> dict[str, Any]:
    return {
        "method": str(method),
        "degree": None if degree is None else _arrays.whole("degree", degree),
        "area": float(area),
        "seed": _arrays.whole("seed", seed),
        "memory": _arrays.size(memory),
        "threads": _arrays.threads(threads),
    }


def parametrize(
    surface: Any,
    *,
    fix: bool = False,
    largest_repair: float | None = None,
    wrap: int | None = None,
    cut_handles: bool = False,
    method: str = "auto",
    degree: int | None = None,
    area: float = 0.1,
    seed: int = 0,
    memory: int | str | None = None,
    threads: int | None = None,
    progress: Progress = None,
) -> Parametrization:
    """Maps a closed surface of genus zero to the sphere, one to one.

    Parameters
    ----------
    surface : Surface or what `as_surface` takes
    fix : bool
        Repair the surface as `repair` does, instead of refusing it. The repaired surface is mapped, and a warning states the
        changes.
    largest_repair : float, optional
        With ``fix`` or ``wrap``: share of the area, from 0 to 1, that the repair may drop or add, or the wrap leave out,
        as for `repair`.
    wrap : int, optional
        Replace the surface by the closed surface around it, as `repair` does, instead of repairing it.
    cut_handles : bool
        Cut handles along short loops and fill both sides, instead of refusing the surface. The cut surface is mapped;
        `Model.surface` of a model fitted over its sphere restores the handles. A warning states the cuts.
    method : {"auto", "cald", "conformal", "stretch", "deform"}
        ``auto`` is ``cald`` (equal areas with little length distortion), or ``stretch`` if ``cald`` fails.
    degree : int, optional
        Degree of the model to whose residual the areas adapt; below 2 they don't adapt.
    area : float
        Allowed area distortion: the root mean square of the log area ratio, from 0 to 1.
    seed : int
        Seed of the sphere's initial rotation.
    memory : int or str, optional
        Memory budget in bytes, or text such as ``"512MiB"``; by default the free memory.
    threads : int, optional
        Number of threads; by default all CPUs.
    progress : bool or callable, optional
        ``progress(stage, done, total)``, or True for a tqdm bar.

    Returns
    -------
    Parametrization

    Raises
    ------
    MeshError
        If the surface isn't closed (without ``fix``), has handles (without ``cut_handles``), or can't be mapped.
    MemoryBudgetError
        If the budget is too small; the exception has ``budget`` and ``needed``.

    Examples
    --------
    >>> import spharm_rs as sp
    >>> surface, _ = sp.example_surface(3)
    >>> found = sp.parametrize(surface)
    >>> found.quality["flipped"]
    0
    """
    mesh, settings = as_surface(surface), _settings(method, degree, area, seed, memory, threads)
    found = _core.parametrize(
        mesh.vertices,
        mesh.faces,
        changes=changes_of(fix, largest_repair, wrap, cut_handles),
        **settings,
        progress=callback(progress),
    )
    return _made(found, mesh._meta)


def parametrize_volume(
    volume: Path | ArrayLike,
    *,
    label: int | None = None,
    channel: int | None = None,
    time: int | None = None,
    threshold: float | None = None,
    probability: bool = False,
    label_surface: str = "smooth",
    smooth_radius: float | None = None,
    affine: ArrayLike | None = None,
    spacing: ArrayLike | None = None,
    axes: str = "xyz",
    fix: bool = False,
    cut_handles: bool = False,
    method: str = "auto",
    degree: int | None = None,
    area: float = 0.1,
    seed: int = 0,
    memory: int | str | None = None,
    threads: int | None = None,
    progress: Progress = None,
) -> Parametrization:
    """Maps the surface around a label of a volume to the sphere.

    Parameters
    ----------
    volume : str, os.PathLike or array_like, (i, j, k)
        A file (NIfTI, MGH/MGZ, NRRD, TIFF, npy), or an array of labels, grey values or probabilities.
    label : int, optional
        Required if the volume has several labels.
    channel, time : int, optional
        Image to read from a file of several channels or times, counted from 1.
    threshold : float, optional
        Read grey values: the body is the voxels of this value or more, and its surface is where linear interpolation
        reaches the value.
    probability : bool
        Read probabilities, or the share of each voxel inside the body, from 0 to 1: the body is the voxels of 0.5 or
        more, and its volume the sum of the probabilities near its surface and the number of voxels farther inside.
    label_surface : {"smooth", "voxels"}
        The surface of least bending near the voxels' faces, with the volume of the voxels or of their values; or the
        faces.
    smooth_radius : float, optional
        Distance in voxels that a smooth surface may be from the voxels' faces, 0.25 to 4; by default 0.5.
    affine : array_like of float, (4, 4), optional
        For an array, or a file without a voxel size: the transform from voxel indices along x, y and z to positions; by
        default the identity for an array.
    spacing : array_like of float, (3,), optional
        Size of the voxels, instead of ``affine``: along the axes of an array, or along x, y and z of a file, where it
        replaces the size in the file.
    axes : {"xyz", "zyx"}
        Order of the axes of an array or a NumPy file: ``zyx`` for images of scikit-image, tifffile and napari. The axes
        of other files have a fixed order, for which ``zyx`` is refused.
    fix : bool
        Repair a label whose surface isn't of genus zero, instead of refusing it. A warning states the changes.
    cut_handles : bool
        As for `parametrize`; the label's surface is then mapped as a triangle mesh.
    method : str
        ``auto`` is ``equal-area``; other methods are as for `parametrize`.
    degree, area, seed, memory, threads, progress
        As for `parametrize`.

    Returns
    -------
    Parametrization
        Its surface is that of the label. Its report also has the label's ``voxels``, ``at_border`` and, after a repair,
        ``repair``. A warning says if the label touches the border of the volume.

    Examples
    --------
    >>> import numpy as np, spharm_rs as sp
    >>> labels = np.zeros((8, 8, 8), int)
    >>> labels[2:6, 2:6, 2:5] = 3
    >>> sp.parametrize_volume(labels, label=3).surface
    Surface(82 vertices, 160 faces)
    >>> image = labels.transpose()
    >>> sp.parametrize_volume(image, label=3, axes="zyx", spacing=(0.5, 0.2, 0.2)).report["voxels"]
    48
    """
    settings = _settings(method, degree, area, seed, memory, threads)
    chosen = None if label is None else int(np.asarray(label).item())
    found = _core.parametrize_volume(
        _volume(volume, threshold is not None or probability, affine, spacing, axes),
        label=chosen,
        image=_image(channel, time, volume),
        **_volume_settings(threshold, probability, label_surface, smooth_radius),
        fix=bool(fix),
        cut_handles=bool(cut_handles),
        **settings,
        progress=callback(progress),
    )
    return _made(found)


def labels(volume: Path | ArrayLike, *, channel: int | None = None, time: int | None = None) -> dict[int, int]:
    """Returns the labels of a volume, each with its number of voxels; 0 is the background.

    Parameters
    ----------
    volume : str, os.PathLike or array_like of int, (i, j, k)
    channel, time : int, optional
        As for `parametrize_volume`.
    """
    return _core.labels(_volume(volume, False), image=_image(channel, time, volume))


def _image(channel: int | None, time: int | None, volume: Any = None) -> tuple[int | None, int | None]:
    """Returns the numbers of a channel and a time, which only files have."""
    found = []
    for what, number in (("channel", channel), ("time", time)):
        if number is not None and volume is not None and not isinstance(volume, (str, os.PathLike)):
            raise ValueError(f"{what}: expected None if the volume is an array, found {number!r}; index the array instead")
        found.append(None if number is None else _arrays.whole(what, number, 1))
    return found[0], found[1]


def _volume_settings(
    threshold: float | None, probability: bool, label_surface: str, smooth_radius: float | None
) -> dict[str, Any]:
    if threshold is not None and probability:
        raise ValueError("threshold: expected None with probability=True, which uses the threshold 0.5")
    if threshold is not None and not np.isfinite(threshold):
        raise ValueError(f"threshold: expected a number, found {threshold}")
    return {
        "threshold": None if threshold is None else float(threshold),
        "probability": bool(probability),
        "label_surface": str(label_surface),
        "smooth_radius": None if smooth_radius is None else float(smooth_radius),
    }


def _volume(
    volume: Path | ArrayLike,
    of_values: bool,
    affine: ArrayLike | None = None,
    spacing: ArrayLike | None = None,
    axes: str = "xyz",
) -> Any:
    axes = _axes(axes)
    if affine is not None and spacing is not None:
        raise ValueError(f"spacing: expected None with affine, which has the voxel size, found {spacing!r}")
    matrix, sizes = None if affine is None else _affine(affine), None if spacing is None else _spacing(spacing)
    if isinstance(volume, (str, os.PathLike)):
        return os.fspath(volume), sizes, matrix, axes
    if np.ma.is_masked(volume):
        raise ValueError("volume: expected a value for each voxel, found masked voxels; volume.filled(0) makes them background")
    array = np.asarray(volume)
    if array.ndim != 3:
        raise ValueError(f"volume: expected shape (i, j, k), found {array.shape}")
    if array.dtype.kind not in ("iubf" if of_values else "iub"):
        if array.dtype.kind == "f":
            advice = "parametrize_volume takes grey values with threshold=, and probabilities with probability=True"
            raise ValueError(f"volume: expected whole numbers as labels, found {array.dtype}; {advice}")
        raise ValueError(f"volume: expected whole numbers, found {array.dtype}")
    if not of_values and array.size and not -(2**31) <= int(array.min()) <= int(array.max()) < 2**31:
        raise ValueError(f"volume: expected labels that fit into 32 bits, found {array.min()} to {array.max()}")
    if axes == "zyx":
        array, sizes = array.transpose(), None if sizes is None else sizes[::-1]
    if matrix is None:
        matrix = np.diag([*(sizes or [1.0] * 3), 1.0])
    return np.require(array, np.float64 if of_values else np.int32, "A"), matrix


def _axes(axes: str) -> str:
    if axes not in ("xyz", "zyx"):
        raise ValueError(f"axes: expected 'xyz' or 'zyx', found {axes!r}")
    return axes


def _affine(affine: ArrayLike) -> _arrays.Floats:
    matrix = _arrays.real("affine", affine, "(4, 4)")
    if matrix.shape != (4, 4):
        raise ValueError(f"affine: expected shape (4, 4), found {matrix.shape}")
    return matrix


def _spacing(spacing: ArrayLike) -> list[float]:
    sizes = _arrays.real("spacing", spacing, "(3,)")
    if sizes.shape != (3,) or not (np.isfinite(sizes) & (sizes > 0)).all():
        raise ValueError(f"spacing: expected three positive numbers, found {spacing!r}")
    return [float(size) for size in sizes]


def resample(
    surface: Any,
    sphere: Any,
    onto: Any = "icosphere:6",
    *,
    memory: int | str | None = None,
    threads: int | None = None,
    progress: Progress = None,
) -> Parametrization:
    """Resamples a surface at the vertices of another sphere, so that the subjects of a study share their vertices.

    Parameters
    ----------
    surface : Surface or what `as_surface` takes
    sphere : Surface or what `as_surface` takes, Parametrization, or ndarray of float, (n, 3)
        The surface's own sphere, with the same vertices in the same order.
    onto : str, Surface or what `as_surface` takes
        ``icosphere:N``, or a sphere.
    memory, threads, progress
        As for `parametrize`.

    Returns
    -------
    The new surface over ``onto``; its report has ``distance_rms`` and ``distance_max``, the distances from the given
    surface.

    Examples
    --------
    >>> import spharm_rs as sp
    >>> surface, sphere = sp.example_surface(4)
    >>> sp.resample(surface, sphere, "icosphere:3").surface
    Surface(642 vertices, 1280 faces)
    """
    mesh = as_surface(surface)
    if isinstance(sphere, Parametrization):
        sphere = sphere.sphere
    unit = _arrays.positions("sphere", sphere) if isinstance(sphere, np.ndarray) else as_surface(sphere).vertices
    shared = as_surface(named_icosphere(onto))
    return _made(
        _core.resample(
            mesh.vertices,
            mesh.faces,
            unit,
            shared.vertices,
            shared.faces,
            memory=_arrays.size(memory),
            threads=_arrays.threads(threads),
            progress=callback(progress),
        ),
        mesh._meta,
    )
