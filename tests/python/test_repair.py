"""Meshes are repaired, and refused with the call that repairs them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import spharm_rs as sp

from .test_handles import characteristic, torus


def without_cap(height: float) -> sp.Surface:
    """A ball of radius 1 without what lies above this height."""
    ball = sp.icosphere(4)
    return sp.Surface(ball.vertices, ball.faces[(ball.vertices[ball.faces, 2] < height).any(axis=1)])


@pytest.fixture(scope="module")
def open_ball() -> sp.Surface:
    return without_cap(0.9)


def test_a_repair_fills_holes_by_a_surface_that_continues_the_mesh(open_ball: sp.Surface) -> None:
    repaired = sp.repair(open_ball)
    kept = len(np.unique(open_ball.faces))
    assert characteristic(repaired.surface) == 2 and repaired.report["problems"] == []
    assert repaired.changes == f"1 hole filled (4.4 % of the area), {len(open_ball.vertices) - kept} unused vertices dropped"
    report = repaired.report
    assert report["holes_filled"] == 1 and abs(report["filled_area"] - 0.044) < 1e-3 and report["dropped_area"] == 0
    radii = np.linalg.norm(repaired.surface.vertices[kept:], axis=1)
    assert np.abs(radii - 1).max() < 0.01
    assert sp.repair(repaired.surface).changes == "nothing"


def test_each_kind_of_defect_is_counted() -> None:
    ball = sp.icosphere(3)
    corners = ball.vertices[ball.faces]
    soup = np.concatenate([corners, corners[5:6], corners[:1] + [9, 0, 0]]).reshape(-1, 3)
    faces = np.arange(len(soup)).reshape(-1, 3)
    faces[40] = faces[40, ::-1]
    repaired = sp.repair((soup, faces))
    assert repaired.surface.faces.shape == ball.faces.shape and abs(repaired.surface.volume - ball.volume) < 1e-12
    report = repaired.report
    assert (report["repeated_triangles_dropped"], report["triangles_turned"], report["pieces_dropped"]) == (1, 1, 1)
    assert 0 < report["dropped_area"] < 0.01 and report["holes_filled"] == 0


def test_a_large_repair_is_refused_unless_it_is_allowed() -> None:
    half = without_cap(0.1)
    with pytest.raises(sp.MeshError, match=r"1 hole filled \(.*; largest_repair=0.(\d\d) allows this repair") as refused:
        sp.repair(half)
    share = float(str(refused.value).split("largest_repair=")[1].split()[0])
    with pytest.raises(sp.MeshError):
        sp.repair(half, largest_repair=share - 0.02)
    assert characteristic(sp.repair(half, largest_repair=share).surface) == 2
    for wrong in (-0.1, 25, float("nan"), True, [0.4]):
        with pytest.raises(ValueError, match="largest_repair: expected a share from 0 to 1"):
            sp.repair(half, largest_repair=wrong)  # type: ignore[arg-type]


def test_what_a_repair_leaves_is_stated() -> None:
    ring = torus()
    open_ring = sp.Surface(ring.vertices, ring.faces[1:])
    with pytest.raises(sp.MeshError, match=r"leaves 1 handle: .*; call spharm_rs.repair\(surface\) and give cut_handles=True$"):
        sp.fit(open_ring)
    repaired = sp.repair(open_ring)
    # The middle of an edge as a corner of a triangle at the edge.
    ball = sp.icosphere(2)
    vertices = ball.vertices.copy()
    vertices[ball.faces[3, 0]] = vertices[ball.faces[3, 1:]].mean(axis=0)
    assert "no area" in sp.repair((vertices, ball.faces)).report["problems"][0]
    assert repaired.report["problems"] == ["the surface has a handle (genus 1)"]


def test_errors_name_the_call_that_repairs(open_ball: sp.Surface) -> None:
    for call in (sp.parametrize, sp.fit):
        with pytest.raises(sp.MeshError, match=r"a repair is possible: 1 hole filled .*; call spharm_rs.repair\(surface\)$"):
            call(open_ball)
    with pytest.raises(sp.MeshError, match="cut_handles=True cuts the handles$"):
        sp.fit(torus())
    with pytest.raises(sp.MeshError, match=r"; call spharm_rs.repair\(surface, largest_repair=0\.\d\d\)$"):
        sp.fit(without_cap(0.1))
    with pytest.raises(sp.MeshError, match="triangle 0 refers to vertex 3"):
        sp.repair((np.eye(3), [[0, 1, 3]]))


def test_fix_repairs_before_the_map(open_ball: sp.Surface, tmp_path: Path) -> None:
    repaired = sp.repair(open_ball)
    with pytest.warns(sp.SpharmWarning, match="the mesh was repaired: 1 hole filled"):
        mapped = sp.parametrize(open_ball, fix=True)
    assert np.array_equal(mapped.surface.vertices, repaired.surface.vertices)
    assert mapped.report["mesh_repair"]["holes_filled"] == 1
    with pytest.warns(sp.SpharmWarning, match="the mesh was repaired"):
        model = sp.fit(open_ball, max_degree=8, fix=True)
    expected = sp.fit(repaired.surface, max_degree=8)
    assert np.array_equal(model.coefficients, expected.coefficients)
    report = model.report["parametrization"]
    assert report is not None and report["mesh_repair"]["holes_filled"] == 1
    assert model.provenance["repair"]["holes_filled"] == 1
    with pytest.warns(sp.SpharmWarning):
        (one,) = sp.fit_many([open_ball], max_degree=8, fix=True)
    assert np.allclose(one.coefficients, model.coefficients, atol=1e-12)
    # A sound surface is not changed.
    assert "mesh_repair" not in sp.parametrize(sp.icosphere(2), fix=True).report

    path = tmp_path / "half.ply"
    without_cap(0.1).save(path)
    rows = [{"id": "half", "surface": path}]
    (refused,) = sp.fit_cohort(rows, tmp_path, 6, fix=True, on_error="collect")
    assert "a large part of the surface" in str(refused.error)
    with pytest.warns(sp.SpharmWarning):
        (done,) = sp.fit_cohort(rows, tmp_path, 6, fix=True, largest_repair=0.4)
    assert done.state == "done"
    map_report = done.report["parametrization"] if done.report is not None else None
    assert map_report is not None and 0.3 < map_report["mesh_repair"]["filled_area"] < 0.4


def test_a_mesh_that_winds_inwards_is_a_warning() -> None:
    ball = sp.icosphere(2)
    inward = sp.Surface(ball.vertices, np.ascontiguousarray(ball.faces[:, ::-1]))
    with pytest.warns(sp.SpharmWarning, match="the triangles wind inwards"):
        model = sp.fit(inward, max_degree=4)
    assert any("wind inwards" in text for text in model.report["warnings"])
    outward = sp.fit(ball, max_degree=4)
    assert not any("wind inwards" in text for text in outward.report["warnings"])


def test_a_wrap_is_the_closed_surface_around_all_parts(tmp_path: Path) -> None:
    ball = sp.icosphere(4)
    beside = 0.7 * ball.vertices + [0.9, 0, 0]
    parts = (np.concatenate([ball.vertices, beside]), np.concatenate([ball.faces, ball.faces + len(ball.vertices)]))
    with pytest.raises(sp.MeshError, match=r"repair\(surface, wrap=128\) replaces the mesh by the closed surface around it"):
        sp.repair(parts)
    wrapped = sp.repair(parts, wrap=64)
    assert characteristic(wrapped.surface) == 2 and wrapped.report["problems"] == []
    # The volume of two balls at a distance d, less that of the lens they share.
    r, s, d = 1.0, 0.7, 0.9
    lens = np.pi * (r + s - d) ** 2 * (d * d + 2 * d * (r + s) - 3 * (r - s) ** 2) / (12 * d)
    assert abs(wrapped.surface.volume / (4 / 3 * np.pi * (r**3 + s**3) - lens) - 1) < 0.01
    report = wrapped.report["wrap"]
    assert report["voxels"] == 64 and abs(report["voxel"] - 2.6 / 64) < 1e-12
    # The walls inside are two caps, with 0.215 of the area; less than a voxel of them is near the outside.
    assert 0.18 < report["hidden_area"] < 0.215
    assert report["handles"] == report["cavities"] == report["pieces"] == 0
    with pytest.warns(sp.SpharmWarning, match="wrapped with 32 voxels"):
        model = sp.fit(parts, max_degree=8, wrap=32)
    assert model.provenance["repair"]["wrap"]["voxels"] == 32
    with pytest.warns(sp.SpharmWarning):
        (one,) = sp.fit_many([parts], max_degree=8, wrap=32)
    assert np.allclose(one.coefficients, model.coefficients, atol=1e-12)
    path = tmp_path / "parts.ply"
    sp.Surface(*parts).save(path)
    with pytest.warns(sp.SpharmWarning):
        (done,) = sp.fit_cohort([{"id": "parts", "surface": path}], tmp_path, 6, wrap=32)
    assert done.state == "done" and sp.Model.load(tmp_path / "parts.spharm.npz").provenance["wrap"] == 32
    for wrong in (5, True, 3.5, "128"):
        with pytest.raises(ValueError, match="wrap: expected a number of voxels from 16 to 512, found"):
            sp.repair(parts, wrap=wrong)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="wrap: expected None with fix=True"):
        sp.fit(parts, max_degree=8, fix=True, wrap=32)
    with pytest.raises(ValueError, match="wrap: expected no sphere"):
        sp.fit(ball, ball, 4, wrap=32)
    apart = (np.concatenate([ball.vertices, beside + [2, 0, 0]]), parts[1])
    with pytest.raises(sp.MeshError, match=r"1 smaller piece left out \(.*; largest_repair=0\.3\d allows this wrap$"):
        sp.repair(apart, wrap=32)
    kept = sp.repair(apart, wrap=32, largest_repair=0.4)
    assert 0.3 < kept.report["wrap"]["lost_area"] < 0.36 and 0.2 < kept.report["wrap"]["left_out"] < 0.3
    sheet = (np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    with pytest.raises(sp.MeshError, match="the mesh is an open sheet"):
        sp.repair(sheet, wrap=64)


def test_a_wrap_is_advised_first_but_only_if_it_would_succeed() -> None:
    ball = sp.icosphere(4)
    for distance, advised in ((0.9, True), (3.0, False)):
        vertices = np.concatenate([ball.vertices, ball.vertices + [distance, 0, 0]])
        both = (vertices, np.concatenate([ball.faces, ball.faces + len(ball.vertices)]))
        for call in (sp.repair, lambda surface: sp.fit(surface, max_degree=2)):
            with pytest.raises(sp.MeshError, match=r"largest_repair=0\.5[01]") as refused:
                call(both)
            first = "replaces the mesh by the closed surface around it; alternatively, "
            assert (first in str(refused.value)) == advised and ("wrap=" in str(refused.value)) == advised
    cap = without_cap(-0.8)
    with pytest.raises(sp.MeshError, match=r"span large holes, but at most 25 % is allowed: .*; largest_repair=0\.\d\d allows"):
        sp.repair(cap, wrap=32)
    share = sp.repair(cap, wrap=32, largest_repair=0.5).report["wrap"]["bridged_area"]
    assert 0.3 < share < 0.5


def test_triangles_with_wide_gaps_are_no_sheet() -> None:
    ball = sp.icosphere(3)
    corners = ball.vertices[ball.faces]
    soup = (0.999 * corners + 0.001 * corners.mean(axis=1, keepdims=True)).reshape(-1, 3)
    apart = (soup, np.arange(len(soup)).reshape(-1, 3))
    for call in (sp.repair, lambda surface: sp.fit(surface, max_degree=2)):
        with pytest.raises(sp.MeshError, match=r"1280 separate pieces; the gaps .* welding distance of 1e-5 .*wrap=128\)"):
            call(apart)
    assert characteristic(sp.repair(apart, wrap=32).surface) == 2


def test_surfaces_that_enclose_nothing_are_refused_with_the_reason() -> None:
    x, y = np.meshgrid(np.arange(8.0), np.arange(8.0), indexing="ij")
    first = (8 * np.arange(7)[:, None] + np.arange(7)).ravel()
    faces = np.concatenate([first[:, None] + [0, 8, 9], first[:, None] + [0, 9, 1]])
    sheet = (np.column_stack([x.ravel(), y.ravel(), np.zeros(64)]), faces)
    for call in (sp.repair, lambda surface: sp.fit(surface, max_degree=2)):
        with pytest.raises(sp.MeshError, match="the mesh is an open sheet") as refused:
            call(sheet)
        assert "repair(" not in str(refused.value)
    # A Klein bottle has no rim, so there is a closed surface around it.
    i, j = np.divmod(np.arange(64), 8)
    after, next_j = (i + 1) % 8, (j + 1) % 8
    beyond, next_beyond = (np.where(i < 7, k, -k % 8) for k in (j, next_j))
    corners = [8 * i + j, 8 * after + beyond, 8 * after + next_beyond, 8 * i + next_j]
    faces = np.concatenate([np.column_stack([corners[k] for k in face]) for face in ([0, 1, 2], [0, 2, 3])])
    u, v = 2 * np.pi * i / 8, 2 * np.pi * j / 8
    bottle = (np.column_stack([(2 + np.cos(v)) * np.cos(u), (2 + np.cos(v)) * np.sin(u), np.sin(v)]), faces)
    with pytest.raises(sp.MeshError, match=r"not orientable: .*; spharm_rs\.repair\(surface, wrap=128\) replaces"):
        sp.fit(bottle, max_degree=2)
    ball = sp.icosphere(2)
    vertices = ball.vertices.copy()
    vertices[5, 0] = 1e30
    with pytest.raises(sp.MeshError, match=r"vertex 5 \(counted from 0\) lies 1\.\d*e30 times the median distance"):
        sp.fit((vertices, ball.faces), max_degree=2)


def test_settings_that_have_no_effect_are_refused(open_ball: sp.Surface) -> None:
    with pytest.raises(ValueError, match="largest_repair: expected None without fix=True"):
        sp.fit(open_ball, max_degree=4, largest_repair=0.5)
    ball = sp.icosphere(2)
    given: Any
    for given in ({"mask": np.ones(2562, bool)}, {"weights": np.ones(2562)}):
        with pytest.raises(ValueError, match=f"{next(iter(given))}: expected no array with fix=True"):
            sp.fit(open_ball, max_degree=4, fix=True, **given)
    with pytest.raises(ValueError, match="largest_repair: expected None without fix=True"):
        sp.fit_many([ball], ball, 4, largest_repair=0.5)
    with pytest.raises(ValueError, match="largest_repair: expected a share"):
        sp.fit_each([ball], 4, fix=True, largest_repair=5)
    for name in ("fix", "cut_handles"):
        setting: Any = {name: True}
        with pytest.raises(ValueError, match=f"{name}: expected no sphere"):
            sp.fit(ball, ball, 4, **setting)
