"""The package and the program give the same numbers, and the package contains the program."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import spharm_rs as sp

from .conftest import Study


def spharm(*arguments: str | Path, code: int = 0) -> str:
    command = [sys.executable, "-m", "spharm_rs", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == code, done.stderr
    return done.stdout + done.stderr


def coefficients(path: Path) -> np.ndarray:
    found: np.ndarray = np.load(path)["coefficients"]
    return found


def test_the_program_runs() -> None:
    assert sp.__version__ in spharm("--version")
    assert "Usage: spharm fit" in spharm("fit", "--no-such-flag", code=2)
    assert "error: nowhere.ply" in spharm("fit", "--surface", "nowhere.ply", "--max-degree", "4", "-o", "x.npz", code=1)


def test_a_fit_over_a_sphere_has_the_programs_bits(study: Study, files: Path, tmp_path: Path) -> None:
    out = tmp_path / "m.npz"
    spharm("fit", "--surface", files / "surface.ply", "--sphere", files / "sphere.ply", "--max-degree", "20", "--threads",
           "2", "-o", out)  # fmt: skip
    model = sp.fit(*study, 20, threads=2)
    assert np.array_equal(model.coefficients, coefficients(out))
    assert np.array_equal(sp.Model.load(out).coefficients, model.coefficients)


def test_a_fit_of_a_bare_mesh_has_the_programs_bits(study: Study, files: Path, tmp_path: Path) -> None:
    out = tmp_path / "m.npz"
    spharm("fit", "--surface", files / "surface.ply", "--max-degree", "15", "--threads", "2", "-o", out)
    model = sp.fit(study[0], max_degree=15, threads=2)
    assert np.array_equal(model.coefficients, coefficients(out))
    assert model.directions is not None and np.array_equal(model.directions, np.load(out)["directions"])


@pytest.mark.parametrize("method", ["irf", "mirf", "nlsf", "lsq"])
def test_a_fit_over_a_store_has_the_programs_bits(study: Study, files: Path, tmp_path: Path, method: str) -> None:
    store = sp.Store(tmp_path / "store")
    store.build(files / "sphere.ply", 12, threads=2)
    if method == "lsq":
        store.factor(files / "sphere.ply", 12, threads=2)
    out, passes = tmp_path / "m.npz", ["--passes", "2"] if "irf" in method else []
    spharm("fit", "--surface", files / "surface.ply", "--sphere", files / "sphere.ply", "--max-degree", "12", "--store",
           store.path, "--method", method, "--threads", "2", *passes, "-o", out)  # fmt: skip
    model = sp.fit(*study, 12, store=store, method=method, passes=2 if passes else 1, threads=2)
    assert np.array_equal(model.coefficients, coefficients(out))


def test_the_program_reads_models_of_the_package(study: Study, tmp_path: Path) -> None:
    model = sp.fit(*study, 10)
    model.save(tmp_path / "m.spharm.npz")
    spharm("reconstruct", "--model", tmp_path / "m.spharm.npz", "-o", tmp_path / "r.ply", "--double")
    assert np.array_equal(sp.read_surface(tmp_path / "r.ply").vertices, model.surface().vertices)
