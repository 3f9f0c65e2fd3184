"""Converts coefficients to other packages' conventions and back, and evaluates them by these packages' formulas."""

from __future__ import annotations

import os
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


def test_complex_coefficients_are_scipys() -> None:
    a, unit = coefficients(8), DIRECTIONS / np.linalg.norm(DIRECTIONS, axis=1)[:, np.newaxis]
    theta, phi = np.arccos(unit[:, 2]), np.arctan2(unit[:, 1], unit[:, 0])
    c = convert.to_complex(a)
    rows = [(degree, order) for degree in range(9) for order in range(-degree, degree + 1)]
    values = sum(sph_harm_y(*row, theta, phi)[:, np.newaxis] * c[i] for i, row in enumerate(rows))
    assert np.allclose(values, basis(DIRECTIONS, 8) @ a, atol=1e-12)
    # For a complex function, the coefficients are those of its real part.
    assert np.allclose(convert.from_complex(c + 1j * convert.to_complex(coefficients(8)[::-1])), a)


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
