"""Tests of masks of vertices, and of the maps, images and files of results."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import pytest

import spharm_rs as sp

GROUPS = ["a"] * 6 + ["b"] * 6
SPHERE = sp.icosphere(2)
#: All but a cap, and some vertices on its edge.
KEPT = SPHERE.vertices[:, 2] < 0.7
MAPS = ("statistic", "p", "q", "p_fwe", "p_permutation", "tfce", "p_tfce", "effect", "margin", "standard_error", "size")


def values_of(seed: int = 5) -> Any:
    """Returns values of 12 subjects at the vertices of an icosphere, which differ between the groups on one side."""
    values = np.random.default_rng(seed).normal(size=(12, 162))
    values[:6, SPHERE.vertices[:, 0] > 0.5] += 1.5
    return values


def test_images_bring_their_common_mesh() -> None:
    images = [SPHERE.to_nilearn(values) for values in values_of()]
    for given in (images, SPHERE.to_nilearn(values_of().T)):
        found = sp.shape.group_test(given, GROUPS, permutations=20, tfce=True)
        assert found.surface is not None and np.array_equal(found.surface.faces, SPHERE.faces)
        assert found.to_nilearn("p").mesh.parts["left"].coordinates.shape == SPHERE.vertices.shape
    other = sp.Surface(2 * SPHERE.vertices, SPHERE.faces).to_nilearn(values_of()[0])
    assert sp.shape.group_test([other, *images[1:]], GROUPS, permutations=20).surface is None


@pytest.mark.parametrize("missing", [1e6, np.nan, np.inf])
def test_a_mask_tests_the_columns_inside_alone(missing: float, tmp_path: Path) -> None:
    values = np.where(KEPT, values_of(), missing)
    settings: dict[str, Any] = {"groups": GROUPS, "tfce": True, "cluster": 0.05, "permutations": 300}
    found = sp.shape.group_test(values, surface=SPHERE, mask=KEPT, **settings)
    alone = sp.shape.group_test(values[:, KEPT], groups=GROUPS, permutations=300)
    assert found.tfce is not None and found.p_tfce is not None and found.clusters and found.cluster_of is not None
    for name in ("tfce", "p_tfce"):
        assert np.isfinite(getattr(found, name)[KEPT]).all() and np.isnan(getattr(found, name)[~KEPT]).all()
    for name in (name for name in MAPS if "tfce" not in name):
        whole, part = getattr(found, name), getattr(alone, name)
        assert whole.shape == (162,) and whole[KEPT].tobytes() == part.tobytes(), name
        assert np.isnan(whole[~KEPT]).all(), name
    assert not found.cluster_of[~KEPT].any()
    for number, cluster in enumerate(found.clusters, 1):
        assert found.statistic[cluster.peak] == cluster.statistic and found.cluster_of[cluster.peak] == number
        assert (found.cluster_of == number).sum() == cluster.vertices
    assert found.mask is not None and np.array_equal(found.mask, KEPT) and alone.mask is None
    assert repr(found).startswith(f"TestResult(t, a - b, {KEPT.sum()} of 162 vertices, least p_fwe 0.")
    sp.write_signal(tmp_path / "mask.shape.gii", KEPT)
    again = sp.shape.group_test(values, surface=SPHERE, mask=tmp_path / "mask.shape.gii", **settings)
    assert np.array_equal(again.statistic, found.statistic, equal_nan=True)


def test_a_group_is_tested_at_its_own_directions() -> None:
    ball, rng = sp.icosphere(3), np.random.default_rng(2)
    surfaces = []
    for _ in range(6):
        bump = 1 + 0.05 * rng.normal() * ball.vertices[:, :1] + 0.2 * ball.vertices[:, 1:2]
        surfaces.append(sp.Surface(ball.vertices * [12, 8, 6] * bump, ball.faces))
    group = sp.shape.correspond(surfaces, 6, subdivisions=3, pose="near")
    found = sp.shape.group_test(group, ["a", "b"] * 3, permutations=0)
    models = sp.shape.group_test(group.models, ["a", "b"] * 3, sphere=group.sphere, permutations=0)
    assert found.statistic.shape == (len(group.directions),) and np.array_equal(found.statistic, models.statistic)
    assert found.surface is not None and len(found.surface.vertices) == len(group.directions)


def test_a_mask_of_models_and_of_positions() -> None:
    rng = np.random.default_rng(1)
    ball = sp.Model(np.eye(4)[:, [3, 1, 2]])
    models = [ball + sp.Model(rng.normal(size=(9, 3)) * 0.1) for _ in range(12)]
    for signal, shape in (("normal", (162,)), ("position", (162, 3))):
        whole = sp.shape.group_test(models, GROUPS, sphere=2, signal=signal, permutations=0)
        found = sp.shape.group_test(models, GROUPS, sphere=2, signal=signal, permutations=0, mask=KEPT)
        assert found.effect is not None and whole.effect is not None and found.effect.shape == shape
        assert np.array_equal(found.effect[KEPT], whole.effect[KEPT]) and np.isnan(found.effect[~KEPT]).all()
        assert np.array_equal(found.statistic[KEPT], whole.statistic[KEPT])
        # Fewer tests are corrected for.
        assert not np.array_equal(found.q[KEPT], whole.q[KEPT])
        assert found.surface is not None and len(found.surface.vertices) == 162
        assert found.picture("effect" if signal == "normal" else "statistic", size=80).png[:4] == b"\x89PNG"


def test_a_label_of_freesurfer_needs_its_sphere(tmp_path: Path) -> None:
    models = [sp.Model(size * np.eye(4)[:, [3, 1, 2]]) for size in np.linspace(1, 2, 12)]
    label = tmp_path / "lh.cortex.label"
    inside = np.flatnonzero(KEPT)
    label.write_text(f"#!ascii label\n{len(inside)}\n" + "".join(f"{vertex} 0 0 0 0\n" for vertex in inside))
    for sphere in (2, "icosphere:2"):
        with pytest.raises(ValueError, match=r"lh\.cortex\.label: expected a mask for the vertices of an icosphere, .* sphere="):
            sp.shape.group_test(models, GROUPS, sphere=sphere, permutations=0, mask=label)
    found = sp.shape.group_test(models, GROUPS, sphere=SPHERE, permutations=0, mask=label)
    assert found.mask is not None and np.array_equal(found.mask, KEPT)


def test_values_without_a_mask_have_to_be_finite() -> None:
    values = values_of()
    values[3, 7] = np.nan
    with pytest.raises(ValueError, match="subjects: found NaN in row 3, column 7 .*leave out vertices without values with mask="):
        sp.shape.group_test(values, GROUPS)
    with pytest.raises(ValueError, match="found NaN in row 3, column 7 .*, which is inside the mask"):
        sp.shape.group_test(values, GROUPS, mask=np.arange(162) > 5)
    with pytest.raises(ValueError, match="subjects, minus: found infinity in row 0, column 2"):
        sp.shape.group_test(values_of(), minus=np.where(np.arange(162) == 2, np.inf, values_of(1)), mean=True)
    refused: list[tuple[Any, str]] = [
        (np.zeros(162, bool), "mask: expected at least one vertex to test, found none"),
        (np.ones(161, bool), r"mask: expected shape \(162,\), found \(161,\)"),
    ]
    for mask, message in refused:
        with pytest.raises(ValueError, match=message):
            sp.shape.group_test(values, GROUPS, mask=mask, tfce=True, surface=SPHERE)


def test_a_surface_of_other_vertices_is_refused_at_once() -> None:
    for more in ({}, {"mask": KEPT}, {"tfce": True, "permutations": 20}):
        settings: dict[str, Any] = {"permutations": 0, **more}
        with pytest.raises(ValueError, match="surface: expected 162 vertices, as many as the values have; found 42"):
            sp.shape.group_test(values_of(), GROUPS, surface=sp.icosphere(1), **settings)


def test_small_p_are_high_in_pictures_and_on_request_in_images(tmp_path: Path) -> None:
    found = sp.shape.group_test(values_of(), GROUPS, surface=SPHERE, mask=KEPT, tfce=True, permutations=100)
    for name in ("p", "q", "p_fwe", "p_permutation", "p_tfce"):
        p = getattr(found, name)
        drawn = sp.picture(SPHERE, -np.log10(p), label=f"-log10 {name}, a - b", size=120)
        assert found.picture(name, size=120).png == drawn.png
        image = found.to_nilearn(name, log10=True)
        assert np.allclose(image.data.parts["left"], -np.log10(p), equal_nan=True)
        assert np.array_equal(found.to_nilearn(name).data.parts["left"], p, equal_nan=True)
        nibabel.save(found.to_nibabel(name, log10=True), tmp_path / "map.shape.gii")
        saved = nibabel.load(tmp_path / "map.shape.gii")
        assert np.allclose(saved.darrays[0].data, -np.log10(p), equal_nan=True)
        assert saved.darrays[0].meta["Name"] == f"-log10 {name}, a - b"
    assert found.picture("effect", size=120).png == sp.picture(SPHERE, found.effect, label="effect, a - b", size=120).png
    assert np.isnan(found.to_nilearn("effect").data.parts["left"]).sum() == (~KEPT).sum()
    with pytest.raises(ValueError, match="values, with log10=True: expected one of p, q, p_fwe"):
        found.to_nilearn("effect", log10=True)
    with pytest.raises(ValueError, match="values: expected one of statistic, p"):
        found.picture("mask")
    # A p value that is too small for a number.
    image = replace(found, p=np.where(KEPT, 0.0, np.nan)).to_nilearn("p", log10=True)
    assert 300 < np.nanmin(image.data.parts["left"]) == np.nanmax(image.data.parts["left"]) < 310


def test_a_result_is_saved_whole_or_not_at_all(tmp_path: Path) -> None:
    found = sp.shape.group_test(values_of(), GROUPS, surface=SPHERE, tfce=True, cluster=0.05, permutations=100)
    folder = tmp_path / "out" / "test"
    found.save(folder)
    about = json.loads((folder / "test.json").read_text())
    assert sorted(path.name for path in folder.iterdir()) == sorted(["test.json", "surface.surf.gii", *about["maps"].values()])
    assert set(about["maps"]) == {*MAPS, "cluster_of"}
    for name, file in about["maps"].items():
        assert np.allclose(sp.read_signal(folder / file)[:, 0], getattr(found, name), rtol=1e-6), name
    assert np.allclose(sp.read_surface(folder / "surface.surf.gii").vertices, SPHERE.vertices, atol=1e-6)
    assert about["kind"] == "t" and about["meaning"] == "a - b" and about["levels"] == {"a": 6, "b": 6}
    assert found.clusters and len(about["clusters"]) == len(found.clusters)
    assert about["clusters"][0]["peak"] == found.clusters[0].peak
    assert about["freedom"] == [10.0] and about["vertices"] == about["tested_vertices"] == 162

    positions = np.random.default_rng(2).normal(size=(12, 162, 3))
    other = sp.shape.group_test(positions, GROUPS, permutations=0)
    before = {path: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(FileExistsError, match="overwrite=True"):
        other.save(folder)
    assert {path: path.read_bytes() for path in folder.iterdir()} == before
    other.save(folder, overwrite=True)
    about = json.loads((folder / "test.json").read_text())
    assert about["surface"] is None
    assert sorted(path.name for path in folder.iterdir()) == sorted(["test.json", *about["maps"].values()])
    assert other.effect is not None
    assert np.allclose(sp.read_signal(folder / "effect.shape.gii"), other.effect, rtol=1e-5)
    # One file of an earlier result is enough to refuse, before anything is written.
    (tmp_path / "rest").mkdir()
    (tmp_path / "rest" / "test.json").write_text("{}")
    with pytest.raises(FileExistsError):
        found.save(tmp_path / "rest")
    assert [path.name for path in (tmp_path / "rest").iterdir()] == ["test.json"]


def test_a_mask_leaves_the_statistics_of_the_program(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    ball = sp.Model(np.eye(4)[:, [3, 1, 2]])
    models = [ball + sp.Model(rng.normal(size=(9, 3)) * 0.1) for _ in range(8)]
    for index, model in enumerate(models):
        model.save(tmp_path / f"{'ab'[index // 4]}{index}.spharm.npz")
    sp.write_signal(tmp_path / "mask.csv", KEPT)
    files = [[str(path) for path in sorted(tmp_path.glob(f"{name}*.npz"))] for name in "ab"]
    command = ["shape", "test", "--a", *files[0], "--b", *files[1], "--icosphere", "2", "--mask", str(tmp_path / "mask.csv")]
    command += ["--tfce", "--cluster", "0.05", "-o", str(tmp_path / "out"), "-q"]
    subprocess.run([sys.executable, "-m", "spharm_rs", *command], check=True, capture_output=True)
    found = sp.shape.group_test(models, ["a"] * 4 + ["b"] * 4, sphere=2, mask=KEPT, tfce=True, cluster=0.05)
    left_out_as = {"statistic": 0.0, "p": 1.0, "q": 1.0, "p_fwe": 1.0, "effect": 0.0, "tfce": 0.0, "p_tfce": 1.0}
    for name, left_out in left_out_as.items():
        theirs = sp.read_signal(tmp_path / "out" / f"{name.replace('_', '-')}.shape.gii")[:, 0]
        assert np.allclose(theirs[KEPT], getattr(found, name)[KEPT], rtol=1e-5, atol=1e-7), name
        assert (theirs[~KEPT] == left_out).all() and np.isnan(getattr(found, name)[~KEPT]).all()
