"""Fits of cohorts from tables, whose outcomes are returned as they finish."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Iterator

import numpy as np
import pytest

import spharm_rs as sp


@pytest.fixture()
def folder(tmp_path: Path) -> Path:
    for seed in range(3):
        sp.example_surface(3, seed)[0].save(tmp_path / f"s{seed}.ply", double=True)
    sp.example_surface(3)[1].save(tmp_path / "sphere.ply", double=True)
    return tmp_path


def run(*arguments: str) -> None:
    """Runs the program in a separate process, because it handles signals."""
    subprocess.run([sys.executable, "-m", "spharm_rs", *arguments], check=True, timeout=300)


def rows(folder: Path) -> list[dict[str, object]]:
    return [{"id": f"s{seed}", "surface": folder / f"s{seed}.ply"} for seed in range(3)]


class Frame:
    """The part of pandas.DataFrame's interface that is used; cells without a value are NaN."""

    columns = ("id", "surface", "label")

    def __init__(self, rows: list[dict[str, object]]) -> None:
        self._rows = rows

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns)

    def to_dict(self, orient: str) -> list[dict[str, object]]:
        assert orient == "records"
        return [{**row, "label": float("nan")} for row in self._rows]


def test_a_table_is_fitted_as_by_the_program(folder: Path) -> None:
    table = folder / "subjects.tsv"
    table.write_text("id\tsurface\tsphere\n" + "".join(f"s{seed}\ts{seed}.ply\tsphere.ply\n" for seed in range(3)))
    found = {row.id: row for row in sp.fit_cohort(table, folder / "ours", 8, threads=2)}
    arguments = ["fit", "--manifest", str(table), "-o", str(folder / "theirs"), "--max-degree", "8", "--threads", "2", "-q"]
    run(*arguments)
    assert set(found) == {"s0", "s1", "s2"}
    for name, row in found.items():
        ours, theirs = ((folder / where / f"{name}.spharm.npz").read_bytes() for where in ("ours", "theirs"))
        assert ours == theirs
        assert row.state == "done" and row.error is None and row.path == folder / "ours" / f"{name}.spharm.npz"
        assert row.report is not None and (row.report["msd"] or 0) > 0 and row.seconds is not None


def test_rows_are_mappings_or_a_data_frame(folder: Path) -> None:
    first = list(sp.fit_cohort(rows(folder), folder / "a", 5))
    maps = [row.report["parametrization"] for row in first if row.report is not None]
    assert len(maps) == 3 and all(found is not None and found["sphere"] for found in maps)
    second = list(sp.fit_cohort(Frame(rows(folder)), folder / "b", 5))
    for a, b in zip(first, second):
        np.testing.assert_array_equal(a.model.coefficients, b.model.coefficients)


def test_failures_end_it_or_are_collected(folder: Path) -> None:
    broken = [*rows(folder), {"id": "gone", "surface": folder / "gone.ply"}]
    broken.insert(0, broken.pop())
    with pytest.raises(FileNotFoundError):
        list(sp.fit_cohort(broken, folder / "a", 5, sphere=folder / "sphere.ply"))
    found = {row.id: row for row in sp.fit_cohort(broken, folder / "b", 5, on_error="collect")}
    assert [found[name].state for name in ("gone", "s0", "s1", "s2")] == ["failed", "done", "done", "done"]
    assert found["gone"].error is not None and "gone.ply" in found["gone"].error
    with pytest.raises(sp.SpharmError, match="has no model"):
        found["gone"].model


def test_models_that_exist_are_kept_or_refused(folder: Path) -> None:
    assert {row.state for row in sp.fit_cohort(rows(folder), folder, 5)} == {"done"}
    assert {row.state for row in sp.fit_cohort(rows(folder), folder, 5, exists="skip")} == {"skipped"}
    with pytest.raises(ValueError, match="the output exists"):
        list(sp.fit_cohort(rows(folder), folder, 5))
    refused = list(sp.fit_cohort(rows(folder), folder, 6, exists="skip", on_error="collect"))
    assert all(row.state == "failed" and "max-degree 5, not 6" in str(row.error) for row in refused)
    assert {row.state for row in sp.fit_cohort(rows(folder), folder, 6, exists="update")} == {"done"}


def test_masks_leave_vertices_out_as_in_the_program(folder: Path) -> None:
    mask = np.ones(642)
    mask[:100] = 0
    sp.write_signal(folder / "mask.shape.gii", mask)
    sphere = folder / "sphere.ply"
    [ours] = sp.fit_cohort(rows(folder)[:1], folder / "ours", 5, sphere=sphere, mask=folder / "mask.shape.gii")
    theirs = folder / "theirs.spharm.npz"
    arguments = ["fit", "--surface", str(folder / "s0.ply"), "--sphere", str(sphere), "--mask", str(folder / "mask.shape.gii")]
    run(*arguments, "--max-degree", "5", "-o", str(theirs), "-q")
    np.testing.assert_array_equal(ours.model.coefficients, sp.Model.load(theirs).coefficients)


def test_progress_and_status_follow_the_rows(folder: Path) -> None:
    calls: list[tuple[str, int, int]] = []
    status = folder / "status.tsv"
    fits = sp.fit_cohort(rows(folder), folder, 5, status=status, progress=lambda *call: calls.append(call))
    assert len(fits) == 3
    assert len(list(fits)) == 3 and calls == [("fit", 1, 3), ("fit", 2, 3), ("fit", 3, 3)]
    assert [line.split("\t")[:2] for line in status.read_text().splitlines()[1:]] == [[f"s{seed}", "done"] for seed in range(3)]


def test_leaving_it_stops_the_fits(folder: Path) -> None:
    many = [{"id": f"m{number}", "surface": folder / f"s{number % 3}.ply"} for number in range(60)]
    with sp.fit_cohort(many, folder, 5) as fits:
        next(fits)
    # Fits that are running end, and the remaining rows aren't started.
    assert len(list(folder.glob("m*.spharm.npz"))) < 60


def test_bad_arguments_are_refused(folder: Path) -> None:
    with pytest.raises(ValueError, match="row 0 has no surface"):
        sp.fit_cohort([{"id": "a"}])
    with pytest.raises(ValueError, match="id 's0' occurs twice"):
        sp.fit_cohort([*rows(folder), *rows(folder)])
    with pytest.raises(ValueError, match="on_error: expected"):
        sp.fit_cohort(rows(folder), on_error="ignore")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="exists: expected"):
        sp.fit_cohort(rows(folder), exists="maybe")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="shard"):
        sp.fit_cohort(rows(folder), shard="3/2")
    with pytest.raises(ValueError, match="weights"):
        sp.fit_cohort(rows(folder), weights=np.ones(3))  # type: ignore[arg-type]
    with pytest.raises(FileNotFoundError):
        sp.fit_cohort(folder / "no.tsv")
