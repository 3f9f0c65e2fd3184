"""Transforms and least squares by transforms, compared with SciPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.sparse.linalg import lsqr
from scipy.special import sph_harm_y

import spharm_rs as sp

DIRECTIONS = np.random.default_rng(0).normal(size=(500, 3))


def basis(directions: np.ndarray, degree: int) -> np.ndarray:
    """Returns canonical real harmonics, computed by SciPy."""
    theta = np.arctan2(np.hypot(directions[:, 0], directions[:, 1]), directions[:, 2])
    phi = np.arctan2(directions[:, 1], directions[:, 0])
    columns = []
    for n in range(degree + 1):
        for m in range(-n, n + 1):
            y = sph_harm_y(n, abs(m), theta, phi) * (-1) ** m * (np.sqrt(2) if m else 1)
            columns.append(y.imag if m < 0 else y.real)
    return np.stack(columns, axis=1)


def test_synthesis_adjoint_and_normal_are_those_of_the_basis() -> None:
    transform, matrix = sp.Transform(DIRECTIONS, 12), basis(DIRECTIONS, 12)
    rng = np.random.default_rng(1)
    x, r, w = rng.normal(size=(169, 2)), rng.normal(size=(500, 2)), rng.random(500)
    assert np.allclose(transform.synthesis(x), matrix @ x, atol=1e-11)
    assert np.allclose(transform.adjoint(r), matrix.T @ r, atol=1e-10)
    assert np.allclose(transform.normal(x, w), matrix.T @ (w[:, np.newaxis] * (matrix @ x)), atol=1e-9)
    assert np.array_equal(transform.synthesis(np.asfortranarray(x)), transform.synthesis(x))
    assert transform.synthesis(x[:, 0]).shape == (500,)


def test_complex_values_are_refused_with_advice() -> None:
    values = np.ones(500, complex)
    for call in (lambda: sp.solve(DIRECTIONS, values, 3), lambda: sp.Transform(DIRECTIONS, 3).adjoint(values)):
        with pytest.raises(ValueError, match="found complex128 of shape .*; pass the real and imaginary parts as two channels"):
            call()
    with pytest.raises(ValueError, match="; convert.from_complex converts coefficients of complex harmonics"):
        sp.Model(np.ones((9, 1), complex))


def test_scipy_takes_the_linear_operator() -> None:
    transform = sp.Transform(DIRECTIONS, 6)
    x = np.random.default_rng(2).normal(size=49)
    found = lsqr(transform.as_linear_operator(), transform.synthesis(x), atol=1e-14, btol=1e-14)[0]
    assert np.allclose(found, x, atol=1e-9)


def test_a_transform_keeps_the_moments_of_its_directions() -> None:
    rng = np.random.default_rng(4)
    transform, weights = sp.Transform(rng.normal(size=(5_000, 3)), 12), 1 + rng.random(5_000)
    values = rng.normal(size=5_000)

    def solved(**settings: Any) -> tuple[np.ndarray, bool]:
        found, report = sp.solve(transform, values, preconditioner="density", **settings)
        return found, "moments" in [step["name"] for step in report["solver"]["steps"]]

    (first, computed), (again, computed_again) = solved(), solved()
    assert computed and not computed_again and np.array_equal(first, again)
    (weighted, computed), (again, computed_again) = solved(weights=weights), solved(weights=weights)
    assert computed and not computed_again and np.array_equal(weighted, again) and not np.allclose(weighted, first)


def test_the_least_squares_of_a_masked_sky_is_numpys() -> None:
    kept = DIRECTIONS[DIRECTIONS[:, 2] > -0.5 * np.linalg.norm(DIRECTIONS, axis=1)]
    values = np.random.default_rng(3).normal(size=len(kept))
    found, report = sp.solve(sp.Transform(kept, 6), values)
    expected = np.linalg.lstsq(basis(kept, 6), values, rcond=None)[0]
    assert found.shape == (49,) and np.allclose(found, expected, atol=1e-8) and report["solver"]["optimality"] <= 1e-10
    with pytest.raises(ValueError, match="max_degree"):
        sp.solve(kept, values)


@pytest.mark.parametrize("wrong", [np.zeros((4, 2)), np.zeros((0, 3)), np.full((4, 3), np.nan), np.zeros((4, 3)), None])
def test_wrong_directions_are_refused(wrong: object) -> None:
    with pytest.raises(ValueError):
        sp.Transform(wrong, 3)  # type: ignore[arg-type]


def test_solves_with_a_transform_take_its_plan_or_make_their_own() -> None:
    rng = np.random.default_rng(3)
    directions = rng.normal(size=(3000, 3))
    truth = rng.normal(size=(169, 2))
    values = sp.Transform(directions, 12).synthesis(truth)
    transform = sp.Transform(directions, 12)
    for given in (transform, transform, sp.Transform(directions, 12, accuracy=1e-4), sp.Transform(directions, 5)):
        coefficients, report = sp.solve(given, values, 12)
        assert np.allclose(coefficients, truth, atol=1e-8) and report["solver"]["optimality"] < 1e-9
        assert report["scheme_key"] == sp.solve(directions, values, 12)[1]["scheme_key"]
    # Another right-hand side, other weights, a mask, and a smoothness, of the same plan.
    weights, keep = rng.random(3000) + 0.1, rng.random(3000) > 0.2
    wild = np.where(keep[:, None], values, np.nan)
    for settings in ({"weights": weights}, {"mask": keep}, {"weights": weights, "mask": keep, "smoothness": 1e-12}):
        coefficients, _ = sp.solve(transform, 2 * wild if "mask" in settings else 2 * values, **settings)
        assert np.allclose(coefficients, 2 * truth, atol=1e-7)
    with pytest.raises(sp.errors.MemoryBudgetError):
        sp.solve(transform, values, memory="1MiB")
    with pytest.raises(ValueError, match="3000 directions"):
        sp.solve(transform, values[:5])


def test_standard_errors_of_samples_are_those_of_a_fit() -> None:
    surface, sphere = sp.example_surface(4)
    height = surface.vertices[:, 2]
    _, report = sp.solve(sphere.vertices, height, 6, stderr=True)
    fitted = sp.fit(height, sphere.vertices, 6, stderr=True).standard_errors
    assert fitted is not None and np.array_equal(report["standard_errors"], fitted[:, 0])
    _, of_two = sp.solve(sp.Transform(sphere.vertices, 6), surface.vertices[:, :2], stderr=True)
    assert of_two["standard_errors"].shape == (49, 2)
    assert "standard_errors" not in sp.solve(sphere.vertices, height, 6)[1]
