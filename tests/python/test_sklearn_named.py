"""scikit-learn's transformers name surfaces in errors and warnings."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sklearn.pipeline import make_pipeline

import spharm_rs as sp
from spharm_rs.sklearn import Descriptors, ShapeFeatures

COARSE = sp.icosphere(2)
SMALL: dict[str, Any] = {"subdivisions": 2, "threads": 2}


def bars(count: int) -> list[sp.Surface]:
    """Returns bent bars in one pose."""
    x, y, z = COARSE.vertices.T
    bends = 1 + np.arange(count) / 2
    return [sp.Surface(np.stack([12 * x, 5 * y + bend * x**2, 3.5 * z + x * y], axis=1), COARSE.faces) for bend in bends]


@pytest.fixture(scope="module")
def rough() -> ShapeFeatures:
    return ShapeFeatures(3, **SMALL).fit(bars(4))


def test_errors_name_the_surface(rough: ShapeFeatures, tmp_path: Path) -> None:
    (good,) = bars(1)
    file = tmp_path / "bad.ply"
    file.write_text("no mesh")
    hole = sp.Surface(good.vertices, good.faces[1:])
    flat, holey = sp.Surface(0 * good.vertices, good.faces), np.where(np.arange(162) == 4, np.nan, 1)
    not_finite = sp.Surface(good.vertices * holey[:, np.newaxis], good.faces)
    unfitted = ShapeFeatures(3, **SMALL)
    descriptors = Descriptors(3).fit([good])
    for transform in (rough.transform, unfitted.fit, descriptors.transform):
        for item, kind, text in (
            (file, sp.MeshError, rf"^X\[2\]: {file}: damaged or not a PLY file"),
            (not_finite, sp.MeshError, r"^X\[2\]: .*NaN at vertex 4"),
            (flat, sp.MeshError, r"^X\[2\]: .*no area"),
            (None, ValueError, r"^X\[2\]: surface: expected .* found NoneType"),
            (sp.Model(np.ones((16, 1))), ValueError, r"^X\[2\]: expected a surface, found a Model"),
        ):
            with pytest.raises(kind, match=text):
                transform([good, good, item])
        with pytest.raises(FileNotFoundError, match=r"X\[2\]: .*none.ply"):
            transform([good, good, tmp_path / "none.ply"])
    with pytest.raises(sp.MeshError, match=r"^X\[1\]: .*holes"):
        descriptors.transform([good, hole])
    with pytest.raises(ValueError, match=r"^X\[0\]: expected a model of degree 3 or more, found degree 1"):
        descriptors.transform([sp.Model(np.ones((4, 3)))])


def test_warnings_name_the_surface_at_the_line_of_the_call(rough: ShapeFeatures) -> None:
    group = bars(4)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rough.transform(group)
    huge, inwards = sp.Surface(100 * COARSE.vertices, COARSE.faces), sp.Surface(group[1].vertices, group[1].faces[:, ::-1])
    for call, X, text in (
        (ShapeFeatures(3, **SMALL).fit, [*group, group[1]], r"^X\[4\]: the surface is identical to X\[1\]$"),
        (ShapeFeatures(3, **SMALL).fit_transform, [*group, group[1]], r"^X\[4\]: the surface is identical to X\[1\]$"),
        (rough.transform, [group[0], huge], r"^X\[1\]: .*the surface may be of another kind or in another unit"),
        (make_pipeline(Descriptors(2)).fit_transform, [group[0], inwards], r"^X\[1\]: .*inwards"),
    ):
        with pytest.warns(sp.SpharmWarning, match=text) as found:
            call(X)
        assert {one.filename for one in found} == {__file__}
