"""Tests of columns of tables of subjects: numbers, levels, missing values, and spheres of values."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import spharm_rs as sp

VALUES = np.random.default_rng(6).normal(size=(12, 42))
GROUPS = ["a", "b"] * 6
AGES = [60, 61, 64, 70, 58, 59, 77, 65, 62, 81, 74, 69]


def found_of(groups: Any = None, **more: Any) -> sp.shape.TestResult:
    return sp.shape.group_test(VALUES, groups, permutations=0, **more)


def test_text_of_numbers_is_numbers() -> None:
    expected, text = found_of(GROUPS, covariates={"age": AGES}), [f" {age}" for age in AGES]
    for ages in (text, np.array(text), np.array(text, object), np.array(AGES, object)):
        found = found_of(GROUPS, covariates={"age": ages})
        assert found.columns == ["a", "b", "age"] and np.array_equal(found.statistic, expected.statistic)
    assert np.array_equal(found_of(effect=text).statistic, found_of(effect=AGES).statistic)
    slopes = found_of(interaction={"group": GROUPS, "age": text})
    assert slopes.meaning == "slope of age in a minus slope of age in b"
    assert found_of(GROUPS, covariates={"site": ["1", "2", "3", "3"] * 3}).codes == {"site": [1, 2, 3]}
    with pytest.raises(ValueError, match=r"covariates, age: expected a number, as in most rows, found '60y' in row 0 "):
        found_of(GROUPS, covariates={"age": ["60y", *text[1:]]})
    with pytest.raises(ValueError, match="effect: expected numbers, found levels such as 'a'; give levels as groups="):
        found_of(effect=GROUPS)


def test_levels_that_differ_only_in_case_are_doubted() -> None:
    names = ["A", *GROUPS[1:]]
    doubt = 'the levels "A" and "a" differ only in case'
    with pytest.warns(sp.SpharmWarning, match=doubt):
        found = found_of(names)
    assert found.levels == {"A": 1, "a": 5, "b": 6} and any(doubt in text for text in found.warnings)
    with pytest.warns(sp.SpharmWarning, match=f"site: {doubt}"):
        found_of(effect=AGES, covariates={"site": names})


def test_missing_levels_are_refused_with_their_row() -> None:
    names = GROUPS[:3] + ["?"] + GROUPS[4:]
    for missing in ("", "  ", "NA", "n/a", "nan", None, float("nan")):
        column: Any = [missing if name == "?" else name for name in names]
        wrong: list[tuple[str, dict[str, Any]]] = [
            ("groups", {"groups": column}),
            ("groups", {"groups": np.array(column, object)}),
            ("covariates, site", {"groups": GROUPS, "covariates": {"site": column}}),
            ("interaction, site", {"interaction": {"site": column, "age": AGES}}),
            ("blocks", {"groups": GROUPS, "blocks": column}),
            ("variance_groups", {"groups": GROUPS, "variance_groups": column}),
        ]
        for what, arguments in wrong:
            with pytest.raises(ValueError, match=rf"{what}: expected a name or a finite number .* in row 3 \(counted from 0\)"):
                sp.shape.group_test(VALUES, permutations=20, **arguments)
    assert found_of([f" {name} " for name in GROUPS]).levels == {"a": 6, "b": 6}
    ages = np.array(AGES, float)
    ages[5] = np.nan
    with pytest.raises(ValueError, match="covariates, age: .* found NaN in row 5"):
        found_of(GROUPS, covariates={"age": ages})
    with pytest.raises(ValueError, match="effect: .* found NaN in row 5"):
        found_of(effect=ages)
    masked: Any = np.ma.array(AGES, mask=np.arange(12) == 4)
    with pytest.raises(ValueError, match="effect: .* in row 4"):
        found_of(effect=masked)


def test_levels_that_do_not_fit_are_named() -> None:
    mixed = np.array([*GROUPS[:-1], 3], object)
    with pytest.raises(ValueError, match="groups: .*; found 3 in row 11, and 'a' in row 0"):
        found_of(mixed)
    with pytest.raises(ValueError, match='levels: .* duplicate level "a"'):
        found_of(GROUPS, levels=["a", "a", "b"])
    for constant in (["x"] * 12, [True] * 12, [7] * 12):
        with pytest.raises(ValueError, match="omit the co"):
            found_of(GROUPS, covariates={"site": constant})


def test_categorical_columns_are_levels() -> None:
    pandas = pytest.importorskip("pandas")
    sites = [1, 2, 3] * 4
    names = [f"site{site}" for site in sites]
    expected = found_of(GROUPS, covariates={"site": names})
    column = pandas.Categorical(sites)
    table = pandas.DataFrame({"site": column})
    for covariates in ({"site": column}, {"site": pandas.Series(column)}, table, {"site": pandas.CategoricalIndex(sites)}):
        found = found_of(GROUPS, covariates=covariates)
        assert found.columns == ["a", "b", "site 2", "site 3"] and found.codes == {}
        assert np.allclose(found.statistic, expected.statistic, rtol=1e-12)
    assert found_of(GROUPS, covariates=column).columns == ["a", "b", "covariate 1 2", "covariate 1 3"]
    ordered = pandas.Categorical(GROUPS, categories=["c", "b", "a"], ordered=True)
    assert found_of(ordered).meaning == found_of(pandas.Series(ordered)).meaning == "b - a"
    assert found_of(ordered, levels=["a", "b"]).meaning == "a - b"
    assert found_of(interaction={"group": ordered, "age": AGES}).meaning == "slope of age in b minus slope of age in a"
    for missing in (pandas.Categorical([None, *GROUPS[1:]]), pandas.Series([pandas.NA, *GROUPS[1:]], dtype="string")):
        with pytest.raises(ValueError, match="groups: .* in row 0"):
            found_of(missing)
    assert found_of(effect=pandas.Series(AGES, dtype="Int64")).meaning == "slope of effect"


def test_values_are_tested_on_their_sphere() -> None:
    settings: dict[str, Any] = {"tfce": True, "cluster": 0.05, "permutations": 50}
    expected = sp.shape.group_test(VALUES, GROUPS, surface=sp.icosphere(1), **settings)
    for sphere in (1, sp.icosphere(1)):
        found = sp.shape.group_test(VALUES, GROUPS, sphere=sphere, **settings)
        assert found.tfce is not None and expected.tfce is not None and np.array_equal(found.tfce, expected.tfce)
        assert found.surface is not None and len(found.surface.vertices) == 42
    with pytest.raises(ValueError, match="sphere: expected 42 vertices, as many as the values have; found 162"):
        sp.shape.group_test(VALUES, GROUPS, sphere=2, **settings)
    with pytest.raises(ValueError, match="give surface=, or sphere= with triangles"):
        sp.shape.group_test(VALUES, GROUPS, sphere=sp.icosphere(1).vertices, **settings)
    for signal in ("position", "normal"):
        with pytest.raises(ValueError, match=rf"signal='{signal}', found values of shape \(12, 42\)"):
            found_of(GROUPS, signal=signal)
    assert found_of(GROUPS, signal="value").meaning == "a - b"


def test_files_are_not_subjects() -> None:
    names = [f"s{k}.spharm.npz" for k in range(12)]
    for subjects in (names, np.array(names), [Path(name) for name in names], "models"):
        with pytest.raises(ValueError, match="subjects: .*Model.load"):
            sp.shape.group_test(subjects, GROUPS)


def test_the_minus_sign_is_read_as_a_hyphen() -> None:
    scores = [-3, 1, 4, -1, 5, 9, 2, 6, 5, 3, -5, 8]
    text = [str(score).replace("-", "\u2212") for score in scores]
    found, expected = found_of(effect=text), found_of(effect=scores)
    assert found.meaning == "slope of effect" and np.array_equal(found.statistic, expected.statistic)
