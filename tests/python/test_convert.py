"""Converts coefficients to other packages' conventions and back, and evaluates them by these packages' formulas."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import sph_harm_y

import spharm_rs as sp
from spharm_rs import convert

from .test_transform import DIRECTIONS, basis

BESIDE = Path(__file__).resolve().parents[3] / "shared" / "data"
SHARED = Path(os.environ.get("SPHARM_SHARED_DATA", BESIDE)) / "peers"


def coefficients(degree: int) -> np.ndarray:
    return np.random.default_rng(degree).normal(size=((degree + 1) ** 2, 3))


@pytest.mark.parametrize("degree", [0, 1, 20, 100])
@pytest.mark.parametrize("format", convert.FORMATS)
def test_there_and_back(format: str, degree: int) -> None:
    a = coefficients(degree)
    assert np.abs(convert.from_(format, convert.to(format, a)) - a).max() <= 1e-14 * np.abs(a).max()


# Degree, order, normalisation, and the function at colatitude theta and longitude phi of which pyshtools' coefficient is 1.
FUNCTIONS = [
    (1, 0, "4pi", lambda theta, phi: np.sqrt(3) * np.cos(theta)),
    (1, 1, "4pi", lambda theta, phi: np.sqrt(3) * np.sin(theta) * np.cos(phi)),
    (1, 0, "schmidt", lambda theta, phi: np.cos(theta)),
    (2, -1, "schmidt", lambda theta, phi: np.sqrt(3) * np.sin(theta) * np.cos(theta) * np.sin(phi)),
    (2, 1, "unnorm", lambda theta, phi: 3 * np.sin(theta) * np.cos(theta) * np.cos(phi)),
    (2, 2, "unnorm", lambda theta, phi: 3 * np.sin(theta) ** 2 * np.cos(2 * phi)),
    (1, 1, "ortho", lambda theta, phi: np.sqrt(3 / (4 * np.pi)) * np.sin(theta) * np.cos(phi)),
]


@pytest.mark.parametrize("degree, order, normalization, function", FUNCTIONS)
def test_normalisations_and_phases_of_pyshtools(degree: int, order: int, normalization: str, function: Any) -> None:
    unit = DIRECTIONS / np.linalg.norm(DIRECTIONS, axis=1)[:, np.newaxis]
    values = function(np.arccos(unit[:, 2]), np.arctan2(unit[:, 1], unit[:, 0]))
    for csphase, sign in [(1, 1.0), (-1, -1.0 if order % 2 else 1.0)]:
        given = np.zeros((2, 4, 4))
        given[int(order < 0), degree, abs(order)] = sign
        a = convert.from_pyshtools(given, normalization=normalization, csphase=csphase)
        assert np.allclose(sp.Model(a, surface=False).evaluate(unit)[:, 0], values, atol=1e-13)
        assert np.allclose(convert.to_pyshtools(a, normalization=normalization, csphase=csphase)[0], given, atol=1e-14)


@pytest.mark.parametrize("wrong", [{"normalization": "full"}, {"csphase": 0}])
def test_wrong_normalisations_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=f"^{next(iter(wrong))}: expected"):
        convert.to_pyshtools(coefficients(2), **wrong)


class Coefficients:
    """As pyshtools' ``SHCoeffs``, of the real or the complex kind."""

    def __init__(self, coeffs: np.ndarray, normalization: str, csphase: int, kind: str = "real") -> None:
        self.coeffs, self.normalization, self.csphase, self.kind = coeffs, normalization, csphase, kind


def of_a_complex_kind(a: np.ndarray) -> Coefficients:
    """Returns the orthonormal coefficients of complex harmonics with the Condon-Shortley phase, as SciPy's."""
    c, degree = convert.to_complex(a)[:, 0], round(len(a) ** 0.5) - 1
    degrees, orders = convert.degrees_and_orders(degree)
    array = np.zeros((2, degree + 1, degree + 1), complex)
    array[(orders < 0).astype(int), degrees, abs(orders)] = c
    return Coefficients(array, "ortho", -1, "complex")


@pytest.mark.parametrize("normalization", ["ortho", "4pi", "schmidt", "unnorm"])
@pytest.mark.parametrize("csphase", [1, -1])
def test_objects_of_pyshtools_have_their_own_normalisation(normalization: str, csphase: int) -> None:
    a = coefficients(6)
    given = convert.to_pyshtools(a, normalization=normalization, csphase=csphase)
    channels = [Coefficients(array, normalization, csphase) for array in given]
    assert np.allclose(convert.from_pyshtools(channels[0]), a[:, :1], rtol=1e-14)
    assert np.allclose(sp.Model.from_("pyshtools", channels).coefficients, a, rtol=1e-14)
    options: dict[str, Any] = {"normalization": normalization, "csphase": csphase}
    assert np.array_equal(convert.from_("pyshtools", given, **options), convert.from_pyshtools(channels))
    assert np.array_equal(convert.to("pyshtools", a, **options), given)


def test_complex_objects_of_pyshtools_are_those_of_real_functions() -> None:
    a = coefficients(6)[:, :1]
    given = of_a_complex_kind(a)
    assert np.allclose(convert.from_pyshtools(given), a, rtol=1e-13)
    # pyshtools 4.14.1: SHCoeffs.from_array(array).convert(kind="complex").coeffs[:, 1, 1] of C_11 = 1 and S_11 = 2.
    array = np.zeros((2, 2, 2), complex)
    array[:, 1, 1] = [0.7071067811865475 - 1.414213562373095j, -0.7071067811865475 - 1.414213562373095j]
    known = np.zeros((2, 2, 2))
    known[:, 1, 1] = 1, 2
    found = convert.from_pyshtools(Coefficients(array, "4pi", 1, "complex"))
    assert np.allclose(found, convert.from_pyshtools(known, normalization="4pi"), rtol=1e-14)
    given.coeffs[1, 3, 2] *= 1.01
    with pytest.raises(ValueError, match="pyshtools: expected complex coefficients of a real function"):
        convert.from_pyshtools(given)
    given.normalization = "unnorm"
    with pytest.raises(ValueError, match="normalization other than 'unnorm'"):
        convert.from_pyshtools(given)
    with pytest.raises(ValueError, match="pyshtools: expected real coefficients, found complex ones"):
        convert.from_pyshtools(given.coeffs)


@pytest.mark.parametrize(
    "call, text",
    [
        (lambda a: convert.to("pyshtools", a, norm="4pi"), "norm: expected the options normalization and csphase"),
        (lambda a: convert.to("ktch", a, csphase=1), "csphase: expected no options for the format 'ktch', found csphase=1"),
        (lambda a: convert.from_("ktch", a.T, csphase=1), "csphase: expected no options for the format 'ktch'"),
        (lambda a: convert.from_pyshtools(of_a_complex_kind(a), csphase=1), "csphase: expected none with an SHCoeffs"),
        (lambda a: convert.from_pyshtools([of_a_complex_kind(a), of_a_complex_kind(a[:4])]), "one degree, found degrees 2, 1"),
    ],
)
def test_options_that_a_format_does_not_have_are_refused(call: Any, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        call(coefficients(2))


def test_complex_coefficients_are_scipys() -> None:
    a, unit = coefficients(8), DIRECTIONS / np.linalg.norm(DIRECTIONS, axis=1)[:, np.newaxis]
    theta, phi = np.arccos(unit[:, 2]), np.arctan2(unit[:, 1], unit[:, 0])
    c = convert.to_complex(a)
    rows = [(degree, order) for degree in range(9) for order in range(-degree, degree + 1)]
    values = sum(sph_harm_y(*row, theta, phi)[:, np.newaxis] * c[i] for i, row in enumerate(rows))
    assert np.allclose(values, basis(DIRECTIONS, 8) @ a, atol=1e-12)


def packed(format: str, c: np.ndarray) -> np.ndarray:
    """Returns complex coefficients, (K, c), in the layout of a format."""
    degrees, orders = convert.degrees_and_orders(round(len(c) ** 0.5) - 1)
    if format == "healpy":
        return c[np.lexsort((degrees, orders))][np.sort(orders) >= 0].T
    if format == "s2fft":
        found = np.zeros((c.shape[1], degrees.max() + 1, 2 * degrees.max() + 1), complex)
        found[:, degrees, degrees.max() + orders] = c.T
        return found
    return c


@pytest.mark.parametrize("format", ["complex", "spharm_mat", "s2fft"])
def test_an_imaginary_part_is_dropped_with_a_warning(format: str) -> None:
    a, b = coefficients(8), coefficients(8)[::-1]
    array = packed(format, convert.to_complex(a) + 1j * convert.to_complex(b))
    share = 100 * (b**2).sum() / ((a**2).sum() + (b**2).sum())
    with pytest.warns(sp.SpharmWarning, match=f"imaginary part, which has {share:.3g} % of the power; for both parts"):
        assert np.allclose(convert.from_(format, array), a)
    with pytest.warns(sp.SpharmWarning, match="of the power"):
        assert np.allclose(sp.Model.from_(format, -1j * array).coefficients, b)


def test_rounding_errors_are_no_imaginary_part() -> None:
    a = coefficients(8)
    c = convert.to_complex(a)
    noise = np.random.default_rng(1).normal(size=c.shape)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for format in ("complex", "spharm_mat", "s2fft", "healpy"):
            for near in (c, c + 1e-9j * noise, c.astype(np.complex64), 0 * c):
                convert.from_(format, packed(format, near))
    with pytest.warns(sp.SpharmWarning, match="healpy: .* alm of order 0 must be real"):
        convert.from_healpy(packed("healpy", c + 0.1j * noise))


def test_pdm_files_go_there_and_back(tmp_path: Path) -> None:
    a = coefficients(20)
    convert.write_spharm_pdm(tmp_path / "x.coef", a)
    assert np.abs(convert.read_spharm_pdm(tmp_path / "x.coef") - a).max() < 1e-15 * 100
    with pytest.raises(FileExistsError):
        convert.write_spharm_pdm(tmp_path / "x.coef", a)
    (tmp_path / "bad.coef").write_text("{ 4,{1, 2, 3},\n{1, 2")
    with pytest.raises(ValueError, match="expected 4 rows"):
        convert.read_spharm_pdm(tmp_path / "bad.coef")


@pytest.mark.skipif("SPHARM_WITHOUT_SHARED_DATA" in os.environ, reason="SPHARM_WITHOUT_SHARED_DATA is set")
def test_a_genuine_pdm_file_is_read() -> None:
    files = sorted(SHARED.rglob("*.coef"))
    assert files, f"no .coef file in {SHARED}; SPHARM_SHARED_DATA names another folder"
    for file in files:
        model = sp.Model(convert.read_spharm_pdm(file))
        assert model.is_surface and np.isfinite(model.surface(2).vertices).all()


@pytest.mark.parametrize("format", convert.FORMATS)
@pytest.mark.parametrize("wrong", [None, "x", np.zeros(5), np.zeros((5, 3)), np.zeros((2, 3, 4, 5, 6)), []])
def test_wrong_arrays_are_refused(format: str, wrong: object) -> None:
    with pytest.raises(ValueError):
        convert.to(format, wrong)  # type: ignore[arg-type]
