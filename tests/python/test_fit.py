"""Fits: settings, signals, several surfaces at once, models and their files."""

from __future__ import annotations

import pickle
import warnings
from pathlib import Path
from typing import Any, Callable

import numpy as np
import pytest
from sklearn.decomposition import PCA
from sklearn.pipeline import make_pipeline

import spharm_rs as sp
from spharm_rs.sklearn import SpharmTransformer

from .conftest import Study


def test_the_least_squares_solution_is_numpys(study: Study) -> None:
    surface, sphere = study
    model = sp.fit(surface, sphere, 8, objective="vertices")
    basis = sp.Transform(sphere.vertices, 8).synthesis(np.eye(81))
    expected = np.linalg.lstsq(basis, surface.vertices, rcond=None)[0]
    assert np.allclose(model.coefficients, expected, atol=1e-8 * np.abs(expected).max())
    residual = surface.vertices - basis @ expected
    mean_square, scale = (residual**2).sum(1).mean(), model.report["scale"]
    assert scale is not None and model.report["msd"] == pytest.approx(mean_square / scale**2)
    assert model.rms == pytest.approx(np.sqrt(mean_square)) and sp.Model(model.coefficients).rms is None


def test_a_surface_is_fitted_between_its_vertices(study: Study) -> None:
    surface, sphere = study
    model = sp.fit(surface, sphere, 20)
    distance = model.report["surface_distance"]
    assert 0 < distance["rms"] < distance["percentile95"] < distance["hausdorff"]
    compared = sp.compare(surface, model.surface(6), surface_distance=True).surface
    assert compared is not None and compared["rms"] == pytest.approx(distance["rms_raw"], rel=0.1)
    vertices = sp.fit(surface, sphere, 20, objective="vertices")
    at_vertices = [found.report["msd"] or 0 for found in (vertices, model)]
    assert "surface_distance" not in vertices.report and 0 < at_vertices[0] < at_vertices[1]
    assert model.rms == distance["rms_raw"]
    assert "surface_distance" not in sp.fit(surface, sphere, 20, surface_distance=False).report
    assert model.provenance["objective"] == "surface"
    refused: list[dict[str, Any]] = [{"objective": "points"}, {"objective": "surface", "method": "lsq", "store": "store"}]
    for wrong in refused:
        with pytest.raises(ValueError, match="objective surface|surface or vertices"):
            sp.fit(surface, sphere, 8, **wrong)


def test_a_signal_of_three_channels_is_not_taken_for_a_surface_without_a_warning(study: Study) -> None:
    surface, sphere = study
    signal = sp.Transform(sphere.vertices, 10).synthesis(np.random.default_rng(0).normal(size=(121, 3)))
    with pytest.warns(sp.SpharmWarning, match='enclose hardly any volume; for a signal of three channels, give objective="vertices"'):
        sp.fit(signal, sphere, 10, surface_distance=False)
    one = signal[:, 0]
    for on_a_line in (np.c_[one, one, one], np.c_[one, 2 * one, -one], np.c_[one, np.ones_like(one), np.ones_like(one)]):
        with pytest.warns(sp.SpharmWarning, match="enclose hardly any volume"):
            sp.fit(on_a_line, sphere, 4, surface_distance=False)
    sheet = sphere.vertices * [1, 1, 0.02]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        sp.fit(signal, sphere, 10, objective="vertices")
        for positions in (surface.vertices, sheet, sheet * 1e120):
            sp.fit(positions, sphere, 4, surface_distance=False)
    assert not [one for one in caught if "volume" in str(one.message)]


def test_the_lowest_accurate_degree_is_chosen(study: Study) -> None:
    surface, sphere = study

    def error(degree: int, over: Any) -> float:
        return float(sp.fit(surface, over, degree).report["surface_distance"]["rms_raw"])

    for over in (None, sphere):
        wanted = error(9, over) * 1.001
        degree = sp.choose_degree(surface, over, accuracy=wanted)
        assert degree == 9 or (degree < 9 and error(degree, over) <= wanted)
    with pytest.warns(sp.errors.NotDetermined, match="no degree has an rms error"):
        assert sp.choose_degree(surface, accuracy="1e-7%") >= 1
    with pytest.raises(ValueError, match="percentage"):
        sp.choose_degree(surface, accuracy="a little")
    with pytest.raises(ValueError, match="found .auto.; choose_degree chooses one for a surface"):
        sp.fit(surface, over, "auto")  # type: ignore[arg-type]


def test_arrays_and_meshes_are_the_same_surface(study: Study) -> None:
    surface, sphere = study
    models = [
        sp.fit(surface, sphere, 8),
        sp.fit((surface.vertices, surface.faces), sphere.vertices, 8),
        sp.fit(np.asfortranarray(surface.vertices), sphere, 8),
        sp.fit(surface, 3 * sphere.vertices.astype(np.float64), 8),
    ]
    assert all(np.allclose(model.coefficients, models[0].coefficients, rtol=0, atol=1e-11) for model in models)
    assert all(model.is_surface for model in models)


def test_signals_are_fitted(study: Study) -> None:
    sphere = study[1]
    thickness = 2 + sphere.vertices[:, 2]
    model = sp.fit(thickness, sphere, 3)
    assert not model.is_surface and model.coefficients.shape == (16, 1)
    assert np.allclose(model.evaluate()[:, 0], thickness)
    with pytest.raises(ValueError, match="signal"):
        model.surface()
    with pytest.raises(ValueError, match="sphere"):
        sp.fit(thickness, max_degree=3)


def test_weights_smoothness_and_errors_are_given(study: Study) -> None:
    surface, sphere = study
    by_area = sp.fit(surface, sphere, 8, weights="area").coefficients
    assert np.array_equal(by_area, sp.fit(surface, sphere, 8, weights="area").coefficients)
    ones = sp.fit(surface, sphere, 8, weights=np.ones(len(surface.vertices), np.float32)).coefficients
    assert np.allclose(ones, sp.fit(surface, sphere, 8).coefficients, atol=1e-9)
    smooth = sp.fit(surface, sphere, 8, objective="vertices", smoothness=1.0, stderr=True, hold_out=0.1)
    assert smooth.report["smoothness"] == 1.0 and smooth.report["held_out"]["held_out"]["msd_raw"] > 0
    assert smooth.standard_errors is not None and smooth.standard_errors.shape == (81, 3)
    assert sp.fit(surface, sphere, 8, objective="vertices", smoothness="auto").report["smoothness"] > 0


def test_noise_is_removed(study: Study) -> None:
    surface, sphere = study
    clean = sp.fit(surface, sphere, 8, objective="vertices").evaluate()
    noisy = clean + np.random.default_rng(0).normal(0, 1.0, clean.shape)
    for objective in ("vertices", "surface"):
        models = [sp.fit(noisy, sphere, 14, objective=objective, denoise=denoise) for denoise in (False, True)]
        removed = models[1].report["denoise"][0]
        assert removed["sigma"] == pytest.approx(1.0, rel=0.1) and len(removed["gain"]) == 15
        errors = [((model.evaluate() - clean) ** 2).mean() for model in models]
        assert errors[1] < 0.8 * errors[0] and "denoise" not in models[0].report
    for wrong in ({"smoothness": "auto"}, {"smoothness": 1.0}, {"method": "quadrature"}):
        with pytest.raises(ValueError, match="denoise"):
            sp.fit(noisy, sphere, 14, denoise=True, **wrong)


def test_values_of_weight_zero_are_never_read(study: Study) -> None:
    surface, sphere = study[:2]
    weights = np.where(sphere.vertices[:, 2] > 0.9 * sphere.vertices.max(), 0.0, 1.0)
    assert 0 < (weights == 0).sum() < 600
    for objective in ("surface", "vertices"):
        right = sp.fit(surface, sphere, 8, objective=objective, weights=weights)
        for value in (1e3, np.nan, -np.inf):
            wild = np.where(weights[:, None] == 0, value, surface.vertices)
            found = sp.fit(wild, sphere, 8, objective=objective, weights=weights)
            assert np.array_equal(found.coefficients, right.coefficients) and found.report["msd"] == right.report["msd"]
    with pytest.raises(ValueError, match="NaN at vertex"):
        sp.fit(np.where(weights[:, None] == 0, np.nan, surface.vertices), sphere, 8)
    signal = np.where(weights == 0, np.nan, sphere.vertices[:, 0])
    assert np.isfinite(sp.fit(signal, sphere, 3, weights=weights).coefficients).all()


def test_a_mask_is_a_weight_of_zero(study: Study, tmp_path: Path) -> None:
    surface, sphere = study[:2]
    keep = sphere.vertices[:, 2] <= 0.9 * sphere.vertices.max()
    wild = np.where(keep[:, None], surface.vertices, np.nan)
    label = tmp_path / "lh.cortex.label"
    rows = "".join(f"{vertex} 0.0 0.0 0.0 0.0\n" for vertex in np.flatnonzero(keep))
    label.write_text(f"#!ascii label\n{keep.sum()}\n{rows}")
    for objective in ("surface", "vertices"):
        right = sp.fit(surface, sphere, 8, objective=objective, weights=keep.astype(float))
        for mask in (keep, keep.astype(np.int32).tolist(), label):
            found = sp.fit(wild, sphere, 8, objective=objective, mask=mask)
            assert np.array_equal(found.coefficients, right.coefficients)
    # Files whose values are missing there are read, too.
    mesh, values = tmp_path / "wild.obj", tmp_path / "wild.csv"
    corners = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in wild.tolist())
    mesh.write_text(corners + "".join(f"f {a} {b} {c}\n" for a, b, c in (surface.faces + 1).tolist()))
    values.write_text("x\n" + "".join(f"{x!r}\n" for x in wild[:, 0].tolist()))
    right = sp.fit(surface, sphere, 8, mask=keep)
    for settings in ({"mask": keep}, {"weights": keep.astype(float)}):
        assert np.array_equal(sp.fit(mesh, sphere, 8, **settings).coefficients, right.coefficients)
        assert np.isfinite(sp.fit(values, sphere, 8, **settings).coefficients).all()
    with pytest.raises(sp.errors.MeshError, match="wild.obj"):
        sp.fit(mesh, sphere, 8)
    # Weights given beside it count where the mask reads.
    weights = np.random.default_rng(0).random(len(keep)) + 0.5
    both = sp.fit(wild, sphere, 8, weights=weights, mask=keep).coefficients
    assert np.array_equal(both, sp.fit(wild, sphere, 8, weights=weights * keep).coefficients)
    area = sp.fit(wild, sphere, 8, weights="area", mask=keep)
    assert np.isfinite(area.coefficients).all() and not np.array_equal(area.coefficients, both)
    # Of many, and of a mesh that is mapped first: the map reads all of it, the fit doesn't.
    many = sp.fit_many([wild, wild], sphere, 8, mask=keep)
    assert all(np.array_equal(model.coefficients, many[0].coefficients) for model in many)
    bare, whole = sp.fit(surface, max_degree=8, mask=keep, weights="area"), sp.fit(surface, max_degree=8, weights="area")
    assert not np.array_equal(bare.coefficients, whole.coefficients)
    for wrong, message in (
        (keep[:-1], "shape"),
        (np.zeros(len(keep)), "not all zero"),
        (np.where(keep, np.nan, 1.0), "NaN at vertex"),
    ):
        with pytest.raises((ValueError, sp.errors.SpharmError), match=message):
            sp.fit(surface, sphere, 8, mask=wrong)


def test_a_setting_leaves_the_objective_as_it_is(study: Study) -> None:
    surface, sphere = study
    settings: list[dict[str, Any]] = [{"hold_out": 0.1}, {"stderr": True}, {"smoothness": "auto"}, {"preconditioner": "density"}]
    for setting in settings:
        assert sp.fit(surface, sphere, 6, **setting).provenance["objective"] == "surface"
        assert sp.fit(surface, sphere, 6, objective="vertices", **setting).provenance["objective"] == "vertices"


def test_many_are_fitted_as_each(study: Study) -> None:
    sphere = study[1]
    surfaces = [sp.example_surface(4, seed)[0] for seed in range(3)]
    models = sp.fit_many(surfaces, sphere, 8)
    stacked = sp.fit_many(np.stack([surface.vertices for surface in surfaces]), sphere, 8)
    for surface, model, other in zip(surfaces, models, stacked):
        alone = sp.fit(surface, sphere, 8)
        assert np.allclose(model.coefficients, alone.coefficients, rtol=0, atol=1e-10)
        assert np.array_equal(model.coefficients, other.coefficients)
    assert sp.fit_many([], sphere, 8) == []


def test_many_signals_are_read_from_files(study: Study, tmp_path: Path) -> None:
    surface, sphere = study
    values = [sphere.vertices[:, axis] ** 2 for axis in range(2)]
    keep = np.ones(len(sphere.vertices), bool)
    keep[5] = False
    values[1][5] = np.nan
    paths = [tmp_path / f"{at}.csv" for at in range(2)]
    for path, one in zip(paths, values):
        sp.write_signal(path, one)
    found = sp.fit_many(paths, sphere, 4, mask=keep)
    assert not found[0].is_surface
    for model, path in zip(found, paths):
        assert np.allclose(model.coefficients, sp.fit(path, sphere, 4, mask=keep).coefficients, rtol=0, atol=1e-10)
    with pytest.raises(ValueError, match="surfaces: expected surfaces or signals, found both"):
        sp.fit_many([surface, paths[0]], sphere, 4)
    with pytest.raises(sp.MeshError, match="1.csv: expected finite numbers, found NaN at vertex 5"):
        sp.fit_many(paths, sphere, 4)


def test_surfaces_without_a_common_sphere_are_fitted_one_by_one(tmp_path: Path) -> None:
    surfaces = [sp.example_surface(level, level)[0] for level in (3, 2, 3, 2)]
    alone = [sp.fit(surface, max_degree=5, threads=1, smoothness=1e-4) for surface in surfaces]
    read: list[int] = []

    def given() -> Any:
        for at, surface in enumerate(surfaces):
            read.append(at)
            surface.save(path := tmp_path / f"{at}.ply", double=True)
            yield path

    found = sp.fit_each(given(), 5, smoothness=1e-4, threads=1)
    assert not read
    assert np.array_equal(next(found).coefficients, alone[0].coefficients) and read == [0, 1]
    rest = list(found)
    assert all(np.array_equal(model.coefficients, one.coefficients) for model, one in zip(rest, alone[1:], strict=True))

    open_ = sp.Surface(surfaces[0].vertices, surfaces[0].faces[1:])
    done: list[int] = []
    many = sp.fit_many([surfaces[0], open_, surfaces[1]], max_degree=5, on_error="collect", progress=lambda _, n, of: done.append(n))
    assert [type(one) for one in many] == [sp.Model, sp.MeshError, sp.Model] and done == [1, 2, 3]
    with pytest.raises(sp.MeshError, match=str(many[1])[:20]):
        sp.fit_many([surfaces[0], open_], max_degree=5)
    with pytest.raises(ValueError, match="on_error: expected 'raise' or 'collect', found 'skip'"):
        sp.fit_each(surfaces, on_error="skip")  # type: ignore[call-overload]
    with pytest.raises(ValueError, match="on_error: expected 'raise', because all surfaces are fitted together"):
        sp.fit_many(surfaces, sp.icosphere(3), 5, on_error="collect")
    # The fits that are still running end with the iterator.
    stopped = sp.fit_each(iter(surfaces * 9), 5, threads=2)
    next(stopped)
    stopped.close()  # type: ignore[attr-defined]


def test_warnings_name_the_line_that_calls_the_package() -> None:
    ball = sp.fit(*sp.example_surface(3), 8)
    mirrored = sp.Model(ball.coefficients * [1, 1, -1])
    calls: list[Callable[[], Any]] = [
        lambda: mirrored.area,
        lambda: sp.shape.measure(mirrored),
        lambda: sp.solve(sp.icosphere(1).vertices, np.ones(42), 10),
        lambda: sp.fit(*sp.example_surface(1), 10, objective="vertices", smoothness=0),
    ]
    for call in calls:
        with pytest.warns(sp.SpharmWarning) as found:
            call()
        assert {one.filename for one in found} == {__file__}


def test_what_may_be_wrong_is_warned_of(study: Study) -> None:
    surface, sphere = study
    few = sp.example_surface(1)
    with pytest.warns(sp.Oscillation), pytest.warns(sp.NotDetermined):
        model = sp.fit(*few, 10, objective="vertices", smoothness=0)
    assert model.report["warnings"]
    with pytest.warns(sp.NotConverged):
        sp.fit(surface, sphere, 20, objective="vertices", max_iterations=1, preconditioner="none")
    with pytest.raises(sp.SpharmError, match="optimality"):
        sp.fit(surface, sphere, 20, objective="vertices", max_iterations=1, preconditioner="none", strict=True)


def test_samples_of_a_part_of_the_sphere_are_doubted_where_noise_decides() -> None:
    """Samples up to latitude 65 determine degree 30 with a condition number of 3e5, and the noise is multiplied by it."""
    rng = np.random.default_rng(3)
    at = rng.normal(size=(12_000, 3))
    at /= np.linalg.norm(at, axis=1, keepdims=True)
    truth = rng.normal(size=(31**2, 1)) / (1 + np.sqrt(np.arange(31**2)))[:, np.newaxis]
    clean = sp.Transform(at, 30).synthesis(truth)
    noisy = clean + rng.normal(0, 0.1, clean.shape)
    seen = abs(at[:, 2]) < np.sin(np.radians(65))
    with pytest.warns(sp.NotDetermined, match="degree 30 is poorly determined by this sampling") as warned:
        found, report = sp.solve(at, noisy, 30, mask=seen)
    assert len(warned) == 1 and np.abs(found - truth).max() > 10
    # Neither exact samples of the part, nor noisy ones of the whole sphere, nor a penalty give the warning.
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        exact, _ = sp.solve(at, clean, 30, mask=seen)
        whole, _ = sp.solve(at, noisy, 30)
        smooth, _ = sp.solve(at, noisy, 30, mask=seen, smoothness=1e-3)
    assert np.abs(exact - truth).max() < 1e-3 and np.abs(whole - truth).max() < 0.1 and np.abs(smooth).max() < 10


def test_a_mask_of_fewer_vertices_than_coefficients_gives_the_solution_of_minimum_norm(study: Study) -> None:
    surface, sphere = study
    at = sphere.vertices / np.linalg.norm(sphere.vertices, axis=1, keepdims=True)
    mask = np.zeros(len(at), bool)
    mask[np.random.default_rng(2).choice(len(at), 150, replace=False)] = True
    with pytest.warns(sp.SpharmWarning, match="150 vertices don't determine 441 coefficients"):
        best = sp.fit(surface.vertices[mask], at[mask], 20, objective="vertices", preconditioner="none")
    for preconditioner in ("auto", "factor"):
        settings: dict[str, Any] = {"mask": mask, "objective": "vertices", "preconditioner": preconditioner}
        with pytest.warns(sp.SpharmWarning) as warned:
            model = sp.fit(surface.vertices, at, 20, **settings)
        assert any("150 vertices don't determine 441 coefficients" in str(one.message) for one in warned)
        assert (preconditioner == "factor") == any("no Cholesky factor was" in str(one.message) for one in warned)
        assert np.abs(model.coefficients - best.coefficients).max() < 1e-5 * np.abs(best.coefficients).max()


def test_mirf_makes_several_passes(study: Study, tmp_path: Path) -> None:
    store = sp.Store(tmp_path / "store")
    store.build(study[1], 6)
    usual, four, one = (sp.fit(*study, 6, store=store, method="mirf", passes=passes) for passes in (None, 4, 1))
    assert np.array_equal(usual.coefficients, four.coefficients)
    assert not np.array_equal(usual.coefficients, one.coefficients)


def test_settings_that_the_method_does_not_have_are_refused(study: Study, tmp_path: Path) -> None:
    store = sp.Store(tmp_path / "store")
    store.build(study[1], 4)
    refused: list[tuple[dict[str, Any], str]] = [
        ({"method": "sirf", "passes": 3}, "passes needs the method irf or mirf, found sirf"),
        ({"method": "nlsf", "passes": 2}, "passes needs the method irf or mirf, found nlsf"),
        ({"method": "sirf", "granularity": 50}, "granularity needs the method irf, found sirf"),
        ({"method": "irf", "start_degree": 2}, "start_degree needs the method sirf or mirf, found irf"),
        ({"method": "lsq", "accelerate": True}, "accelerate needs the method irf or mirf, found lsq"),
        ({"method": "irf", "tolerance": 1e-6}, "tolerance needs the method lsq, found irf"),
        ({"method": "mirf", "max_iterations": 9}, "max_iterations needs the method lsq, found mirf"),
    ]
    for settings, message in refused:
        with pytest.raises(ValueError, match=message):
            sp.fit(*study, 4, store=store, **settings)


def test_a_model_goes_to_a_file_and_back(study: Study, tmp_path: Path) -> None:
    model = sp.fit(*study, 8)
    model.save(tmp_path / "m.spharm.npz")
    with pytest.raises(FileExistsError):
        model.save(tmp_path / "m.spharm.npz")
    for found in (sp.Model.load(tmp_path / "m.spharm.npz"), pickle.loads(pickle.dumps(model))):
        assert np.array_equal(found.coefficients, model.coefficients) and found.is_surface
        assert np.array_equal(found.surface().vertices, model.surface().vertices)
    assert sp.Model.load(tmp_path / "m.spharm.npz").provenance["method"] == "lsq"
    for name in ("mean.ply", "lh.STL", "mean.surf.gii.gz"):
        with pytest.raises(ValueError, match="path: expected a model's name"):
            model.save(tmp_path / name)
    np.savez(tmp_path / "mean.npz", coefficients=model.coefficients)
    assert np.array_equal(sp.Model.load(tmp_path / "mean.npz").coefficients, model.coefficients)


def test_models_are_evaluated_truncated_and_summed(study: Study) -> None:
    model = sp.fit(*study, 8)
    low = model.truncate(3)
    assert low.max_degree == 3 and np.array_equal(low.surface().vertices, model.surface(degree=3).vertices)
    assert model.spectrum().shape == (9,) and model.spectrum().sum() == pytest.approx((model.coefficients**2).sum())
    assert len(model.surface(2).vertices) == 162
    assert np.array_equal(model.evaluate(study[1].vertices), model.surface(study[1]).vertices)
    assert not model.coefficients.flags.writeable
    with pytest.raises(ValueError, match="highest degree of the model, 8"):
        model.surface(degree=9)
    with pytest.raises(ValueError, match="sphere"):
        sp.Model(model.coefficients).surface()


def test_stores_are_built_listed_and_verified(study: Study, tmp_path: Path) -> None:
    store = sp.Store(tmp_path / "store")
    assert store.build(study[1], 6)["degrees_built"] == 7
    assert store.build(study[1], 6)["degrees_present"] == 7
    assert store.factor(study[1], 6)["condition"] > 1 and store.factor(study[1], 6)["present"]
    (scheme,) = store.schemes()
    assert scheme["directions"] == 2562 and scheme["max_degree"] == 6 and scheme["factors"] == 1
    assert store.verify() == []
    with pytest.raises(sp.StoreError):
        sp.fit(*study, 7, store=store)
    damaged = next((tmp_path / "store").rglob("A_*"))
    data = bytearray(damaged.read_bytes())
    data[len(data) // 2] ^= 1
    damaged.write_bytes(data)
    assert len(store.verify()) == 1


def test_memory_is_kept_to(study: Study, tmp_path: Path) -> None:
    store = sp.Store(tmp_path / "store")
    store.build(study[1], 6)
    with pytest.raises(sp.MemoryBudgetError) as caught:
        sp.fit(*study, 6, store=store, memory="10KiB")
    assert caught.value.budget == 10 << 10 and caught.value.needed > caught.value.budget
    assert isinstance(caught.value, MemoryError) and isinstance(caught.value, sp.SpharmError)
    with pytest.raises(ValueError, match="512MiB"):
        sp.fit(*study, 6, memory="much")


def test_scikit_learn_takes_the_transformer(study: Study) -> None:
    X = np.stack([sp.example_surface(3, seed)[0].vertices for seed in range(8)])
    spharm = SpharmTransformer(6, sphere="icosphere:3")
    rows = spharm.fit_transform(X)
    assert rows.shape == (8, 147) == (8, len(spharm.get_feature_names_out()))
    again = spharm.transform(spharm.inverse_transform(rows))
    assert np.allclose(again, rows, atol=1e-8)
    pipeline = make_pipeline(SpharmTransformer(6, sphere="icosphere:3"), PCA(3)).fit(X)
    assert pipeline.inverse_transform(pipeline.transform(X)).shape == X.shape


def test_what_can_be_refused_is_refused_before_the_map(study: Study) -> None:
    surface, sphere = study
    stages: list[str] = []
    with pytest.raises(ValueError, match="degree 2001 is above 2000"):
        sp.fit(surface, max_degree=2001, progress=lambda stage, done, total: stages.append(stage))
    assert stages == []
    with pytest.raises(ValueError, match="max_degree=10"):
        sp.fit(surface, 10)
    with pytest.raises(sp.MeshError, match="2561 vertices, but the sphere has 2562"):
        sp.fit(surface.vertices[:-1], sphere, 10)


def test_a_sphere_that_may_be_none_is_warned_of(study: Study) -> None:
    surface = study[0]
    with pytest.warns(sp.SpharmWarning, match="check that this is a sphere centred at the origin"):
        sp.fit(surface, surface, 5)
    with pytest.raises(ValueError, match="check that this is a sphere"):
        sp.fit(surface, surface, 5, strict=True)


def test_the_sphere_of_the_other_hemisphere_is_doubted(study: Study, tmp_path: Path) -> None:
    surface, sphere = study
    surface.save(tmp_path / "lh.pial")
    sphere.save(tmp_path / "rh.sphere")
    sp.write_signal(tmp_path / "lh.thickness", surface.vertices[:, 2])
    read = sp.read_surface(tmp_path / "lh.pial")
    over = tmp_path / "rh.sphere"
    other = "lh.{}: this file belongs to the left hemisphere, but the sphere belongs to the right hemisphere"
    works: list[tuple[str, Callable[[], Any]]] = [
        ("pial", lambda: sp.fit(tmp_path / "lh.pial", over, 4)),
        ("pial", lambda: sp.fit(read, sp.read_surface(over), 4)),
        ("pial", lambda: sp.fit_many([surface, read], over, 4)[1]),
        ("thickness", lambda: sp.fit(tmp_path / "lh.thickness", over, 4)),
    ]
    for name, work in works:
        with pytest.warns(sp.SpharmWarning, match=other.format(name)):
            found = work()
        assert any("left hemisphere" in text for text in found.report["warnings"]), name
    with pytest.raises(ValueError, match=other.format("pial")):
        sp.fit(read, over, 4, strict=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sp.fit(surface, over, 4)


def test_a_mask_of_the_other_hemisphere_is_doubted(study: Study, tmp_path: Path) -> None:
    surface, sphere = study
    surface.save(tmp_path / "lh.pial")
    sp.write_signal(tmp_path / "lh.thickness", surface.vertices[:, 2])
    rows = "".join(f"{vertex} 0 0 0 0\n" for vertex in range(len(surface.vertices)))
    left, right = (tmp_path / f"{side}.cortex.label" for side in ("lh", "rh"))
    for path in (left, right):
        path.write_text(f"#!ascii label, from a test\n{len(surface.vertices)}\n{rows}")
    read = sp.read_surface(tmp_path / "lh.pial")
    other = "lh.{}: this file belongs to the left hemisphere, but the mask .*rh.cortex.label belongs to the right hemisphere"
    works: list[tuple[str, Callable[[], Any]]] = [
        ("pial", lambda: sp.fit(tmp_path / "lh.pial", sphere, 4, mask=right)),
        ("pial", lambda: sp.fit(read, max_degree=4, mask=str(right))),
        ("pial", lambda: sp.fit_many([surface, read], sphere, 4, mask=right)[1]),
        ("thickness", lambda: sp.fit(tmp_path / "lh.thickness", sphere, 4, mask=right)),
    ]
    for name, work in works:
        with pytest.warns(sp.SpharmWarning, match=other.format(name)):
            found = work()
        assert any("but the mask" in text for text in found.report["warnings"]), name
    for over in (sphere, None):
        with pytest.raises(ValueError, match=other.format("pial")):
            sp.fit(read, over, 4, mask=right, strict=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sp.fit(read, sphere, 4, mask=left)
        sp.fit(surface, sphere, 4, mask=right)


def test_a_sphere_that_turns_the_surface_inside_out_is_doubted(study: Study) -> None:
    surface, sphere = study
    mirrored = sp.Surface(sphere.vertices * [-1, 1, 1], sphere.faces)
    reverses = "the surface: the sphere reverses the orientation of the surface; is this the sphere of the other hemisphere"
    with pytest.warns(sp.SpharmWarning, match=reverses):
        sp.fit(surface, mirrored, 4)
    with pytest.warns(sp.SpharmWarning, match="the triangles wind inwards") as found:
        sp.fit(sp.Surface(surface.vertices * [-1, 1, 1], surface.faces), mirrored, 4)
    assert not any("reverses" in str(warning.message) for warning in found)


def test_a_file_of_values_is_a_signal_over_a_sphere(study: Study, tmp_path: Path) -> None:
    surface, sphere = study
    height = surface.vertices[:, 2]
    sp.write_signal(tmp_path / "height.csv", height)
    sp.write_signal(tmp_path / "height.shape.gii", height, double=True)
    for name in ("height.csv", "height.shape.gii"):
        model = sp.fit(tmp_path / name, sphere, 6)
        assert not model.is_surface and np.allclose(model.coefficients, sp.fit(height, sphere, 6).coefficients, atol=1e-9)
    with pytest.raises(sp.MeshError, match="height.csv: a signal needs a sphere; give the sphere as sphere="):
        sp.fit(tmp_path / "height.csv", max_degree=6)
    (tmp_path / "none.ply").write_text("ply\nnone\n")
    with pytest.raises(sp.MeshError, match="none.ply: .*PLY"):
        sp.fit(tmp_path / "none.ply", sphere, 6)
