"""Surfaces: vertices and triangles, from files, arrays or other packages' meshes."""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass, field
from typing import Any, Union

import numpy as np
from numpy.typing import ArrayLike

from . import _arrays, _core
from ._arrays import Floats, Triangles
from ._warnings import warn

Path = Union[str, "os.PathLike[str]"]

#: Metadata of a surface's file, as the extension module represents them: the anatomical structure, GIfTI's metadata of
#: the ``file`` and of the ``surface``, its coordinate system, FreeSurfer's stamp and footer, and the file's path.
Metadata = Union["dict[str, Any]", None]


@dataclass(frozen=True, eq=False, repr=False)
class Surface:
    """A triangle mesh.

    Parameters
    ----------
    vertices : array_like of float, (n, 3)
        Positions, in any unit, such as mm for brains.
    faces : array_like of int, (f, 3)
        Triangles: vertex numbers from 0, counter-clockwise seen from outside.

    Notes
    -----
    A surface from `read_surface` or from a model keeps the metadata of its file: GIfTI's metadata, anatomical structure
    and coordinate system, or FreeSurfer's geometry of the volume (``c_ras``). `save`, `to_nibabel` and `fit` pass them on.

    Examples
    --------
    >>> import spharm_rs as sp
    >>> ball = sp.icosphere(2)
    >>> ball.vertices.shape, ball.faces.shape
    ((162, 3), (320, 3))
    """

    vertices: Floats
    faces: Triangles
    _meta: Metadata = field(default=None, init=False)

    def __init__(self, vertices: ArrayLike, faces: ArrayLike) -> None:
        if isinstance(faces, np.ndarray) and faces.ndim == 2 and faces.shape[1] > 3:
            found = f"{faces.shape}, polygons of {faces.shape[1]} corners"
            raise ValueError(f"faces: expected triangles, (f, 3), found {found}; triangulate the mesh first")
        object.__setattr__(self, "vertices", _arrays.positions("vertices", vertices))
        object.__setattr__(self, "faces", _arrays.triangles("faces", faces))

    @classmethod
    def _of(cls, vertices: ArrayLike, faces: ArrayLike, meta: Metadata) -> Surface:
        surface = cls(vertices, faces)
        object.__setattr__(surface, "_meta", meta)
        return surface

    def __repr__(self) -> str:
        return f"Surface({len(self.vertices)} vertices, {len(self.faces)} faces)"

    @property
    def area(self) -> float:
        """Area of the triangles, in the square of the surface's unit."""
        a, b, c = self.vertices[self.faces.T]
        return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)

    @property
    def volume(self) -> float:
        """Signed volume within a closed surface, in the cube of its unit: negative if its triangles face inwards."""
        if len(self.faces) == 0:
            return 0.0
        a, b, c = self.vertices[self.faces.T] - self.vertices[self.faces[0, 0]]
        return float(np.einsum("ij,ij->", np.cross(a, b), c) / 6)

    def to_trimesh(self) -> Any:
        """Returns a ``trimesh.Trimesh`` with the same vertices and triangles."""
        import trimesh

        return trimesh.Trimesh(self.vertices.copy(), self.faces.astype(np.int64), process=False)

    def to_pyvista(self) -> Any:
        """Returns a ``pyvista.PolyData``."""
        import pyvista

        return pyvista.PolyData.from_regular_faces(self.vertices.copy(), self.faces.astype(np.int64))

    def to_nilearn(self, values: ArrayLike | None = None, *, hemisphere: str = "left") -> Any:
        """Returns a mesh of nilearn, or an image with values at the vertices of the mesh.

        Parameters
        ----------
        values : array_like of float, (n,) or (n, c), optional
            Values at the vertices, such as thicknesses or the p values of a test.
        hemisphere : {"left", "right"}
            The part of an image.

        Returns
        -------
        nilearn.surface.InMemoryMesh, or with values nilearn.surface.SurfaceImage
        """
        from nilearn.surface import InMemoryMesh, SurfaceImage

        if hemisphere not in ("left", "right"):
            raise ValueError(f"hemisphere: expected left or right, found {hemisphere!r}")
        mesh = InMemoryMesh(self.vertices.copy(), self.faces.astype(np.int64))
        if values is None:
            return mesh
        data = _arrays.at_vertices("values", values)
        if len(data) != len(self.vertices):
            raise ValueError(f"values: expected one for each of the {len(self.vertices)} vertices, found {len(data)}")
        return SurfaceImage({hemisphere: mesh}, {hemisphere: data.reshape(np.shape(values)).copy()})

    def to_nibabel(self) -> Any:
        """Returns a ``nibabel.GiftiImage``, whose positions have 32 bits, with the metadata that `save` writes."""
        from nibabel.gifti import GiftiCoordSystem, GiftiDataArray, GiftiImage
        from nibabel.nifti1 import xform_codes

        points = GiftiDataArray(
            self.vertices.astype(np.float32), intent="NIFTI_INTENT_POINTSET", datatype="NIFTI_TYPE_FLOAT32"
        )
        triangles = GiftiDataArray(self.faces.astype(np.int32), intent="NIFTI_INTENT_TRIANGLE", datatype="NIFTI_TYPE_INT32")
        image = GiftiImage(darrays=[points, triangles])
        if self._meta is not None:
            image.meta.update(self._meta["file"])
            points.meta.update(_core.of_point_set(self._meta))
            if self._meta["coordinate_system"] is not None:
                *spaces, matrix = self._meta["coordinate_system"]
                # nibabel knows the spaces of the standard by their numbers; 0 is an unknown one.
                codes = [xform_codes.code.get(space, 0) for space in spaces]
                points.coordsys = GiftiCoordSystem(*codes, np.reshape(matrix, (4, 4)))
        return image

    def picture(self, values: ArrayLike | None = None, **settings: Any) -> Any:
        """Draws the surface, with values at its vertices as colours; see `spharm_rs.picture`."""
        from ._picture import picture

        return picture(self, values, **settings)

    def plot(self, values: ArrayLike | None = None, *, limits: tuple[float, float] | None = None, label: str = "") -> Any:
        """Shows the surface in a window or notebook by PyVista; without PyVista, returns a `Picture`.

        Parameters
        ----------
        values, limits, label
            As for `spharm_rs.picture`.
        """
        try:
            mesh = self.to_pyvista()
        except ImportError:
            return self.picture(values, limits=limits, label=label)
        if values is None:
            return mesh.plot()
        return mesh.plot(scalars=np.asarray(values), clim=limits, scalar_bar_args={"title": label})

    def save(self, path: Path, *, overwrite: bool = False, double: bool = False) -> None:
        """Writes the surface in the format given by the file's name; see `write_surface`."""
        write_surface(path, self, overwrite=overwrite, double=double)


def as_surface(mesh: Any) -> Surface:
    """Converts a mesh of any supported kind to a `Surface`.

    Parameters
    ----------
    mesh : object
        A path; a pair (vertices, faces); a `Surface`; a mesh of trimesh (``.vertices``, ``.faces``; also a ``Scene``,
        whose meshes are joined), nilearn (``.coordinates``, ``.faces``; also a ``SurfaceImage`` or ``PolyMesh`` of one
        hemisphere), pyvista (``PolyData``, whose polygons are triangulated; or ``UnstructuredGrid``, whose outer
        surface is taken), meshio (``.points``, ``.cells_dict["triangle"]``); or a GIfTI image of nibabel.

    Returns
    -------
    Surface

    Raises
    ------
    ValueError
        If the object is none of these, or the arrays have invalid shapes.
    MeshError
        If a file holds no surface.

    Examples
    --------
    >>> import spharm_rs as sp
    >>> vertices = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    >>> sp.as_surface((vertices, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
    Surface(4 vertices, 4 faces)
    """
    return surface_of("surface", mesh)


def surface_of(what: str, mesh: Any) -> Surface:
    """Converts a mesh as `as_surface` does; `what` is the argument that errors name."""
    if isinstance(mesh, Surface):
        return mesh
    if isinstance(mesh, (str, os.PathLike)):
        return read_surface(mesh)
    if isinstance(mesh, (tuple, list)):
        if any(isinstance(one, (Surface, str, os.PathLike)) or hasattr(one, "faces") for one in mesh):
            found = f"{len(mesh)} meshes in a {type(mesh).__name__}"
            raise ValueError(f"{what}: expected one mesh, found {found}; use fit_many for several")
        if len(mesh) == 2:
            return Surface(*mesh)
    if hasattr(mesh, "agg_data"):
        arrays = mesh.agg_data(("pointset", "triangle"))
        if not all(isinstance(array, np.ndarray) for array in arrays):
            raise ValueError(f"{what}: expected a GIfTI image with exactly one point set and one array of triangles")
        return Surface(*arrays)
    if hasattr(mesh, "cells_dict") and hasattr(mesh, "extract_surface"):
        return _of_grid(mesh)
    if hasattr(mesh, "cells_dict"):
        if "triangle" not in mesh.cells_dict:
            raise ValueError(f"{what}: expected a mesh with triangles, found only cells of the types {sorted(mesh.cells_dict)}")
        return Surface(mesh.points, mesh.cells_dict["triangle"])
    # A scene of trimesh, such as of a GLB file, with its meshes at their places.
    if hasattr(mesh, "geometry") and hasattr(mesh, "to_mesh"):
        joined = surface_of(what, mesh.to_mesh())
        if len(joined.faces) == 0:
            raise ValueError(f"{what}: expected a scene with triangles, found none")
        return joined
    # pyvista.PolyData raises an error for `regular_faces` if the numbers of corners differ.
    if not getattr(mesh, "is_all_triangles", True) and hasattr(mesh, "triangulate"):
        mesh = mesh.triangulate()
    if hasattr(mesh, "points") and hasattr(mesh, "regular_faces"):
        return Surface(mesh.points, mesh.regular_faces)
    # A nilearn image has a mesh of one or two parts.
    parts = getattr(getattr(mesh, "mesh", mesh), "parts", None)
    if isinstance(parts, dict):
        if len(parts) != 1:
            found = " and ".join(map(str, parts)) or "none"
            raise ValueError(f"{what}: expected one hemisphere, found {found}; give a mesh, such as that of parts['left']")
        return surface_of(what, *parts.values())
    for vertices in ("vertices", "coordinates"):
        if hasattr(mesh, vertices) and hasattr(mesh, "faces"):
            return Surface(getattr(mesh, vertices), mesh.faces)
    # Results such as `Parametrization` and `Repair` have a surface.
    inner = getattr(mesh, "surface", None)
    if isinstance(inner, Surface):
        return inner
    if callable(inner):
        raise ValueError(f"{what}: expected a mesh, found {type(mesh).__name__}; call model.surface() or model.surface(5)")
    kinds = "a path, (vertices, faces), or a mesh of trimesh, nilearn, pyvista, meshio or nibabel"
    raise ValueError(f"{what}: expected {kinds}, found {type(mesh).__name__}")


#: VTK's number of the cell type triangle.
_VTK_TRIANGLE = 5


def _of_grid(mesh: Any) -> Surface:
    """Converts a ``pyvista.UnstructuredGrid``: triangles with their vertices in order, other cells by their outer surface."""
    cells = mesh.cells_dict
    if list(cells) == [_VTK_TRIANGLE]:
        return Surface(mesh.points, cells[_VTK_TRIANGLE])
    with warnings.catch_warnings():
        # PyVista warns that its default algorithm will change; earlier versions have no option to choose one.
        warnings.simplefilter("ignore")
        surface = mesh.extract_surface()
    return as_surface(surface)


def named_icosphere(sphere: Any) -> Any:
    """Converts ``icosphere:N`` to that icosphere, and returns any other value unchanged."""
    if not (isinstance(sphere, str) and sphere.startswith("icosphere:")):
        return sphere
    number = sphere.removeprefix("icosphere:")
    if not number.isdecimal():
        raise ValueError(f"sphere: expected icosphere:N, found {sphere}")
    return icosphere(int(number))


def opened(sphere: Any) -> Any:
    """Reads a sphere that is given as a file or as ``icosphere:N``, and returns any other value unchanged."""
    named = named_icosphere(sphere)
    return read_surface(named) if isinstance(named, (str, os.PathLike)) else named


def meta_of(sphere: Any) -> Metadata:
    """Returns the metadata of a sphere's file; None for other kinds of spheres."""
    return sphere._meta if isinstance(sphere, Surface) else None


def meta_of_path(path: Path) -> Metadata:
    """Returns the metadata of a file of which only the path is known."""
    names = ("structure", "coordinate_system", "stamp", "footer")
    return {**dict.fromkeys(names), "file": [], "surface": [], "path": os.fspath(path)}


def moved_meta(meta: Metadata, turned: bool, mirrored: bool) -> Metadata:
    """Returns the metadata of a surface that was moved, without its position in a volume, which is no longer valid. A
    turned surface no longer has the axes that its file states. A mirror image belongs to the other hemisphere."""
    if meta is None:
        return None
    kept = [entry for entry in meta["surface"] if not entry[0].startswith("VolGeom")]
    file = [entry for entry in meta["file"] if not (turned and entry[0] == "SPACE")]
    moved = {**meta, "file": file, "surface": kept, "coordinate_system": None, "footer": None}
    if mirrored:
        structure = meta["structure"] or ""
        for side, other in (("Left", "Right"), ("Right", "Left")):
            if structure.endswith(side):
                moved["structure"] = structure.removesuffix(side) + other
        # The file's name states the hemisphere of the original.
        moved["path"] = None
    return moved


def read_surface(path: Path) -> Surface:
    """Reads a surface: GIfTI, FreeSurfer, OBJ, PLY, OFF, STL, VTK (also XML), glTF, 3MF, VRML, also gzipped.

    Parameters
    ----------
    path : str or os.PathLike

    Returns
    -------
    Surface

    Raises
    ------
    MeshError
        If the file holds no surface, or is damaged.
    OSError
        If the file can't be read.
    """
    return Surface._of(*_core.read_surface(os.fspath(path)))


def write_surface(path: Path, surface: Any, *, overwrite: bool = False, double: bool = False) -> None:
    """Writes a surface in the format given by the file's name, atomically.

    Parameters
    ----------
    path : str or os.PathLike
        ``.surf.gii``, ``.ply``, ``.obj``, ``.off``, ``.stl``, ``.vtk``, ``.vtp``, ``.glb``, ``.3mf``, or one of FreeSurfer's
        names (``lh.pial``); with ``.gz`` it is gzipped.
    surface : Surface or what `as_surface` takes
    overwrite : bool
        Replace an existing file.
    double : bool
        Write 64-bit numbers if the format allows both (GIfTI, PLY).

    Raises
    ------
    FileExistsError
        If the file exists and ``overwrite`` is False.

    Warns
    -----
    SpharmWarning
        If the file's 32-bit numbers are too coarse for a surface far from the origin.
    """
    mesh = as_surface(surface)
    warning = _core.write_surface(
        os.fspath(path), mesh.vertices, mesh.faces, mesh._meta, overwrite=bool(overwrite), double=bool(double)
    )
    if warning is not None:
        warn([warning])


def read_signal(path: Path) -> Floats:
    """Reads values on vertices: GIfTI, FreeSurfer's curv, MGH/MGZ maps, NumPy's .npy, CSV, TSV. Missing values are NaN.

    Parameters
    ----------
    path : str or os.PathLike

    Returns
    -------
    ndarray of float, (n, c)
        A row for each vertex, a column for each channel.
    """
    return _core.read_values(os.fspath(path), gaps=True)


def write_signal(path: Path, values: ArrayLike, *, overwrite: bool = False, double: bool = False) -> None:
    """Writes values on vertices: ``.func.gii``, ``.shape.gii``, ``.mgz``, ``.csv``, ``.tsv``, FreeSurfer's curv.

    Parameters
    ----------
    path : str or os.PathLike
    values : array_like of float, (n,) or (n, c)
        NaN marks vertices without a value; infinities are refused.
    overwrite : bool
        Replace an existing file.
    double : bool
        Write 64-bit numbers if the format allows both (GIfTI).
    """
    array = _arrays.channels("values", values)
    _core.write_values(os.fspath(path), array, overwrite=bool(overwrite), double=bool(double))


def icosphere(level: int) -> Surface:
    """Returns the unit sphere as a subdivided icosahedron.

    Parameters
    ----------
    level : int
        From 0 to 12; the sphere has 10 * 4**level + 2 vertices.

    Returns
    -------
    Surface

    Examples
    --------
    >>> import spharm_rs as sp
    >>> sp.icosphere(6)
    Surface(40962 vertices, 81920 faces)
    """
    return Surface(*_core.icosphere(min(_arrays.whole("level", level), 2**31)))


def example_surface(level: int = 5, seed: int = 0) -> tuple[Surface, Surface]:
    """Returns a folded surface, like a cortex, and its sphere.

    Parameters
    ----------
    level : int
        As for `icosphere`, from 0 to 8.
    seed : int
        Surfaces of different seeds share the main folds and differ in detail, as the subjects of a study do.

    Returns
    -------
    surface : Surface
        Positions in mm.
    sphere : Surface
        Its sphere: the same triangles over unit vectors.

    Examples
    --------
    >>> import spharm_rs as sp
    >>> surface, sphere = sp.example_surface(4)
    >>> len(surface.vertices) == len(sphere.vertices)
    True
    """
    level = min(_arrays.whole("level", level), 2**31)
    vertices, faces, sphere = _core.example_surface(level, _arrays.whole("seed", seed))
    return Surface(vertices, faces), Surface(sphere, faces)
