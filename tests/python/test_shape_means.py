"""Tests of means and of groups of unequal variance, compared with NumPy and SciPy."""

from __future__ import annotations

import itertools
import warnings
from typing import Any

import numpy as np
import pytest
from scipy import stats

import spharm_rs as sp


def lump(seed: int, size: float = 1.0) -> sp.Model:
    values = 0.05 * np.random.default_rng(seed).normal(size=(36, 3))
    values[[3, 1, 2], [0, 1, 2]] += 9, 6, 4
    return sp.Model(size * values)


def test_a_mean_with_a_covariate_is_tested_by_all_flips() -> None:
    rng = np.random.default_rng(0)
    values, age = rng.normal(size=(8, 5)) + 0.5, rng.uniform(20, 60, 8)
    found = sp.shape.test(values, mean=True, covariates={"age": age})
    assert (found.resampling, found.relabellings, found.exact) == ("sign flips", 256, True)
    assert found.assumption == "independent errors, symmetric about zero" and found.meaning == "mean"
    slope = (age - age.mean()) / np.linalg.norm(age - age.mean())
    residual = values - np.outer(slope, slope @ values)
    largest = []
    for signs in itertools.product([1, -1], repeat=8):
        flipped = np.array(signs)[:, None] * residual
        flipped = flipped - np.outer(slope, slope @ flipped)
        error = flipped.std(0, ddof=1) * np.sqrt(7 / 6) / np.sqrt(8)
        largest.append(abs(flipped.mean(0) / error).max())
    expected = (np.array(largest)[None] >= abs(found.statistic)[:, None] * (1 - 1e-9)).mean(1)
    assert found.p_fwe is not None and np.array_equal(found.p_fwe, expected)
    plain = sp.shape.test(values, mean=True)
    assert np.allclose(plain.statistic, stats.ttest_1samp(values, 0).statistic, rtol=1e-12)


def test_contrasts_of_means_are_not_exchanged() -> None:
    rng = np.random.default_rng(1)
    values = rng.normal(size=(24, 10)) + 10
    two = np.repeat(np.eye(2), 12, axis=0)
    contrast: Any
    for contrast in ([1, 0], [0.5, 0.5], [[1, 0], [0, 1]]):
        found = sp.shape.test(values, design=two, contrast=contrast, permutations=999)
        assert found.resampling == "sign flips" and found.p_fwe is not None and (found.p_fwe <= 0.005).all()
    difference = sp.shape.test(values, design=two, contrast=[1, -1], permutations=99)
    assert difference.resampling == "permutations"
    few = sp.shape.test(values, design=np.repeat(np.eye(2), [4, 20], axis=0), contrast=[1, 0], permutations=99)
    assert few.resampling == "permutations and sign flips"


def test_a_second_measurement_is_subtracted() -> None:
    before = [lump(seed) for seed in range(8)]
    after = [lump(seed, 1.1) for seed in range(8)]
    field = sp.shape.measure_group(after, 2, minus=before, signal="position")
    expected = [a.evaluate(field.directions) - b.evaluate(field.directions) for a, b in zip(after, before)]
    assert field.values.shape == (8, 162, 3) and np.allclose(field.values, expected, atol=1e-12)
    found = sp.shape.test(after, minus=before, mean=True, sphere=2)
    assert found.effect is not None and (found.effect > 0.1).all() and found.p_fwe is not None and (found.p_fwe <= 0.01).all()
    values = np.random.default_rng(2).normal(size=(8, 4))
    differences = sp.shape.test(values, minus=values[::-1], mean=True)
    assert np.array_equal(differences.statistic, sp.shape.test(values - values[::-1], mean=True).statistic)
    with pytest.raises(ValueError, match="minus: expected 8 models"):
        sp.shape.measure_group(after, 2, minus=before[:7])
    with pytest.raises(ValueError, match="minus: expected shape"):
        sp.shape.test(values, minus=values[:7], mean=True)
    with pytest.raises(ValueError, match="give minus, or signal='value'"):
        sp.shape.test(after, mean=True)
    with pytest.raises(ValueError, match="expected exactly one of them"):
        sp.shape.test(values, groups=[0, 1] * 4, mean=True)


def test_unequal_groups_are_warned_of_and_welchs_test_flips_signs() -> None:
    rng = np.random.default_rng(3)
    values = rng.normal(size=(20, 30)) * np.repeat([3.0, 1.0], [5, 15])[:, None]
    groups = ["patient"] * 5 + ["control"] * 15
    with pytest.warns(sp.SpharmWarning, match=r"the variance of patient \(5 subjects\) is .* too small; use Welch's test"):
        sp.shape.test(values, groups=groups, permutations=0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = sp.shape.test(values, groups=groups, levels=["patient", "control"], welch=True, permutations=199)
        sp.shape.test(values.reshape(20, 10, 3), groups=groups, welch=True, permutations=99)
    assert found.resampling == "sign flips"
    assert np.allclose(found.statistic, stats.ttest_ind(values[:5], values[5:], equal_var=False).statistic, rtol=1e-12)


def test_counts_and_codes() -> None:
    values = np.random.default_rng(4).normal(size=(12, 3))
    for count in (10**8 + 1, 10**12, 2**63 - 1):
        with pytest.raises(ValueError, match="relabellings"):
            sp.shape.test(values, groups=[0, 1] * 6, permutations=count)
    for threads in (65, 20_000, 10**6):
        with pytest.raises(ValueError, match="threads: expected a number from 1 to 64"):
            sp.shape.test(values, groups=[0, 1] * 6, threads=threads)
    site = [1, 2, 3] * 4
    found = sp.shape.test(values, effect=np.arange(12.0), covariates={"site": site, "sex": [0, 1] * 6}, permutations=0)
    assert found.codes == {"site": [1, 2, 3]} and len(found.columns) == 4
    levels = sp.shape.test(
        values, effect=np.arange(12.0), covariates={"site": [f"site{one}" for one in site]}, permutations=0
    )  # fmt: skip
    assert levels.codes == {} and len(levels.columns) == 4


def test_models_in_another_unit_are_named() -> None:
    models = [lump(seed) for seed in range(6)] + [lump(6, 1000.0)]
    for call, name in (
        (lambda: sp.shape.pca(models), "models[6]"),
        (lambda: sp.shape.mean(models), "models[6]"),
        (lambda: sp.shape.procrustes(models, method="fixed"), "member 6"),
    ):
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always")
            call()
        texts = [str(one.message) for one in found if "another unit" in str(one.message)]
        assert len(texts) == 1 and texts[0].startswith(f"{name}: ") and "about 1000 times" in texts[0], texts


def doubts(call: Any) -> list[str]:
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        call()
    assert all(one.filename == __file__ for one in found)
    return [str(one.message) for one in found]


def test_models_that_are_not_aligned_with_the_modes_are_named() -> None:
    modes = sp.shape.pca([lump(seed) for seed in range(8)])
    aligned = [lump(seed) for seed in range(40)]
    for kept in (modes, modes.truncate(2)):
        assert doubts(lambda: kept.transform(aligned)) == [] and doubts(lambda: kept.project(aligned[9])) == []
    turned = sp.shape.rotate(lump(9), parameters=[70, 40, 10], object=[0, 60, 0])
    mirrored = sp.Model(lump(11).coefficients * [1, 1, -1])
    found = doubts(lambda: modes.transform([*aligned, lump(12, 1000.0), turned, mirrored]))
    assert [text.partition(":")[0] for text in found] == ["models[40]", "models[41]", "models[42]"]
    assert all("but that of the farthest member is" in text and "shape.align" in text for text in found)
    remedied = [sp.shape.align(turned, modes.mean).model, sp.shape.align(mirrored, modes.mean, mirror=True).model]
    assert doubts(lambda: modes.project(remedied)) == []


def test_a_model_of_another_kind_is_far_from_the_modes() -> None:
    modes = sp.shape.pca([lump(seed) for seed in range(8)])
    (text,) = doubts(lambda: modes.project(lump(9, 1.5)))
    assert text.startswith("model: the root mean square distance from the mean is ") and "shape.align" in text
    # Few members don't show how far a member may be from the mean.
    few = sp.shape.pca([lump(seed) for seed in range(4)])
    assert doubts(lambda: few.project(lump(9, 1.5))) == []
