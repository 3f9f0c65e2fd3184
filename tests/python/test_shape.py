"""Shape analysis: figures equal to the program's, and errors for bad models."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

import spharm_rs as sp

UNIT = (4 * np.pi / 3) ** 0.5


@pytest.fixture(scope="module")
def ellipsoid() -> sp.Model:
    coefficients = np.zeros((4, 3))
    coefficients[3, 0], coefficients[1, 1], coefficients[2, 2] = 3 * UNIT, 2 * UNIT, UNIT
    return sp.Model(coefficients)


def test_an_ellipsoid_has_its_measures_and_curvatures(ellipsoid: sp.Model) -> None:
    found = sp.shape.measure(ellipsoid)
    assert np.isclose(found.volume, 8 * np.pi, rtol=1e-12) and np.isclose(found.area, 48.88214630258206, rtol=1e-9)
    assert not found.inwards and np.allclose(found.centroid, 0, atol=1e-12)
    tips = sp.shape.geometry(ellipsoid, [[2, 0, 0], [0, 0, 1]])
    assert np.allclose(tips.gaussian_curvature, [9 / 4, 1 / 36], rtol=1e-12)
    assert np.allclose(tips.normals, [[1, 0, 0], [0, 0, 1]], atol=1e-12)
    assert np.allclose(tips.principal_curvatures.mean(axis=1), tips.mean_curvature, rtol=1e-12)


def test_smoothing_damps_each_degree(study: Any) -> None:
    model = sp.fit(study[0], study[1], 8)
    smooth = sp.shape.smooth(model, s=0.01)
    degree = np.repeat(np.arange(9), 2 * np.arange(9) + 1)
    assert np.allclose(smooth.coefficients, model.coefficients * np.exp(-degree * (degree + 1) * 0.01)[:, None], rtol=1e-14)
    assert smooth.provenance["transform"][0]["heat_kernel"]["s"] == 0.01
    by_width = sp.shape.smooth(model, fwhm=np.degrees(4 * np.sqrt(0.01 * np.log(2))))
    assert np.allclose(by_width.coefficients, smooth.coefficients, rtol=1e-12)
    for bad in ({}, {"fwhm": 1, "s": 1}, {"fwhm": -1}, {"fwhm": 181}, {"s": float("nan")}):
        with pytest.raises(ValueError):
            sp.shape.smooth(model, **bad)


def test_models_are_found_in_another_pose(study: Any) -> None:
    model = sp.fit(study[0], study[1], 8)
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    turned = sp.Model(model.coefficients @ turn)
    power, values = sp.shape.describe(model)
    assert power.shape == (8,) and values.shape == (8, 3)
    assert np.allclose(sp.shape.describe(turned)[1], values, atol=1e-12 * values.max())
    assert np.allclose(power, model.spectrum()[1:] / (4 * np.pi), rtol=1e-12)
    others = [sp.shape.smooth(model, s=s) for s in (0.01, 0.02)]
    first, second = sp.shape.nearest(turned, [*others, model], 2)
    assert (first.index, second.index) == (2, 0) and first.distance < 1e-12 * values.max() < second.distance
    with pytest.raises(ValueError, match="channels"):
        sp.shape.nearest(turned, [sp.Model(np.ones((4, 1)))])
    with pytest.raises(ValueError, match="expected a Model"):
        sp.shape.nearest(turned, [model.coefficients])  # type: ignore[list-item]


def test_models_of_several_degrees_are_compared_at_the_lowest_with_a_warning(study: Any) -> None:
    models = [sp.fit(study[0], study[1], degree, surface_distance=False) for degree in (8, 5)]
    for query, among in (models, models[::-1], (models[0], models)):
        with pytest.warns(sp.SpharmWarning, match="degrees from 5 to 8; they are compared up to degree 5"):
            sp.shape.nearest(query, among if isinstance(among, list) else [among])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert sp.shape.nearest(models[0], [models[0]])[0].distance == 0


def test_tails_are_parsevals_and_even_meshes_are_even(ellipsoid: sp.Model) -> None:
    found = sp.shape.truncation_error(ellipsoid)
    assert np.allclose(found, [np.sqrt(14 / 3), 0])
    sphere = sp.shape.even(ellipsoid, 4)

    def spread(surface: sp.Surface) -> float:
        a, b, c = (surface.vertices[surface.faces[:, k]] for k in range(3))
        areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        return float(areas.std() / areas.mean())

    assert spread(ellipsoid.surface(sphere)) < 0.5 * spread(ellipsoid.surface(4))


@pytest.mark.parametrize("coefficients", [np.ones((4, 2)), np.ones((1, 3)), np.ones((9, 3))])
def test_what_is_no_surface_is_refused(coefficients: Any) -> None:
    with pytest.raises(ValueError):
        sp.shape.measure(sp.Model(coefficients))
    with pytest.raises(ValueError):
        sp.shape.geometry(sp.Model(coefficients), [[0, 0, 1]])


def test_poses_by_surfaces_move_points_and_surfaces_with_the_model(study: Any) -> None:
    model = sp.fit(study[0], study[1], 8)
    moved = sp.shape.rotate(model, parameters=[10, 20, 30], object=[40, 50, 60], translation=[1, 2, 3])
    found = sp.shape.align(moved, model, pose="surfaces")
    size = np.ptp(model.evaluate(study[1].vertices), axis=0).max()
    assert found.surface_distance is not None and found.surface_distance < 0.01 * size
    points = moved.evaluate([[0, 0, 1], [1, 0, 0]])
    back = found.transform.apply(points)
    assert np.allclose(back, points @ found.transform.object.T + found.transform.translation, atol=1e-9 * size)
    surface = sp.Surface(moved.evaluate(study[1].vertices), study[1].faces)
    assert np.allclose(found.transform.apply(surface).vertices, found.transform.apply(surface.vertices))
    assert np.allclose(found.transform.apply(points[0]), back[0])
    with pytest.raises(ValueError, match="pose: expected joint or surfaces"):
        sp.shape.align(moved, model, pose="upright")
    with pytest.raises(ValueError, match="points: expected shape"):
        found.transform.apply([[1.0, 2.0]])
