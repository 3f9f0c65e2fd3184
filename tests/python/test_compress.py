"""Tests of the names of models' files, and of compressed models."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import spharm_rs as sp


@pytest.fixture(scope="module")
def model() -> sp.Model:
    return sp.fit(*sp.example_surface(3), 8)


@pytest.mark.parametrize("name", ["x.sphz", "x.txt", "x.spharm", "x.surf.gii", "x.npz.gz"])
def test_models_are_saved_under_names_of_models_only(model: sp.Model, tmp_path: Path, name: str) -> None:
    advice = {"x.sphz": "model.compress", "x.surf.gii": "save writes meshes"}.get(name, "")
    with pytest.raises(ValueError, match=f"path: expected a model's name such as .*, found .*{name}.*{advice}"):
        model.save(tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_a_model_is_compressed_and_loaded_again(model: sp.Model, tmp_path: Path) -> None:
    file = tmp_path / "m.sphz"
    distance = model.compress(file, tolerance=1e-4)
    found = sp.Model.load(file)
    assert 0 < distance <= 1e-4 and found.max_degree == 8 and found.is_surface and found.sphere is None
    assert np.abs(found.coefficients - model.coefficients).max() < 1e-2 * np.abs(model.coefficients).max()
    fewer = file.stat().st_size - 20
    with pytest.raises(FileExistsError):
        model.compress(file, bytes=fewer)
    assert model.compress(file, bytes=fewer, overwrite=True) > distance and file.stat().st_size <= fewer
    signal = sp.Model(np.random.default_rng(0).normal(size=(16, 2)))
    signal.compress(str(tmp_path / "s.SPHZ"), tolerance=0.01)
    assert not sp.Model.load(tmp_path / "s.SPHZ").is_surface


@pytest.mark.parametrize(
    "given, text",
    [
        ({}, "tolerance, bytes: expected one of them, found none"),
        ({"tolerance": 0.1, "bytes": 100}, "tolerance, bytes: expected one of them, found both"),
        ({"tolerance": 2.0}, "tolerance: expected 1e-8 to 1, found 2"),
        ({"bytes": 0}, "bytes: expected at least 1, found 0"),
        ({"bytes": 20}, "20 bytes are too few"),
    ],
)
def test_wrong_targets_are_refused(model: sp.Model, tmp_path: Path, given: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        model.compress(tmp_path / "m.sphz", **given)
    with pytest.raises(ValueError, match=r"path: expected a name that ends in .sphz, found .*m.npz"):
        model.compress(tmp_path / "m.npz", tolerance=0.1)


def test_damaged_compressed_models_are_refused(model: sp.Model, tmp_path: Path) -> None:
    file = tmp_path / "m.sphz"
    with pytest.raises(FileNotFoundError):
        sp.Model.load(file)
    model.compress(file, tolerance=1e-6)
    whole = file.read_bytes()
    file.write_bytes(whole[:-3])
    with pytest.raises(sp.errors.MeshError, match="m.sphz: truncated file"):
        sp.Model.load(file)
    file.rename(tmp_path / "m.npz").write_bytes(whole)
    with pytest.raises(sp.errors.MeshError, match="m.npz: the file is a compressed model .*; Model.load reads the file"):
        sp.Model.load(tmp_path / "m.npz")
    file.write_bytes(b"PK" + whole)
    with pytest.raises(sp.errors.MeshError, match="m.sphz: not a compressed model"):
        sp.Model.load(file)
