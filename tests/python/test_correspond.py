"""Groups made to correspond: known places, added members, names in errors, and one template registered to one
surface."""

from __future__ import annotations

import json
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import pytest

import spharm_rs as sp


def apart(a: sp.Surface, b: sp.Surface) -> float:
    """Returns the root mean square distance of two surfaces."""
    found = sp.compare(a, b, surface_distance=True, samples=2000).surface
    assert found is not None
    return float(found["rms"])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Returns a folder with five boxes with a growing bump, each with its own mesh and a random pose, and with
    landmarks of the same places."""
    made = tmp_path_factory.mktemp("group") / "bumps"
    command = ["generate", "--group", "growing-bump", "--members", "5", "--subdivisions", "4", "--output-dir", str(made)]
    subprocess.run([sys.executable, "-m", "spharm_rs", *command], check=True, stdout=subprocess.DEVNULL)
    return made


def paths(folder: Path) -> list[Path]:
    return sorted(folder.glob("s0?.ply"))


@pytest.fixture(scope="module")
def marks(folder: Path) -> list[sp.Landmarks]:
    return [sp.read_landmarks(path.with_suffix(".json")) for path in paths(folder)]


@pytest.fixture(scope="module")
def group(folder: Path, marks: list[sp.Landmarks]) -> sp.shape.Group:
    return sp.shape.correspond(paths(folder), 8, landmarks=marks, subdivisions=3)


def test_poses_near_the_given_ones_are_not_turned_over() -> None:
    """Ellipsoids with a little noise, all the right way round, look nearly the same after a half turn."""
    ball, rng = sp.icosphere(3), np.random.default_rng(4)
    surfaces = []
    for _ in range(6):
        centre = rng.normal(size=3)
        bump = 1 + 0.02 * np.cos(3 * ball.vertices @ (centre / np.linalg.norm(centre)))
        surfaces.append(sp.Surface(ball.vertices * [12, 8, 6] * bump[:, np.newaxis], ball.faces))
    group = sp.shape.correspond({f"body {k}": body for k, body in enumerate(surfaces)}, 6, subdivisions=3, pose="near")
    assert group.names == ("body 0", "body 1", "body 2", "body 3", "body 4", "body 5")
    turns = [np.array(transform.matrix)[:3, :3] for transform in group.transforms]
    cosines = [(np.trace(turn @ turns[0].T) - 1) / 2 for turn in turns]
    assert min(cosines) > np.cos(np.radians(15))
    assert not any("doubtful" in warning for warning in group.warnings)
    with pytest.raises(ValueError, match="pose: expected one of any, near, given; found 'own'"):
        sp.shape.correspond(surfaces, 6, pose="own")  # type: ignore[arg-type]


def lumps(sizes: list[float]) -> list[sp.Surface]:
    """Returns bodies of one shape without symmetry, of the given sizes."""
    ball = sp.icosphere(3)
    unit = np.asarray(ball.vertices)
    bumps = [height * np.exp(8 * (unit @ place - 1)) for height, place in ((0.4, [0.6, 0.8, 0]), (0.3, [0, -0.6, 0.8]))]
    body = unit * [20, 14, 11] * (1 + np.sum(bumps, axis=0))[:, np.newaxis]
    return [sp.Surface(size * body, ball.faces) for size in sizes]


def test_given_poses_are_kept() -> None:
    """Two bodies lie apart from the others. They stay where they are, and so do new members."""
    bodies = lumps([1, 1, 1.05, 0.95])
    shifts = np.array([[0, 0, 0], [3, 0, 0], [0, -2, 1], [0, 0, 0]])
    bodies = [sp.Surface(np.asarray(body.vertices) + shift, body.faces) for body, shift in zip(bodies, shifts)]
    group = sp.shape.correspond(bodies[:3], 6, subdivisions=3, pose="given")
    member = group.add(bodies[3])
    members = [*zip(group.transforms, group.models), (member.transform, member.model)]
    for (transform, model), body in zip(members, bodies):
        assert np.array_equal(transform.matrix, np.eye(4))
        found = sp.compare(body, model.surface(4), surface_distance=True, samples=2000).surface
        assert found is not None and found["rms"] < 0.3
    mean = np.mean([model.coefficients[0] for model in group.models], axis=0)
    assert np.allclose(group.mean.coefficients[0], mean)
    with pytest.raises(ValueError, match="settings without scaling or mirror images"):
        sp.shape.correspond(bodies, 6, pose="given", scale=True)


def test_smaller_bodies_are_not_turned() -> None:
    """Bodies of one shape correspond at equal vertices, whatever their sizes and poses."""
    bodies = lumps([1, 1.02, 0.98, 1.01, 0.8, 0.6])
    turns = [np.linalg.qr(np.random.default_rng(k).normal(size=(3, 3)))[0] for k in range(6)]
    turns = [turn * np.linalg.det(turn) for turn in turns]
    bodies = [sp.Surface(np.asarray(body.vertices) @ turn.T, body.faces) for body, turn in zip(bodies, turns)]
    group = sp.shape.correspond(bodies[:5], 8, subdivisions=3)
    member = group.add(bodies[5])
    assert member.transform.scale == 1.0 and all(transform.scale == 1.0 for transform in group.transforms)
    transforms, models = [*group.transforms, member.transform], [*group.models, member.model]
    matrices = [np.array(transform.matrix)[:3, :3] @ turn for transform, turn in zip(transforms, turns)]
    cosines = [(np.trace(matrix @ matrices[0].T) - 1) / 2 for matrix in matrices]
    assert min(cosines) > np.cos(np.radians(0.5))
    found = sp.shape.procrustes(models, method="fixed", scale=True)
    assert found.report["spread_after"] < 0.02
    # The models are at the bodies' own sizes.
    for model, body in zip(models, bodies):
        assert model.volume == pytest.approx(body.volume, rel=0.02)


def test_places_are_carried_to_where_truth_says(group: sp.shape.Group, marks: list[sp.Landmarks]) -> None:
    assert group.names == ("s01", "s02", "s03", "s04", "s05") and len(group) == 5
    errors = []
    for source, own in zip(group.names, marks):
        for target, other in zip(group.names, marks):
            carried = group.carry(own, source, target)
            assert carried.names == own.names
            errors.append(np.linalg.norm(carried.points - other.points, axis=1).mean())
    # The boxes are 30 mm long; a triangle between the 642 directions is some 2 mm wide.
    assert max(errors) < 0.6 and np.mean(errors) < 0.3
    points = group.carry(marks[0].points, 0, 0)
    assert np.linalg.norm(points - marks[0].points, axis=1).max() < 0.5
    found = group.carried(marks[0], 0, 1)
    assert found.points.shape == marks[0].points.shape and found.reached.all() and found.off_surface.max() < 0.5
    with pytest.raises(ValueError, match="s01, s02"):
        group.carry(points, "s09", 0)
    with pytest.raises(ValueError, match="0 to 4"):
        group.carry(points, 5, 0)
    with pytest.raises(ValueError, match=r"\(n, 3\)"):
        group.carry([1.0, 2.0], 0, 1)


def test_values_at_vertices_are_carried_to_the_places(group: sp.shape.Group, folder: Path, tmp_path: Path) -> None:
    surfaces = [sp.read_surface(path) for path in paths(folder)]
    own = [surface.vertices for surface in surfaces]
    positions = group.carry_values(surfaces, own)
    n = len(group.directions)
    assert positions.shape == (5, n, 3)
    # Images of other packages hold the same values.
    held = [surface.to_nilearn(values) for surface, values in zip(surfaces, own)]
    assert np.array_equal(group.carry_values(surfaces, held), positions, equal_nan=True)
    flat = [surface.to_nilearn(values[:, 0]).data for surface, values in zip(surfaces, own)]
    assert np.array_equal(group.carry_values(surfaces, flat), positions[..., 0], equal_nan=True)
    # Positions as values are the places, in each member's frame.
    for index, (found, transform) in enumerate(zip(positions, group.transforms)):
        assert np.linalg.norm(transform.apply(found) - group.places[index], axis=1).max() < 0.3
    # A signal has one value at each vertex, from an array or a file; surfaces may be files, too.
    file = tmp_path / "height.shape.gii"
    sp.write_signal(file, own[0][:, 2])
    heights = group.carry_values(paths(folder), [file, *(vertices[:, 2] for vertices in own[1:])])
    assert heights.shape == (5, n) and np.allclose(heights[1:], positions[1:, :, 2], atol=1e-9)
    assert np.allclose(heights[0], positions[0, :, 2], atol=1e-4)
    with pytest.raises(ValueError, match="surfaces: expected one for each of 5 members, found 4"):
        group.carry_values(surfaces[:4], own)
    with pytest.raises(ValueError, match=r"values\[1\]: expected a row for each of"):
        group.carry_values(surfaces, [own[0], own[1][:-1], *own[2:]])
    moved = sp.Surface(own[2] + 100.0, surfaces[2].faces)
    with pytest.raises(ValueError, match=r"surfaces\[2\]: expected the mesh of member s03"):
        group.carry_values([*surfaces[:2], moved, *surfaces[3:]], own)
    with pytest.raises(ValueError, match="equal numbers of channels"):
        group.carry_values(surfaces, [own[0][:, 0], *own[1:]])


def test_labels_are_carried_without_averaging(group: sp.shape.Group, folder: Path, tmp_path: Path) -> None:
    surfaces = [sp.read_surface(path) for path in paths(folder)]
    # Two regions, 1 and 5, divided by the plane z = 0.
    labels = [np.where(surface.vertices[:, 2] > 0.0, 5, 1) for surface in surfaces]
    carried = group.carry_values(surfaces, labels)
    assert set(np.unique(carried)) == {1.0, 5.0}
    heights = group.carry_values(surfaces, [surface.vertices[:, 2] for surface in surfaces])
    edges = [surface.vertices[surface.faces[:, 0]] - surface.vertices[surface.faces[:, 1]] for surface in surfaces]
    longest = max(float(np.linalg.norm(edge, axis=1).max()) for edge in edges)
    away = np.abs(heights) > longest
    assert away.mean() > 0.5 and np.array_equal(carried[away] == 5.0, heights[away] > 0.0)
    # Floats are averaged unless nearest values are requested; label files needn't request them.
    floats = [own.astype(float) for own in labels]
    assert len(np.unique(group.carry_values(surfaces, floats))) > 2
    assert np.array_equal(group.carry_values(surfaces, floats, interpolation="nearest"), carried)
    assert len(np.unique(group.carry_values(surfaces, labels, interpolation="linear"))) > 2
    flags = group.carry_values(surfaces, [own == 5 for own in labels])
    assert np.array_equal(flags == 1.0, carried == 5.0)
    file = tmp_path / "regions.label.gii"
    array = nibabel.gifti.GiftiDataArray(labels[0].astype(np.int32), intent="NIFTI_INTENT_LABEL")
    nibabel.save(nibabel.gifti.GiftiImage(darrays=[array]), file)
    assert np.array_equal(group.carry_values(surfaces, [file, *floats[1:]])[0], carried[0])
    with pytest.raises(ValueError, match="interpolation: expected one of linear, nearest; found 'cubic'"):
        group.carry_values(surfaces, labels, interpolation="cubic")  # type: ignore[arg-type]


def test_a_group_has_its_parts(group: sp.shape.Group, folder: Path) -> None:
    n = len(group.sphere.vertices)
    assert n == 642 and group.places.shape == (5, n, 3) and group.reached.shape == (5, n) and group.masked.shape == (n,)
    assert not group.masked.any() and group.reached.all() and group.directions.shape == (n, 3)
    assert np.allclose(np.mean([model.coefficients for model in group.models], axis=0), group.mean.coefficients, atol=1e-9)
    for index, (model, transform, path) in enumerate(zip(group.models, group.transforms, paths(folder))):
        assert np.linalg.norm(model.evaluate(group.directions) - group.places[index], axis=1).max() < 1
        # Places lie on the transformed surface, and the inverse transform restores the surface.
        surface = sp.read_surface(path)
        back = transform.inverse().apply(transform.apply(surface))
        assert np.allclose(back.vertices, surface.vertices, atol=1e-9)
        moved = sp.Surface(group.places[index], group.sphere.faces)
        assert apart(transform.apply(surface), moved) < 0.3
    assert len(group.modes) == 4 and group.modes.members == list(group.names)
    assert group.modes.compactness[0] > 0.9
    assert group.report["template"] in group.names and {member["turned"] for member in group.report["members"]} == {0}
    assert group.report["refinement"]["stages"][-1]["log_area"]["within_eight"] > 0.99
    errors = group.landmark_errors
    assert errors is not None and errors.names is not None and errors.off_surface.max() < 0.5
    assert repr(group) == "Group(5 members, degree 8, 642 directions)"


def test_a_new_member_leaves_the_group_as_it_is(group: sp.shape.Group, folder: Path) -> None:
    before = group.mean.coefficients.copy()
    surface = sp.read_surface(paths(folder)[2])
    with pytest.warns(sp.SpharmWarning, match="5: the surface is identical to s03"):
        member = group.add(surface)
    with pytest.warns(sp.SpharmWarning, match="5: the surface is identical to s03"):
        group.add(moved(surface))
    assert isinstance(member, sp.shape.Member) and member.name == "5"
    assert member.places.shape == group.places[2].shape and member.reached.all() and member.report["turned"] == 0
    both = group.add([paths(folder)[2], surface])
    assert isinstance(both, list) and [one.name for one in both] == ["s03", "6"]
    assert np.array_equal(both[1].places, member.places) and np.array_equal(group.mean.coefficients, before)
    assert np.linalg.norm(member.model.evaluate(group.directions) - member.places, axis=1).max() < 1


def test_what_is_wrong_with_a_subject_is_said_by_its_name(group: sp.shape.Group, folder: Path, tmp_path: Path) -> None:
    flat = tmp_path / "flat.ply"
    sp.Surface(np.zeros((3, 3)), [[0, 1, 2]]).save(flat)
    broken = tmp_path / "broken.ply"
    broken.write_bytes(paths(folder)[0].read_bytes()[:2000])
    for bad, error in ((flat, sp.MeshError), (broken, sp.MeshError), (tmp_path / "none.ply", FileNotFoundError)):
        with pytest.raises(error, match=bad.stem):
            sp.shape.correspond([*paths(folder)[:2], bad], 6, subdivisions=3)
        with pytest.raises(error, match=bad.stem):
            group.add(bad)


def moved(surface: sp.Surface, mirror: bool = False, scale: float = 1.0) -> sp.Surface:
    """Returns a surface that is rotated, translated and optionally mirrored, facing outwards."""
    turn = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]]) * scale
    vertices = np.asarray(surface.vertices) * [-1 if mirror else 1, 1, 1]
    faces = np.asarray(surface.faces)
    return sp.Surface(vertices @ turn.T + [5, -7, 9], faces[:, ::-1] if mirror else faces)


def half(surface: sp.Surface) -> sp.Surface:
    vertices, faces = np.asarray(surface.vertices), np.asarray(surface.faces)
    off = vertices - vertices.mean(0)
    return sp.Surface(vertices, faces[(off @ np.linalg.svd(off, full_matrices=False)[2][0])[faces].mean(1) > 0])


def both(first: sp.Surface, second: sp.Surface) -> sp.Surface:
    vertices = np.concatenate([first.vertices, np.asarray(second.vertices) + [90, 0, 0]])
    return sp.Surface(vertices, np.concatenate([first.faces, np.asarray(second.faces) + len(first.vertices)]))


@pytest.mark.parametrize(
    ("made", "warning"),
    [
        (lambda own, _: moved(own), "the surface is identical to s01"),
        (lambda _, other: moved(other, scale=1000), "of another kind or in another unit"),
        (lambda _, other: half(other), "has no counterpart on this surface"),
        (lambda own, other: both(own, other), "of another kind or in another unit"),
        (lambda *_: moved(sp.icosphere(4), scale=9), "of another kind or in another unit"),
    ],
    ids=["twice", "units", "half", "two in one file", "a ball"],
)
def test_a_member_that_is_not_like_the_others_is_named(folder: Path, made: Any, warning: str) -> None:
    own, *_, other = (sp.read_surface(path) for path in paths(folder))
    with pytest.warns(sp.SpharmWarning, match=warning):
        found = sp.shape.correspond([*paths(folder)[:4], made(own, other)], 6, subdivisions=3, refine=False)
    assert any(text.startswith("4: ") and warning in text for text in found.warnings)


def bodies_without_symmetry(count: int, subdivisions: int) -> list[sp.Surface]:
    """Returns ellipsoids of slightly different widths with two bumps each, which differ from their mirror images."""
    ball = sp.icosphere(subdivisions)
    directions = np.asarray(ball.vertices)
    near = [np.exp(6 * (directions @ place - 1)) for place in ([0.6, 0.64, 0.48], [-0.36, 0.48, -0.8])]
    radius = 1 + 0.4 * near[0] + 0.3 * near[1]
    return [sp.Surface(directions * radius[:, None] * [9, 6 + 0.1 * k, 4], ball.faces) for k in range(count)]


def test_a_mirrored_member_is_named() -> None:
    bodies = bodies_without_symmetry(5, subdivisions=4)
    bodies[3] = moved(bodies[3], mirror=True)
    with pytest.warns(sp.SpharmWarning, match="3: the mirror image fits"):
        found = sp.shape.correspond(bodies, 6, subdivisions=3, refine=False)
    assert all(text.startswith("3:") for text in found.warnings)
    known = sp.shape.correspond(bodies, 6, subdivisions=3, refine=False, mirrored=[False, False, False, True, False])
    assert not known.warnings
    assert [np.linalg.det(transform.object) < 0 for transform in known.transforms] == [False] * 3 + [True, False]
    added = known.add(bodies[3], mirrored=True)
    assert np.linalg.det(added.transform.object) < 0
    assert np.abs(added.places - known.add(bodies[2]).places).max() < 0.5
    with pytest.raises(ValueError, match="mirrored: expected a bool for each of 5 surfaces, found 1"):
        sp.shape.correspond(bodies, 6, mirrored=[True])


@pytest.mark.parametrize("known", [False, True])
def test_files_state_which_members_were_mirrored_before_the_alignment(known: bool, tmp_path: Path) -> None:
    bodies = bodies_without_symmetry(3, subdivisions=3)
    bodies[2] = moved(bodies[2], mirror=True)
    mirrored = [False, False, True]
    settings: dict[str, Any] = {"mirrored": mirrored} if known else {"mirror": True}
    found = sp.shape.correspond(bodies, 6, subdivisions=2, refine=False, **settings)
    found.save(tmp_path / "group")
    sp.shape.Group.load(tmp_path / "group").save(tmp_path / "again")
    for folder in (tmp_path / "group", tmp_path / "again"):
        records = [json.loads(path.read_text()) for path in sorted((folder / "members").glob("*.json"))]
        assert [record["mirrored"] for record in records] == mirrored
        assert [record["mirrored_first"] for record in records] == [known and own for own in mirrored]


def test_members_that_are_alike_are_not_named(folder: Path) -> None:
    inside_out = sp.read_surface(paths(folder)[4])
    inside_out = sp.Surface(inside_out.vertices, np.asarray(inside_out.faces)[:, ::-1])
    found = sp.shape.correspond([*paths(folder)[:4], inside_out], 6, subdivisions=3, refine=False)
    assert not found.warnings
    assert found.report["members"][4]["turned"] == 0 and found.report["members"][4]["unreached"] < 0.01


def test_landmarks_that_cannot_be_right_are_named(folder: Path, marks: list[sp.Landmarks]) -> None:
    few, points = paths(folder)[:3], [own.points for own in marks[:3]]
    for wrong, message in (
        ([points[0], points[1][:-1], points[2]], r"landmarks\[1\]: expected 16 positions, as in landmarks\[0\], found 15"),
        ([points[0], points[1], points[2] * np.nan], r"landmarks\[2\]: expected finite"),
    ):
        with pytest.raises(ValueError, match=message):
            sp.shape.correspond(few, 6, subdivisions=3, landmarks=wrong)
    with pytest.warns(sp.SpharmWarning, match=rf"s02: {len(points[1])} of {len(points[1])} landmarks are far from the surface"):
        found = sp.shape.correspond(few, 6, subdivisions=3, refine=False, landmarks=[points[0], points[1] + 30, points[2]])
    assert len(found.warnings) == 1


def test_swapped_landmarks_are_named(folder: Path, marks: list[sp.Landmarks], group: sp.shape.Group) -> None:
    assert not any("swapped" in warning for warning in group.warnings)
    points = [own.points.copy() for own in marks]
    points[2][[0, 7]] = points[2][[7, 0]]
    with pytest.warns(sp.SpharmWarning, match="s03: the landmarks 0 and 7 seem to be swapped"):
        sp.shape.correspond(paths(folder), 6, subdivisions=3, refine=False, landmarks=points)


def test_landmarks_that_guide_stay_together(folder: Path, marks: list[sp.Landmarks], group: sp.shape.Group) -> None:
    guided = sp.shape.correspond(paths(folder), 8, landmarks=marks, guide=True, template="s03", subdivisions=3)

    def error(found: sp.shape.Group) -> float:
        pairs = [(i, j) for i in range(5) for j in range(5) if i != j]
        off = [np.linalg.norm(found.carry(marks[i], i, j).points - marks[j].points, axis=1).mean() for i, j in pairs]
        return float(np.mean(off))

    assert error(guided) < 0.5 * error(group)
    guide = guided.report["guide"]
    assert len(guide["guided"]) == len(marks[0].names) and np.mean(guide["guided"]) < 0.5 * np.mean(guide["left_out"])
    assert group.report["guide"] is None


def test_signals_say_what_surfaces_do_not() -> None:
    """The signal is a patch at another place of each member, which the shape doesn't show."""
    ball, rng = sp.icosphere(3), np.random.default_rng(1)
    unit = ball.vertices
    shape = 1 + 0.25 * np.exp(8 * (unit @ [0.7, 0.5, 0.51] - 1)) + 0.15 * np.exp(8 * (unit @ [-0.67, 0.67, -0.33] - 1))
    surfaces, patches, places = [], [], []
    for angle in (-0.5, -0.2, 0.1, 0.4):
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        turn *= np.linalg.det(turn)
        body = (1 + 0.1 * angle) * (unit * [12, 7, 5] * shape[:, None]) @ turn
        near = unit @ [0.3 * np.cos(angle), 0.95 * np.sin(angle), -0.95 * np.cos(angle)]
        surfaces.append(sp.Surface(body, ball.faces))
        patches.append(np.exp(6 * (near - 1)))
        places.append(body[near.argmax()])

    def error(found: sp.shape.Group) -> float:
        pairs = [(i, j) for i in range(4) for j in range(4) if i != j]
        return float(np.mean([np.linalg.norm(found.carry([places[i]], i, j) - places[j]) for i, j in pairs]))

    without = error(sp.shape.correspond(surfaces, 8, subdivisions=3))
    with_them = error(sp.shape.correspond(surfaces, 8, subdivisions=3, signals=[(patches, 0.5)]))
    assert with_them < 0.4 * without
    # The same with a member that is a mirror image, whose triangles are wound the other way.
    surfaces[2] = sp.Surface(surfaces[2].vertices * [-1, 1, 1], surfaces[2].faces[:, [0, 2, 1]])
    places[2] = places[2] * [-1, 1, 1]
    mirrored = [member == 2 for member in range(4)]
    found = sp.shape.correspond(surfaces, 8, subdivisions=3, signals=[(patches, 0.5)], mirrored=mirrored)
    assert error(found) < 0.4 * without


def test_a_group_is_saved_read_and_pickled(
    group: sp.shape.Group, folder: Path, marks: list[sp.Landmarks], tmp_path: Path
) -> None:
    group.save(tmp_path / "group")
    with pytest.raises(FileExistsError):
        group.save(tmp_path / "group")
    group.save(tmp_path / "group", overwrite=True)
    read = sp.shape.Group.load(tmp_path / "group", landmarks=marks)
    for other in (read, pickle.loads(pickle.dumps(group))):
        assert other.names == group.names and other.warnings == group.warnings
        assert np.array_equal(other.places, group.places) and np.array_equal(other.reached, group.reached)
        assert np.array_equal(other.mean.coefficients, group.mean.coefficients)
        assert other.report["members"] == group.report["members"] and other.report["template"] == group.report["template"]
        assert other.landmark_errors is not None and group.landmark_errors is not None
        assert other.landmark_errors.mean == pytest.approx(group.landmark_errors.mean, rel=1e-9)
        new = other.add(paths(folder)[2])
        assert np.array_equal(new.places, group.add(paths(folder)[2]).places)
    # Names that are invalid as file names.
    odd = sp.shape.correspond([sp.read_surface(path) for path in paths(folder)[:2]], 4, subdivisions=2, rounds=1, refine=False)
    odd.names = ("a/b", "mean")
    assert pickle.loads(pickle.dumps(odd)).names == ("a/b", "mean")
    with pytest.raises(ValueError, match="valid file names"):
        odd.save(tmp_path / "odd")
    with pytest.raises(OSError, match="group.json"):
        sp.shape.Group.load(tmp_path)


def test_settings_that_are_none_are_refused(folder: Path) -> None:
    few = paths(folder)[:2]
    wrong: list[tuple[Any, dict[str, Any], str]] = [
        (few[:1], {}, "at least 2"),
        (few, {"rounds": 0}, "rounds"),
        (few, {"subdivisions": 1}, "subdivisions"),
        (few, {"template": 2}, "template"),
        (few, {"landmarks": [np.zeros((1, 3))]}, "2 members"),
        (few[0], {}, "sequence"),
        (few, {"guide": True}, "guide: expected landmarks"),
        (few, {"guide": True, "landmarks": [np.zeros((1, 3))] * 2, "template": folder / "s05.ply"}, "template: expected the number or name of a member"),
        (few, {"signals": [[np.ones(3)] * 2]}, r"a pair \(values, weight\)"),
        (few, {"signals": [([np.ones(3)], 0.1)]}, "each of 2 surfaces"),
        (few, {"signals": [([np.ones((3, 2))] * 2, 0.1)]}, "one value per vertex"),
        (few, {"signals": [([np.ones(3)] * 2, 0.0)]}, "a weight above 0"),
        (few, {"signals": [([np.ones(3)] * 2, 0.1)]}, "found 3 values for"),
        (few, {"signals": [([np.ones(3)] * 2, 0.1)], "refine": False}, "refine=True"),
        ([sp.Model(np.ones((4, 1))), *few], {}, "surfaces"),
    ]
    for surfaces, arguments, message in wrong:
        with pytest.raises(ValueError, match=message):
            sp.shape.correspond(surfaces, 6, **arguments)


def test_models_and_a_template_by_name(group: sp.shape.Group, folder: Path, tmp_path: Path) -> None:
    saved = tmp_path / "m.spharm.npz"
    group.models[1].save(saved)
    given = [group.models[0], saved, sp.read_surface(paths(folder)[2])]
    stages = []
    found = sp.shape.correspond(
        given, 6, template="m", subdivisions=3, rounds=1, refine=False, progress=lambda *now: stages.append(now[0])
    )
    assert found.names == ("0", "m", "2") and found.report["template"] is None and "registration" in stages
    assert found.report["refinement"] is None and found.landmark_errors is None


def test_an_interrupt_ends_it(folder: Path) -> None:
    timer = threading.Timer(0.3, lambda: os.kill(os.getpid(), signal.SIGINT))
    start = time.perf_counter()
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        sp.shape.correspond(paths(folder), 20)
    assert time.perf_counter() - start < 2
    timer.join()


def test_a_template_on_a_surface() -> None:
    ball = sp.icosphere(3)
    egg = sp.Surface(ball.vertices * [12, 9, 7], ball.faces)
    fine = sp.icosphere(5)
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    other = sp.Surface((fine.vertices * [13, 9, 7.5]) @ turn.T + [50, 0, 0], fine.faces)
    found = sp.shape.register(egg, other)
    assert found.surface.vertices.shape == egg.vertices.shape and np.array_equal(found.surface.faces, egg.faces)
    assert found.reached.all() and found.cover["turned"] == 0 and found.cover["unreached"] == 0
    # The result is in the surface's own frame; the transform maps it to the template's frame.
    assert apart(other, found.surface) < 0.2
    assert np.linalg.norm(found.transform.apply(found.surface).vertices - egg.vertices, axis=1).max() < 3
    half = np.asarray(egg.vertices)[:, 2] > 0
    masked = sp.shape.register(egg, sp.Surface(np.asarray(egg.vertices) * 1.02, egg.faces), pose=False, masked=half)
    assert not masked.reached[half].any() and np.array_equal(masked.transform.object, np.eye(3))
    with pytest.raises(sp.MeshError, match="surface"):
        sp.shape.register(egg, sp.Surface(np.zeros((3, 3)), [[0, 1, 2]]))
    with pytest.raises(ValueError, match="expected 642"):
        sp.shape.register(egg, egg, masked=[True])


def test_files_that_state_different_axes_are_warned_about(tmp_path: Path) -> None:
    ball = sp.icosphere(3)
    given = []
    for name, axes in (("a", "LPS"), ("b", "RAS"), ("c", "LPS")):
        surface = sp.Surface(ball.vertices * [9, 6, 4], ball.faces)
        lines = [f"# SPACE={axes}"]
        lines += ["v {} {} {}".format(*vertex) for vertex in surface.vertices.tolist()]
        lines += ["f {} {} {}".format(*face) for face in (surface.faces + 1).tolist()]
        given.append(tmp_path / f"{name}.obj")
        given[-1].write_text("\n".join(lines))
    # Surfaces in memory keep the statement of their files.
    with pytest.warns(sp.SpharmWarning, match="LPS for a, 2; RAS for b"):
        group = sp.shape.correspond(
            [*given[:2], sp.read_surface(given[2])], 3, pose="near", rounds=1, refine=False, subdivisions=2
        )
    assert sum("different axes" in text for text in group.warnings) == 1
