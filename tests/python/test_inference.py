"""Tests of blocks, variance groups and regions, compared with NumPy by all relabellings."""

from __future__ import annotations

import itertools
import warnings
from typing import Any

import numpy as np
import pytest

import spharm_rs as sp


def g_statistic(values: Any, design: Any, contrast: Any, groups: Any) -> Any:
    """Aspin and Welch's v (signed) or G by its definition (Winkler et al. 2014, equations 8 to 10)."""
    n, rows = len(design), len(contrast)
    residual_forming = np.eye(n) - design @ np.linalg.pinv(design)
    found = []
    for y in values.T:
        beta, errors = np.linalg.pinv(design) @ y, residual_forming @ y
        weights, share = np.zeros(n), 0.0
        for group in np.unique(groups):
            of = groups == group
            weights[of] = np.diag(residual_forming)[of].sum() / (errors[of] ** 2).sum()
        for group in np.unique(groups):
            of = groups == group
            share += (1 - weights[of].sum() / weights.sum()) ** 2 / np.diag(residual_forming)[of].sum()
        inverse = np.linalg.inv(design.T @ (weights[:, None] * design))
        effect = contrast @ beta
        value = effect @ np.linalg.inv(contrast @ inverse @ contrast.T) @ effect / rows
        value /= 1 + 2 * (rows - 1) * share / (rows * (rows + 2))
        found.append(np.sign(effect[0]) * np.sqrt(value) if rows == 1 else value)
    return np.array(found)


def family_wise(values: Any, design: Any, contrast: Any, groups: Any, relabellings: list[Any]) -> Any:
    """p by relabelled residuals of the reduced model; a relabelling is a signed permutation matrix."""
    own = abs(g_statistic(values, design, contrast, groups))
    # A basis of the reduced model: columns of the design times the null space of the contrast.
    reduced = design @ np.linalg.svd(contrast)[2][len(contrast) :].T
    residuals = values - reduced @ np.linalg.pinv(reduced) @ values
    largest = [abs(g_statistic(move @ residuals, design, contrast, groups)).max() for move in relabellings]
    return (np.array(largest)[None] >= own[:, None] * (1 - 1e-9)).mean(1)


def permutations(orders: Any) -> list[Any]:
    return [np.eye(len(order))[list(order)] for order in orders]


CASES = [
    ("one mean", np.ones((7, 1)), [[1.0]], "symmetric"),
    ("two means", np.repeat(np.eye(2), [3, 4], axis=0), [[1.0, -1.0]], "exchangeable"),
    ("two means", np.repeat(np.eye(2), [3, 4], axis=0), [[1.0, -1.0]], "symmetric"),
    ("slope", np.column_stack([np.ones(6), [3.0, 1.0, 4.0, 1.5, 9.0, 2.6]]), [[0.0, 1.0]], "exchangeable"),
    ("F", np.repeat(np.eye(3), [2, 2, 3], axis=0), [[1.0, -1.0, 0.0], [0.0, 1.0, -1.0]], "exchangeable"),
]


@pytest.mark.parametrize("split", [False, True])
@pytest.mark.parametrize(("name", "design", "contrast", "errors"), CASES)
def test_p_is_that_of_all_relabellings(name: str, design: Any, contrast: Any, errors: str, split: bool) -> None:
    n, contrast = len(design), np.array(contrast)
    values = np.random.default_rng(len(name)).normal(size=(n, 4)) + 0.4
    # Two variance groups, each with several errors, or none.
    groups = np.arange(n) % 2 if split else np.zeros(n, int)
    if errors == "symmetric":
        moves = [np.diag(signs) for signs in itertools.product([1.0, -1.0], repeat=n)]
    else:
        moves = permutations(itertools.permutations(range(n)))
    found = sp.shape.test(
        values, design=design, contrast=contrast, errors=errors, variance_groups=groups if split else None
    )
    statistic = g_statistic(values, design, contrast, groups)
    assert np.allclose(found.statistic, statistic, rtol=1e-9), (found.statistic, statistic)
    assert found.kind == {(1, False): "t", (1, True): "v", (2, False): "F", (2, True): "G"}[len(contrast), split]
    assert found.exact and found.p_fwe is not None
    assert np.allclose(found.p_fwe, family_wise(values, design, contrast, groups, moves), atol=1e-12)


def test_blocks_are_exchanged_within_and_as_wholes() -> None:
    rng = np.random.default_rng(3)
    subject = np.repeat(np.arange(4), 2)
    dose, age = np.array([0, 1, 1, 0, 0, 1, 0, 1.0]), np.repeat([20.0, 35, 50, 30], 2)
    values = rng.normal(size=(8, 3)) + rng.normal(size=4)[subject][:, None] + dose[:, None]
    design = np.column_stack([dose, subject[:, None] == np.arange(4)]).astype(float)
    contrast, one = np.eye(5)[:1], np.zeros(8, int)
    within = permutations(
        np.concatenate([np.array(pair) + 2 * k for k, pair in enumerate(orders)])
        for orders in itertools.product([(0, 1), (1, 0)], repeat=4)
    )
    found = sp.shape.test(values, design=design, contrast=contrast, blocks=subject, level=0.2)
    assert (found.relabellings, found.exact, found.resampling) == (16, True, "permutations")
    assert found.p_fwe is not None and np.allclose(found.p_fwe, family_wise(values, design, contrast, one, within))
    named = sp.shape.test(values, effect=dose, covariates={"subject": subject.astype(str)}, blocks=subject, level=0.2)
    assert named.p_fwe is not None and np.array_equal(named.p_fwe, found.p_fwe)
    for ids in (subject, subject.astype(float)):
        numbered = sp.shape.test(values, effect=dose, covariates={"subject": ids}, blocks=subject, level=0.2)
        assert numbered.p_fwe is not None and np.array_equal(numbered.p_fwe, found.p_fwe)
        assert len(numbered.columns) == 2 + 3
    # Amounts, although they are constant within blocks.
    for amounts in (7 - subject, age + 0.5, [20, 20, 35, 35, 35, 35, 30, 30]):
        slope = sp.shape.test(values, effect=dose, covariates={"age": amounts}, blocks=subject, level=0.2)
        assert slope.columns == ["mean", "effect", "age"]

    between = np.column_stack([np.ones(8), age])
    whole = permutations(np.concatenate([[2 * k, 2 * k + 1] for k in order]) for order in itertools.permutations(range(4)))
    found = sp.shape.test(values, design=between, contrast=[0, 1], blocks=subject, whole_blocks=True)
    expected = family_wise(values, between, np.array([[0.0, 1.0]]), one, whole)
    assert found.relabellings == 24 and found.p_fwe is not None and np.allclose(found.p_fwe, expected)
    both = [np.kron(np.diag(signs), np.eye(2)) @ move for signs in itertools.product([1, -1], repeat=4) for move in whole]
    found = sp.shape.test(values, design=between, contrast=[0, 1], blocks=subject, whole_blocks=True, errors="both")
    expected = family_wise(values, between, np.array([[0.0, 1.0]]), one, both)
    assert found.relabellings == 384 and found.p_fwe is not None and np.allclose(found.p_fwe, expected)


def enhanced(statistic: Any, edges: Any, areas: Any, steps: int = 4000) -> Any:
    """TFCE by midpoints of steps, by connected components of SciPy."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    found, top = np.zeros_like(statistic), statistic.max()
    for height in (np.arange(steps) + 0.5) * top / steps:
        inside = statistic >= height
        kept = edges[inside[edges].all(1)]
        graph = coo_matrix((np.ones(len(kept)), kept.T), shape=(len(statistic),) * 2)
        label = connected_components(graph, directed=False)[1]
        extent = np.bincount(label, areas * inside, len(statistic))
        found += np.where(inside, extent[label] * height**2, 0) * top / steps
    return found


def test_regions_are_enhanced_and_clustered() -> None:
    sphere = sp.icosphere(2)
    values = np.random.default_rng(5).normal(size=(12, 162))
    patch = sphere.vertices[:, 2] > 0.6
    values[:6, patch] += 1.2
    groups = ["a"] * 6 + ["b"] * 6
    found = sp.shape.test(values, groups, tfce=True, cluster=0.05, surface=sphere, permutations=500)
    corners = sphere.vertices[sphere.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    areas = np.bincount(sphere.faces.ravel(), np.repeat(area / 3, 3), 162)
    edges = np.concatenate([sphere.faces[:, [0, 1]], sphere.faces[:, [1, 2]], sphere.faces[:, [2, 0]]])
    expected = enhanced(found.statistic, edges, areas) - enhanced(-found.statistic, edges, areas)
    assert found.tfce is not None and found.p_tfce is not None and found.p_fwe is not None
    assert np.allclose(found.tfce, expected, atol=2e-3 * abs(expected).max())
    assert (found.p_tfce[patch] <= 0.05).sum() > (found.p_fwe[patch] <= 0.05).sum()
    assert found.clusters is not None and found.cluster_of is not None and found.cluster_threshold is not None
    first = found.clusters[0]
    inside = found.cluster_of == 1
    assert patch[first.peak] and first.p < 0.05 and first.vertices == inside.sum()
    assert np.isclose(first.area, areas[inside].sum()) and first.statistic == found.statistic[first.peak]
    assert (abs(found.statistic) >= found.cluster_threshold).sum() == sum(cluster.vertices for cluster in found.clusters)


def test_groups_given_apart_are_refused() -> None:
    models = [sp.Model(np.eye(9)[:, :3]) for _ in range(4)]
    with pytest.raises(ValueError, match="groups: expected a name for each subject, found models; give all subjects in one"):
        sp.shape.group_test(models[:2], models[2:])


def test_signals_over_maps_of_their_own_are_doubted() -> None:
    surfaces = [sp.example_surface(2, seed)[0] for seed in range(6)]
    groups = ["a"] * 3 + ["b"] * 3
    maps = [sp.fit(surface, max_degree=4) for surface in surfaces]
    own = [sp.fit(surface.vertices[:, 0], model, 4) for surface, model in zip(surfaces, maps)]
    with pytest.warns(sp.SpharmWarning, match="fitted over maps of several surfaces"):
        sp.shape.group_test(own, groups, signal="value", sphere=2, permutations=0)
    with pytest.raises(ValueError, match="signal: expected 'value' for models of signals, found 'normal'"):
        sp.shape.group_test(own, groups)
    common = [sp.fit(surface.vertices[:, 0], sp.icosphere(2), 4) for surface in surfaces]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sp.shape.group_test(common, groups, signal="value", sphere=2, permutations=0)


def test_arguments_that_do_not_fit_are_refused() -> None:
    values, groups = np.random.default_rng(0).normal(size=(8, 12)), ["a"] * 4 + ["b"] * 4
    refused: list[tuple[dict[str, Any], str]] = [
        ({"errors": "normal"}, "exchangeable, symmetric or both"),
        ({"blocks": [1, 2]}, r"shape \(8,\)"),
        ({"whole_blocks": True}, "with blocks"),
        ({"blocks": list("aabbccdd")}, "in these blocks"),
        ({"variance_groups": list("abbbbbbb")}, "fits all of its rows exactly"),
        ({"variance_groups": groups, "welch": True}, "together with Welch"),
        ({"tfce": True}, "give surface="),
        ({"tfce": True, "surface": sp.icosphere(1)}, "expected 12 vertices"),
        ({"cluster": 0.0, "surface": sp.icosphere(0)}, "above 0 and below 1"),
        ({"tfce": True, "surface": sp.icosphere(0), "permutations": 0}, "permutations=1 or more"),
        ({"blocks": list("abcdabcd"), "errors": "symmetric"}, "single rows"),
        ({"blocks": list("abcdabcd"), "permutations": 0}, "permutations=1 or more"),
    ]
    for arguments, message in refused:
        design: dict[str, Any] = {"groups": groups}
        if "variance_groups" in arguments and "welch" not in arguments:
            design = {"design": np.column_stack([np.eye(8)[0], np.ones(8)]), "contrast": [1, 0]}
        with pytest.raises(ValueError, match=message):
            sp.shape.test(values, **design, **arguments)


def test_interactions_are_nested_models() -> None:
    """Each interaction's F is that of the residuals of the models with and without it, in treatment coding."""
    rng = np.random.default_rng(7)
    n, values = 24, rng.normal(size=(24, 3))
    group, sex = np.array(["b", "a", "c"] * 8), np.array(["m"] * 11 + ["f"] * 13)
    age, weight = rng.uniform(20, 80, n), rng.uniform(50, 90, n)
    values += np.outer((group == "a") * age, [0.05, 0.0, 0.0])

    def coded(column: Any) -> Any:
        if column.dtype.kind == "f":
            return column[:, None]
        return np.stack([column == level for level in np.unique(column)[1:]], 1).astype(float)

    def rest(*columns: Any) -> Any:
        design = np.column_stack([np.ones(n), *columns])
        return ((values - design @ np.linalg.lstsq(design, values, rcond=None)[0]) ** 2).sum(0), n - design.shape[1]

    for a, b in itertools.combinations([group, sex, age, weight], 2):
        x, z = coded(a), coded(b)
        products = (x[:, :, None] * z[:, None]).reshape(n, -1)
        other = weight if a is not weight and b is not weight else age
        covariates = {} if other is a or other is b else {"other": other}
        more = [column[:, None] for column in covariates.values()]
        (without, _), (full, freedom) = rest(x, z, *more), rest(x, z, products, *more)
        expected = (without - full) / products.shape[1] / (full / freedom)
        found = sp.shape.test(values, interaction={"a": a, "b": b}, covariates=covariates, permutations=0)
        statistic = found.statistic**2 if products.shape[1] == 1 else found.statistic
        assert np.allclose(statistic, expected, rtol=1e-9), found.meaning
        assert found.freedom[-1] == freedom

    # Interactions that are accounted for: of two covariates, and of the tested column with a covariate.
    covariates = {"age": age, "sex": sex}
    x, product = coded(group), coded(sex) * (age - age.mean())[:, None]
    (without, _), (full, freedom) = rest(coded(sex), age, product), rest(x, coded(sex), age, product)
    found = sp.shape.test(values, group, covariates=covariates, interactions="age:sex", permutations=0)
    assert np.allclose(found.statistic, (without - full) / 2 / (full / freedom), rtol=1e-9)
    assert found.freedom == (2, freedom)
    found = sp.shape.test(values, effect=weight, covariates=covariates, interactions=["age:sex", "effect:age"], permutations=0)
    base = [coded(sex), age, product, (weight - weight.mean()) * (age - age.mean())]
    (without, _), (full, freedom) = rest(*base), rest(*base, weight)
    assert np.allclose(found.statistic**2, (without - full) / (full / freedom), rtol=1e-9)
    for bad in ("age:dose", "age", "groups:"):
        with pytest.raises(ValueError, match="interactions: expected two columns.*groups, age, sex"):
            sp.shape.test(values, group, covariates=covariates, interactions=bad)
    with pytest.raises(ValueError, match="interactions: expected None with a design"):
        sp.shape.test(values, design=np.ones((n, 1)), contrast=[1], interactions="a:b")


def test_contrasts_are_combinations_of_named_columns() -> None:
    rng = np.random.default_rng(8)
    values, group = rng.normal(size=(12, 4)), ["mild", "healthy", "severe"] * 4
    means = {name: values[[one == name for one in group]].mean(0) for name in ("mild", "healthy", "severe")}
    found = sp.shape.test(values, group, contrast="severe - 1/2 mild - 1/2 healthy", permutations=0)
    assert found.effect is not None
    assert np.allclose(found.effect, means["severe"] - (means["mild"] + means["healthy"]) / 2)
    any_, both = (
        sp.shape.test(values, group, contrast=rows, permutations=50)
        for rows in (None, ["mild - healthy", "severe - healthy"])
    )
    assert any_.p_fwe is not None and both.p_fwe is not None
    assert np.allclose(any_.statistic, both.statistic) and np.array_equal(any_.p_fwe, both.p_fwe)
    design = np.column_stack([np.ones(12), np.arange(12.0)])
    named = sp.shape.test(values, design=design, contrast="column 2", permutations=0)
    assert np.array_equal(named.statistic, sp.shape.test(values, design=design, contrast=[0, 1], permutations=0).statistic)
    for bad, said in [("mild - cured", "'cured'|\"cured\""), ("", "combination"), ("mild - mild", "zero")]:
        with pytest.raises(ValueError, match=said):
            sp.shape.test(values, group, contrast=bad)
    with pytest.raises(ValueError, match="expected names"):
        sp.shape.test(values, group, contrast=[1, -1, 0])
    with pytest.raises(ValueError, match="dict of two"):
        sp.shape.test(values, interaction={"group": group})
    with pytest.raises(ValueError, match="no subject is both"):
        sp.shape.test(values, interaction={"group": group, "same": group})


def test_a_result_draws_its_maps() -> None:
    sphere = sp.icosphere(2)
    values = np.random.default_rng(2).normal(size=(12, len(sphere.vertices)))
    values[:6, sphere.vertices[:, 2] > 0] += 5
    groups = ["a"] * 6 + ["b"] * 6
    found = sp.shape.group_test(values, groups, surface=sphere, permutations=200)
    whole, significant = found.picture("effect", size=120), found.picture("effect", level=0.05, size=120)
    assert whole.png[:4] == significant.png[:4] == b"\x89PNG" and whole.png != significant.png
    assert found.picture(size=120).png != whole.png and found.surface is not None
    with pytest.raises(ValueError, match="values: expected one of statistic, p, "):
        found.picture("mean")
    with pytest.raises(ValueError, match="surface="):
        sp.shape.group_test(values, groups, permutations=0).picture()
    with pytest.raises(ValueError, match="level: expected a result with p_fwe"):
        sp.shape.group_test(values, groups, surface=sphere, permutations=0).picture(level=0.05)
    models = [sp.Model(sp.Model(np.eye(4)[:, [3, 1, 2]]).coefficients * (1 + 0.1 * k)) for k in range(4)]
    result = sp.shape.group_test(models, ["a", "b"] * 2, sphere=2, permutations=0)
    assert result.surface is not None and len(result.surface.vertices) == len(result.p)
    assert result.picture("effect", size=120).png[:4] == b"\x89PNG"
