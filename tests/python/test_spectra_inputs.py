"""Tests of masks, weights, angles and sizes of numbers that would silently give other results."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

import spharm_rs as sp
from spharm_rs import spectra

AT = sp.icosphere(3).vertices
SEEN = abs(AT[:, 2]) > 0.2
FIELD = np.where(SEEN, AT[:, 0] * AT[:, 1], 1e6)
#: The mask of which the elements outside are masked, whatever is below.
MASKED: Any = np.ma.array(np.ones(len(AT)), mask=~SEEN)
RNG = np.random.default_rng(3)


def test_masked_elements_of_a_mask_are_outside() -> None:
    pseudo = spectra.pseudo_spectrum(AT, FIELD, 4, mask=SEEN)
    assert np.array_equal(spectra.pseudo_spectrum(AT, FIELD, 4, mask=MASKED).power, pseudo.power)
    flags: Any = np.ma.array(np.ones(len(AT), bool), mask=~SEEN)
    assert np.array_equal(spectra.pseudo_spectrum(AT, FIELD, 4, mask=flags).power, pseudo.power)
    graded: Any = np.ma.array(np.full(len(AT), 0.5), mask=~SEEN)
    halved = spectra.pseudo_spectrum(AT, FIELD, 4, mask=graded)
    assert np.allclose(halved.power, pseudo.power / 4) and np.isclose(halved.f_sky, pseudo.f_sky)
    found, expected = (spectra.decoupled_spectrum(AT, FIELD, 4, mask=mask, bins=2) for mask in (MASKED, SEEN))
    assert np.array_equal(found.power, expected.power)
    fields = FIELD, AT[:, 0]
    found, expected = (spectra.decoupled_cross_spectrum(AT, *fields, 4, mask=mask, bins=2) for mask in (MASKED, SEEN))
    assert np.array_equal(found.power, expected.power)
    assert np.array_equal(sp.solve(AT, FIELD, 2, mask=MASKED)[0], sp.solve(AT, FIELD, 2, mask=SEEN)[0])


def test_values_of_a_grid_need_not_be_flattened() -> None:
    grid = spectra.grid(RNG.normal(size=81), kind="DH2")
    seen = abs(grid.latitude)[:, np.newaxis] > np.full(grid.values.shape, 20)
    flat: dict[str, Any] = {"mask": seen.ravel(), "weights": grid.weights}
    shaped: dict[str, Any] = {"mask": seen, "weights": np.reshape(grid.weights, grid.values.shape)}
    at, values = grid.directions, grid.values
    for function, settings in ((spectra.pseudo_spectrum, {"noise": 0.1}), (spectra.decoupled_spectrum, {"bins": 2})):
        expected = function(at, values.ravel(), 8, **flat, **settings)
        found = function(at, values, 8, **shaped, **settings)
        assert found.power.shape == expected.power.shape and np.array_equal(found.power, expected.power)
    cross = spectra.decoupled_cross_spectrum(at, values, values, 8, bins=2, **shaped)
    assert np.array_equal(cross.power, spectra.decoupled_cross_spectrum(at, values.ravel(), values.ravel(), 8, bins=2, **flat).power)
    # Masked rows in a list and xarray's grids are read; exchanged axes are refused.
    masked: Any = np.ma.array(np.where(seen, values, -9999.0), mask=~seen)
    expected = spectra.pseudo_spectrum(at, values, 8, **shaped)
    for rows in (masked, list(masked)):
        assert np.array_equal(spectra.pseudo_spectrum(at, rows, 8, **shaped).power, expected.power)
    rows = [np.ma.array(np.ones(len(row)), mask=~row) for row in seen]
    masks: dict[str, Any] = {"mask": rows, "weights": grid.weights}
    assert np.array_equal(spectra.pseudo_spectrum(at, grid.to_xarray(), 8, **masks).power, expected.power)
    for call in (spectra.pseudo_spectrum, sp.solve):
        with pytest.raises(ValueError, match=r"values: expected the shape of the directions' grid, \(\d+, \d+\), found .*exchange"):
            call(at, values.T, 8)
    pairs = spectra.pseudo_spectrum(at, np.stack([values, 2 * values], axis=2), 8, **shaped)
    assert pairs.power.shape == (9, 2)


def test_masked_elements_are_honoured_by_tests_and_qualities() -> None:
    values = RNG.normal(size=(6, len(AT)))
    names = ["a"] * 3 + ["b"] * 3
    found, expected = (sp.shape.group_test(values, names, permutations=0, mask=mask) for mask in (MASKED, SEEN))
    assert np.array_equal(found.statistic, expected.statistic, equal_nan=True)
    rows = [np.ma.array(row, mask=np.arange(len(AT)) == 7) for row in values]
    with pytest.raises(ValueError, match="subjects: found NaN in row 0, column 7"):
        sp.shape.group_test(rows, names, permutations=0)
    group = [sp.Model(np.eye(9)[:, [3, 1, 2]] * [9 + a, 5, 3]) for a in RNG.normal(size=5)]
    settings: dict[str, Any] = {"modes": 1, "bands": 0, "samples": 5, "surfaces": False, "sphere": 3}
    kept = [sp.shape.quality(group, mask=mask, **settings) for mask in (MASKED, SEEN)]
    assert kept[0].variance == kept[1].variance != sp.shape.quality(group, **settings).variance
    with pytest.raises(ValueError, match=r"mask: expected shape \(642,\), found \(641,\)"):
        sp.shape.quality(group, mask=SEEN[1:], **settings)


@pytest.mark.parametrize("number", [0.5, 2.0, -1.0])
def test_numbers_other_than_0_and_1_are_no_mask(number: float) -> None:
    graded = np.where(SEEN, 1.0, 0.0)
    graded[5] = number
    message = f"mask: expected true or false, or 1 or 0, .* found {number:g} at vertex 5 .*mask > 0.5, or .* weights="
    with pytest.raises(ValueError, match=message):
        sp.solve(AT, FIELD, 2, mask=graded)
    with pytest.raises(ValueError, match=message):
        sp.shape.group_test(RNG.normal(size=(6, len(AT))), ["a"] * 3 + ["b"] * 3, mask=graded.tolist())
    ball = sp.icosphere(1)
    with pytest.raises(ValueError, match="masked: expected true or false.*give a comparison such as masked > 0.5$"):
        sp.shape.register(ball, ball, masked=np.full(42, number))


def test_masked_voxels_and_triangles_are_refused() -> None:
    volume: Any = np.ma.array(np.ones((4, 4, 4), int), mask=np.arange(64).reshape(4, 4, 4) == 0)
    with pytest.raises(ValueError, match=r"volume: expected a value .* found masked voxels; volume.filled\(0\)"):
        sp.parametrize_volume(volume)
    faces: Any = np.ma.array([[0, 1, 2]], mask=[[False, False, True]])
    with pytest.raises(ValueError, match="faces: expected vertex numbers, found masked ones"):
        sp.Surface(np.eye(3), faces)


def test_weights_with_the_sum_1_are_doubted() -> None:
    count, cap = len(AT), AT[:, 2] > 0.7
    area = np.full(count, 4 * np.pi / count)
    for weights in (area / (4 * np.pi), 0.3 * area):
        with pytest.warns(sp.SpharmWarning, match="^the weights have a sum of .* powers can be much too small"):
            spectra.pseudo_spectrum(AT, FIELD, 3, weights=weights)
    with pytest.warns(sp.SpharmWarning, match="^the weights have a sum of 1,"):
        spectra.pseudo_spectrum(AT[cap], FIELD[cap], 3, weights=np.full(cap.sum(), 1 / cap.sum()))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        spectra.pseudo_spectrum(AT, FIELD, 3, weights=area, mask=cap)
        spectra.pseudo_spectrum(AT[cap], FIELD[cap], 3, weights=area[cap])
        # A factor of the weights cancels.
        spectra.decoupled_spectrum(AT, FIELD, 3, weights=area / (4 * np.pi))


def test_angles_that_look_like_radians_are_doubted() -> None:
    latitude, longitude = np.linspace(-80, 80, 12), np.linspace(0, 350, 12)
    north, east = np.radians(latitude), np.radians(longitude)
    text = "^latitude, longitude: latitudes up to 1.396 and longitudes up to 6.109 look like radians, .* expected; "
    with pytest.warns(sp.SpharmWarning, match=text + "give degrees=False for radians"):
        spectra.directions(north, east)
    with pytest.warns(sp.SpharmWarning, match="^colatitude, longitude: colatitudes up to 2.967 and .* radians"):
        spectra.directions(colatitude=north + np.pi / 2, longitude=east)
    with pytest.warns(sp.SpharmWarning, match=text + "convert radians with numpy.degrees"):
        spectra.Grid(north, east, np.zeros((12, 12)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        spectra.directions(latitude, longitude)
        spectra.directions(north, east, degrees=False)
        spectra.directions(north[:5], east[:5])
        spectra.directions(north, np.zeros(12))
        spectra.Grid(latitude, longitude, np.zeros((12, 12)))


@pytest.mark.parametrize("scale", [1e-310, 1e-200, 1e200])
def test_correlations_and_admittances_are_of_any_size(scale: float) -> None:
    a, b = RNG.normal(size=(36, 2)), RNG.normal(size=36)
    expected, found = spectra.correlation(a, b), spectra.correlation(scale * a, scale * b)
    assert np.allclose(found.correlation, expected.correlation, rtol=1e-9)
    assert np.allclose(found.confidence, expected.confidence, equal_nan=True)
    ratio, same = spectra.admittance(a, b), spectra.admittance(scale * a, scale * b)
    assert np.allclose(same.admittance, ratio.admittance, rtol=1e-9)
    assert np.allclose(same.error, ratio.error, rtol=1e-9, equal_nan=True)
    large = spectra.admittance(1e100 * a, 1e-100 * b)
    assert np.allclose(large.admittance, 1e200 * ratio.admittance)
    assert np.allclose(large.error[1:], 1e200 * ratio.error[1:])
