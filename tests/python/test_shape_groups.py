"""Rotation, alignment, modes and tests, compared with NumPy, SciPy and the program."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

import spharm_rs as sp

SPHERE = 4 * np.pi
SOME: dict[str, Any] = {"parameters": [30, 45, 60], "object": [10, 80, -20], "translation": [3, -2, 1]}


def lump(seed: int, amount: float = 0.05) -> sp.Model:
    """Returns an ellipsoid with lumps of degree 5; no rotation or reflection maps it to itself."""
    lumps = np.random.default_rng(7).normal(size=(36, 3)) / (1 + np.arange(36)[:, None])
    values = lumps + amount * np.random.default_rng(seed).normal(size=(36, 3))
    values[[3, 1, 2], [0, 1, 2]] += 9, 6, 4
    return sp.Model(values)


def rmsd(a: sp.Model, b: sp.Model) -> float:
    return float(np.linalg.norm(a.coefficients - b.coefficients) / SPHERE**0.5)


@pytest.fixture(scope="module")
def group() -> list[sp.Model]:
    return [lump(seed) for seed in range(8)]


def test_rotations_turn_the_parameters_and_the_surface(study: Any) -> None:
    model = sp.fit(study[0], study[1], 8)
    matrix = Rotation.from_euler("ZYZ", [30, 45, 60], degrees=True).as_matrix()
    at = np.random.default_rng(0).normal(size=(20, 3))
    turned = sp.shape.rotate(model, parameters=[30, 45, 60])
    assert np.allclose(turned.evaluate(at @ matrix.T), model.evaluate(at), atol=1e-11 * np.abs(model.coefficients).max())
    assert model.directions is not None and turned.directions is not None
    assert np.allclose(turned.directions, model.directions @ matrix.T, atol=1e-14)
    moved = sp.shape.rotate(model, object=matrix, scale=2, translation=[1, 2, 3])
    assert np.allclose(moved.evaluate(at), 2 * model.evaluate(at) @ matrix.T + [1, 2, 3], rtol=1e-11, atol=1e-9)
    rotation = Rotation.from_matrix(matrix)
    for same in (rotation, rotation.as_quat(scalar_first=True), [30, 45, 60]):
        assert rmsd(sp.shape.rotate(model, object=same, scale=2, translation=[1, 2, 3]), moved) < 1e-11
    assert moved.provenance["tool"] == "shape rotate" and moved.provenance["transform"][0]["scale"] == 2
    signal = sp.fit(study[1].vertices[:, 2], study[1], 3)
    assert sp.shape.rotate(signal, parameters=[1, 0, 0, 0]).coefficients.tolist() == signal.coefficients.tolist()
    wrong: dict[str, Any]
    for wrong in ({"object": -np.eye(3)}, {"object": [1, 2]}, {"scale": 0}, {"translation": [1, np.nan, 0]}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            sp.shape.rotate(model, **wrong)
    with pytest.raises(ValueError, match="surface"):
        sp.shape.rotate(signal, object=[1, 2, 3])


def test_the_pose_that_a_surface_comes_in_does_not_count() -> None:
    target, model = lump(0), lump(1)
    plain, posed = sp.shape.align(model, target), sp.shape.align(sp.shape.rotate(model, **SOME), target)
    assert np.isclose(plain.rmsd_after, rmsd(plain.model, target), rtol=1e-9) and not plain.mirrored
    assert rmsd(plain.model, posed.model) < 1e-9 and np.isclose(posed.rmsd_after, plain.rmsd_after, rtol=1e-9)
    assert posed.rmsd_before > 1 > posed.rmsd_after and posed.rmsd_after <= rmsd(model, target) + 1e-12
    # If the target is in another pose, the result moves with it.
    moved = sp.shape.align(model, sp.shape.rotate(target, **SOME)).model
    assert rmsd(moved, sp.shape.rotate(plain.model, **SOME)) < 1e-8
    again = posed.transform.apply(sp.shape.rotate(model, **SOME))
    assert rmsd(again, posed.model) < 1e-11


def test_size_and_mirror_images_are_matched_if_asked_for() -> None:
    target = lump(0)
    small = sp.shape.rotate(target, scale=0.5, **SOME)
    assert sp.shape.align(small, target).rmsd_after > 1
    scaled = sp.shape.align(small, target, scale=True)
    assert scaled.rmsd_after < 1e-9 and np.isclose(scaled.transform.scale, 2)
    degree = np.sqrt(np.arange(36)).astype(int)[:, None]
    mirrored = sp.Model(target.coefficients * [-1, 1, 1] * (-1) ** degree)
    assert sp.shape.align(mirrored, target).rmsd_after > 0.01
    found = sp.shape.align(mirrored, target, mirror=True)
    assert found.mirrored and found.rmsd_after < 1e-9 and np.linalg.det(found.transform.object) < 0
    assert rmsd(found.transform.apply(mirrored), target) < 1e-9
    # A signal, here the x coordinate of each point before it is moved, stays at its point of the surface.
    at = sp.icosphere(2).vertices
    for model, transform in ((mirrored, found.transform), (small, scaled.transform)):
        signal = transform.apply(sp.Model(model.coefficients[:, :1])).evaluate(at)[:, 0]
        before = transform.inverse().apply(transform.apply(model).evaluate(at))[:, 0]
        assert np.allclose(signal, before, rtol=0, atol=1e-9)
    fixed = sp.shape.align(sp.shape.rotate(target, object=[1, 2, 3]), target, "fixed")
    assert fixed.rmsd_after < 1e-12 and np.array_equal(fixed.transform.parameters, np.eye(3))
    with pytest.warns(sp.SpharmWarning, match="degrees 5 and 3"):
        found = sp.shape.align(target, target.truncate(3))
    assert found.degree == 3 and "degrees 5 and 3" in found.warnings[0]
    wrong: dict[str, Any]
    for wrong in ({"method": "best"}, {"degree": -1}, {"starts": 0}):
        with pytest.raises(ValueError):
            sp.shape.align(target, target, **wrong)


def test_copies_in_any_pose_are_one_surface() -> None:
    angles = np.random.default_rng(1).uniform(0, 360, size=(4, 2, 3))
    copies = [sp.shape.rotate(lump(3), parameters=p, object=o, translation=p) for p, o in angles]
    found = sp.shape.procrustes(copies)
    assert found.report["spread_after"] < 1e-10 < 1 < found.report["spread_before"]
    assert len(found.report["rmsd"]) == 4 == len(found.report["templates"]) and not found.report["warnings"]
    for copy, model, transform in zip(copies, found.models, found.transforms):
        assert rmsd(model, found.mean) < 1e-9 and rmsd(transform.apply(copy), model) < 1e-10
    assert np.allclose(found.mean.coefficients[0], 0)
    with pytest.raises(ValueError, match="at least 3"):
        sp.shape.procrustes(copies[:2])
    with pytest.raises(ValueError, match="joint or fixed"):
        sp.shape.procrustes(copies, "foe")
    with pytest.raises(ValueError, match="expected a sequence of Model"):
        sp.shape.procrustes(copies[0])  # type: ignore[arg-type]


def test_the_mean_is_numpys_and_lower_degrees_are_said(group: list[sp.Model]) -> None:
    expected = np.mean([model.coefficients for model in group], axis=0)
    found = sp.shape.mean(group)
    assert np.allclose(found.coefficients, expected, rtol=1e-14, atol=1e-15)
    distances = [rmsd(model, found) for model in group]
    assert np.allclose(found.report["distances"], distances)
    assert np.isclose(found.report["spread"], np.sqrt(np.mean(np.square(distances))))
    assert found.provenance["members"] == [str(index) for index in range(8)]
    with pytest.warns(sp.SpharmWarning, match="degrees from 3 to 5"):
        lower = sp.shape.mean([*group[:3], group[3].truncate(3)])
    assert lower.max_degree == 3
    with pytest.warns(sp.SpharmWarning, match=r"7 not smoothed \(first: models\[0\]\), 1 smoothed by a heat kernel"):
        sp.shape.mean([*group[:7], sp.shape.smooth(group[7], fwhm=10)])
    for other in (sp.Model(np.ones((36, 1))), sp.Model(np.ones((36, 2)), surface=True)):
        with pytest.raises(ValueError, match=r"models\[1\]: expected a model of a surface"):
            sp.shape.mean([group[0], other])
    with pytest.raises(ValueError, match="at least 2 for a mean"):
        sp.shape.mean(group[:1])


def test_modes_are_numpys_singular_vectors(group: list[sp.Model], tmp_path: Path) -> None:
    modes = sp.shape.pca(group, names=[f"s{index}" for index in range(8)])
    rest = np.array([model.coefficients[1:].ravel() for model in group])
    u, s, vt = np.linalg.svd((rest - rest.mean(0)) / SPHERE**0.5, full_matrices=False)
    sign = np.sign(vt[np.arange(7), np.abs(vt[:7]).argmax(1)])[:, None]
    assert len(modes) == 7 and np.allclose(modes.variances, s[:7] ** 2 / 7, rtol=1e-10)
    assert modes.modes.shape == (7, 36, 3) and not modes.modes[:, 0].any()
    assert np.allclose(modes.modes[:, 1:].reshape(7, -1), sign * vt[:7] * SPHERE**0.5, atol=1e-9)
    assert np.allclose(modes.scores, (u * s)[:, :7] * sign.T, atol=1e-10)
    assert np.isclose(modes.total_variance, (s**2).sum() / 7) and np.isclose(modes.compactness[-1], 1)
    assert np.allclose(modes.shares, s[:7] ** 2 / (s**2).sum()) and np.allclose(np.cumsum(modes.shares), modes.compactness)
    shape = modes.shape([1, -2])
    along = np.array([1, -2]) * np.sqrt(modes.variances[:2])
    assert np.allclose(shape.coefficients, modes.mean.coefficients + np.tensordot(along, modes.modes[:2], 1), atol=1e-13)
    scores, distance = modes.project(shape)
    assert distance < 1e-12 and np.allclose(scores, [*along, 0, 0, 0, 0, 0], atol=1e-12)
    quality = modes.quality(samples=200, seed=1)
    assert quality.generalisation.shape == (7,) and (np.diff(quality.generalisation) <= 1e-12).all()
    left = [sp.shape.pca([*group[:i], *group[i + 1 :]], modes=3).project(group[i])[1] for i in range(8)]
    assert np.isclose(quality.generalisation[2], np.mean(left))
    assert np.array_equal(modes.quality(samples=200, seed=1, threads=1).specificity, quality.specificity)
    assert rmsd(*modes.sample(2)) > 0 and rmsd(modes.sample(1)[0], modes.sample(2)[0]) == 0

    path = tmp_path / "group.shape-model.npz"
    modes.save(path)
    back = sp.shape.Modes.load(path)
    assert np.array_equal(back.modes, modes.modes) and np.array_equal(back.scores, modes.scores)
    assert back.members == [f"s{index}" for index in range(8)] and back.provenance["tool"] == "shape pca"
    assert np.array_equal(sp.Model.load(path).coefficients, modes.mean.coefficients)
    with pytest.raises(FileExistsError):
        modes.save(path)
    modes.save(path, overwrite=True)
    with pytest.raises(FileNotFoundError):
        sp.shape.Modes.load(tmp_path / "none.shape-model.npz")
    several, distances = modes.project(group[:3])
    assert several.shape == (3, len(modes)) and distances.shape == (3,)
    for model, scores, distance in zip(group, several, distances):
        alone = modes.project(model)
        assert np.array_equal(alone[0], scores) and alone[1] == distance
    assert np.array_equal(modes.transform(iter(group[:3])), several) and modes.transform([]).shape == (0, len(modes))
    with pytest.raises(ValueError, match=r"models\[1\]: expected a Model, found"):
        modes.project([group[0], "m.npz"])  # type: ignore[list-item]
    with pytest.raises(ValueError, match=r"models\[1\]: expected degree 5, that of the group, found 1"):
        modes.transform([group[0], group[0].truncate(1)])
    with pytest.raises(ValueError, match="model: expected a model of a surface, found"):
        modes.project(sp.Model(group[0].coefficients, surface=False))
    with pytest.raises(ValueError, match="models: expected a sequence of Model, .*project takes a single model"):
        modes.transform(group[0])  # type: ignore[arg-type]
    group[0].save(tmp_path / "model.npz")
    with pytest.raises(ValueError, match="modes"):
        sp.shape.Modes.load(tmp_path / "model.npz")
    with pytest.raises(ValueError, match="not truncated"):
        modes.truncate(2).quality()
    for wrong in ([0] * 8, [float("nan")], [[1, 2]]):
        with pytest.raises(ValueError):
            modes.shape(wrong)
    with pytest.raises(ValueError):
        modes.project(group[0].truncate(3))
    with pytest.raises(TypeError, match="pca"):
        sp.shape.Modes()


def test_what_a_group_measures_is_its_displacement(group: list[sp.Model]) -> None:
    mean, at = sp.shape.mean(group), sp.icosphere(2).vertices
    normals = sp.shape.geometry(mean, at).normals
    expected = [((model.evaluate(at) - mean.evaluate(at)) * normals).sum(1) for model in group]
    if sp.shape.measure(mean).inwards:
        expected = [-values for values in expected]
    found = sp.shape.measure_group(group, 2)
    assert np.allclose(found.values, expected, atol=1e-12) and rmsd(found.mean, mean) < 1e-14
    positions = sp.shape.measure_group(group, at, signal="position")
    assert positions.values.shape == (8, 162, 3) and np.allclose(positions.values[3], group[3].evaluate(at), atol=1e-12)
    signals = [sp.Model(model.coefficients[:, :1]) for model in group]
    assert np.allclose(sp.shape.measure_group(signals, at, signal="value").values, positions.values[..., 0], atol=1e-12)
    with pytest.raises(ValueError, match="normal, position or value"):
        sp.shape.measure_group(group, 2, signal="colour")
    with pytest.raises(ValueError, match="models of signals"):
        sp.shape.measure_group(signals, 2)


@pytest.fixture(scope="module")
def values() -> Any:
    values = np.random.default_rng(5).normal(size=(12, 40))
    values[:6, :10] += 2
    return values


GROUPS = ["b"] * 6 + ["a"] * 6


def test_two_groups_are_tested_as_by_scipy(values: Any) -> None:
    a, b = values[6:], values[:6]
    found = sp.shape.test(values, GROUPS)
    expected = stats.ttest_ind(a, b)
    assert np.array_equal(found.t, found.statistic)
    assert found.kind == "t" and found.freedom == (10,) and found.meaning == "a - b" and found.levels == {"a": 6, "b": 6}
    assert np.allclose(found.statistic, expected.statistic, rtol=1e-11) and np.allclose(found.p, expected.pvalue, rtol=1e-10)
    assert np.allclose(found.q, stats.false_discovery_control(expected.pvalue), rtol=1e-10)
    assert found.effect is not None and found.margin is not None and found.size is not None
    assert np.allclose(found.effect, a.mean(0) - b.mean(0))
    interval = expected.confidence_interval(0.95)
    assert np.allclose(found.effect + found.margin, interval.high) and np.allclose(found.effect - found.margin, interval.low)
    pooled = np.sqrt((a.var(0, ddof=1) + b.var(0, ddof=1)) / 2)
    assert np.allclose(found.size, (a.mean(0) - b.mean(0)) / pooled)

    # The statistics of all 924 relabellings, computed one by one.
    each = np.array([
        np.abs(stats.ttest_ind(values[list(first)], np.delete(values, first, axis=0)).statistic)
        for first in itertools.combinations(range(12), 6)
    ])  # fmt: skip
    own = np.abs(expected.statistic) * (1 - 1e-9)
    assert found.relabellings == 924 and found.exact and found.p_fwe is not None and found.p_permutation is not None
    assert np.allclose(found.p_permutation, (each >= own).mean(0)), "pointwise"
    assert np.allclose(found.p_fwe, [(each.max(1) >= t).mean() for t in own])

    welch = sp.shape.test(values, GROUPS, welch=True, permutations=0)
    expected = stats.ttest_ind(a, b, equal_var=False)
    assert np.allclose(welch.statistic, expected.statistic) and np.allclose(welch.p, expected.pvalue)
    assert welch.p_fwe is None and welch.relabellings == 0 and welch.smallest_p is None
    reverse = sp.shape.test(values, GROUPS, levels=["b", "a"], permutations=0)
    assert np.array_equal(reverse.statistic, -found.statistic) and reverse.meaning == "b - a"
    numbered = sp.shape.test(values, [10] * 6 + [9] * 6, permutations=0)
    assert np.array_equal(numbered.statistic, found.statistic) and numbered.meaning == "9 - 10"


def test_slopes_covariates_and_designs_are_least_squares(values: Any) -> None:
    rng = np.random.default_rng(2)
    age, site = rng.uniform(20, 80, 12), ["x", "y", "z", "x"] * 3
    slope = sp.shape.test(values, effect=age, permutations=0)
    assert np.allclose(slope.p, [stats.linregress(age, column).pvalue for column in values.T], rtol=1e-9)
    adjusted = sp.shape.test(values, GROUPS, covariates={"age": age, "site": site}, permutations=0)
    assert adjusted.columns == ["a", "b", "age", "site y", "site z"]

    class Table:
        """The part of a data frame's interface that is used."""

        columns = ("age", "site")

        def __getitem__(self, name: str) -> Any:
            return {"age": age, "site": site}[name]

    table = sp.shape.test(values, GROUPS, covariates=Table(), permutations=0)
    assert np.array_equal(table.statistic, adjusted.statistic) and table.columns == adjusted.columns
    plain = sp.shape.test(values, GROUPS, covariates=age, permutations=0)
    assert plain.columns == ["a", "b", "covariate 1"] and plain.freedom == (9,)
    own = np.column_stack([np.equal(GROUPS, "a"), np.equal(GROUPS, "b"), age, np.equal(site, "y"), np.equal(site, "z")]) * 1.0
    contrast = np.array([1.0, -1, 0, 0, 0])
    solution, squares, *_ = np.linalg.lstsq(own, values, rcond=None)
    error = np.sqrt(squares / 7 * (contrast @ np.linalg.inv(own.T @ own) @ contrast))
    assert np.allclose(adjusted.statistic, contrast @ solution / error, rtol=1e-9) and adjusted.freedom == (7,)
    by_design = sp.shape.test(values, design=own, contrast=contrast, permutations=0)
    assert np.allclose(by_design.statistic, adjusted.statistic, rtol=1e-9)
    three = ["u", "v", "w", "w"] * 3
    found = sp.shape.test(values, three, permutations=0)
    parts = [values[np.equal(three, level)] for level in "uvw"]
    expected = stats.f_oneway(*parts)
    assert found.kind == "F" and found.freedom == (2, 9) and found.effect is None
    assert np.allclose(found.statistic, expected.statistic) and np.allclose(found.p, expected.pvalue)
    one = sp.shape.test(values, design=np.ones((12, 1)), contrast=[1], permutations=0)
    assert np.allclose(one.statistic, stats.ttest_1samp(values, 0).statistic)


def test_positions_are_tested_by_hotellings_statistic() -> None:
    values = np.random.default_rng(3).normal(size=(14, 5, 3))
    found = sp.shape.test(values, [0] * 7 + [1] * 7, permutations=500, seed=4)
    a, b = values[:7], values[7:]
    off = a.mean(0) - b.mean(0)
    for at in range(5):
        scatter = (np.cov(a[:, at].T) + np.cov(b[:, at].T)) / 2
        assert np.isclose(found.statistic[at], 3.5 * off[at] @ np.linalg.solve(scatter, off[at]))
    f = found.statistic * (12 - 3 + 1) / (12 * 3)
    assert found.kind == "T2" and found.freedom == (3, 12) and np.allclose(found.p, stats.f.sf(f, 3, 10), rtol=1e-9)
    assert found.effect is not None and np.allclose(found.effect, off)


def test_the_same_seed_gives_the_same_bits_for_any_threads() -> None:
    values = np.random.default_rng(6).normal(size=(30, 200))
    groups = [0, 1] * 15
    found = sp.shape.test(values, groups, permutations=300, seed=1, threads=1)
    same = sp.shape.test(np.asfortranarray(values), groups, permutations=300, seed=1, threads=3)
    other = sp.shape.test(values, groups, permutations=300, seed=2)
    assert found.p_fwe is not None and same.p_fwe is not None and other.p_fwe is not None
    assert found.p_fwe.tobytes() == same.p_fwe.tobytes() and found.statistic.tobytes() == same.statistic.tobytes()
    assert found.p_fwe.tobytes() != other.p_fwe.tobytes() and not found.exact and found.relabellings == 301

    posed = [sp.shape.rotate(lump(seed), parameters=[seed, 40, 80], object=[0, 70 * seed, 20]) for seed in range(4)]
    one, three = (sp.shape.procrustes(posed, threads=threads) for threads in (1, 3))
    assert all(a.coefficients.tobytes() == b.coefficients.tobytes() for a, b in zip(one.models, three.models))


def test_groups_are_the_programs_to_the_bit(group: list[sp.Model], tmp_path: Path) -> None:
    def run(*command: str) -> None:
        command = (sys.executable, "-m", "spharm_rs", "shape", *command)
        subprocess.run(command, cwd=tmp_path, capture_output=True, check=True)

    posed = [sp.shape.rotate(model, **SOME) if index % 2 else model for index, model in enumerate(group[:4])]
    for index, model in enumerate(posed):
        model.save(tmp_path / f"m{index}.spharm.npz")
    names = [f"m{index}.spharm.npz" for index in range(4)]

    def same(path: Path, model: sp.Model) -> bool:
        return bool(np.array_equal(sp.Model.load(path).coefficients, model.coefficients))

    run("rotate", names[0], "--object=10,80,-20", "--parameters=30,45,60", "--translate=3,-2,1", "-o", "rotated.npz")
    assert same(tmp_path / "rotated.npz", sp.shape.rotate(posed[0], **SOME))
    run("align", names[1], "--to", names[0], "-o", "aligned.npz")
    assert same(tmp_path / "aligned.npz", sp.shape.align(posed[1], posed[0]).model)
    run("align", *names, "--group", "--mean", "mean.npz", "-o", "together")
    found = sp.shape.procrustes(posed)
    assert same(tmp_path / "mean.npz", found.mean)
    assert all(same(path, model) for path, model in zip(sorted((tmp_path / "together").glob("*.npz")), found.models))
    run("pca", "together", "-o", "modes.shape-model.npz")
    program, modes = sp.shape.Modes.load(tmp_path / "modes.shape-model.npz"), sp.shape.pca(found.models)
    assert np.array_equal(program.modes, modes.modes) and np.array_equal(program.scores, modes.scores)
    run("sample", "modes.shape-model.npz", "--random", "2", "--seed", "5", "-o", "shapes")
    files = sorted((tmp_path / "shapes").glob("*.npz"))
    assert len(files) == 2 and all(same(path, shape) for path, shape in zip(files, program.sample(2, seed=5)))


def test_models_are_tested_as_by_the_program(group: list[sp.Model], tmp_path: Path) -> None:
    for index, model in enumerate(group):
        model.save(tmp_path / f"{'ab'[index // 4]}{index}.spharm.npz")
    files = [[str(path) for path in sorted(tmp_path.glob(f"{name}*"))] for name in "ab"]
    command = ["shape", "test", "--a", *files[0], "--b", *files[1], "--icosphere", "2", "-o", str(tmp_path / "out"), "--json"]
    done = subprocess.run([sys.executable, "-m", "spharm_rs", *command], capture_output=True, text=True, check=True)
    found = sp.shape.test(group, ["a"] * 4 + ["b"] * 4, sphere=2)
    program, report = np.genfromtxt(tmp_path / "out" / "test.csv", delimiter=",", names=True), json.loads(done.stdout)
    assert report["relabellings"] == found.relabellings == 70 and report["meaning"] == found.meaning
    for name in ("statistic", "p", "q", "p_fwe", "p_permutation", "effect", "margin", "size"):
        # genfromtxt drops the hyphens in the header's names.
        assert np.allclose(program[name.replace("_", "")], getattr(found, name), rtol=1e-6, atol=1e-9), name
    assert found.mean is not None and rmsd(found.mean, sp.shape.mean(group)) < 1e-14
    image = found.to_nilearn("p_fwe", hemisphere="right")
    assert found.p_fwe is not None and found.surface is not None
    assert np.array_equal(image.data.parts["right"], found.p_fwe)
    assert np.array_equal(image.mesh.parts["right"].coordinates, found.surface.vertices)
    with pytest.raises(ValueError, match="values: expected one of statistic"):
        found.to_nilearn("meaning")


def test_studies_that_say_nothing_are_refused_or_warned_of(values: Any) -> None:
    flat = values.copy()
    flat[:, 0] = 1
    with pytest.warns(sp.SpharmWarning, match="no variance"):
        found = sp.shape.test(flat, GROUPS, permutations=0)
    assert found.statistic[0] == 0 and found.p[0] == 1 and found.size is not None and found.size[0] == 0
    assert "no variance" in found.warnings[0] and all(np.isfinite(found.p))
    with pytest.warns(sp.SpharmWarning, match="no vertex can be significant"):
        sp.shape.test(values[3:8], GROUPS[3:8])
    refused: list[tuple[dict[str, Any], str]] = [
        ({}, "one of them"),
        ({"groups": GROUPS[1:]}, "groups"),
        ({"groups": ["a"] * 12}, "two levels"),
        ({"groups": [*GROUPS[1:], None]}, "groups: .* found None in row 11"),
        ({"groups": GROUPS, "levels": ["a", "c"]}, "order"),
        ({"groups": GROUPS, "covariates": {"g": [x == "a" for x in GROUPS]}}, "combination"),
        ({"groups": GROUPS, "covariates": np.full(12, np.nan)}, "covariate 1: .* found NaN in row 0"),
        ({"design": np.eye(12)[:, :2]}, "both"),
        ({"design": np.eye(12)[:, :2], "contrast": [1, -1, 0]}, "contrast"),
        ({"groups": GROUPS, "covariates": range(12), "welch": True}, "Welch's test.*give variance_groups="),
        ({"groups": GROUPS, "confidence": 2}, "between 0 and 1"),
        ({"groups": GROUPS, "level": 0}, "between 0 and 1"),
    ]
    for wrong, said in refused:
        with pytest.raises(ValueError, match=said):
            sp.shape.test(values, **wrong)
    nothing: list[Any] = [np.full((12, 3), np.nan), np.zeros(12), [lump(0), "model"]]
    for bad in nothing:
        with pytest.raises(ValueError):
            sp.shape.test(bad, GROUPS)


def test_morphs_are_the_programs(tmp_path: Path) -> None:
    first, last = sp.shape.rotate(lump(0), **SOME), lump(1)
    path = sp.shape.morph(first, last, 5)
    assert path.times.tolist() == [0, 0.25, 0.5, 0.75, 1] and 0.9 < path.volume_ratio < 1.1 and path.warnings == ()
    assert rmsd(path.models[-1], last) < 1e-12
    halves = (path.models[0].coefficients + path.models[4].coefficients) / 2
    assert np.allclose(path.models[2].coefficients, halves, atol=1e-12)
    some = sp.shape.morph(first, last, [0.5])
    assert np.array_equal(some.models[0].coefficients, path.models[2].coefficients)
    # With keep_pose, the path begins at the first model's position.
    kept = sp.shape.morph(first, last, 3, keep_pose=True)
    place = [model.coefficients[0] for model in kept.models]
    assert np.allclose(place[0], first.coefficients[0], atol=1e-9) and np.allclose(place[2], last.coefficients[0], atol=1e-9)
    for name, model in (("a", first), ("b", last)):
        model.save(tmp_path / f"{name}.spharm.npz")
    command = ["shape", "morph", "a.spharm.npz", "b.spharm.npz", "--steps", "5", "--format", "spharm.npz", "-o", "path", "-q"]
    subprocess.run([sys.executable, "-m", "spharm_rs", *command], cwd=tmp_path, check=True, capture_output=True)
    for step, model in enumerate(path.models):
        theirs = sp.Model.load(tmp_path / "path" / f"step{step}.spharm.npz")
        assert np.array_equal(theirs.coefficients, model.coefficients)


def test_morphs_keep_the_correspondence_of_a_group() -> None:
    surfaces = [sp.example_surface(4, seed)[0] for seed in (0, 1)]
    first, last = sp.shape.correspond(surfaces, 8, subdivisions=3, pose="near").models
    kept = sp.shape.morph(first, last, 3, keep_pose=True)
    assert np.allclose(kept.models[0].coefficients, first.coefficients, atol=1e-9)
    assert np.allclose(kept.models[2].coefficients, last.coefficients, atol=1e-9)
    fixed = sp.shape.align(first, last, "fixed").model.coefficients
    assert np.allclose(sp.shape.morph(first, last, 2).models[0].coefficients, fixed, atol=1e-12)
    joint = sp.shape.morph(first, last, 2, method="joint").models[0].coefficients
    assert np.allclose(joint, sp.shape.align(first, last).model.coefficients, atol=1e-12)
    assert abs(joint - fixed).max() > 1e-3
    # Directions of models of other origins may not correspond.
    one, other = (sp.Model(model.coefficients) for model in (first, last))
    assert np.array_equal(sp.shape.morph(one, other, 2).models[0].coefficients, joint)
    assert np.allclose(sp.shape.morph(one, other, 2, method="fixed").models[0].coefficients, fixed, atol=1e-12)
    with pytest.raises(ValueError, match="method: expected one of joint, fixed; found 'foe'"):
        sp.shape.morph(first, last, method="foe")  # type: ignore[arg-type]


def test_bad_morphs_are_refused() -> None:
    one, signal = lump(0), sp.Model(np.ones((4, 1)))
    for steps in (1, 2.5, [[0.5]], [np.nan]):
        with pytest.raises(ValueError):
            sp.shape.morph(one, one, steps)
    with pytest.raises(ValueError, match="end: expected a model of a surface"):
        sp.shape.morph(one, signal)
