"""Tables of other orders and forms, and models over mirrored spheres."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import spharm_rs as sp

MODEL = sp.Model(np.random.default_rng(0).normal(size=(9, 3)))
ELLIPSOID = sp.Model(np.eye(4)[:, [3, 1, 2]] * [9.0, 6, 4])


def test_channels_of_tables_are_found_by_name() -> None:
    pytest.importorskip("pandas")
    pytest.importorskip("xarray")
    for order in ("zxy", "yxz"):
        assert sp.Model.from_("frame", MODEL.to_frame()[list(order)]) == MODEL
        assert sp.Model.from_("xarray", MODEL.to_xarray().sel(channel=list(order))) == MODEL
    signal = sp.Model.from_("frame", MODEL.to_frame().rename(columns={"z": "height"})[["height", "x", "y"]])
    assert not signal.is_surface and np.array_equal(signal.coefficients, MODEL.coefficients[:, [2, 0, 1]])


def test_degrees_and_orders_of_frames_may_be_columns() -> None:
    pytest.importorskip("pandas")
    frame = MODEL.to_frame().reset_index()
    for table in (frame, frame[["z", "order", "y", "x", "degree"]], frame.set_index(np.arange(9)[::-1])):
        assert sp.Model.from_("frame", table) == MODEL


def test_normals_and_curvatures_over_a_mirrored_sphere_come_with_a_warning() -> None:
    directions = sp.icosphere(1).vertices
    mirrored = sp.Model(ELLIPSOID.coefficients * [-1, 1, 1])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert ((ELLIPSOID.normals(directions) * ELLIPSOID.at(directions)).sum(axis=1) > 0).all()
        assert (ELLIPSOID.curvature(directions) > 0).all()
    with pytest.warns(sp.SpharmWarning, match="the parameterisation is mirrored, so that its normals point inwards"):
        normals = mirrored.normals(directions)
    with pytest.warns(sp.SpharmWarning, match="the parameterisation is mirrored"):
        curvature = mirrored.curvature(directions)
    assert ((normals * mirrored.at(directions)).sum(axis=1) < 0).all() and (curvature < 0).all()


def test_means_of_models_of_different_degrees_are_sums() -> None:
    models = [MODEL, MODEL.truncate(1)]
    mean = sum(models, 0 * MODEL) / len(models)
    assert np.allclose(mean.coefficients[:4], MODEL.coefficients[:4])
    assert np.allclose(mean.coefficients[4:], MODEL.coefficients[4:] / 2)
