"""Models of all labels of a volume."""

from __future__ import annotations

import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import spharm_rs as sp
from spharm_rs import _core

SHAPE = (26, 24, 22)
SPACING = (0.5, 0.4, 0.6)
#: Centre and radii of each label, in voxels; label 7 is cut off by the border of the volume.
CELLS = {1: ((6, 6, 6), (4, 4, 4)), 2: ((16, 14, 12), (6, 4, 5)), 7: ((0, 18, 16), (3, 3, 3))}


def cells() -> NDArray[np.int_]:
    """Returns a volume with axes x, y and z."""
    volume, at = np.zeros(SHAPE, int), np.moveaxis(np.indices(SHAPE), 0, -1)
    for label, (centre, radii) in CELLS.items():
        volume[(((at - centre) / radii) ** 2).sum(axis=-1) < 1] = label
    return volume


def test_all_labels_are_fitted_each_as_by_itself() -> None:
    volume = cells()
    done: list[tuple[int, int]] = []
    found = list(sp.fit_labels(volume, 6, spacing=SPACING, progress=lambda _, n, of: done.append((n, of))))
    assert [cell.label for cell in found] == [1, 2, 7] and done == [(1, 3), (2, 3), (3, 3)]
    assert {cell.label: cell.voxels for cell in found} == sp.labels(volume)
    assert [cell.at_border for cell in found] == [False, False, True]
    for cell in found[:2]:
        mapped = sp.parametrize_volume(volume, label=cell.label, spacing=SPACING, threads=1)
        alone = sp.fit(mapped, max_degree=6, threads=1)
        assert cell.model is not None and cell.measures is not None and cell.error is None
        assert np.allclose(cell.model.coefficients, alone.coefficients, rtol=0, atol=1e-9)
        assert cell.volume == pytest.approx(cell.voxels * np.prod(SPACING), rel=0.05)
        assert np.allclose(cell.centroid, np.multiply(CELLS[cell.label][0], SPACING), rtol=0, atol=0.05)
    image = sp.fit_labels(volume.transpose(), 6, axes="zyx", spacing=SPACING[::-1], skip_border=True)
    assert [cell.centroid for cell in image] == [cell.centroid for cell in found[:2]]


def test_models_and_degree_are_those_of_the_program(tmp_path: Path) -> None:
    np.save(tmp_path / "cells.npy", cells())
    arguments = ["volumes", str(tmp_path / "cells.npy"), "--voxel-size", "0.5,0.4,0.6", "--skip-border", "--min-voxels", "50",
                 "--threads", "1", "-o", str(tmp_path / "out"), "-q"]  # fmt: skip
    subprocess.run([sys.executable, "-m", "spharm_rs", *arguments], check=True, timeout=300)
    found = list(sp.fit_labels(tmp_path / "cells.npy", spacing=SPACING, skip_border=True, min_voxels=50))
    assert [cell.label for cell in found] == [1, 2]
    for cell in found:
        theirs = sp.Model.load(tmp_path / "out" / f"cells.{cell.label}.spharm.npz")
        assert cell.model is not None and cell.model.max_degree == theirs.max_degree
        assert np.allclose(cell.model.coefficients, theirs.coefficients, rtol=0, atol=1e-6)


def test_chosen_labels_fail_alone() -> None:
    volume = cells()
    volume[22:24, 2:4, 2:4] = 2
    with pytest.raises(sp.MeshError, match="label 2"):
        list(sp.fit_labels(volume, 4, labels=[1, 2]))
    found = list(sp.fit_labels(volume, 4, labels=[2, 1, 5, 1], on_error="collect"))
    assert [cell.label for cell in found] == [2, 1, 5]
    assert [cell.model is None for cell in found] == [True, False, True]
    assert "label 2" in str(found[0].error) and np.isnan(found[0].volume) and np.isnan(found[0].centroid).all()
    assert isinstance(found[2].error, sp.MeshError) and "5" in str(found[2].error) and found[2].voxels == 0
    with pytest.warns(sp.SpharmWarning, match="the volume: label 2: ") as warned:
        (fixed,) = sp.fit_labels(volume, 4, labels=2, fix=True)
    assert fixed.model is not None and {one.filename for one in warned if "label 2" in str(one.message)} == {__file__}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert list(sp.fit_labels(volume, 4, min_voxels=10_000)) == []
        assert list(sp.fit_labels(volume, min_voxels=10_000)) == []


def test_doubts_about_a_fit_and_its_errors_name_the_label() -> None:
    early: dict[str, Any] = {"objective": "vertices", "max_iterations": 1, "preconditioner": "none"}
    with pytest.warns(sp.SpharmWarning) as warned:
        found = list(sp.fit_labels(cells(), 6, labels=[1, 2], **early))
    doubts = [one for one in warned if issubclass(one.category, sp.NotConverged)]
    for cell, doubt in zip(found, doubts, strict=True):
        assert str(doubt.message).startswith(f"the volume: label {cell.label}: ") and doubt.filename == __file__
        assert cell.model is not None and any(str(doubt.message).endswith(text) for text in cell.model.report["warnings"])
    assert all(str(one.message).startswith("the volume: label ") for one in warned)
    with pytest.raises(sp.SpharmError, match="^the volume: label 2: "):
        list(sp.fit_labels(cells(), 6, labels=2, strict=True, **early))
    (cell,) = sp.fit_labels(cells(), 6, labels=2, strict=True, on_error="collect", **early)
    assert str(cell.error).startswith("the volume: label 2: ")
    with pytest.raises(sp.MemoryBudgetError, match="label 1") as small:
        list(sp.fit_labels(cells(), 6, labels=1, memory="10KiB"))
    assert small.value.needed > small.value.budget


def test_a_model_with_another_volume_than_its_label_is_warned_of(tmp_path: Path) -> None:
    # Two balls and a neck of one voxel, which degree 6 can't follow.
    at, volume = np.moveaxis(np.indices((38, 20, 20)), 0, -1), np.zeros((38, 20, 20), int)
    for middle in (9, 29):
        volume[((at - (middle, 9, 9)) ** 2).sum(axis=-1) < 49] = 1
    volume[9:30, 9, 9] = 1
    np.save(tmp_path / "balls.npy", volume)
    given: Any
    for given, spacing in ((volume, None), (tmp_path / "balls.npy", (0.5, 0.5, 0.5))):
        with pytest.warns(sp.SpharmWarning, match=r"label 1: the volume of the model differs .* by \d\.\d %") as warned:
            (cell,) = sp.fit_labels(given, 6, spacing=spacing)
        size = cell.voxels * (1.0 if spacing is None else 0.125)
        assert f"by {100 * abs(cell.volume / size - 1):.1f} %" in str(warned[0].message)
        assert cell.model is not None and str(warned[0].message).endswith(cell.model.report["warnings"][-1])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        list(sp.fit_labels(cells(), 12, labels=[1, 2]))


def test_wrong_volumes_and_labels_are_refused() -> None:
    with pytest.raises(sp.MeshError, match="the volume: expected a label, found only 0, the background"):
        sp.fit_labels(np.zeros((4, 4, 4), int))
    with pytest.raises(ValueError, match="labels: expected a whole number, found 1.5"):
        sp.fit_labels(cells(), labels=[1.5])  # type: ignore[list-item]
    with pytest.raises(ValueError, match="labels: expected whole numbers, found 'all'"):
        sp.fit_labels(cells(), labels="all")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="on_error: expected 'raise' or 'collect', found 'skip'"):
        sp.fit_labels(cells(), on_error="skip")  # type: ignore[arg-type]


def test_floats_are_labels_if_they_are_whole_numbers() -> None:
    volume = cells().astype(np.float32)
    found = list(sp.fit_labels(volume, 3, labels=[1, 2]))
    assert [cell.voxels for cell in found] == [int((volume == label).sum()) for label in (1, 2)]
    volume[0, 0, 0] = np.nan
    with pytest.raises(ValueError, match="found NaN; if NaN is the background, set it to 0"):
        sp.fit_labels(volume, 3)
    volume[0, 0, 0] = 0.5
    with pytest.raises(ValueError, match="expected whole numbers as labels, found float32"):
        sp.fit_labels(volume, 3)


def test_a_speck_at_the_border_that_the_repair_drops_is_ignored() -> None:
    volume = cells()
    volume[0, 0, 0] = 1
    settings: dict[str, Any] = {"labels": 1, "spacing": SPACING, "skip_border": True}
    assert list(sp.fit_labels(volume, 3, **settings)) == []
    with pytest.warns(sp.SpharmWarning, match="label 1: "):
        (cell,) = sp.fit_labels(volume, 3, fix=True, **settings)
    assert cell.model is not None and not cell.at_border


def test_only_chosen_labels_are_repaired_at_the_border() -> None:
    volume = cells().astype(np.int32)
    volume[0, 0, 0], volume[-1, 0, 0] = 1, 2
    core = _core.Labels((volume, np.eye(4)), image=(None, None))

    def at_border(fix: bool, chosen: list[int] | None) -> list[bool]:
        return [border for _, border in core.labels(fix, chosen).values()]

    assert at_border(True, None) == [False, False, True]
    assert at_border(True, [1, 5]) == [False, True, True]
    assert at_border(False, [1]) == [True, True, True]
