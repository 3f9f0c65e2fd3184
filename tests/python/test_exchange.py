"""Files exported by the program are read and evaluated by other packages; `./run peers` tests all packages."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from scipy.special import sph_harm_y

import spharm_rs as sp
from spharm_rs import convert

from .test_program import spharm
from .test_transform import DIRECTIONS, basis


@pytest.fixture(params=[20, 100])
def model(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, np.ndarray, int]:
    degree: int = request.param
    degrees = np.repeat(np.arange(degree + 1), 2 * np.arange(degree + 1) + 1)
    a = np.random.default_rng(degree).normal(size=((degree + 1) ** 2, 3)) / (1 + degrees[:, np.newaxis])
    sp.Model(a).save(tmp_path / "m.spharm.npz")
    return tmp_path / "m.spharm.npz", a, degree


def export(path: Path, format: str, name: str) -> Path:
    spharm("export", path, "--to", format, "-o", path.parent / name)
    return path.parent / name


def test_arrays_are_those_of_the_package(model: tuple[Path, np.ndarray, int]) -> None:
    path, a, degree = model
    bar = 1e-13 if degree == 20 else 1e-12
    for format in ("s2fft", "ktch", "flowshape"):
        found = np.load(export(path, format, f"{format}.npy"))
        expected = convert.to(format, a)
        assert found.shape == expected.shape
        assert np.abs(found - expected).max() <= bar * np.abs(expected).max(), format
        back = path.parent / f"{format}.npz"
        spharm("import", path.parent / f"{format}.npy", "--from", format, "-o", back)
        assert np.abs(np.load(back)["coefficients"] - a).max() <= bar * np.abs(a).max()


def test_scipy_reads_a_mat_file_and_its_own_is_read(model: tuple[Path, np.ndarray, int]) -> None:
    path, a, degree = model
    fvec = scipy.io.loadmat(export(path, "mat", "m.mat"))["fvec"]
    unit = DIRECTIONS / np.linalg.norm(DIRECTIONS, axis=1)[:, np.newaxis]
    theta, phi = np.arccos(unit[:, 2]), np.arctan2(unit[:, 1], unit[:, 0])
    rows = [(l, m) for l in range(degree + 1) for m in range(-l, l + 1)]
    values = sum(sph_harm_y(*row, theta, phi)[:, np.newaxis] * fvec[i] for i, row in enumerate(rows))
    known = basis(DIRECTIONS, degree) @ a
    assert np.abs(np.real(values) - known).max() <= (1e-13 if degree == 20 else 1e-12) * np.abs(known).max()
    for compressed in (False, True):
        scipy.io.savemat(path.parent / "theirs.mat", {"other": np.eye(3), "fvec": fvec}, do_compression=compressed)
        back = path.parent / "theirs.npz"
        spharm("import", path.parent / "theirs.mat", "-o", back, "--force")
        assert np.abs(np.load(back)["coefficients"] - a).max() <= 1e-13 * np.abs(a).max()


def test_pdm_files_are_those_of_the_package(model: tuple[Path, np.ndarray, int]) -> None:
    path, a, _ = model
    found = convert.read_spharm_pdm(export(path, "pdm", "m.coef"))
    assert np.abs(found - a).max() <= 1e-15 * np.abs(a).max()


def test_aics_values_have_the_sign_of_its_azimuth(tmp_path: Path) -> None:
    a = np.random.default_rng(5).normal(size=(36, 1))
    sp.Model(a, surface=False).save(tmp_path / "r.spharm.npz")
    named = json.loads(export(tmp_path / "r.spharm.npz", "aics", "r.json").read_text())
    array = convert.to_pyshtools(a, normalization="4pi", csphase=-1)[0]
    for (s, l, m), value in np.ndenumerate(array):
        assert np.isclose(named[f"shcoeffs_L{l}M{m}{'CS'[s]}"], value, rtol=1e-14, atol=0)


def test_text_has_every_digit(model: tuple[Path, np.ndarray, int]) -> None:
    path, a, degree = model
    table = np.loadtxt(export(path, "csv", "m.csv"), delimiter=",", skiprows=1)
    assert np.array_equal(table[:, 2:], a)
    found = json.loads(export(path, "json", "m.json").read_text())
    assert found["max_degree"] == degree and np.array_equal(found["coefficients"], a)
    export(path, "pyshtools", "m.sh")
    for k, axis in enumerate("xyz"):
        l, m, c, s = np.loadtxt(path.parent / f"m.{axis}.sh", delimiter=",").T
        array = convert.to_pyshtools(a)[k]
        assert np.array_equal(c, array[0, l.astype(int), m.astype(int)])
        assert np.array_equal(s, array[1, l.astype(int), m.astype(int)])


def test_a_mesh_for_viewers_opens_with_its_colours(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    surface, _ = sp.example_surface(3)
    surface.save(tmp_path / "a.ply", double=True)
    sp.Surface(surface.vertices + [0, 0, 1], surface.faces).save(tmp_path / "b.ply", double=True)
    for ending in ("glb", "vtk", "vtp", "shape.gii"):
        spharm("compare", tmp_path / "a.ply", tmp_path / "b.ply", "-o", tmp_path / f"c.{ending}")
    (mesh,) = trimesh.load(tmp_path / "c.glb", process=False).geometry.values()
    assert np.allclose(mesh.vertices, surface.vertices + [0, 0, 1], atol=1e-4)
    assert np.array_equal(mesh.faces, surface.faces)
    assert mesh.visual.vertex_attributes["color"].shape == (len(mesh.vertices), 4)
    assert np.allclose(mesh.vertex_attributes["_DISTANCE"], 1)
    text = (tmp_path / "c.vtk").read_text()
    values = np.array(text.split("LOOKUP_TABLE default\n")[1].split(), float)
    assert "POINT_DATA 642\nSCALARS distance double 1\n" in text and np.allclose(values, 1)
    assert np.allclose(sp.read_signal(tmp_path / "c.shape.gii"), 1)
