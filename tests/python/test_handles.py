"""Surfaces with handles are cut, fitted and restored; the program gives the same models."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import spharm_rs as sp


def torus(around: int = 16, ring: float = 2.0) -> sp.Surface:
    along = round(around * ring)
    u, v = np.meshgrid(2 * np.pi * np.arange(along) / along, 2 * np.pi * np.arange(around) / around, indexing="ij")
    out = ring + np.cos(v)
    vertices = np.stack([out * np.cos(u), out * np.sin(u), np.sin(v)], axis=-1).reshape(-1, 3)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(along), np.arange(around), indexing="ij"))
    a, b, c, d = (((i + di) % along) * around + (j + dj) % around for di, dj in ((0, 0), (1, 0), (1, 1), (0, 1)))
    return sp.Surface(vertices, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.uint32))


def characteristic(surface: sp.Surface) -> int:
    faces = surface.faces
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    return len(surface.vertices) - len(np.unique(edges, axis=0)) + len(faces)


@pytest.fixture(scope="module")
def given() -> sp.Surface:
    return torus()


def is_given(found: sp.Surface, given: sp.Surface, within: float) -> bool:
    return np.array_equal(found.faces, given.faces) and float(np.abs(found.vertices - given.vertices).max()) < within


def test_handles_are_refused_unless_they_are_to_be_cut(given: sp.Surface) -> None:
    with pytest.raises(sp.errors.MeshError, match="genus 1"):
        sp.parametrize(given)
    with pytest.warns(sp.SpharmWarning, match="genus reduced from 1 to 0: 1 handle severed"):
        mapped = sp.parametrize(given, cut_handles=True)
    assert characteristic(given) == 0 and characteristic(mapped.surface) == 2
    handles = mapped.report["handles"]
    assert (handles["genus_before"], handles["genus_after"], len(handles["loops"])) == (1, 0, 1)
    assert np.array_equal(mapped.surface.vertices[: len(given.vertices)], given.vertices)
    ball = sp.parametrize(sp.icosphere(2), cut_handles=True)
    assert "handles" not in ball.report and ball.surface.faces.shape == (320, 3)


def test_a_model_gives_the_handles_back(given: sp.Surface, tmp_path: Path) -> None:
    mapped = sp.parametrize(given, cut_handles=True, degree=16, area=0.8)
    for model in (sp.fit(mapped, max_degree=16), sp.fit(mapped.surface, mapped, 16), sp.fit_many([mapped.surface], mapped, 16)[0]):
        assert is_given(model.surface(), given, 0.1)
    with pytest.warns(sp.SpharmWarning, match="genus reduced from 1 to 0: 1 handle severed"):
        one = sp.fit(given, max_degree=16, cut_handles=True)
    assert any("1 handle severed" in text for text in one.report["warnings"])
    assert is_given(one.surface(), given, 0.1)
    report = one.report["parametrization"]
    assert report is not None and one.provenance["handles"]["loops"] == report["handles"]["loops"]
    # The cut surface at its own vertices, and the model on another sampling.
    assert one.sphere is not None and characteristic(one.surface(one.sphere)) == 2
    assert characteristic(one.surface(3)) == 2
    # The handles are also restored from a file, in another process, and by a model made from the coefficients.
    one.save(tmp_path / "torus.spharm.npz")
    assert is_given(sp.Model.load(tmp_path / "torus.spharm.npz").surface(), given, 0.1)
    assert is_given(sp.Model(one.coefficients, sphere=one).surface(), given, 0.1)
    assert is_given(sp.Model(one.coefficients, sphere=mapped).surface(), given, 3)


def test_the_program_makes_the_same_model(given: sp.Surface, tmp_path: Path) -> None:
    given.save(tmp_path / "torus.ply", double=True)
    command = [sys.executable, "-m", "spharm_rs", "fit", "--surface", "torus.ply", "--cut-handles", "--max-degree", "12", "-o", "."]
    subprocess.run([*command, "-q"], cwd=tmp_path, check=True, capture_output=True)
    theirs = sp.Model.load(tmp_path / "torus.spharm.npz")
    ours = sp.fit(given, max_degree=12, cut_handles=True)
    assert np.array_equal(ours.coefficients, theirs.coefficients)
    assert ours.provenance["handles"] == theirs.provenance["handles"]


def test_labels_with_handles() -> None:
    at = np.stack(np.meshgrid(*[np.arange(16) - 7.5] * 3, indexing="ij"), axis=-1)
    ring = ((np.hypot(at[..., 0], at[..., 1]) - 4.6) ** 2 + at[..., 2] ** 2 < 5).astype(int)
    with pytest.raises(sp.errors.MeshError, match="handle"):
        sp.parametrize_volume(ring)
    with pytest.warns(sp.SpharmWarning, match="genus reduced from 1 to 0"):
        mapped = sp.parametrize_volume(ring, cut_handles=True)
    model = sp.fit(mapped, max_degree=10)
    assert characteristic(model.surface()) == 0 and mapped.report["handles"]["genus_before"] == 1


def test_a_seam_that_does_not_fit_its_sphere_is_refused() -> None:
    sphere = sp.icosphere(0)
    for seam in ((13, 1, []), (12, 21, []), (11, 1, [11])):
        arrays: tuple[int, int, Any] = (seam[0], seam[1], np.array(seam[2], np.uint32))
        with pytest.raises(ValueError, match="seam"):
            sp._core.Model(np.eye(4)[:, 1:], surface=True, sphere=sphere.vertices, faces=sphere.faces, seam=arrays)


def test_reports_are_plain_json(given: sp.Surface) -> None:
    report = sp.parametrize(given, cut_handles=True).report
    assert json.loads(json.dumps(report)) == report


def test_a_model_with_handles_is_compared_without_the_caps_of_its_cuts(given: sp.Surface) -> None:
    model = sp.fit(given, max_degree=16, cut_handles=True)
    found, of_surface = (sp.compare(given, other, surface_distance=True) for other in (model, model.surface()))
    assert found.rms == of_surface.rms and found.surface == of_surface.surface
    assert sp.compare(model, model.truncate(16)).max == 0
