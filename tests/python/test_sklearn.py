"""scikit-learn's transformers: scores found again, known shapes and poses, scikit-learn's own checks, and errors."""

from __future__ import annotations

import pickle
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import special
from scipy.spatial.transform import Rotation
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from sklearn.linear_model import LogisticRegression
from sklearn.model_selection import GridSearchCV, cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils import InputTags, estimator_checks, get_tags
from sklearn.utils.validation import validate_data

import spharm_rs as sp
from spharm_rs.sklearn import Descriptors, ShapeFeatures, SpharmTransformer

BALL = sp.icosphere(3)
ELLIPSOID = np.eye(9)[:, [3, 1, 2]] * [900, 600, 400]
COARSE = sp.icosphere(2)
SMALL: dict[str, Any] = {"subdivisions": 2, "threads": 2}


def bar(seed: int, bend: float, taper: float = 0.3, size: float = 1.0, ball: sp.Surface = BALL) -> sp.Surface:
    """Returns a bent and tapered bar of 24 by 10 by 7 mm, in a pose and with vertices that depend on the seed."""
    turn, directions = (Rotation.random(random_state=seed + of).as_matrix() for of in (0, 1000))
    x, y, z = directions @ ball.vertices.T
    thick = 1 + taper * x
    vertices = size * np.stack([12 * x, 5 * thick * y + bend * x**2, 3.5 * thick * z + x * y], axis=1)
    return sp.Surface(vertices @ turn.T + [seed, -2 * seed, 5], ball.faces)


def bars(count: int, first: int = 0, ball: sp.Surface = BALL) -> tuple[list[sp.Surface], NDArray[Any], NDArray[Any]]:
    """Returns bars, their bends, and their groups: bars of group 1 are bent more."""
    rng = np.random.default_rng(first)
    group = np.arange(count) % 2
    bend = 2 + 3 * group + rng.uniform(-1, 1, count)
    tapers = rng.uniform(0.2, 0.4, count)
    shapes = enumerate(zip(bend, tapers))
    return [bar(first + index, own, taper, ball=ball) for index, (own, taper) in shapes], bend, group


def apart(a: sp.Surface, b: sp.Surface) -> float:
    """Returns the root mean square distance of a surface's vertices from another surface in the best pose."""
    found = sp.compare(sp.shape.pose(a, b).transform.apply(a), b, surface_distance=True, samples=2000).per_vertex
    return float(np.sqrt(np.mean(found**2)))


@pytest.fixture(scope="module")
def trained() -> tuple[ShapeFeatures, NDArray[Any]]:
    features = ShapeFeatures(6, subdivisions=3)
    return features, features.fit_transform(bars(8)[0])


@pytest.fixture(scope="module")
def rough() -> ShapeFeatures:
    """Returns features of four bars, with few directions."""
    return ShapeFeatures(3, **SMALL).fit(bars(4, ball=COARSE)[0])


def test_transform_finds_the_scores_of_the_training_group_again(trained: Any) -> None:
    features, scores = trained
    again = features.transform(bars(8)[0])
    assert scores.shape == (8, 7) and features.n_features_out_ == 7
    assert again.tolist() == scores.tolist()
    own = features.scores_
    assert np.allclose(own, features.modes_.scores) and features.modes_.members == list(features.group_.names)
    assert 0 < np.sqrt(((scores - own) ** 2).mean()) < 0.03 < 0.2 < scores[:, 0].std()


def test_the_bend_is_the_first_mode_also_of_new_bars(trained: Any) -> None:
    features, scores = trained
    new, bend, _ = bars(6, first=100)
    found = features.transform(new)
    assert abs(np.corrcoef(scores[:, 0], bars(8)[1])[0, 1]) > 0.98
    assert abs(np.corrcoef(found[:, 0], bend)[0, 1]) > 0.98


def test_scores_turn_back_into_the_surfaces(trained: Any) -> None:
    features, _ = trained
    new = [bar(100, 1.0), bar(101, 6.0)]
    back = features.inverse_transform(features.transform(new))
    mean = features.inverse_transform(np.zeros((1, 7)))[0]
    for given, found in zip(new, back):
        assert isinstance(found, sp.Surface) and len(found.vertices) == 2562
        assert apart(found, given) < 0.2 < 0.3 < apart(mean, given)
    model = features.modes_.shape([1.5])
    deviations = [[1.5 * np.sqrt(features.modes_.variances[0]), *[0] * 6]]
    assert np.allclose(features.inverse_transform(deviations)[0].vertices, model.evaluate(4))
    assert features.group_.directions.shape == (642, 3)


def test_size_is_a_column_of_its_own() -> None:
    sizes = np.array([0.7, 1.4, 1.0, 1.2, 0.8])
    group = [bar(seed, 2 + seed, size=size, ball=COARSE) for seed, size in enumerate(sizes)]
    features = ShapeFeatures(4, 0.9, scale=True, size=True, **SMALL)
    rows = features.fit_transform(group)
    assert features.get_feature_names_out()[-1] == "log_size" and rows.shape[1] == features.n_features_out_
    off = rows[:, -1] - np.log(sizes)
    assert np.ptp(off) < 0.1
    own = features.scores_
    assert np.abs(rows[:, -1] - own[:, -1]).max() < 0.01 and np.abs((rows - own)[:, :-1]).max() < 0.5 * own[:, 0].std()
    new = bar(9, 3.0, size=1.5, ball=COARSE)
    found = features.transform([new])
    assert found[0, -1] - np.log(1.5) == pytest.approx(off.mean(), abs=0.1)
    assert features.inverse_transform(found)[0].volume == pytest.approx(new.volume, rel=0.1)
    # The mesh at another size has the same scores and another size.
    twice = features.transform([sp.Surface(2 * group[0].vertices, group[0].faces)])
    assert np.allclose(twice - rows[:1], [*[0] * (rows.shape[1] - 1), np.log(2)], atol=1e-3)


def test_modes_are_a_number_or_a_share(trained: Any) -> None:
    features, _ = trained
    every, models = ShapesOfModels(6), features.group_.models
    shares = every.fit(models).modes_.compactness
    assert len(shares) == 7
    for share in (0.5, 0.95, 0.99):
        some = clone(every).set_params(modes=share).fit(models)
        assert len(some.modes_) == 1 + int((shares < share).sum()) == some.n_features_out_ < 7
    assert clone(every).set_params(modes=2).fit(models).get_feature_names_out().tolist() == ["mode_1", "mode_2"]
    for wrong in (0, 1.0, -0.5, True, "all"):
        with pytest.raises(ValueError, match="modes: expected"):
            clone(every).set_params(modes=wrong).fit(models)


def test_a_pickled_transformer_is_the_same(rough: ShapeFeatures) -> None:
    new = bars(1, first=100, ball=COARSE)[0]
    again, row = pickle.loads(pickle.dumps(rough)), rough.modes_.scores[:1]
    assert again.transform(new).tolist() == rough.transform(new).tolist()
    assert again.inverse_transform(row)[0].vertices.tolist() == rough.inverse_transform(row)[0].vertices.tolist()
    assert again.set_params(threads=1).transform(new).tolist() == rough.transform(new).tolist()
    unfitted = clone(rough)
    assert unfitted.get_params() == rough.get_params() and not hasattr(unfitted, "group_")


def test_processes_cross_validate_a_classifier() -> None:
    group, _, labels = bars(8, ball=COARSE)
    pipeline = make_pipeline(ShapeFeatures(4, 2, subdivisions=2, threads=1), StandardScaler(), LogisticRegression())
    assert cross_val_score(pipeline, group, labels, cv=2, n_jobs=2).tolist() == [1, 1]
    pipeline = make_pipeline(Descriptors(threads=1), StandardScaler(), LogisticRegression())
    search = GridSearchCV(pipeline, {"descriptors__max_degree": [1, 2]}, cv=2, n_jobs=2).fit(group, labels)
    assert search.cv_results_["mean_test_score"].min() > 0.8 and search.score(group, labels) == 1


def test_tables_name_their_columns(rough: ShapeFeatures) -> None:
    pandas = pytest.importorskip("pandas")
    group = bars(3, first=100, ball=COARSE)[0]
    features = pickle.loads(pickle.dumps(rough)).set_output(transform="pandas")
    table = features.transform(pandas.Series(group, index=["a", "b", "c"]))
    assert table.index.tolist() == ["a", "b", "c"] and table.columns.tolist() == ["mode_1", "mode_2", "mode_3"]
    assert np.array_equal(table.to_numpy(), rough.transform(group))
    assert features.inverse_transform(table)[2].vertices.shape == (2562, 3)
    frame = pandas.DataFrame({"surface": group})
    table = Descriptors(1, measures=["area", "size"]).set_output(transform="pandas").fit_transform(frame)
    assert table.columns.tolist() == ["singular_value_1_1", "singular_value_1_2", "singular_value_1_3", "area", "size"]
    positions = np.stack([surface.vertices for surface in group])
    table = SpharmTransformer(2, sphere="icosphere:2").set_output(transform="pandas").fit_transform(positions)
    assert table.shape == (3, 27) and table.columns[[0, 15]].tolist() == ["x_0_0", "y_2_0"]


def test_descriptors_of_an_ellipsoid_are_its_half_axes() -> None:
    axes = np.array([9.0, 6, 4])
    # Harmonics of degree 1 are sqrt(3 / 4 pi) times x, y and z.
    model = sp.Model(np.eye(9)[:, [3, 1, 2]] * axes * np.sqrt(4 * np.pi / 3))
    turned = sp.shape.rotate(model, parameters=[30, 45, 60], object=[10, 80, -20], translation=[3, -2, 1])
    power = axes @ axes / 3
    measures = ("size", "volume", "area", "sphericity")
    rows = Descriptors(2, measures=measures).fit_transform([model, turned])
    volume, area, sphericity = rows[0, 7:]
    assert np.allclose(rows[:, :7], [*axes / np.sqrt(3), 0, 0, 0, np.sqrt(power)], atol=1e-12)
    assert np.allclose(rows[1], rows[0], atol=1e-12) and volume == pytest.approx(4 * np.pi / 3 * axes.prod())
    # NIST Digital Library of Mathematical Functions, 19.33.2, with Legendre's integrals.
    a, b, c = axes
    sine, parameter = np.sqrt(1 - c**2 / a**2), a**2 * (b**2 - c**2) / (b**2 * (a**2 - c**2))
    first, second = special.ellipkinc(np.arcsin(sine), parameter), special.ellipeinc(np.arcsin(sine), parameter)
    expected = 2 * np.pi * (c**2 + a * b / sine * (second * sine**2 + first * (1 - sine**2)))
    assert area == pytest.approx(expected, rel=1e-6)
    assert sphericity == pytest.approx((36 * np.pi * volume**2) ** (1 / 3) / expected, rel=1e-6)
    rows = Descriptors(2, "power", unit_size=True, measures=["volume"]).fit_transform([model, 3 * model])
    assert np.allclose(rows, [[1, 0, volume], [1, 0, 27 * volume]])


def test_descriptors_of_meshes_depend_neither_on_pose_nor_on_vertices() -> None:
    meshes = [bar(1, 3.0), bar(2, 3.0), bar(3, 3.0), bar(1, 4.0)]
    rows = Descriptors(4, area=0.1).fit_transform(meshes)
    assert Descriptors(4, area=0.1, threads=1).fit_transform(meshes[:1]).tolist() == rows[:1].tolist()
    off = np.linalg.norm(rows - rows[0], axis=1)
    assert off[1:3].max() < 0.02 < 0.1 < off[3]
    mapped = sp.parametrize(meshes[0], degree=4)
    model = sp.fit(mapped, max_degree=4)
    assert np.allclose(rows[0], sp.shape.describe(model).singular_values.ravel(), atol=1e-12)
    assert np.allclose(Descriptors(4, area=0.1).fit_transform([mapped, model]), rows[0], atol=1e-12)


def halved(surface: sp.Surface) -> sp.Surface:
    """Returns the same surface with each triangle divided into four."""
    edges = np.sort(surface.faces[:, [[0, 1], [1, 2], [2, 0]]], axis=-1).reshape(-1, 2)
    pairs, numbers = np.unique(edges, axis=0, return_inverse=True)
    (a, b, c), (x, y, z) = surface.faces.T, len(surface.vertices) + numbers.reshape(-1, 3).T
    faces = np.concatenate([np.stack(corners, axis=1) for corners in ((a, x, z), (x, b, y), (z, y, c), (x, y, z))])
    return sp.Surface(np.concatenate([surface.vertices, surface.vertices[pairs].mean(axis=1)]), faces)


def test_descriptors_find_the_same_body_at_another_resolution() -> None:
    rng = np.random.default_rng(1)
    places = rng.normal(size=(3, 3))
    places /= np.linalg.norm(places, axis=1, keepdims=True)
    bumps = np.exp(12 * (COARSE.vertices @ places.T - 1))
    radii = [10 * (1 + bumps @ (0.35 + 0.1 * rng.uniform(-1, 1, 3))) for _ in range(5)]
    bodies = [sp.Surface(COARSE.vertices * radius[:, np.newaxis], COARSE.faces) for radius in radii]
    rows = Descriptors(10).fit_transform([*bodies, *map(halved, bodies)])
    off = np.linalg.norm(rows[:, np.newaxis] - rows, axis=2) + np.diag([np.inf] * 10)
    assert off.argmin(axis=1).tolist() == [*range(5, 10), *range(5)]


def test_surfaces_come_as_paths_arrays_and_tables(rough: ShapeFeatures, tmp_path: Path) -> None:
    group = bars(3, ball=COARSE)[0]
    for index, surface in enumerate(group):
        surface.save(tmp_path / f"{index}.ply", double=True)
    model = sp.fit(sp.parametrize(group[2], degree=2, area=0), max_degree=2)
    model.save(tmp_path / "2.spharm.npz")
    paths = [tmp_path / "0.ply", str(tmp_path / "1.ply"), str(tmp_path / "2.spharm.npz")]
    objects = np.empty(3, dtype=object)
    objects[:] = group
    pairs = [(surface.vertices, surface.faces) for surface in group]
    descriptors = Descriptors(2).fit(group)
    expected = descriptors.transform(group)
    for X in (tuple(group), objects, objects[:, np.newaxis], pairs, paths, np.array([str(path) for path in paths])):
        assert np.allclose(descriptors.transform(X), expected, atol=1e-12)
    assert np.allclose(rough.transform(paths[:2]), rough.transform(group[:2]), atol=1e-12)


@pytest.mark.parametrize("transformer", [ShapeFeatures(3, **SMALL), Descriptors(2), SpharmTransformer(2)])
def test_what_is_not_fitted_is_refused(transformer: Any) -> None:
    calls = [lambda: transformer.transform([BALL]), transformer.get_feature_names_out]
    if hasattr(transformer, "inverse_transform"):
        calls.append(lambda: transformer.inverse_transform(np.zeros((1, 2))))
    for call in calls:
        with pytest.raises(NotFittedError, match="not fitted yet"):
            call()


def test_what_is_no_sequence_of_surfaces_is_refused(rough: ShapeFeatures) -> None:
    for X, text in (
        (BALL, "expected a sequence of surfaces, found Surface"),
        ("a.ply", "expected a sequence of surfaces, found str"),
        (None, "expected a sequence of surfaces, found NoneType"),
        ([], "expected at least one surface, found none"),
        (np.zeros((4, 6)), r"an array of float64 of shape \(4, 6\)"),
        (np.array([["a.ply", "b.ply"]]), r"\(n, 1\); found shape \(1, 2\)"),
    ):
        for call in (rough.transform, ShapeFeatures().fit, Descriptors().fit):
            with pytest.raises(ValueError, match=f"^X: .*{text}"):
                call(X)
    with pytest.raises(ValueError, match="expected three or more surfaces for modes of variation, found 2"):
        ShapeFeatures().fit([BALL, BALL])


def test_surfaces_with_other_triangles_than_the_sphere_are_refused() -> None:
    surface = sp.Surface(BALL.vertices * [9, 6, 4], BALL.faces)
    shuffled = sp.Surface(surface.vertices, BALL.faces[::-1, [1, 2, 0]])
    others = BALL.faces.copy()
    others[0] = others[0, 0], others[0, 1], others[1, 0]
    wrong = sp.Surface(surface.vertices, others)
    transformer = SpharmTransformer(4, sphere=BALL).fit([surface])
    found = transformer.transform([surface, shuffled])
    assert np.array_equal(found[0], found[1]) and np.array_equal(found[:1], transformer.transform([surface.vertices]))
    with pytest.raises(sp.MeshError, match="triangles? differs? between this surface and the sphere") as refused:
        sp.fit(wrong, BALL, 4)
    with pytest.raises(sp.MeshError) as same:
        transformer.transform([surface, wrong])
    assert str(same.value) == str(refused.value).replace("the surface:", "surfaces[1]:", 1)


def test_other_columns_and_parameters_are_refused(rough: ShapeFeatures) -> None:
    transformer = SpharmTransformer(2, sphere="icosphere:1").fit([])
    for call, columns, of in ((rough, 3, "scores"), (transformer, 27, "coefficients")):
        for wrong in (np.zeros((2, columns - 1)), np.zeros((2, columns + 1)), np.zeros((1, 1, columns))):
            shape = ", ".join(map(str, wrong.shape))
            with pytest.raises(ValueError, match=rf"expected rows of {columns} {of}, .*found shape \({shape}\)"):
                call.inverse_transform(wrong)
        with pytest.raises(ValueError, match="expected finite numbers, found NaN or infinity in row 1"):
            call.inverse_transform([[0.0] * columns, [np.inf] * columns])
    with pytest.raises(ValueError, match=r"found shape \(3,\)"):
        rough.inverse_transform(np.zeros(3))
    for wrong_parameters, text in (
        ({"kind": "both"}, "kind: expected singular_values or power, found 'both'"),
        ({"max_degree": 0}, "max_degree: expected at least 1, found 0"),
        ({"measures": ["mass"]}, "measures: expected .* sphericity; found .'mass'."),
        ({"measures": "area"}, "measures: expected a sequence"),
        ({"area": 1.5}, "area: expected a number from 0 to 1, found 1.5"),
    ):
        with pytest.raises(ValueError, match=text):
            Descriptors(**wrong_parameters).fit([BALL])
    with pytest.raises(ValueError, match="size: expected False"):
        ShapeFeatures(size=True).fit([BALL] * 3)


class StandIn:
    """Lets scikit-learn's checks run on rows of numbers, each of which stands for a model of degree 2."""

    def _surfaces(self, X: Any, reset: bool = False) -> list[Any]:
        values = validate_data(self, X, reset=reset, dtype=np.float64, ensure_min_samples=3 if reset else 1)
        return [sp.Model(ELLIPSOID + 10 * np.tanh(np.resize(row, (9, 3)))) for row in values]

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()  # type: ignore[misc]
        tags.input_tags = InputTags()
        return tags


class Together:
    """Stands for a group in which models already correspond."""

    def __init__(self, models: list[sp.Model]) -> None:
        self.models, self.names, self.sphere = models, [str(index) for index in range(len(models))], sp.icosphere(1)
        self.transforms = [None] * len(models)


class ShapesOfModels(ShapeFeatures):
    """`ShapeFeatures` of models that correspond already."""

    def _correspond(self, surfaces: list[Any]) -> Any:
        return Together(surfaces)

    def _register(self, surfaces: list[Any]) -> Any:
        return [SimpleNamespace(model=model, transform=None) for model in surfaces]


class DescriptorsOfNumbers(StandIn, Descriptors):
    """`Descriptors` of models."""


class ShapesOfNumbers(StandIn, ShapesOfModels):
    """`ShapeFeatures` of rows of numbers."""


OF_NUMBERS = [ShapesOfNumbers(2, 2), DescriptorsOfNumbers(2, measures=("size",))]


@pytest.mark.filterwarnings("ignore::spharm_rs.SpharmWarning")
@estimator_checks.parametrize_with_checks(OF_NUMBERS)  # type: ignore[untyped-decorator]
def test_scikit_learns_checks_pass(estimator: Any, check: Any) -> None:
    check(estimator)


@pytest.mark.filterwarnings("ignore::spharm_rs.SpharmWarning", "ignore:X .* feature names:UserWarning")
@pytest.mark.parametrize("estimator", OF_NUMBERS)
def test_scikit_learns_checks_of_tables_pass(estimator: Any) -> None:
    pytest.importorskip("pandas")
    for check in (
        estimator_checks.check_set_output_transform,
        estimator_checks.check_set_output_transform_pandas,
        estimator_checks.check_global_output_transform_pandas,
    ):
        check(type(estimator).__name__, estimator)


#: Checks of conventions for which scikit-learn passes no data; with data it only tests estimators of numbers.
CONVENTIONS = [
    estimator_checks.check_estimator_cloneable,
    estimator_checks.check_estimator_tags_renamed,
    estimator_checks.check_valid_tag_types,
    estimator_checks.check_estimator_repr,
    estimator_checks.check_no_attributes_set_in_init,
    estimator_checks.check_do_not_raise_errors_in_init_or_set_params,
    estimator_checks.check_mixin_order,
    estimator_checks.check_parameters_default_constructible,
    estimator_checks.check_get_params_invariance,
    estimator_checks.check_set_params,
]


@pytest.mark.parametrize("estimator", [ShapeFeatures(), Descriptors(), SpharmTransformer()])
def test_conventions_hold(estimator: Any) -> None:
    for check in CONVENTIONS:
        check(type(estimator).__name__, estimator)
    tags = get_tags(estimator)
    assert not tags.input_tags.two_d_array and tags.input_tags.string and tags.requires_fit
    assert tags.input_tags.three_d_array == isinstance(estimator, SpharmTransformer)
