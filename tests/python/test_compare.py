"""Distances and poses of models whose surfaces were mapped separately."""

from __future__ import annotations

import re
import warnings
from typing import Any

import numpy as np
import pytest

import spharm_rs as sp

from .conftest import Study


def bump(level: int) -> sp.Surface:
    """Returns one smooth surface, without symmetry, with vertices of an icosphere."""
    ball = sp.icosphere(level)
    x, y, z = ball.vertices.T
    radii = 1 + 0.2 * np.sin(2 * x) * np.cos(3 * y) + 0.15 * z + 0.1 * x * y
    return sp.Surface(ball.vertices * radii[:, None] * [1.3, 1, 0.8], ball.faces)


@pytest.fixture(scope="module")
def pair() -> tuple[sp.Model, sp.Model]:
    """Returns models of one surface, from two meshes that were mapped separately."""
    return sp.fit(bump(3), max_degree=8), sp.fit(bump(2), max_degree=8)


def test_models_mapped_separately_are_compared_as_surfaces(pair: tuple[sp.Model, sp.Model]) -> None:
    found = sp.compare(*pair)
    assert not found.corresponding and np.isnan(found.msd) and np.isnan(found.xsd)
    assert found.surface is not None and found.rms == found.surface["rms"] and found.max == found.surface["hausdorff"]
    assert found.rms < 0.02 and len(found.per_vertex) == 163_842 and found.per_vertex.max() <= found.max
    assert sp.compare(*pair, surface_distance=True).surface == found.surface
    with pytest.warns(sp.SpharmWarning, match="mapped separately, so equal directions don't correspond; omit surface_distance"):
        at_directions = sp.compare(*pair, surface_distance=False)
    assert at_directions.corresponding and at_directions.rms > 10 * found.rms and at_directions.surface is None
    with pytest.raises(ValueError, match="mask: expected models whose directions correspond, found models .* mapped separately"):
        sp.compare(*pair, mask=np.ones(163_842, bool))


def test_models_over_one_map_or_given_spheres_are_compared_at_equal_directions(pair: tuple[sp.Model, sp.Model]) -> None:
    first = pair[0]
    surface, sphere = sp.example_surface(3)
    registered = sp.fit(surface, sphere, 6), sp.fit(sp.resample(surface, sphere, "icosphere:2"), max_degree=6)
    bare = sp.Model(first.coefficients), sp.Model(pair[1].coefficients)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for models in ((first, first.truncate(6)), (first, 2 * first), (first, bare[1]), bare, registered):
            for asked in (None, False):
                found = sp.compare(*models, surface_distance=asked)
                assert found.corresponding and found.surface is None and found.msd >= 0


def test_distances_have_their_figures_as_attributes(study: Study) -> None:
    surface = study[0]
    moved = sp.Surface(surface.vertices + [0.5, 0, 0], surface.faces)
    alone, both, apart = (
        sp.compare(surface, moved),
        sp.compare(surface, moved, surface_distance=True),
        sp.compare(surface, sp.icosphere(2)),
    )
    assert np.isnan([alone.mean, alone.percentile95, alone.hausdorff]).all() and alone.rms == pytest.approx(0.5)
    for found in (both, apart):
        figures = {name: getattr(found, name) for name in ("mean", "percentile95", "hausdorff")}
        assert found.surface is not None and figures == {name: found.surface[name] for name in figures}
    assert both.corresponding and both.rms == alone.rms and both.max == alone.max
    assert apart.surface is not None and (apart.rms, apart.max) == (apart.surface["rms"], apart.surface["hausdorff"])
    assert repr(alone) == f"Distances(corresponding vertices: rms {alone.rms:.4g}, max {alone.max:.4g})"
    assert repr(apart).startswith("Distances(between surfaces: mean ") and repr(apart).endswith(f"hausdorff {apart.max:.4g})")
    assert "corresponding vertices" in repr(both) and "between surfaces" in repr(both)


def test_a_pose_by_parameters_of_separate_maps_is_warned_of_once(pair: tuple[sp.Model, sp.Model]) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = sp.shape.align(pair[1], pair[0])
    texts = [str(one.message) for one in caught if "mapped separately" in str(one.message)]
    assert len(texts) == 1 and "pose='surfaces' finds the pose from the surfaces" in texts[0] and texts[0] in found.warnings
    with pytest.warns(sp.SpharmWarning, match="mapped separately, .* shape.correspond"):
        assert len(sp.shape.morph(pair[1], pair[0], 3).warnings) == 1
    # The pose by the surfaces themselves is exact.
    by_surfaces = sp.shape.align(pair[1], pair[0], pose="surfaces")
    assert not any("mapped separately" in text for text in by_surfaces.warnings)
    assert np.allclose(by_surfaces.transform.object, np.eye(3), atol=0.03)


def test_a_map_that_was_turned_is_still_the_same_map(pair: tuple[sp.Model, sp.Model]) -> None:
    first = pair[0]
    turned = first.rotate(parameters=[10, 20, 30], object=[40, 50, 60], translation=[1, 2, 3])
    mesh = bump(3)
    half_turn = sp.shape.SimilarityTransform(np.eye(3), False, np.diag([-1.0, -1, 1]), 1.0, np.ones(3))
    moved = sp.fit(half_turn.apply(mesh), max_degree=8)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for model in (turned, moved):
            assert sp.shape.align(model, first).rmsd_after < 1e-3
            assert sp.shape.morph(model, first, 3).warnings == ()


def test_a_mesh_in_place_of_a_model_is_named_by_its_type(pair: tuple[sp.Model, sp.Model]) -> None:
    model, mesh = pair[0], bump(2).to_trimesh()
    calls: list[tuple[str, Any]] = [
        ("model", lambda: sp.shape.align(mesh, model)),
        ("target", lambda: sp.shape.align(model, mesh)),
        ("start", lambda: sp.shape.morph(mesh, model)),
        ("end", lambda: sp.shape.morph(model, mesh)),
        ("query", lambda: sp.shape.nearest(mesh, [model])),
        ("among", lambda: sp.shape.nearest(model, [mesh])),
        ("model", lambda: sp.shape.measure(mesh)),
    ]
    for name, call in calls:
        with pytest.raises(ValueError, match=f"^{name}: expected a Model, found Trimesh; spharm_rs.fit makes a Model"):
            call()
    with pytest.raises(ValueError, match="shape.pose finds the pose of a mesh"):
        sp.shape.align(mesh, model)
    expected = "spharm_rs.Model(coefficients) makes a Model of coefficients, and spharm_rs.fit one of a surface"
    with pytest.raises(ValueError, match=f"^model: expected a Model, found ndarray; {re.escape(expected)}$"):
        sp.shape.rotate(np.ones((81, 3)))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="^models: expected a sequence of Model, found Model$"):
        sp.shape.procrustes(model)  # type: ignore[arg-type]


def test_the_model_of_a_coarse_mesh_is_smooth() -> None:
    mesh = sp.icosphere(2)
    ball = sp.fit(mesh, mesh, 1, objective="vertices")
    found = sp.compare(mesh, ball, surface_distance=True)
    assert found.corresponding and found.rms < 1e-9 and found.surface is not None
    # The mean depth of triangles below the ball is an eighth of their squared edges.
    a, b, c = mesh.vertices[mesh.faces.T]
    edges = np.mean([((x - y) ** 2).sum(axis=1).mean() for x, y in ((a, b), (b, c), (c, a))])
    assert found.surface["mean"] == pytest.approx(edges / 8, rel=0.2)
    turned = sp.compare(ball, mesh, surface_distance=True)
    assert turned.surface is not None and turned.surface["mean"] == pytest.approx(found.surface["mean"], rel=1e-6)
    for each in (found.per_vertex, turned.per_vertex):
        assert each.shape == (162,) and each.max() < 1e-3


def test_transforms_move_meshes_of_any_kind(pair: tuple[sp.Model, sp.Model]) -> None:
    mirror = sp.shape.SimilarityTransform(np.eye(3), False, np.diag([-1.0, 1, 1]), 2.0, np.array([1.0, 2, 3]))
    mesh = bump(2)
    expected = mirror.apply(mesh)
    assert expected.volume == pytest.approx(8 * mesh.volume)
    for given in (mesh.to_trimesh(), (mesh.vertices, mesh.faces), [mesh.vertices.tolist(), mesh.faces.tolist()]):
        found: Any = mirror.apply(given)
        assert isinstance(found, sp.Surface)
        assert np.array_equal(found.vertices, expected.vertices) and np.array_equal(found.faces, expected.faces)
    assert np.array_equal(mirror.apply(mesh.to_trimesh().vertices), expected.vertices)
    assert mirror.apply([[1, 2, 3], [4, 5, 6]]).tolist() == [[-1, 6, 9], [-7, 12, 15]]
    with pytest.raises(ValueError, match="expected a path"):
        mirror.apply(None)


def test_an_aligned_copy_of_a_model_still_corresponds() -> None:
    surface, _ = sp.example_surface(3)
    model = sp.fit(surface, max_degree=6)
    turned = model.rotate(parameters=[20, 30, 40])
    assert not sp.compare(turned, model).corresponding
    found = sp.compare(sp.shape.align(turned, model).model, model)
    assert found.corresponding and found.rms < 1e-9


def test_errors_name_the_argument(pair: tuple[sp.Model, sp.Model]) -> None:
    for given, name in (((pair[0], None), "other"), ((None, pair[0]), "surface"), ((bump(1), 3), "other")):
        with pytest.raises(ValueError, match=f"^{name}: expected a path"):
            sp.compare(*given)


def test_equal_triangles_whose_vertices_dont_correspond_are_warned_about() -> None:
    surface = sp.icosphere(4)
    turned = sp.Surface(surface.vertices @ [[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]], surface.faces)
    with pytest.warns(sp.SpharmWarning, match="the vertices don't correspond; measure the distance between the surfaces"):
        assert sp.compare(surface, turned).rms > 0.1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert sp.compare(surface, turned, surface_distance=True).surface is not None
        sp.compare(surface, sp.Surface(1.1 * surface.vertices, surface.faces))


def test_a_surface_whose_mirror_image_fits_better_is_warned_about() -> None:
    target, other = bump(4), bump(3)
    mirrored = sp.Surface(other.vertices * [-1, 1, 1], other.faces[:, ::-1])
    with pytest.warns(sp.SpharmWarning, match="the mirror image fits the other surface better"):
        assert len(sp.shape.pose(mirrored, target).warnings) == 1
    with pytest.warns(sp.SpharmWarning, match="the mirror image fits the other surface better"):
        assert len(sp.shape.register(target, mirrored).warnings) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert sp.shape.pose(mirrored, target, mirror=True).warnings == sp.shape.pose(other, target).warnings == ()
