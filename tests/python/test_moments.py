"""Moments of samples, and their addition by Dask."""

from __future__ import annotations

import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any, Iterator

import numpy as np
import pytest

import spharm_rs as sp

DIRECTIONS = np.random.default_rng(0).normal(size=(5000, 3))
VALUES = np.random.default_rng(1).normal(size=(5000, 2))
WEIGHTS = np.random.default_rng(2).random(5000)


def in_parts(count: int) -> list[sp.Moments]:
    rows = np.array_split(np.arange(5000), count)
    shards = [(i, count) for i in range(count)]
    return [
        sp.Moments(DIRECTIONS[r], VALUES[r], WEIGHTS[r], max_degree=12, whole="all", shard=shard)
        for r, shard in zip(rows, shards)
    ]


def test_a_fit_is_that_of_the_samples() -> None:
    moments = sp.Moments(DIRECTIONS, VALUES, WEIGHTS, max_degree=12)
    assert (moments.samples, moments.max_degree, moments.channels) == (5000, 12, ["0", "1"])
    assert np.isclose(moments.weight, WEIGHTS.sum(), rtol=1e-13)
    for degree in (12, 7):
        expected, _ = sp.solve(DIRECTIONS, VALUES, degree, weights=WEIGHTS, tolerance=1e-13)
        model = moments.fit(degree, tolerance=1e-13)
        assert np.abs(model.coefficients - expected).max() < 1e-11
    basis = sp.Transform(DIRECTIONS, 7)
    rms = np.sqrt(np.average((VALUES - basis.synthesis(model.coefficients)) ** 2, axis=0, weights=WEIGHTS))
    assert np.allclose(np.array(model.report["rms"], float), rms, rtol=1e-9)
    assert moments.fit(5, stderr=True).standard_errors is not None
    noise = moments.fit(12, denoise=True).report["denoise"]
    assert len(noise) == 2 and all(0 < channel["sigma"] < 1 for channel in noise)
    assert moments.fit(12, smoothness="auto").report["gcv"]["smoothness"] > 0
    surface = sp.Moments(DIRECTIONS, DIRECTIONS, max_degree=3, channels=["x", "y", "z"]).fit()
    assert surface.is_surface and not model.is_surface


def test_a_mean_that_hides_the_residual_is_noticed() -> None:
    values = 0.01 * VALUES[:, 0]
    expected = sp.Moments(DIRECTIONS, values, max_degree=10).fit().report
    raised = sp.Moments(DIRECTIONS, np.column_stack([values + 980000, values + 1]), max_degree=10, channels=["g", "h"])
    with pytest.warns(sp.SpharmWarning, match="explained share of channel g are unknown.*subtract a constant"):
        model = raised.fit()
    assert model.report["rms"][0] is None and model.report["explained"][0] is None and model.rms is None
    assert model.report["rms"][1] == pytest.approx(expected["rms"][0], rel=1e-6)
    settings: list[dict[str, Any]] = [{"stderr": True}, {"denoise": True}, {"smoothness": "auto"}]
    for setting in settings:
        with pytest.raises(ValueError, match='found a mean of channel "g" so large.*leave out this channel'):
            raised.fit(**setting)


def test_the_chosen_smoothness_ignores_the_mean() -> None:
    height = DIRECTIONS[:, 2] / np.linalg.norm(DIRECTIONS, axis=1)
    values = np.sin(5 * height) + 0.5 * VALUES[:, 0]
    chosen = [sp.solve(DIRECTIONS, values + mean, 10, smoothness="auto")[1]["smoothness"] for mean in (0, 6371000)]
    assert chosen[0] == pytest.approx(chosen[1], rel=1e-6)


def test_a_missing_part_is_noticed() -> None:
    with pytest.warns(sp.SpharmWarning, match="missing: shard 1/2"):
        in_parts(2)[0].fit(3)


def test_parts_add_up_travel_and_are_kept(tmp_path: Path) -> None:
    whole = sp.Moments(DIRECTIONS, VALUES, WEIGHTS, max_degree=12).fit(tolerance=1e-13)
    parts = in_parts(3)
    parts[1] = pickle.loads(pickle.dumps(parts[1]))
    parts[2].save(tmp_path / "2.moments")
    parts[2] = sp.Moments.load(tmp_path / "2.moments")
    with pytest.raises(FileExistsError):
        parts[1].save(tmp_path / "2.moments")
    model = sp.Moments.merge(parts).fit(tolerance=1e-13)
    assert np.abs(model.coefficients - whole.coefficients).max() < 1e-12
    with pytest.raises(ValueError, match="1 range of shards is missing: shard 1/3"):
        sp.Moments.merge([parts[0], parts[2]])
    assert sp.Moments.merge([parts[0], parts[2]], partial=True).samples == 5000 - 1667
    with pytest.raises(ValueError, match="both contain samples of shard 0/3"):
        sp.Moments.merge([parts[0], parts[0]])
    # The program reads files of moments written by the package.
    for i, part in enumerate(parts):
        part.save(tmp_path / f"{i}.moments", overwrite=True)
    command = [sys.executable, "-m", "spharm_rs", "moments", "merge", *map(str, sorted(tmp_path.glob("?.moments")))]
    subprocess.run([*command, "-o", str(tmp_path / "all.moments")], check=True, capture_output=True)
    again = sp.Moments.load(tmp_path / "all.moments").fit(tolerance=1e-13)
    assert np.array_equal(again.coefficients, model.coefficients)


def test_the_scheme_is_the_one_that_the_program_read(tmp_path: Path) -> None:
    sphere = sp.icosphere(3)
    sphere.save(tmp_path / "s.obj")
    np.save(tmp_path / "f.npy", sphere.vertices[:, 2] ** 2)
    command = [sys.executable, "-m", "spharm_rs", "moments", "--sphere", "s.obj", "--samples", "f.npy", "--values", "0"]
    subprocess.run([*command, "--max-degree", "4", "-o", "f.moments"], check=True, capture_output=True, cwd=tmp_path)
    moments = sp.Moments.load(tmp_path / "f.moments")
    # A fit of a surface over the sphere reports the key of its sampling scheme.
    key = sp.fit(sphere, sphere, 1).report["scheme_key"]
    assert moments.scheme == key and moments.fit(2).report["scheme_key"] == key
    assert pickle.loads(pickle.dumps(moments)).scheme == key
    arrays = sp.Moments(sphere.vertices, sphere.vertices[:, 2] ** 2, max_degree=4, channels=["0"])
    assert arrays.scheme is None and arrays.fit(2).report["scheme_key"] is None
    assert sp.Moments.merge([moments, arrays]).scheme is None


def test_bad_samples_are_refused(tmp_path: Path) -> None:
    values = VALUES.copy()
    values[17, 1] = np.nan
    with pytest.raises(ValueError, match="sample 17: value: expected a finite number, found NaN"):
        sp.Moments(DIRECTIONS, values, max_degree=3)
    with pytest.raises(ValueError, match="sample 2: direction"):
        sp.Moments([[1, 0, 0], [0, 1, 0], [0, 0, 0]], [1, 2, 3], max_degree=1)
    with pytest.raises(ValueError, match="sample 1: weight"):
        sp.Moments(DIRECTIONS[:2], [1, 2], [1, -1], max_degree=1)
    with pytest.raises(ValueError, match="values: expected 5000, found 4999"):
        sp.Moments(DIRECTIONS, VALUES[1:], max_degree=1)
    with pytest.raises(ValueError, match="shard 3 of 3"):
        sp.Moments(DIRECTIONS, VALUES, max_degree=1, shard=(3, 3))
    with pytest.raises(ValueError, match="list of names"):
        sp.Moments(DIRECTIONS, VALUES, max_degree=1, channels="ab")
    moments = sp.Moments(DIRECTIONS, VALUES, max_degree=3)
    with pytest.raises(ValueError, match="4"):
        moments.fit(4)
    with pytest.raises(sp.MemoryBudgetError):
        moments.fit(memory="1KiB")
    with pytest.warns(sp.NotDetermined):
        sp.Moments(DIRECTIONS[:10], VALUES[:10], max_degree=12).fit()
    with pytest.warns(sp.NotDetermined):
        sp.Moments(np.repeat(DIRECTIONS[:5], 100, axis=0), np.repeat(VALUES[:5], 100, axis=0), max_degree=8).fit()
    (tmp_path / "bad.moments").write_bytes(b"no moments")
    with pytest.raises(sp.SpharmError, match="bad.moments"):
        sp.Moments.load(tmp_path / "bad.moments")
    with pytest.raises(FileNotFoundError):
        sp.Moments.load(tmp_path / "none.moments")


def test_dask_is_asked_for_only_where_it_is_needed() -> None:
    code = "import sys, spharm_rs; assert 'dask' not in sys.modules\nsys.modules['dask'] = None\nimport spharm_rs.dask"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert run.returncode == 1 and "pip install 'spharm-rs[dask]'" in run.stderr.splitlines()[-1], run.stderr


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Yields a client with two worker processes."""
    distributed = pytest.importorskip("distributed", reason="Dask isn't installed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster, distributed.Client(cluster) as client:
        yield client


def test_dask_workers_give_the_model_of_one_process(cluster: Any) -> None:
    import dask
    import dask.array as da

    import spharm_rs.dask

    expected = sp.Moments(DIRECTIONS, VALUES, WEIGHTS, max_degree=12).fit(tolerance=1e-13).coefficients
    at, values = da.from_array(DIRECTIONS, chunks=(431, 2)), da.from_array(VALUES, chunks=(700, 1))
    weights = da.from_array(WEIGHTS, chunks=5000)
    processes = set(cluster.run(lambda: __import__("os").getpid()).values())
    assert len(processes) == 2
    model = sp.dask.fit(at, values, 12, weights=weights, split_every=3, tolerance=1e-13)
    assert np.abs(model.coefficients - expected).max() < 1e-12
    assert model.report["samples"] == 5000
    chunks = [
        dask.delayed(lambda rows: (DIRECTIONS[rows], VALUES[rows], WEIGHTS[rows]))(rows)
        for rows in np.array_split(np.arange(5000), 7)
    ]
    moments = sp.dask.moments(chunks, max_degree=12).compute()
    assert np.abs(moments.fit(tolerance=1e-13).coefficients - expected).max() < 1e-12
    assert sp.dask.fit(chunks, max_degree=4, smoothness=1e-3).max_degree == 4
    # One column without weights; and an error in a chunk is raised by the fit.
    flat = sp.dask.fit(at, values[:, 0], 3)
    assert np.abs(flat.coefficients - sp.Moments(DIRECTIONS, VALUES[:, :1], max_degree=3).fit().coefficients).max() < 1e-12
    with pytest.raises(ValueError, match="sample 0: value"):
        sp.dask.fit(at, values * np.nan, 3)


def test_dask_fits_a_cohort_in_shards(cluster: Any, tmp_path: Path) -> None:
    import spharm_rs.dask

    for seed in range(3):
        sp.example_surface(3, seed)[0].save(tmp_path / f"s{seed}.ply", double=True)
    rows = [{"id": f"s{seed}", "surface": tmp_path / f"s{seed}.ply"} for seed in range(3)]
    rows.append({"id": "gone", "surface": tmp_path / "gone.ply"})
    fits = sp.dask.fit_cohort(rows, tmp_path / "shards", 6, shards=3).compute()
    assert {fit.id: fit.state for fit in fits} == {"s0": "done", "s1": "done", "s2": "done", "gone": "failed"}
    for fit in fits[:3]:
        if fit.state == "done":
            alone = sp.fit_cohort([row for row in rows if row["id"] == fit.id], tmp_path / "alone", 6, threads=1)
            assert np.array_equal(next(alone).model.coefficients, fit.model.coefficients)
    with pytest.raises(ValueError, match="shards"):
        sp.dask.fit_cohort(rows, tmp_path, 6, shard="0/3")


def test_dask_says_what_it_expects() -> None:
    da = pytest.importorskip("dask.array", reason="Dask isn't installed")
    import spharm_rs.dask

    at, values = da.from_array(DIRECTIONS, chunks=(1000, 3)), da.from_array(VALUES, chunks=(1000, 2))
    for samples, more, text in [
        (at, {}, "found None"),
        (at, {"values": VALUES}, "values: expected a Dask array, found ndarray"),
        (at[:, :2], {"values": values}, r"\(n, 3\)"),
        (at, {"values": values[:10]}, "values: expected 5000 rows, found 10"),
        (at, {"values": values, "weights": values}, r"weights: expected shape \(n,\)"),
        (DIRECTIONS, {}, "delayed chunks, found ndarray"),
        ([], {}, "at least one chunk"),
        (at, {"values": values, "split_every": 1}, "split_every"),
    ]:
        with pytest.raises(ValueError, match=text):
            sp.dask.fit(samples, max_degree=2, **more)
