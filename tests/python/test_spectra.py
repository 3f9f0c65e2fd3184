"""Directions and spectra by degree, compared with analytic values, pyshtools, and the scatter of random fields."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss
from numpy.typing import ArrayLike
from scipy.stats import t as student

import spharm_rs as sp
from spharm_rs import spectra

# Coefficients of which pyshtools computed the numbers below.
A = np.sin(1.0 + np.arange(25))
B = 0.5 * A + np.cos(3.0 * np.arange(25))


def grid(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns directions and weights that integrate products of two functions to a degree, exactly."""
    z, weights = leggauss(degree + 1)
    phi = 2 * np.pi * np.arange(2 * degree + 1) / (2 * degree + 1)
    across = np.sqrt(1 - z**2)[:, None]
    at = np.stack([across * np.cos(phi), across * np.sin(phi), np.broadcast_to(z[:, None], (len(z), len(phi)))], -1)
    return at.reshape(-1, 3), np.repeat(weights * 2 * np.pi / len(phi), len(phi))


def degrees(count: int) -> np.ndarray:
    return np.sqrt(np.arange(count)).astype(int)


class Column:
    """A column of a table, such as a pandas Series, which NumPy converts."""

    def __init__(self, values: ArrayLike) -> None:
        self.values = values

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.array(self.values, dtype=dtype)



def test_directions_of_latitudes_colatitudes_and_longitudes() -> None:
    r = np.sqrt(0.5)
    expected = [[0, 0, 1], [0, 0, -1], [1, 0, 0], [0, -1, 0], [-r, 0, r], [0.5, 0.5, -r]]
    latitude, longitude = [90, -90, 0, 0, 45, -45], [12, 0, 360, 270, -180, 45]
    found = spectra.directions(latitude, longitude)
    assert np.allclose(found, expected, atol=1e-15) and np.allclose(np.linalg.norm(found, axis=1), 1, atol=1e-15)
    assert np.allclose(spectra.directions(colatitude=90.0 - np.array(latitude), longitude=longitude), found, atol=1e-15)
    columns = Column(latitude), Column(longitude)
    assert np.array_equal(spectra.directions(*columns), found)
    radians = spectra.directions(np.radians(latitude), np.radians(longitude), degrees=False)
    assert np.allclose(radians, found, atol=1e-15)
    # Half of pi as float32 is above half of pi as float64.
    pole = spectra.directions(np.radians(np.array([90, -90], np.float32)), np.zeros(2), degrees=False)
    assert np.allclose(pole, [[0, 0, 1], [0, 0, -1]], atol=1e-15)


def test_directions_of_numbers_and_arrays_that_broadcast() -> None:
    assert np.array_equal(spectra.directions(48.1, 11.6), spectra.directions([48.1], [11.6]))
    latitude, longitude = np.array([80.0, 0.0, -35.0]), np.array([-20.0, 0.0])
    expected = spectra.directions(np.repeat(latitude, 2), np.tile(longitude, 3))
    assert np.array_equal(spectra.directions(*np.meshgrid(latitude, longitude, indexing="ij")), expected)
    assert np.array_equal(spectra.directions(latitude[:, None], longitude), expected)
    assert np.array_equal(spectra.directions(latitude, 20.0), spectra.directions(latitude, np.full(3, 20.0)))


def test_directions_of_columns_of_pandas() -> None:
    pandas = pytest.importorskip("pandas", reason="pandas isn't installed")
    table = pandas.DataFrame({"lat": [10.0, -20.0], "lon": [30, 40]})
    assert np.array_equal(spectra.directions(table["lat"], table.lon), spectra.directions([10.0, -20.0], [30, 40]))


@pytest.mark.parametrize("degrees", [True, False])
def test_latitudes_and_longitudes_of_directions(degrees: bool) -> None:
    rng = np.random.default_rng(0)
    half = 90 if degrees else np.pi / 2
    latitude, longitude = rng.uniform(-half, half, 50), rng.uniform(-2 * half, 2 * half, 50)
    at = spectra.directions(latitude, longitude, degrees=degrees) * rng.uniform(0.1, 9, (50, 1))
    found = spectra.latitude_longitude(at, degrees=degrees)
    assert np.allclose(found[0], latitude, rtol=1e-13) and np.allclose(found[1], longitude, rtol=1e-13)


@pytest.mark.parametrize(
    "given, text",
    [
        ({"latitude": [0.0, 91.0], "longitude": [0, 0]}, "latitude: expected degrees from -90 to 90, .* in row 1"),
        ({"latitude": [2.0], "longitude": [0], "degrees": False}, "latitude: expected radians from -1.571 to 1.571"),
        ({"colatitude": [-1.0], "longitude": [0]}, "colatitude: expected degrees from 0 to 180"),
        ({"latitude": [0.0], "longitude": [361.0]}, "longitude: expected degrees from -360 to 360"),
        ({"latitude": [0.0, np.nan], "longitude": [0, 0]}, "latitude: expected finite degrees, .* in row 1"),
        ({"latitude": [0.0], "longitude": [np.inf]}, "longitude: expected finite degrees"),
        ({"latitude": [0.0, 1.0], "longitude": [0.0] * 3}, r"longitude: expected shape \(2,\), as latitude has.*; found \(3,\)"),
        ({"latitude": [[0.0, 1.0]], "longitude": [0.0, np.nan]}, "longitude: expected finite degrees, .* in row 1"),
        ({"latitude": ["5N"], "longitude": [0.0]}, "latitude: expected real numbers"),
        ({"longitude": [0.0]}, "latitude, colatitude: expected one of them, found none"),
        ({"latitude": [0.0], "colatitude": [0.0], "longitude": [0.0]}, "found both"),
        ({"latitude": [0.0]}, "longitude: expected an array"),
    ],
)
def test_wrong_angles_are_refused(given: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        spectra.directions(**given)


@pytest.mark.parametrize("wrong, text", [(np.zeros((2, 3)), "zero vector in row 0"), (np.full((1, 3), np.nan), "row 0")])
def test_directions_without_a_latitude_are_refused(wrong: np.ndarray, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        spectra.latitude_longitude(wrong)



def test_powers_add_up_to_the_mean_square() -> None:
    coefficients = np.random.default_rng(1).normal(size=(144, 2))
    at, weights = grid(11)
    values = sp.Transform(at, 11).synthesis(coefficients)
    mean_square = weights @ values**2 / (4 * np.pi)
    found = spectra.spectrum(coefficients)
    assert found.power.shape == (12, 2) and np.array_equal(found.degree, np.arange(12))
    assert np.allclose(found.power.sum(axis=0), mean_square, rtol=1e-11)
    assert np.allclose(spectra.spectrum(coefficients, convention="energy").power.sum(axis=0), 4 * np.pi * mean_square)
    mean_product = weights @ (values[:, 0] * values[:, 1]) / (4 * np.pi)
    assert np.isclose(spectra.cross_spectrum(coefficients[:, 0], coefficients[:, 1]).power.sum(), mean_product, rtol=1e-10)
    model = sp.Model(coefficients)
    assert np.allclose(model.spectrum(), spectra.spectrum(model.coefficients, convention="energy").power.sum(axis=1))


def test_one_harmonic_has_the_power_of_its_degree() -> None:
    coefficients = np.zeros(36)
    coefficients[3 * 3 + 3 - 2] = -2.0
    found = spectra.spectrum(coefficients)
    assert np.allclose(found.power, [0, 0, 0, 4 / (4 * np.pi), 0, 0], rtol=1e-15)
    assert np.array_equal(np.asarray(found), found.power) and np.asarray(found, np.float32).dtype == np.float32
    assert (found.unit, found.convention, found.noise, found.noise_error) == ("per_l", "power", None, None)
    assert np.allclose(spectra.spectrum(coefficients, unit="per_lm").power[3], 1 / (7 * np.pi), rtol=1e-15)
    per_log = spectra.spectrum(coefficients, unit="per_dlogl", base=np.e)
    assert np.allclose(per_log.power[3], 3 / np.pi, rtol=1e-15)
    assert np.allclose(spectra.spectrum(coefficients, normalization="4pi").power[3], 4, rtol=1e-15)


def test_spectra_are_those_of_pyshtools() -> None:
    # pyshtools 4.14.1: spectralanalysis.spectrum(convert.to_pyshtools(A)[0], ..).
    powers = {
        "ortho": [0.056346692295107, 0.1129591612067314, 0.2051436839815962, 0.2584243171776886, 0.3658931017724266],
        "4pi": [0.7080734182735712, 1.4194866840109297, 2.5779115621077153, 3.24745574541754, 4.597948322109751],
        "schmidt": [0.7080734182735712, 0.4731622280036432, 0.5155823124215431, 0.4639222493453629, 0.5108831469010835],
        "unnorm": [0.70807341827357118, 0.47316222800364321, 3.3349737196553306, 32.792589456199224, 2512.9468636431034],
    }
    for normalization, expected in powers.items():
        for convention, factor in (("power", 1), ("energy", 4 * np.pi)):
            found = spectra.spectrum(A, normalization=normalization, convention=convention)
            assert np.allclose(found.power, factor * np.array(expected), rtol=1e-13)
        if normalization != "unnorm":
            found = spectra.spectrum(A, normalization=normalization, convention="l2norm")
            assert np.allclose(found.power, powers["4pi"], rtol=1e-13)
    assert np.array_equal(spectra.spectrum(A).power, spectra.spectrum(A, normalization="ortho").power)
    units = {
        "per_lm": [0.056346692295107, 0.0376530537355771, 0.0410287367963192, 0.0369177595968127, 0.0406547890858252],
        "per_dlogl": [0, 0.0782973241088622, 0.2843895323230477, 0.5373782605195316, 1.0144710875195624],
    }
    for unit, expected in units.items():
        assert np.allclose(spectra.spectrum(A, unit=unit, base=2).power, expected, rtol=1e-13)


class Coefficients:
    """As pyshtools' ``SHCoeffs``."""

    kind = "real"

    def __init__(self, coeffs: np.ndarray, normalization: str, csphase: int) -> None:
        self.coeffs, self.normalization, self.csphase = coeffs, normalization, csphase


def test_spectra_of_pyshtools_objects_are_those_of_their_coefficients() -> None:
    theirs = [
        Coefficients(sp.convert.to_pyshtools(a, normalization=norm, csphase=csphase)[0], norm, csphase)
        for a, norm, csphase in ((A, "4pi", -1), (B, "schmidt", 1))
    ]
    assert np.allclose(spectra.spectrum(theirs[0]).power, spectra.spectrum(A).power, rtol=1e-13)
    for compute in (spectra.cross_spectrum, spectra.admittance, spectra.correlation):
        assert np.allclose(compute(*theirs), compute(A, B), rtol=1e-12, equal_nan=True)
    with pytest.raises(ValueError, match="normalization: expected none with an SHCoeffs"):
        spectra.spectrum(theirs[0], normalization="4pi")
    with pytest.raises(ValueError, match="normalization: expected none with an SHCoeffs"):
        spectra.cross_spectrum(A, theirs[0], normalization="4pi")


def test_the_errors_of_a_model_are_the_default() -> None:
    at = sp.icosphere(3).vertices
    values = at[:, 2] ** 2 + 0.1 * np.random.default_rng(3).normal(size=len(at))
    model = sp.fit(values, at, 3, stderr=True)
    found, expected = spectra.spectrum(model), spectra.spectrum(model.coefficients, errors=model.standard_errors)
    assert found.noise_error is not None and expected.noise_error is not None and found.noise_error.shape == (4, 1)
    assert np.array_equal(found.noise_error, expected.noise_error) and np.array_equal(found.power, expected.power)
    assert spectra.spectrum(sp.fit(values, at, 3)).noise_error is None


def test_results_are_shown_in_a_line() -> None:
    assert repr(spectra.spectrum(A)) == "Spectrum(degrees 0 to 4, per_l, power)"
    pairs = np.stack([A, B], axis=1)
    assert repr(spectra.cross_spectrum(pairs, B, unit="per_lm")) == "Spectrum(degrees 0 to 4, 2 channels, per_lm, power)"
    assert repr(spectra.admittance(A, B)) == "Admittance(degrees 0 to 4)"
    assert repr(spectra.correlation(pairs[:, :1], B)) == "Correlation(degrees 0 to 4, 1 channel)"


def test_cross_spectra_admittance_and_correlation_are_those_of_pyshtools() -> None:
    # pyshtools 4.14.1: cross_spectrum(A, B, unit="per_lm", convention="energy"), SHAdmitCorr and SHConfidence.
    crosses = {
        "orthonormal": [1.1955076939446823, 0.2115302022019272, 0.1517526180167142, 0.2049366217295501, 0.2581190969331057],
        "unnorm": [15.023192754426754, 0.88605563899991735, 0.085349508376684383, 24.172087042676115, 3531.2982624654269],
    }
    for normalization, expected in crosses.items():
        cross = spectra.cross_spectrum(A, B, normalization=normalization, unit="per_lm", convention="energy")
        assert np.allclose(cross.power, expected, rtol=1e-12)
    admittance = spectra.admittance(A, B)
    ratio = [0.5922784285371022, 0.2106951882063402, 0.3271300788297345, 1.1426795589662486, 0.2754918171647469]
    error = [0.4620075546354632, 0.5011028772960088, 0.4620619354531845, 0.2422221150887741]
    assert np.allclose(admittance.admittance, ratio, rtol=1e-13)
    assert np.array_equal(np.asarray(admittance), admittance.admittance)
    assert np.allclose(admittance.error[1:], error, rtol=1e-12) and np.isnan(admittance.error[0])
    correlation = spectra.correlation(A, B)
    r = [1, 0.3069081822104851, 0.310298252827743, 0.7104760048520602, 0.3730814295280888]
    confidence = [0.3069081822104851, 0.4505088447192715, 0.9517390345597775, 0.7116930499938848]
    assert np.allclose(correlation.correlation, r, rtol=1e-13)
    assert np.array_equal(np.asarray(correlation), correlation.correlation)
    assert np.allclose(correlation.confidence[1:], confidence, rtol=1e-12) and np.isnan(correlation.confidence[0])


def test_confidence_is_the_distribution_of_student() -> None:
    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(2, 41**2, 3))
    found = spectra.correlation(a, b + 0.2 * a)
    freedom = 2.0 * np.arange(1, 41)[:, None]
    r = found.correlation[1:]
    statistic = abs(r) * np.sqrt(freedom / (1 - r**2))
    assert np.allclose(found.confidence[1:], 1 - 2 * student.sf(statistic, freedom), rtol=1e-11)


def test_fields_in_proportion_have_an_exact_admittance() -> None:
    rng = np.random.default_rng(3)
    b = rng.normal(size=(64, 2))
    z = np.linspace(-3, 2, 8)[degrees(64)]
    found = spectra.admittance(z[:, None] * b, b)
    assert np.allclose(found.admittance, np.linspace(-3, 2, 8)[:, None], rtol=1e-13) and (found.error[1:] < 1e-7).all()
    assert np.allclose(spectra.correlation(z[:, None] * b, b).correlation, np.sign(z)[np.arange(8) ** 2][:, None], rtol=1e-13)
    # One channel is paired with each of the other's, and the lower degree counts.
    assert spectra.cross_spectrum(b[:, 0], b[:16]).power.shape == (4, 2)
    assert np.allclose(spectra.cross_spectrum(b[:, 0], b[:16]).power[:, 0], spectra.spectrum(b[:16, 0]).power)
    empty = np.zeros(64)
    assert np.isnan(spectra.admittance(b, empty).admittance).all()
    assert np.isnan(spectra.correlation(empty, b).correlation).all()


def test_the_error_of_an_admittance_is_its_scatter() -> None:
    rng = np.random.default_rng(4)
    b = rng.normal(size=(49, 1))
    a = 0.7 * b + rng.normal(size=(49, 4000))
    found = spectra.admittance(a, b)
    # The variance is unbiased, and its relative scatter over 4,000 fields is sqrt(2 / 4000) = 0.022.
    assert np.allclose((found.error[1:] ** 2).mean(axis=1), found.admittance[1:].var(axis=1), rtol=0.09)
    assert np.allclose(found.admittance.mean(axis=1), 0.7, atol=4 * found.admittance.std(axis=1).max() / np.sqrt(4000))


def test_sample_errors_are_the_scatter_of_gaussian_fields() -> None:
    rng = np.random.default_rng(5)
    a = rng.normal(size=(64, 4000)) / (1 + degrees(64)[:, None])
    b = 0.6 * a + 0.5 * rng.normal(size=a.shape)
    power = spectra.spectrum(a, f_sky=0.5)
    assert np.allclose(power.sample_error, power.power * np.sqrt(4 / (2 * np.arange(8) + 1))[:, None], rtol=1e-14)
    counts, c_aa = 2 * np.arange(8) + 1, 1 / (1 + np.arange(8)) ** 2
    c_ab, c_bb = 0.6 * c_aa, 0.36 * c_aa + 0.25
    cross = spectra.cross_spectrum(a, b, unit="per_lm", convention="energy")
    assert np.allclose(cross.power.std(axis=1), np.sqrt((c_ab**2 + c_aa * c_bb) / counts), rtol=0.09)
    both = spectra.cross_spectrum(a, a, f_sky=0.5)
    assert np.allclose(both.power, power.power) and np.allclose(both.sample_error, power.sample_error)
    s_aa, s_bb = (spectra.spectrum(field, unit="per_lm", convention="energy").power for field in (a, b))
    assert np.allclose(cross.sample_error, np.sqrt((cross.power**2 + s_aa * s_bb) / counts[:, None]), rtol=1e-13)


@pytest.mark.parametrize("signal", [0.0, 0.3, 3.0])
def test_noise_errors_are_the_scatter_of_noisy_coefficients(signal: float) -> None:
    rng = np.random.default_rng(6)
    count = 4000
    a, b = signal * rng.normal(size=(2, 36, 1))
    s, t = np.broadcast_to(rng.uniform(0.2, 1, (2, 36, 1)), (2, 36, count))
    noisy = a + s * rng.normal(size=s.shape), b + t * rng.normal(size=t.shape)
    found = spectra.spectrum(noisy[0], errors=s, unit="per_dlogl")
    assert found.noise is not None and found.noise_error is not None
    true = spectra.spectrum(a[:, 0], unit="per_dlogl").power
    mean = (found.power - found.noise).mean(axis=1)
    scatter = found.power.std(axis=1)
    assert (abs(mean - true) <= 4 * scatter / np.sqrt(count)).all()
    # Where the power may be 0, the estimate of the variance is at least that of noise alone.
    ratio = np.sqrt((found.noise_error[1:] ** 2).mean(axis=1)) / scatter[1:]
    assert (ratio > 0.95).all() and (ratio < (1.05 if signal > 1 else 1.35)).all()
    cross = spectra.cross_spectrum(*noisy, errors=(s, t))
    assert cross.noise_error is not None and cross.noise is not None and not cross.noise.any()
    ratio = np.sqrt((cross.noise_error**2).mean(axis=1)) / cross.power.std(axis=1)
    assert (ratio > 0.95).all() and (ratio < (1.05 if signal > 1 else 1.5)).all()


@pytest.mark.parametrize(
    "given, text",
    [
        ({"coefficients": np.zeros(5)}, r"coefficients: expected \(L \+ 1\)\*\*2 rows, found 5"),
        ({"coefficients": np.full(4, np.nan)}, "coefficients: expected finite numbers, .* in row 0"),
        ({"normalization": "geodesy"}, "normalization: expected one of orthonormal, .*; found 'geodesy'"),
        ({"unit": "per_m"}, "unit: expected one of per_l, per_lm, per_dlogl"),
        ({"convention": "variance"}, "convention: expected one of power, energy, l2norm"),
        ({"convention": "l2norm", "normalization": "unnorm"}, "convention: expected power or energy"),
        ({"coefficients": np.zeros(152**2), "normalization": "unnorm"}, "expected degrees up to 150"),
        ({"base": 1.0}, "base: expected a number above 1"),
        ({"f_sky": 0.0}, "f_sky: expected a fraction"),
        ({"f_sky": 1.5}, "f_sky: expected a fraction"),
        ({"errors": np.zeros(9)}, r"errors: expected the coefficients' shape \(4,\), found \(9,\)"),
        ({"errors": -np.ones(4)}, "errors: expected standard errors of at least 0"),
        ({"errors": np.full(4, np.inf)}, "errors: expected finite numbers"),
    ],
)
def test_wrong_settings_of_spectra_are_refused(given: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        spectra.spectrum(**{"coefficients": np.ones(4), **given})


def test_wrong_pairs_are_refused() -> None:
    for compute in (spectra.cross_spectrum, spectra.admittance, spectra.correlation):
        with pytest.raises(ValueError, match="b: expected 1 channel or 2, as in a; found 3"):
            compute(np.ones((4, 2)), np.ones((4, 3)))
        with pytest.raises(ValueError, match="b: expected finite numbers"):
            compute(np.ones(4), np.full(4, np.nan))
    with pytest.raises(ValueError, match="errors: expected a pair, the errors of a and of b, found ndarray"):
        spectra.cross_spectrum(A, B, errors=np.ones(25))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"errors\[1\]: expected the coefficients' shape"):
        spectra.cross_spectrum(A, B, errors=(np.ones(25), np.ones(4)))


def test_grids_are_the_function_at_latitudes_and_longitudes() -> None:
    latitude, longitude = np.array([80.0, 0.0, -35.0]), np.array([-20.0, 0.0, 100.0, 359.0])
    found = spectra.grid(A, latitude, longitude)
    north, east = np.meshgrid(latitude, longitude, indexing="ij")
    at = spectra.directions(north.ravel(), east.ravel())
    assert found.values.shape == (3, 4)
    assert np.allclose(found.values.ravel(), sp.Model(A, surface=False).evaluate(at)[:, 0], atol=1e-13)
    assert np.array_equal(found.latitude, latitude) and np.array_equal(found.longitude, longitude)


def test_the_default_grid_is_pyshtools_and_determines_the_coefficients() -> None:
    found = spectra.grid(np.stack([A, B], axis=1))
    assert found.values.shape == (10, 20, 2)
    assert np.allclose(found.latitude, 90 - 18 * np.arange(10)) and np.allclose(found.longitude, 18 * np.arange(20))
    north, east = np.meshgrid(found.latitude, found.longitude, indexing="ij")
    at = spectra.directions(north.ravel(), east.ravel())
    again, _ = sp.solve(at, found.values.reshape(-1, 2), 4)
    assert np.allclose(again, np.stack([A, B], axis=1), atol=1e-8)
    named = spectra.grid(sp.Model(np.stack([A, B], axis=1))).to_xarray()
    assert named.dims == ("latitude", "longitude", "channel") and named.channel.values.tolist() == ["0", "1"]
    shape = spectra.grid(sp.Model(np.eye(4)[:, 1:])).to_xarray()
    assert np.allclose(shape.sel(channel="y"), shape[..., 1])
    assert float(named.sel(latitude=0, longitude=90)[0]) == pytest.approx(found.values[5, 5, 0])


@pytest.mark.parametrize(
    "wrong",
    [{"latitude": [91.0]}, {"longitude": [[1.0]]}, {"latitude": [np.nan]}, {"longitude": [361.0]}, {"longitude": []}],
)
def test_wrong_grids_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=f"^{next(iter(wrong))}: expected"):
        spectra.grid(A, **wrong)
    with pytest.raises(ValueError, match="^coefficients: expected finite numbers"):
        spectra.grid(np.array([np.nan]))
    with pytest.raises(ValueError, match="^kind: expected one of DH2, DH, GLQ; found 'HEALPix'"):
        spectra.grid(A, kind="HEALPix")


# The axes of pyshtools 4.14.1: expand(grid=kind, extend=extend) to degree 4, of which the latitudes of GLQ are rounded.
GRIDS = [
    ("DH2", np.arange(90, -90, -18), np.arange(0, 360, 18)),
    ("DH", np.arange(90, -90, -18), np.arange(0, 360, 36)),
    ("GLQ", np.array([64.98266022, 32.57949883, 0, -32.57949883, -64.98266022]), np.arange(0, 360, 40)),
]


@pytest.mark.parametrize("kind, latitude, longitude", GRIDS, ids=lambda value: value if isinstance(value, str) else "")
@pytest.mark.parametrize("extended", [False, True])
def test_grids_of_pyshtools_give_the_coefficients(
    kind: str, latitude: np.ndarray, longitude: np.ndarray, extended: bool
) -> None:
    found = spectra.grid(np.stack([A, B, A - B], axis=1), kind=kind)
    assert np.allclose(found.latitude, latitude, atol=1e-8) and np.allclose(found.longitude, longitude, atol=1e-12)
    if extended:
        # pyshtools repeats longitude 0 at 360, and adds the south pole to DH.
        latitude = found.latitude if kind == "GLQ" else np.append(latitude, -90)
        found = spectra.grid(np.stack([A, B, A - B], axis=1), latitude, np.append(longitude, 360))
    assert found.directions.shape == (found.values.size // 3, 3) and np.isclose(found.weights.sum(), 4 * np.pi, rtol=1e-14)
    model = found.expand()
    assert model.max_degree == 4 and not model.is_surface
    assert abs(model.coefficients - np.stack([A, B, A - B], axis=1)).max() < 1e-12
    assert np.allclose(found.expand(2).coefficients[:, 0], A[:9], atol=1e-12)
    # A grid from the south, and from the west of Greenwich.
    turned = spectra.Grid(found.latitude[::-1], found.longitude - 180, found.values[::-1, :, 0])
    assert np.allclose(turned.expand().spectrum(), (A**2) @ (degrees(25)[:, None] == np.arange(5)), rtol=1e-12)


def test_grids_are_made_of_arrays() -> None:
    latitude, longitude = [89.5 - i for i in range(180)], np.arange(0.5, 360)
    values = spectra.grid(A, latitude, longitude).values
    mine = spectra.Grid(latitude, longitude, values)
    assert mine.channel == [] and abs(mine.expand(4).coefficients[:, 0] - A).max() < 1e-12
    assert mine.expand().max_degree == 89
    # Away from the poles, where the quadrature's weights oscillate, they are areas.
    areas = np.cos(np.radians(latitude))[:, None] * np.radians(1) ** 2
    assert np.allclose(mine.weights.reshape(180, 360)[10:-10], areas[10:-10], rtol=1e-2)
    several = spectra.Grid(np.array([10.0, 0.0]), np.array([5.0]), np.ones((2, 1, 3)))
    assert several.channel == ["0", "1", "2"]
    surface = sp.Model(np.eye(4)[:, 1:])
    again = spectra.grid(surface, kind="GLQ").expand()
    assert again.is_surface and abs(again.coefficients - surface.coefficients).max() < 1e-12


def test_weights_of_other_grids_are_areas() -> None:
    # Uneven latitudes over the sphere, and even ones of a part of it.
    uneven = spectra.Grid(np.array([80.0, 50.0, 10.0, -60.0]), np.arange(0, 360, 10.0), np.zeros((4, 36)))
    edges = np.sin(np.radians([90, 65, 30, -25, -90]))
    assert np.allclose(uneven.weights.reshape(4, 36), (edges[:-1] - edges[1:])[:, None] * np.radians(10), rtol=1e-12)
    part = spectra.Grid(np.arange(10, 41, 2.0), np.arange(-20, 21, 4.0), np.zeros((16, 11)))
    area = (np.sin(np.radians(41)) - np.sin(np.radians(9))) * np.radians(44)
    assert np.isclose(part.weights.sum(), area, rtol=1e-12)
    for grid in (uneven, part):
        with pytest.raises(ValueError, match="^latitude, longitude: expected a grid with an exact quadrature.*spharm_rs.solve"):
            grid.expand()


def test_grids_that_do_not_determine_coefficients_are_refused() -> None:
    found = spectra.grid(A)
    with pytest.raises(ValueError, match="max_degree: expected at most 4, .* found 5. spharm_rs.solve"):
        found.expand(5)
    gaps = np.where(np.arange(20) == 7, np.nan, found.values)
    with pytest.raises(ValueError, match="values: expected finite numbers, .* in row 0, column 7.*mask="):
        spectra.Grid(found.latitude, found.longitude, gaps).expand()
    with pytest.raises(ValueError, match=r"values: expected a row for each of 10 latitudes and a column for each of 20"):
        spectra.Grid(found.latitude, found.longitude, found.values.T)
    with pytest.raises(ValueError, match="channel: expected 0 names"):
        spectra.Grid(found.latitude, found.longitude, found.values, ["height"])
    with pytest.raises(ValueError, match="latitude: expected degrees from -90 to 90"):
        spectra.Grid(found.latitude + 1, found.longitude, found.values)


def test_solve_reads_values_on_a_grid() -> None:
    found = spectra.grid(np.stack([A, B], axis=1))
    at, rows = found.directions, found.values.reshape(-1, 2)
    flat, _ = sp.solve(at, rows[:, 0], 4)
    assert flat.shape == (25,) and np.array_equal(sp.solve(at, found.values[..., 0], 4)[0], flat)
    assert np.array_equal(sp.solve(sp.Transform(at, 4), found.values)[0], sp.solve(sp.Transform(at, 4), rows)[0])
    seen = np.broadcast_to(found.latitude[:, None] < 60, (10, 20)).copy()
    part = np.where(seen, found.values[..., 0], np.nan)
    expected, _ = sp.solve(at, rows[:, 0], 2, mask=seen.ravel())
    assert np.array_equal(sp.solve(at, part, 2, mask=seen)[0], expected)
    assert np.array_equal(sp.solve(at, part, 2, weights=seen.astype(float))[0], expected)


def test_solve_names_the_row_of_a_missing_value() -> None:
    at = sp.icosphere(2).vertices
    values = np.where(np.arange(len(at)) == 5, np.nan, at[:, 2])
    with pytest.raises(ValueError, match="^values: expected finite numbers, found NaN in row 5 .*mask=.*drop these rows"):
        sp.solve(at, values, 3)
    with pytest.raises(ValueError, match="found NaN in row 5"):
        sp.solve(at, np.stack([at[:, 0], values], axis=1), 3, mask=np.arange(len(at)) > 2)
    assert np.isfinite(sp.solve(at, values, 3, mask=np.isfinite(values))[0]).all()


def test_equal_angles_of_a_grid_share_their_weight() -> None:
    latitude, longitude = [60, 0, 0, -60], [0, 0, 0, 120, 240]
    weights = sp.spectra.Grid(latitude, longitude, np.zeros((4, 5))).weights.reshape(4, 5)
    alone = sp.spectra.Grid([60, 0, -60], [0, 120, 240], np.zeros((3, 3))).weights.reshape(3, 3)
    assert np.isclose(weights.sum(), 4 * np.pi) and np.isclose(alone.sum(), 4 * np.pi)
    assert np.allclose(weights[1], weights[2]) and np.allclose(weights[:, 0], weights[:, 2])
    assert np.allclose(2 * weights[1, 3:], alone[1, 1:]) and np.allclose(3 * weights[0, 0], alone[0, 0])


def test_a_grid_keeps_a_copy_and_refuses_text_for_names() -> None:
    values = np.ones((2, 3))
    grid = sp.spectra.Grid([45, -45], [0, 120, 240], values)
    values[:] = 7
    assert (grid.values == 1).all()
    missing = np.ma.masked_greater(np.array([[1.0, 2, 3], [4, 5, 6]]), 5)
    assert np.isnan(sp.spectra.Grid([45, -45], [0, 120, 240], missing).values[1, 2])
    with pytest.raises(ValueError, match="channel: expected a list of names, found the text 'height'"):
        sp.spectra.Grid([45, -45], [0, 120, 240], np.ones((2, 3, 1)), channel="height")
    with pytest.raises(ValueError, match="values: expected a row for each of 2 latitudes"):
        sp.spectra.Grid([45, -45], [0, 120, 240], np.ones((2, 3, 0)))
