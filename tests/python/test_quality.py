"""Quality of a group compared with NumPy; landmarks and their files."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import spharm_rs as sp


def group(count: int = 6) -> list[sp.Model]:
    rng = np.random.default_rng(3)
    base = np.zeros((16, 3))
    base[[3, 1, 2], [0, 1, 2]] = 9, 5, 3
    return [sp.Model(base + 0.3 * rng.normal(size=base.shape)) for _ in range(count)]


def areas(x: Any, faces: Any) -> Any:
    a = np.linalg.norm(np.cross(x[faces[:, 1]] - x[faces[:, 0]], x[faces[:, 2]] - x[faces[:, 0]]), axis=1)
    shares = np.bincount(faces.ravel(), np.repeat(a, 3), len(x))
    return shares / shares.sum()


def test_measures_agree_with_numpy() -> None:
    models, sphere = group(), sp.icosphere(3)
    directions = np.asarray(sphere.vertices)
    directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    x = np.array([model.evaluate(directions) for model in models])
    weights = np.mean([areas(member, np.asarray(sphere.faces)) for member in x], axis=0)
    x = x - np.einsum("v,nvc->nc", weights, x)[:, None]
    y = (x * np.sqrt(weights)[None, :, None]).reshape(len(x), -1)
    found = sp.shape.quality(models, bands=0, sphere=3, surfaces=False)
    values = np.linalg.svd(y - y.mean(0), compute_uv=False) ** 2 / (len(y) - 1)
    assert np.allclose(found.variances, values[:5]) and np.isclose(found.variance, values.sum())
    for k in (1, 2, 3):
        left = []
        for i in range(len(y)):
            others = np.delete(y, i, 0)
            rest = y[i] - others.mean(0)
            basis = np.linalg.svd(others - others.mean(0), full_matrices=False)[2][:k]
            left.append(np.linalg.norm(rest - basis.T @ (basis @ rest)))
        assert np.isclose(found.generalisation.values[k - 1], np.mean(left), rtol=1e-9)
    assert found.surface_generalisation is None and found.landmarks is None and found.specificity.low.shape == (0,)


def test_bands_surfaces_and_landmarks(tmp_path: Path) -> None:
    models = group()
    landmarks = [model.evaluate(np.eye(3)) for model in models]
    found = sp.shape.quality(models, modes=2, bands=20, samples=50, sphere=3, landmarks=landmarks)
    assert found.landmarks is not None and found.surface_generalisation is not None
    assert found.landmarks.mean < 1e-6 and found.landmarks.off_surface.shape == (6, 3) and found.landmarks.names is None
    for curve in (found.compactness, found.generalisation, found.specificity, found.surface_generalisation):
        assert (curve.low <= curve.values).all() and (curve.values <= curve.high).all() and curve.values.shape == (2,)
    assert (found.surface_generalisation.values <= found.generalisation.values).all()
    # Landmarks are matched by name: in another order, and with a name that other files lack.
    paths = []
    for index, points in enumerate(landmarks):
        names, order = ["x", "y", "z"], [[0, 1, 2], [2, 0, 1]][index % 2]
        marks = sp.Landmarks(tuple(names[k] for k in order), points[order])
        paths.append(tmp_path / f"{index}.csv")
        sp.write_landmarks(paths[-1], marks)
    again = sp.shape.quality(models, modes=2, bands=0, surfaces=False, sphere=3, landmarks=paths)
    assert again.landmarks is not None
    assert again.landmarks.names == ("x", "y", "z") and again.landmarks.mean < 1e-6
    moved = [landmarks[0][::-1], *landmarks[1:]]
    apart = sp.shape.quality(models, modes=1, bands=0, surfaces=False, sphere=3, landmarks=moved).landmarks
    assert apart is not None and apart.mean > 1


def test_landmarks_return_in_their_frame(tmp_path: Path) -> None:
    path = tmp_path / "a.mrk.json"
    point = {"label": "tip", "position": [1, 2, 3]}
    path.write_text(json.dumps({"markups": [{"coordinateSystem": "LPS", "controlPoints": [point]}]}))
    marks = sp.read_landmarks(path)
    assert marks.names == ("tip",) and marks.frame == "LPS" and marks.points.tolist() == [[1, 2, 3]]
    assert marks.in_frame("RAS").points.tolist() == [[-1, -2, 3]] and len(marks) == 1
    with pytest.raises(FileExistsError):
        sp.write_landmarks(path, marks)
    with pytest.raises(ValueError, match="different"):
        sp.Landmarks(("a", "a"), np.zeros((2, 3)))


def test_what_is_no_group_is_refused() -> None:
    models = group(3)
    wrong: list[tuple[dict[str, Any], str]] = [
        ({"modes": 0}, "modes"),
        ({"sphere": 9}, "sphere"),
        ({"landmarks": [np.zeros((1, 3))]}, "3 members"),
        ({"landmarks": [np.full((1, 3), np.nan)] * 3}, "landmarks"),
    ]
    for arguments, message in wrong:
        with pytest.raises(ValueError, match=message):
            sp.shape.quality(models, **arguments)
    with pytest.raises((ValueError, sp.SpharmError), match="at least 3"):
        sp.shape.quality(models[:2])
