"""Spectra of a part of the sphere, compared with exact values and with means over random fields."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from numpy.polynomial.legendre import legval

import spharm_rs as sp
from spharm_rs import spectra

from .test_spectra import degrees, grid

# Squares of Wigner 3j symbols (l k j; 0 0 0), SymPy 1.14.0: wigner_3j(l, k, j, 0, 0, 0)**2.
SQUARES = {
    (0, 0, 0): 1.0,
    (1, 1, 0): 1 / 3,
    (1, 1, 2): 2 / 15,
    (2, 2, 2): 2 / 35,
    (2, 4, 6): 5 / 143,
    (3, 4, 5): 20 / 1001,
    (5, 5, 10): 756 / 46189,
    (7, 9, 12): 24024 / 5386025,
    (10, 10, 20): 59676188 / 9880607835,
    (200, 180, 150): 1.2193333201877058e-05,
    (2, 2, 3): 0.0,
    (2, 5, 8): 0.0,
}


@pytest.mark.parametrize("symbol", SQUARES, ids=str)
def test_the_coupling_matrix_has_squares_of_3j_symbols(symbol: tuple[int, int, int]) -> None:
    l, k, j = symbol  # noqa: E741
    window = np.zeros(j + 1)
    window[j] = 4 * np.pi / (2 * j + 1)
    found = spectra.coupling_matrix(window, max(l, k))
    assert np.isclose(found[l, k] / (2 * k + 1), SQUARES[symbol], rtol=1e-12, atol=0)
    assert np.isclose(found[k, l] / (2 * l + 1), SQUARES[symbol], rtol=1e-12, atol=0)


def test_the_coupling_matrix_of_the_whole_sphere_is_the_identity() -> None:
    assert np.allclose(spectra.coupling_matrix([4 * np.pi], 30), np.eye(31), atol=1e-14)
    # A window of independent points has a constant spectrum; the sum of (2 j + 1) (l k j; 0 0 0)**2 over j is 1.
    flat = spectra.coupling_matrix(np.full(61, 4 * np.pi), 30)
    assert np.allclose(flat, np.broadcast_to(2 * np.arange(31) + 1, (31, 31)), rtol=1e-13)
    at, weights = grid(24)
    whole = spectra.pseudo_spectrum(at, np.ones(len(at)), 12, weights=weights)
    assert np.allclose(spectra.coupling_matrix(whole.window, 12), np.eye(13), atol=1e-11) and np.isclose(whole.f_sky, 1)


def test_the_coupling_matrix_is_that_of_pyshtools() -> None:
    # pyshtools 4.14.1: SHMTCouplingMatrix(4, 0.5 ** arange(5)[:, None])[:5], for powers per degree, 4 pi-normalised.
    theirs = [
        [1.0, 0.1666666666666667, 0.05, 0.0178571428571429, 0.0069444444444444],
        [0.5000000000000001, 1.0999999999999999, 0.2321428571428572, 0.0761904761904762, 0.0238095238095238],
        [0.25, 0.3869047619047619, 1.0892857142857142, 0.2380952380952381, 0.0804473304473305],
        [0.125, 0.1777777777777777, 0.3333333333333334, 1.0780303030303031, 0.2449494949494949],
        [0.0625, 0.0714285714285714, 0.1448051948051948, 0.3149350649350648, 1.0750499500499502],
    ]
    counts = 2.0 * np.arange(5) + 1
    found = spectra.coupling_matrix(4 * np.pi * 0.5 ** np.arange(5) / counts, 4)
    assert np.allclose(found * counts[:, None] / counts, theirs, rtol=1e-13) and np.allclose(found.T, theirs, rtol=1e-13)


@pytest.mark.parametrize("self_pairs", [True, False])
def test_the_coupling_matrix_gives_the_expected_spectrum_of_scattered_samples(self_pairs: bool) -> None:
    rng = np.random.default_rng(7)
    at = rng.normal(size=(150, 3))
    at /= np.linalg.norm(at, axis=1, keepdims=True)
    weights = rng.uniform(-0.2, 1, 150)
    weights *= 4 * np.pi / weights.sum()
    spectrum, L = 1 / (1.0 + np.arange(9)) ** 2, 8
    # By the addition theorem, the expectation is the sum of w_i w_j C(u_i . u_j) P_l(u_i . u_j) / (4 pi) over pairs.
    cosines = np.clip(at @ at.T, -1, 1)
    pairs = np.outer(weights, weights) * legval(cosines, spectrum * (2 * np.arange(9) + 1) / (4 * np.pi))
    if not self_pairs:
        np.fill_diagonal(pairs, 0)
    expected = [(pairs * legval(cosines, np.eye(9)[l])).sum() / (4 * np.pi) for l in range(9)]  # noqa: E741
    pseudo = spectra.pseudo_spectrum(at, np.ones(150), L, weights=weights, noise=0.0 if self_pairs else "auto")
    assert np.allclose(spectra.coupling_matrix(pseudo.window, L) @ spectrum, expected, rtol=1e-9)


LEVEL, DEGREE, FIELDS = 4, 16, 100
CUT = np.sin(np.radians(20))


def sky(scattered: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Returns directions, a mask of latitudes above 20 degrees, a spectrum, and samples of fields that have it."""
    rng = np.random.default_rng(8)
    spectrum = 1 / (2.0 + np.arange(DEGREE + 1)) ** 2
    coefficients = rng.normal(size=((DEGREE + 1) ** 2, FIELDS)) * np.sqrt(spectrum[degrees((DEGREE + 1) ** 2)])[:, None]
    at = rng.normal(size=(2500, 3)) if scattered else sp.icosphere(LEVEL).vertices
    at = at / np.linalg.norm(at, axis=1, keepdims=True)
    return at, abs(at[:, 2]) > CUT, spectrum, sp.Transform(at, DEGREE).synthesis(coefficients)


@pytest.mark.parametrize("scattered", [False, True])
@pytest.mark.parametrize("noise", [0.0, 0.2, "auto"])
def test_the_mean_of_decoupled_spectra_is_the_spectrum(scattered: bool, noise: Any) -> None:
    at, mask, spectrum, values = sky(scattered)
    if noise != 0.0:
        values = values + 0.2 * np.random.default_rng(9).normal(size=values.shape)
    values = np.where(mask[:, None], values, np.nan)
    found = spectra.decoupled_spectrum(at, values, DEGREE, mask=mask, noise=noise, bins=4)
    assert found.first.tolist() == [0, 1, 5, 9, 13] and found.last.tolist() == [0, 4, 8, 12, 16]
    assert found.degree.tolist() == [0, 2.5, 6.5, 10.5, 14.5]
    scatter = found.power.std(axis=1, ddof=1)
    off = found.power.mean(axis=1) - found.windows @ spectrum
    assert (abs(off) < 3.5 * scatter / np.sqrt(FIELDS)).all()
    # Chi square of the five means, whose 99.9 % point is 20.5.
    inverse = np.linalg.inv(np.cov(found.power) / FIELDS)
    assert off @ inverse @ off < 25
    # Errors of single fields scatter with their powers; degree 0 has a single coefficient.
    ratio = np.sqrt((found.error**2).mean(axis=1)) / scatter
    assert (ratio[2:] > 0.8).all() and (ratio[2:] < 1.3).all() and ratio[1] < 1.6
    assert np.allclose(found.windows.sum(axis=1), 1, rtol=1e-9)
    assert found.covariance.shape == (5, 5, FIELDS) and np.allclose(found.covariance[2, 2] ** 0.5, found.error[2])


def test_the_pseudo_spectrum_leaks_and_its_bins_of_one_degree_do_not() -> None:
    at, mask, spectrum, values = sky(False)
    pseudo = spectra.pseudo_spectrum(at, values, DEGREE, mask=mask)
    assert np.isclose(pseudo.f_sky, 1 - CUT, atol=0.02) and not pseudo.noise.any()
    expected = spectra.coupling_matrix(pseudo.window, DEGREE) @ spectrum
    assert (abs(pseudo.power.mean(axis=1) - expected) < 4 * pseudo.power.std(axis=1, ddof=1) / np.sqrt(FIELDS)).all()
    assert abs(expected / (pseudo.f_sky * spectrum) - 1).max() > 0.1
    found = spectra.decoupled_spectrum(at, values, DEGREE, mask=mask)
    assert np.allclose(found.windows, np.eye(DEGREE + 1), atol=1e-9)
    off = abs(found.power.mean(axis=1) - spectrum) / found.power.std(axis=1, ddof=1) * np.sqrt(FIELDS)
    assert off.max() < 4
    one = spectra.decoupled_spectrum(at, values[:, 3], DEGREE, mask=mask.astype(float))
    assert np.allclose(one.power, found.power[:, 3]) and np.allclose(one.error, found.error[:, 3]) and one.covariance.ndim == 2
    assert np.array_equal(np.asarray(one), one.power) and np.array_equal(np.asarray(pseudo), pseudo.power)


def test_the_scale_of_weights_cancels_and_an_expected_shape_is_recovered() -> None:
    at, mask, spectrum, values = sky(False)
    first = spectra.decoupled_spectrum(at, values[:, :2], DEGREE, mask=mask, bins=[0, 1, 9, 17], noise=0.1)
    scaled = spectra.decoupled_spectrum(
        at[mask], values[mask, :2], DEGREE, weights=np.full(mask.sum(), 0.3), bins=[0, 1, 9, 17], noise=0.1
    )
    assert np.allclose(first.power, scaled.power, rtol=1e-9) and np.allclose(first.error, scaled.error, rtol=1e-9)
    shaped = spectra.decoupled_spectrum(at, values, DEGREE, mask=mask, bins=[0, 1, 9, 17], shape=5 * spectrum)
    means = [np.average(spectrum[f : l + 1], weights=2 * np.arange(f, l + 1) + 1) for f, l in zip(shaped.first, shaped.last)]
    assert np.allclose(shaped.windows @ spectrum, means, rtol=1e-9)
    assert not np.allclose(first.windows @ spectrum, means, rtol=0.02)


@pytest.mark.parametrize("kind", ["DH2", "DH", "GLQ"])
def test_the_weights_of_a_grid_give_the_spectrum_of_its_field(kind: str) -> None:
    coefficients = np.random.default_rng(13).normal(size=(DEGREE + 1) ** 2)
    found = spectra.grid(coefficients, kind=kind)
    exact = spectra.spectrum(coefficients, unit="per_lm", convention="energy").power
    samples = found.directions, found.values.ravel(), DEGREE
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        weighted = spectra.pseudo_spectrum(*samples, weights=found.weights)
    assert np.allclose(weighted.power, exact, rtol=1e-9) and np.isclose(weighted.f_sky, 1, rtol=1e-12)
    for estimate in (
        lambda: spectra.pseudo_spectrum(*samples),
        lambda: spectra.decoupled_spectrum(*samples, bins=4),
        lambda: spectra.decoupled_cross_spectrum(samples[0], samples[1], *samples[1:], bins=4),
    ):
        with pytest.warns(sp.SpharmWarning, match="^the directions aren't spread evenly.*weights=grid.weights"):
            estimate()


@pytest.mark.parametrize("count", [100, 300, 3000])
def test_even_and_scattered_directions_do_not_warn(count: int) -> None:
    rng = np.random.default_rng(count)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for _ in range(50):
            spectra.pseudo_spectrum(rng.normal(size=(count, 3)), np.ones(count), 1)
        for level in range(5):
            vertices = sp.icosphere(level).vertices
            spectra.pseudo_spectrum(vertices, np.ones(len(vertices)), 1)


def test_weights_above_the_area_of_the_sphere_are_refused() -> None:
    at = sp.icosphere(2).vertices
    with pytest.raises(ValueError, match="^weights: expected areas .* a sum of at most 4 pi = 12.57, found a sum of 162"):
        spectra.pseudo_spectrum(at, np.ones(len(at)), 3, weights=np.ones(len(at)))
    # Samples of a half of the sphere, whose areas add up to its area.
    half = at[:, 2] > 0
    areas = np.full(len(at), 4 * np.pi / len(at))
    found = spectra.pseudo_spectrum(at[half], np.ones(half.sum()), 3, weights=areas[half])
    masked = spectra.pseudo_spectrum(at, np.ones(len(at)), 3, mask=half)
    assert np.allclose(found.power, masked.power, rtol=1e-9) and np.isclose(found.f_sky, masked.f_sky) and found.f_sky < 0.51


def test_a_narrow_mask_gets_the_width_of_bins_that_it_determines() -> None:
    found = spectra.grid(np.random.default_rng(14).normal(size=(DEGREE + 1) ** 2))
    samples = found.directions, found.values.ravel(), DEGREE
    cap: dict[str, Any] = {"mask": found.directions[:, 2] > 0.9, "weights": found.weights}
    with pytest.raises(ValueError, match=r"narrowest width that suffices is bins=\d+. .*180 divided by") as error:
        spectra.decoupled_spectrum(*samples, **cap)
    width = int(str(error.value).split("bins=")[1].split(".")[0])
    assert width > 1 and len(spectra.decoupled_spectrum(*samples, **cap, bins=width).power) > 1
    with pytest.raises(ValueError, match=f"bins={width}"):
        spectra.decoupled_spectrum(*samples, **cap, bins=width - 1)
    with pytest.raises(ValueError, match="no width of bins suffices"):
        spectra.decoupled_spectrum(sp.icosphere(1).vertices, np.ones(42), 3, mask=np.arange(42) < 1)


def test_results_are_shown_in_a_line() -> None:
    at = sp.icosphere(2).vertices
    assert repr(spectra.pseudo_spectrum(at, np.ones(162), 5)) == "PseudoSpectrum(degrees 0 to 5, f_sky 1)"
    bands = spectra.decoupled_spectrum(at, np.ones((162, 2)), 5, bins=3)
    assert repr(bands) == "BandPowers(3 bins, degrees 0 to 5, 2 channels)"


def test_full_sky_errors_are_cosmic_variance() -> None:
    at, weights = grid(2 * DEGREE)
    coefficients = np.random.default_rng(10).normal(size=(DEGREE + 1) ** 2)
    values = sp.Transform(at, DEGREE).synthesis(coefficients)
    found = spectra.decoupled_spectrum(at, values, DEGREE, weights=weights)
    exact = spectra.spectrum(coefficients, unit="per_lm", convention="energy")
    assert np.allclose(found.power, exact.power, rtol=1e-9) and np.allclose(found.error, exact.sample_error, rtol=1e-8)


@pytest.mark.parametrize("noise", [0, "auto"])
def test_the_mean_of_decoupled_cross_spectra_is_the_cross_spectrum(noise: Any) -> None:
    at, mask, spectrum, values = sky(True)
    others = np.roll(values, 1, axis=1)
    first, second = values, 0.6 * values + 0.8 * others
    rng = np.random.default_rng(12)
    if noise == "auto":
        # Noise that both samples share, which the pairs of a sample with itself would add to every degree.
        shared = 0.2 * rng.normal(size=values.shape)
        first, second = first + shared, second + shared
    else:
        first, second = (field + 0.2 * rng.normal(size=values.shape) for field in (first, second))
    second = np.where(mask[:, None], second, np.nan)
    found = spectra.decoupled_cross_spectrum(at, first, second, DEGREE, mask=mask, noise=noise, bins=4)
    scatter = found.power.std(axis=1, ddof=1)
    off = found.power.mean(axis=1) - 0.6 * found.windows @ spectrum
    assert (abs(off) < 3.5 * scatter / np.sqrt(FIELDS)).all()
    ratio = np.sqrt((found.error**2).mean(axis=1)) / scatter
    assert (ratio[2:] > 0.8).all() and (ratio[2:] < 1.3).all() and ratio[1] < 1.6
    assert np.allclose(found.windows.sum(axis=1), 1, rtol=1e-9)


@pytest.mark.parametrize("noise", [0, "auto"])
def test_the_cross_spectrum_of_a_field_with_itself_is_its_spectrum(noise: Any) -> None:
    at, mask, _, values = sky(False)
    own = spectra.decoupled_spectrum(at, values[:, :2], DEGREE, mask=mask, noise=noise, bins=4)
    cross = spectra.decoupled_cross_spectrum(at, values[:, :2], values[:, :2], DEGREE, mask=mask, noise=noise, bins=4)
    assert np.allclose(cross.power, own.power, rtol=1e-12) and np.allclose(cross.covariance, own.covariance, rtol=1e-12)
    broadcast = spectra.decoupled_cross_spectrum(at, values[:, 0], values[:, :2], DEGREE, mask=mask, noise=noise, bins=4)
    assert np.allclose(broadcast.power[:, 0], own.power[:, 0], rtol=1e-12) and broadcast.error.shape == (5, 2)
    one = spectra.decoupled_cross_spectrum(at, values[:, 0], values[:, 1], DEGREE, mask=mask, noise=noise, bins=4)
    assert np.allclose(one.power, broadcast.power[:, 1], rtol=1e-9) and one.covariance.shape == (5, 5)


def test_full_sky_cross_spectra_are_those_of_the_coefficients() -> None:
    at, weights = grid(2 * DEGREE)
    coefficients = np.random.default_rng(11).normal(size=((DEGREE + 1) ** 2, 2))
    a, b = sp.Transform(at, DEGREE).synthesis(coefficients).T
    found = spectra.decoupled_cross_spectrum(at, a, b, DEGREE, weights=weights)
    exact = spectra.cross_spectrum(*coefficients.T, unit="per_lm", convention="energy")
    assert np.allclose(found.power, exact.power, rtol=1e-8) and np.allclose(found.error, exact.sample_error, rtol=1e-7)


@pytest.mark.parametrize(
    "given, text",
    [
        ({"b": np.ones(5)}, "b: expected a row for each of 42 directions"),
        ({"b": np.full(42, np.nan)}, "b: expected finite numbers"),
        ({"a": np.ones((42, 2)), "b": np.ones((42, 3))}, "b: expected 1 channel or 2, as in a; found 3"),
        ({"noise": 0.1}, "noise: expected 0 or 'auto', found 0.1"),
        ({"noise": "white"}, "noise: expected 0 or 'auto', found 'white'"),
    ],
)
def test_wrong_pairs_are_refused(given: dict[str, Any], text: str) -> None:
    samples = {"directions": sp.icosphere(1).vertices, "a": np.ones(42), "b": np.ones(42), "max_degree": 3}
    with pytest.raises(ValueError, match=text):
        spectra.decoupled_cross_spectrum(**{**samples, **given})


@pytest.mark.parametrize(
    "given, text",
    [
        ({"values": np.ones(5)}, "values: expected a row for each of 42 directions"),
        ({"values": np.full(42, np.nan)}, "values: expected finite numbers, .* in row 0"),
        ({"max_degree": -1}, "max_degree: expected at least 0"),
        ({"mask": np.zeros(42, bool)}, "mask: expected directions with a weight"),
        ({"mask": np.full(42, 1.5)}, "mask: expected true or false, or numbers from 0 to 1"),
        ({"mask": np.ones(5)}, r"mask: expected shape \(42,\), found \(5,\)"),
        ({"weights": np.ones(5)}, r"weights: expected shape \(42,\)"),
        ({"weights": np.full(42, np.inf)}, "weights: expected finite numbers"),
        ({"noise": "white"}, "noise: expected standard deviations or 'auto', found 'white'"),
        ({"noise": -1.0}, "noise: expected finite standard deviations of at least 0"),
        ({"noise": np.ones(5)}, r"noise: expected a number or shape \(42,\), found \(5,\)"),
        ({"bins": 0}, "bins: expected at least 1"),
        ({"bins": [0, 2, 9]}, "bins: expected increasing degrees from 0 to 4"),
        ({"bins": [0.0, 2.0]}, "bins: expected a width, or at least 2 degrees l as edges, found float64"),
        ({"shape": np.zeros(4)}, "shape: expected 4 numbers above 0"),
        ({"mask": np.arange(42) < 2}, "bins: expected bins wide enough for the mask"),
    ],
)
def test_wrong_samples_and_masks_are_refused(given: dict[str, Any], text: str) -> None:
    samples = {"directions": sp.icosphere(1).vertices, "values": np.ones(42), "max_degree": 3}
    with pytest.raises(ValueError, match=text):
        spectra.decoupled_spectrum(**{**samples, **given})


@pytest.mark.parametrize("window", [[], [[1.0]], [np.nan], ["a"]])
def test_wrong_windows_are_refused(window: Any) -> None:
    with pytest.raises(ValueError, match="window: expected"):
        spectra.coupling_matrix(window, 3)
