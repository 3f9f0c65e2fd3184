"""Surfaces are made from all supported objects, and written to files and read back."""

from __future__ import annotations

import pickle
import warnings
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import meshio
import nibabel
import numpy as np
import pytest
import trimesh
from nilearn.surface import PolyMesh, SurfaceImage

import spharm_rs as sp
from spharm_rs.reports import MapReport

from .conftest import Study
from .test_program import spharm
from .test_reports import flaws


def _nibabel(surface: sp.Surface) -> Any:
    arrays = [
        nibabel.gifti.GiftiDataArray(surface.vertices.astype("f4"), intent="NIFTI_INTENT_POINTSET"),
        nibabel.gifti.GiftiDataArray(surface.faces.astype("i4"), intent="NIFTI_INTENT_TRIANGLE"),
    ]
    return nibabel.gifti.GiftiImage(darrays=arrays)


HOLDERS = {
    "pair": lambda s: (s.vertices, s.faces),
    "lists": lambda s: [s.vertices.tolist(), s.faces.tolist()],
    "trimesh": lambda s: trimesh.Trimesh(s.vertices, s.faces, process=False),
    "scene of trimesh": lambda s: trimesh.Scene(trimesh.Trimesh(s.vertices, s.faces, process=False)),
    "meshio": lambda s: meshio.Mesh(s.vertices, [("triangle", s.faces)]),
    "pyvista": lambda s: SimpleNamespace(points=s.vertices, regular_faces=s.faces),
    "nilearn": lambda s: s.to_nilearn(),
    "nilearn's meshes": lambda s: PolyMesh(right=s.to_nilearn()),
    "nilearn's image": lambda s: s.to_nilearn(s.vertices[:, 2]),
    "nibabel": _nibabel,
}


@pytest.mark.parametrize("holder", HOLDERS)
def test_meshes_of_other_packages_are_taken(holder: str) -> None:
    ball = sp.icosphere(2)
    found = sp.as_surface(HOLDERS[holder](ball))
    assert np.allclose(found.vertices, ball.vertices, atol=1e-6) and np.array_equal(found.faces, ball.faces)


class OfPyVista:
    """Behaves as PyVista's meshes of several kinds of cells do."""

    def __init__(self, surface: sp.Surface, *, cells: dict[int, Any] | None = None) -> None:
        self.points, self._surface, self.is_all_triangles = surface.vertices, surface, False
        if cells is not None:
            self.cells_dict = cells

    @property
    def regular_faces(self) -> Any:
        raise ValueError("Mesh does not have regular faces")

    def triangulate(self) -> Any:
        return SimpleNamespace(points=self.points, regular_faces=self._surface.faces, is_all_triangles=True)

    def extract_surface(self) -> Any:
        warnings.warn("the default will change", UserWarning, stacklevel=2)
        return OfPyVista(self._surface)


def test_polygons_and_grids_of_pyvista_are_triangulated() -> None:
    ball = sp.icosphere(2)
    quads = np.zeros((3, 4), int)
    cells: list[dict[int, Any] | None] = [None, {5: ball.faces}, {10: quads}, {5: ball.faces[:9], 9: quads}]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for each in cells:
            found = sp.as_surface(OfPyVista(ball, cells=each))
            assert np.array_equal(found.vertices, ball.vertices) and np.array_equal(found.faces, ball.faces)
    message = r"faces: expected triangles, \(f, 3\), found \(6, 4\), polygons of 4 corners; triangulate the mesh first"
    with pytest.raises(ValueError, match=message):
        sp.as_surface((np.zeros((8, 3)), np.zeros((6, 4), int)))


def test_pyvista_itself() -> None:
    pyvista = pytest.importorskip("pyvista")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        cube, box = sp.as_surface(pyvista.Cube()), pyvista.ImageData(dimensions=(3, 3, 3)).cast_to_unstructured_grid()
        assert len(cube.faces) == 12 and cube.volume == pytest.approx(1)
        assert sp.as_surface(box).volume == pytest.approx(8) and len(sp.as_surface(pyvista.Cylinder()).faces) == 396
        sphere = pyvista.Sphere()
        for mesh in (sphere, sphere.cast_to_unstructured_grid()):
            assert np.array_equal(sp.as_surface(mesh).vertices, sphere.points)
            assert np.array_equal(sp.as_surface(mesh).faces, sphere.regular_faces)


def test_an_image_of_nilearn_holds_the_values() -> None:
    ball = sp.icosphere(2)
    image = ball.to_nilearn(ball.vertices[:, 2], hemisphere="right")
    assert isinstance(image, SurfaceImage) and image.shape == (162,) and list(image.mesh.parts) == ["right"]
    assert np.array_equal(image.data.parts["right"], ball.vertices[:, 2])
    assert np.array_equal(ball.to_nilearn(ball.vertices).data.parts["left"], ball.vertices)
    both = SurfaceImage({"left": ball.to_nilearn(), "right": ball.to_nilearn()}, {"left": np.ones(162), "right": np.ones(162)})
    with pytest.raises(ValueError, match="found Model; call model.surface"):
        sp.as_surface(sp.Model(np.eye(4)[:, 1:]))
    assert sp.as_surface(sp.repair(ball)) is not None and len(sp.as_surface(sp.parametrize(ball)).faces) == 320
    with pytest.raises(ValueError, match="expected one hemisphere, found left and right"):
        sp.as_surface(both)
    with pytest.raises(ValueError, match="values: expected one for each of the 162 vertices, found 161"):
        ball.to_nilearn(np.ones(161))
    with pytest.raises(ValueError, match="hemisphere: expected left or right, found 'lh'"):
        ball.to_nilearn(hemisphere="lh")


@pytest.mark.parametrize("wrong", [None, 3, "", object(), np.zeros((4, 3)), (1, 2, 3), {}, trimesh.Scene()])
def test_anything_else_is_refused(wrong: Any) -> None:
    with pytest.raises((ValueError, OSError)):
        sp.as_surface(wrong)


@pytest.mark.parametrize("name", ["s.ply", "s.surf.gii", "lh.pial", "s.obj", "s.off", "s.vtk", "s.vtp", "s.glb", "s.3mf", "s.ply.gz"])
def test_surfaces_go_to_files_and_back(study: Study, tmp_path: Path, name: str) -> None:
    surface = study[0]
    surface.save(tmp_path / name)
    found = sp.read_surface(tmp_path / name)
    assert np.allclose(found.vertices, surface.vertices, atol=1e-4) and np.array_equal(found.faces, surface.faces)
    with pytest.raises(FileExistsError):
        surface.save(tmp_path / name)
    surface.save(tmp_path / name, overwrite=True)


def test_nibabel_reads_what_is_written(study: Study, tmp_path: Path) -> None:
    study[0].save(tmp_path / "s.surf.gii")
    vertices, faces = nibabel.load(tmp_path / "s.surf.gii").agg_data(("pointset", "triangle"))
    assert np.array_equal(vertices, study[0].vertices.astype("f4")) and np.array_equal(faces, study[0].faces)


#: The geometry of a volume, as FreeSurfer's surfaces have it.
VOLUME: dict[str, Any] = {
    "head": np.array([2, 0, 20], np.int32),
    "valid": "1  # volume info valid",
    "filename": "../mri/orig.mgz",
    "volume": [256, 256, 256],
    "voxelsize": [1.0, 1.0, 1.0],
    "xras": [-1.0, 0.0, 0.0],
    "yras": [0.0, 0.0, -1.0],
    "zras": [0.0, 1.0, 0.0],
    "cras": [5.0, -17.5, 18.25],
}


def test_a_surface_keeps_its_place_in_the_volume(study: Study, tmp_path: Path) -> None:
    surface, sphere = study
    path = tmp_path / "lh.pial"
    nibabel.freesurfer.write_geometry(path, surface.vertices, surface.faces, volume_info=VOLUME)
    read = sp.read_surface(path)
    sp.fit(path, sphere, 4).save(tmp_path / "m.spharm.npz")
    spharm("reconstruct", "--model", tmp_path / "m.spharm.npz", "-o", tmp_path / "lh.program")
    spharm("fit", "--surface", path, "--max-degree", "4", "-o", tmp_path / "own.spharm.npz")
    kept = {
        "lh.copy": read,
        "lh.pickled": pickle.loads(pickle.dumps(read)),
        "lh.model": sp.fit(read, max_degree=4).surface(2),
        "lh.many": sp.fit_many([read], sphere, 4)[0].surface(2),
        "lh.loaded": sp.Model.load(tmp_path / "own.spharm.npz").surface(),
        "lh.mapped": sp.parametrize(read).surface,
    }
    for name, found in kept.items():
        found.save(tmp_path / name)
    for name in (*kept, "lh.program"):
        volume = nibabel.freesurfer.read_geometry(tmp_path / name, read_metadata=True)[2]
        assert np.allclose(volume["cras"], VOLUME["cras"]), name
    points = read.to_nibabel().darrays[0]
    assert float(points.meta["VolGeomC_S"]) == 18.25 and read._meta is not None


def test_a_surface_keeps_the_metadata_of_gifti(study: Study, tmp_path: Path) -> None:
    image = _nibabel(study[0])
    image.meta["Origin"], image.darrays[0].meta["AnatomicalStructurePrimary"] = "here", "CortexLeft"
    image.darrays[0].coordsys = nibabel.gifti.GiftiCoordSystem(1, 4, np.diag([1.0, 2, 3, 1]))
    nibabel.save(image, tmp_path / "a.surf.gii")
    read = sp.read_surface(tmp_path / "a.surf.gii")
    read.save(tmp_path / "b.surf.gii")
    for found in (nibabel.load(tmp_path / "b.surf.gii"), read.to_nibabel()):
        points = found.darrays[0]
        assert found.meta["Origin"] == "here" and points.meta["AnatomicalStructurePrimary"] == "CortexLeft"
        assert (points.coordsys.dataspace, points.coordsys.xformspace) == (1, 4) and points.coordsys.xform[2, 2] == 3
    # A mirror image is of the other hemisphere, and elsewhere.
    mirror = sp.shape.SimilarityTransform(np.eye(3), False, np.diag([-1.0, 1, 1]), 1.0, np.zeros(3))
    points = mirror.apply(read).to_nibabel().darrays[0]
    assert points.meta["AnatomicalStructurePrimary"] == "CortexRight" and points.coordsys.dataspace == 0
    assert not study[0].to_nibabel().darrays[0].meta


def test_signals_go_to_files_and_back(tmp_path: Path) -> None:
    values = np.arange(84.0).reshape(42, 2)
    for name in ["v.func.gii", "v.csv", "v.mgz"]:
        sp.write_signal(tmp_path / name, values)
        assert np.array_equal(sp.read_signal(tmp_path / name), values)


def test_a_surface_is_mapped_and_resampled(study: Study) -> None:
    found = sp.parametrize(study[0], method="conformal")
    assert found.quality["flipped"] == 0 and found.report["method"] == "conformal"
    assert np.allclose(np.linalg.norm(found.sphere.vertices, axis=1), 1)
    again = sp.resample(found.surface, found.sphere, "icosphere:3")
    assert len(again.surface.vertices) == 642 and again.report["distance_rms"] > 0


def test_labels_become_surfaces(tmp_path: Path) -> None:
    labels = np.zeros((12, 12, 12), np.int16)
    labels[2:6, 3:7, 2:6], labels[8:11, 2:9, 3:6] = 1, 7
    affine = np.diag([2.0, 1.0, 1.0, 1.0])
    nibabel.save(nibabel.Nifti1Image(labels, affine), tmp_path / "labels.nii.gz")
    assert sp.labels(labels) == sp.labels(tmp_path / "labels.nii.gz") == {1: 64, 7: 63}
    from_array = sp.parametrize_volume(labels, label=7, affine=affine)
    from_file = sp.parametrize_volume(tmp_path / "labels.nii.gz", label=7)
    assert np.array_equal(from_array.surface.vertices, from_file.surface.vertices)
    assert np.array_equal(from_array.sphere.vertices, from_file.sphere.vertices)
    # The smooth surface has the voxels' volume; the voxels' faces end between voxels.
    corners = from_array.surface.vertices[from_array.surface.faces]
    volume = np.linalg.det(corners).sum() / 6
    assert volume == pytest.approx(2 * 63, rel=5e-3)
    faces = sp.parametrize_volume(labels, label=7, affine=affine, label_surface="voxels").surface.vertices
    assert np.allclose(faces.min(0), [15, 1.5, 2.5]) and np.allclose(faces.max(0), [21, 8.5, 5.5])
    assert np.abs(from_array.surface.vertices - faces).max() <= 1 + 1e-12, "half a voxel of 2 mm"
    with pytest.raises(ValueError, match="label_surface: expected smooth or voxels, found round"):
        sp.parametrize_volume(labels, label=7, label_surface="round")
    with pytest.raises(sp.MeshError, match="label"):
        sp.parametrize_volume(labels)


def test_axes_and_spacing_of_images(tmp_path: Path) -> None:
    labels = np.zeros((12, 11, 10), np.int32)
    labels[2:6, 3:8, 2:6] = 4
    expected = sp.parametrize_volume(labels, affine=np.diag([0.2, 0.3, 0.5, 1])).surface.vertices
    of_sizes = sp.parametrize_volume(labels, spacing=(0.2, 0.3, 0.5))
    assert np.array_equal(of_sizes.surface.vertices, expected)
    image = np.ascontiguousarray(labels.transpose())
    of_image = sp.parametrize_volume(image, axes="zyx", spacing=(0.5, 0.3, 0.2))
    assert np.array_equal(of_image.surface.vertices, expected)
    # A file without a voxel size takes one, or an affine.
    np.save(tmp_path / "labels.npy", labels)
    assert sp.labels(tmp_path / "labels.npy") == {4: 80}
    with pytest.raises(sp.MeshError, match="doesn't record the voxel size; give spacing="):
        sp.parametrize_volume(tmp_path / "labels.npy")
    places: list[dict[str, Any]] = [{"spacing": (0.2, 0.3, 0.5)}, {"affine": np.diag([0.2, 0.3, 0.5, 1])}]
    for given in places:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found = sp.parametrize_volume(tmp_path / "labels.npy", **given)
        assert np.allclose(found.surface.vertices, expected)
    nibabel.save(nibabel.Nifti1Image(labels, np.eye(4)), tmp_path / "labels.nii.gz")
    with pytest.raises(ValueError, match="affine: expected None, because the volume file has its own affine"):
        sp.parametrize_volume(tmp_path / "labels.nii.gz", affine=np.eye(4))
    with pytest.warns(sp.SpharmWarning, match="voxel size 0.2 x 0.3 x 0.5 replaces the file's size 1 x 1 x 1"):
        sp.parametrize_volume(tmp_path / "labels.nii.gz", spacing=(0.2, 0.3, 0.5))
    with pytest.raises(ValueError, match="spacing: expected None with affine"):
        sp.parametrize_volume(labels, affine=np.eye(4), spacing=(1, 1, 1))
    # The axes of a NumPy file may have this order, too; its voxel size is that along x, y and z.
    uneven = labels.copy()
    uneven[6:9, 3:8, 2:6] = 4
    np.save(tmp_path / "image.npy", np.ascontiguousarray(uneven.transpose()))
    of_array_file = sp.parametrize_volume(tmp_path / "image.npy", axes="zyx", spacing=(0.2, 0.3, 0.5))
    of_array = sp.parametrize_volume(uneven, spacing=(0.2, 0.3, 0.5))
    assert np.allclose(of_array_file.surface.vertices, of_array.surface.vertices)
    rows = [{"id": "a", "surface": tmp_path / "image.npy"}]
    [row] = sp.fit_cohort(rows, tmp_path, 6, voxel_size=(0.2, 0.3, 0.5), axes="zyx")
    assert row.model is not None
    assert sp.shape.measure(row.model).centroid == pytest.approx((1.0, 1.5, 1.75), abs=0.1)
    with pytest.raises(ValueError, match="a NIfTI file always has, found zyx; omit axes="):
        sp.parametrize_volume(tmp_path / "labels.nii.gz", axes="zyx")
    with pytest.raises(ValueError, match="axes: expected 'xyz' or 'zyx', found 'xzy'"):
        sp.parametrize_volume(labels, axes="xzy")
    with pytest.raises(ValueError, match="spacing: expected three positive numbers"):
        sp.parametrize_volume(labels, spacing=(1, 0, 1))


def test_labels_that_are_cut_off_or_in_pieces_are_reported() -> None:
    labels = np.zeros((30, 8, 8), np.int32)
    labels[2:6, 2:6, 2:6] = 1
    whole = sp.parametrize_volume(labels)
    assert (whole.report["voxels"], whole.report["at_border"]) == (64, False) and "repair" not in whole.report
    assert flaws(whole.report, MapReport, "volume") == []
    for start in (8, 14, 20):
        labels[start : start + 4, 2:6, 2:6] = 1
    loss = r"3 pieces dropped \(192 voxels, 75 % of the label\); .* skimage.measure.label"
    with pytest.warns(sp.SpharmWarning, match=loss):
        fixed = sp.parametrize_volume(labels, fix=True)
    assert fixed.report["voxels"] == 256 and fixed.report["repair"]["pieces_dropped"] == 3
    assert flaws(fixed.report, MapReport, "volume") == []
    with pytest.warns(sp.SpharmWarning, match="label 1 touches the border of the volume"):
        assert sp.parametrize_volume(labels[2:6]).report["at_border"]


@pytest.mark.parametrize("image", [nibabel.Nifti1Image, nibabel.Nifti2Image])
def test_volumes_in_metres_and_microns_are_read_in_mm(image: Any, tmp_path: Path) -> None:
    labels = np.zeros((8, 8, 8), np.uint8)
    labels[2:6, 2:6, 2:6] = 1
    affine = np.array([[0, -0.5, 0, 3], [1, 0, 0, -4], [0, 0, 2, 5], [0, 0, 0, 1]])
    expected = sp.parametrize_volume(labels, affine=affine).surface.vertices
    for unit, length in [("unknown", 1), ("mm", 1), ("meter", 1e-3), ("micron", 1e3)]:
        # nibabel leaves affine and zooms in the unit of the header.
        volume = image(labels, np.diag([length, length, length, 1]) @ affine)
        volume.header.set_xyzt_units(unit, "sec")
        nibabel.save(volume, tmp_path / "labels.nii.gz")
        found = sp.parametrize_volume(tmp_path / "labels.nii.gz").surface.vertices
        assert np.allclose(found, expected, atol=1e-5), unit


def test_distances_are_those_of_the_definition(study: Study) -> None:
    surface = study[0]
    moved = sp.Surface(surface.vertices + [0.5, 0, 0], surface.faces)
    found = sp.compare(surface, moved, surface_distance=True)
    assert (found.per_vertex <= 0.5).all() and found.rms == pytest.approx(0.5)
    assert found.msd == pytest.approx(0.25 / found.scale**2)
    assert found.surface is not None and found.surface["hausdorff"] <= 0.5
    other = sp.compare(surface, sp.icosphere(2), surface_distance=True)
    assert np.isnan(other.msd) and len(other.per_vertex) == 162
    same = sp.compare(surface, sp.icosphere(2))
    assert same.surface == other.surface and sp.compare(surface, moved).surface is None
    with pytest.raises(ValueError, match="other: the triangles of"):
        sp.compare(surface, sp.icosphere(2), surface_distance=False)
    kept = surface.vertices[:, 2] > 0
    half = sp.Surface(surface.vertices + np.outer(kept, [0.5, 0, 0]), surface.faces)
    part, rest = (sp.compare(surface, half, surface_distance=True, mask=mask) for mask in (kept, ~kept))
    assert part.rms == pytest.approx(0.5) and rest.max == 0 and sp.compare(surface, half).rms < 0.5
    assert part.surface is not None and rest.surface is not None and part.surface["rms"] > 0.1 > rest.surface["rms"]
    with pytest.raises(ValueError, match="mask: expected meshes with the same triangles"):
        sp.compare(surface, sp.icosphere(2), surface_distance=True, mask=kept)


def test_models_are_compared_with_each_other_and_with_meshes(study: Study) -> None:
    surface, sphere = study
    model = sp.fit(surface, sphere, 12)
    assert sp.compare(surface, model).rms == sp.compare(surface, model.surface()).rms
    assert np.array_equal(sp.compare(model, surface).per_vertex, sp.compare(model.surface(), surface).per_vertex)
    signal = sp.fit(surface.vertices[:, 0], sphere, 4)
    for name, pair in {"surface": (signal, surface), "other": (model, signal)}.items():
        with pytest.raises(ValueError, match=f"^{name}: expected a surface, found a model of a signal"):
            sp.compare(*pair)
    shifted = sp.Model(model.coefficients + np.eye(169)[:, :1] * np.sqrt(4 * np.pi))
    found = sp.compare(model, shifted)
    assert found.rms == pytest.approx(np.sqrt(3)) and len(found.per_vertex) == 163_842
    # Over another mesh, the model is a surface of its own.
    other = sp.compare(sp.icosphere(3), model)
    assert other.surface is not None and len(other.per_vertex) == 163_842


def test_a_mesh_that_is_no_sphere_is_doubted(study: Study) -> None:
    surface, sphere = study
    model = sp.fit(surface, sphere, 4)
    with pytest.warns(sp.SpharmWarning, match="the sphere: the radii range from .* this is a sphere centred at the origin"):
        model.surface(surface)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model.surface(sp.Surface(3 * sphere.vertices, sphere.faces))


def test_what_memory_doesnt_allow_is_refused(study: Study) -> None:
    labels = np.ones((4, 4, 4), int)
    refused: list[Callable[[str], object]] = [
        lambda memory: sp.parametrize(study[0], method="conformal", memory=memory),
        lambda memory: sp.parametrize_volume(np.pad(labels, 1), label=1, memory=memory),
        lambda memory: sp.resample(*study, "icosphere:3", memory=memory),
        lambda memory: sp.compare(*study, surface_distance=True, samples=1000, memory=memory),
    ]
    for work in refused:
        with pytest.raises(sp.MemoryBudgetError, match="memory= allows only 0.0 MiB") as caught:
            work("10KiB")
        assert caught.value.budget == 10 << 10 and caught.value.needed > caught.value.budget
        with pytest.raises(ValueError, match="512MiB"):
            work("much")
        work("1GiB")
    with pytest.raises(sp.MemoryBudgetError, match="are free"):
        sp.compare(*study, surface_distance=True, samples=10**12)


def test_grey_values_and_probabilities_of_arrays_and_files(tmp_path: Path) -> None:
    grid = np.stack(np.meshgrid(*(np.arange(16.0),) * 3, indexing="ij"), -1)
    grey = 5.2 - np.linalg.norm(grid - [7.4, 7.7, 7.2], axis=-1)
    share = np.clip(grey + 0.5, 0, 1).astype(np.float32)
    affine = np.diag([1.0, 1.0, 1.0, 1.0])

    def volume(made: sp.Parametrization) -> float:
        return float(np.linalg.det(made.surface.vertices[made.surface.faces]).sum() / 6)

    def ball(radius: float) -> float:
        return float(4 / 3 * np.pi * radius**3)

    assert abs(volume(sp.parametrize_volume(grey, threshold=0.0)) / ball(5.2) - 1) < 0.015
    assert abs(volume(sp.parametrize_volume(grey, threshold=1.0)) / ball(4.2) - 1) < 0.02
    of_shares = sp.parametrize_volume(share, probability=True)
    assert abs(volume(of_shares) / ball(5.2) - 1) < 0.01

    nibabel.save(nibabel.Nifti1Image(share, affine), tmp_path / "share.nii.gz")
    of_file = sp.parametrize_volume(tmp_path / "share.nii.gz", probability=True)
    np.testing.assert_array_equal(of_file.surface.vertices, of_shares.surface.vertices)
    rows = [{"id": "a", "surface": tmp_path / "share.nii.gz"}]
    [row] = sp.fit_cohort(rows, tmp_path, 6, probability=True)
    assert row.state == "done" and row.model is not None
    assert abs(sp.shape.measure(row.model).volume / ball(5.2) - 1) < 0.01

    wide = sp.parametrize_volume(share, probability=True, smooth_radius=1.5)
    assert not np.array_equal(wide.surface.vertices, of_shares.surface.vertices)
    with pytest.raises(ValueError, match="grey values with threshold="):
        sp.parametrize_volume(grey)
    with pytest.raises(ValueError, match="probabilities from 0 to 1, found"):
        sp.parametrize_volume(grey, probability=True)
    with pytest.raises(ValueError, match="threshold: expected a number, found nan"):
        sp.fit_cohort(rows, tmp_path, 6, threshold=float("nan"), on_error="collect")
    with pytest.raises(ValueError, match="expected None with probability=True"):
        sp.parametrize_volume(grey, threshold=0.5, probability=True)
    with pytest.raises(ValueError, match="smooth_radius: expected 0.25 to 4 voxels"):
        sp.parametrize_volume(share, probability=True, smooth_radius=0)
