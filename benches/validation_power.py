"""Measures findings inside and outside of the bump that half of the subjects of `generate --study` have.

All meshes of these studies are made from one icosphere, so the place of every vertex is known; the alignments don't use
this. Constants are those of `crates/surface/src/generate/study.rs`.
"""

import numpy as np
import spharm_rs as sp
from scipy.spatial.transform import Rotation

import correspondence as bench
import correspondence_measures as measured

AXES, BEND = np.array([20.0, 11.0, 8.0]), 5.0
PLACE, WIDTH = np.array([0.48, 0.64, 0.6]), 0.35
LEVEL = 4


def body(directions):
    """Returns the study's body without waves."""
    places = directions * AXES
    places[:, 2] += BEND * directions[:, 0] ** 2
    return places


def tapered(surface, share=0.25):
    """Returns a subject that is made wider at one end, so that no half turn brings it close to itself."""
    vertices, faces = bench.arrays(surface)
    turn, shift = measured.rotation(vertices, body(bench.sphere(LEVEL)[0]))
    upright = vertices @ turn + shift
    upright[:, 1:] *= 1 + share * upright[:, :1] / AXES[0]
    return sp.Surface((upright - shift) @ turn.T, faces)


def study(seed, height, taper):
    surfaces = bench.study(seed, height)
    return [tapered(surface) for surface in surfaces] if taper else surfaces


def known_group(surfaces, max_degree):
    """Returns the group over the icosphere of all meshes, which is the true correspondence."""
    models = [sp.fit(surface, sp.icosphere(LEVEL), max_degree) for surface in surfaces]
    return sp.shape.procrustes(models, method="fixed")


def true_places(group, surfaces):
    """Returns, for each member, the true direction of the place at each direction of the icosphere, (n, V, 3)."""
    directions, found = bench.sphere(LEVEL)[0], []
    for model, transform, surface in zip(group.models, group.transforms, surfaces):
        vertices, faces = transform.apply(np.asarray(surface.vertices)), np.asarray(surface.faces)
        at, which, _ = measured.closest(vertices, faces, model.evaluate(directions))
        nearest = np.linalg.norm(vertices[faces[which]] - at[:, None], axis=2).argmin(1)
        found.append(directions[faces[which, nearest]])
    return np.array(found)


def agreed(places):
    """Returns the largest set of members whose places agree; the other members are off by a half turn."""
    alike = np.einsum("avc,bvc->ab", places, places) / places.shape[1] > 0.7
    return alike[alike.sum(1).argmax()]


def degrees_between(group, known, surfaces, chosen, labels):
    """Returns the angle in degrees between the two groups' mean poses, relative to the true correspondence."""
    turns = []
    for first, second, surface in zip(known.transforms, group.transforms, surfaces):
        vertices = np.asarray(surface.vertices)
        turns.append(measured.rotation(first.apply(vertices), second.apply(vertices))[0])
    first, second = (Rotation.from_matrix([turn for turn, kept, own in zip(turns, chosen, labels) if kept and own == label]).mean()
                     for label in "ab")  # fmt: skip
    return float(np.degrees((first * second.inv()).magnitude()))


def found_of(group, known, surfaces, labels, permutations=999):
    """Returns the share of the bump's area, and the share of the area beyond three widths of the bump, where p is at
    most 0.05; the number of members that are off by a half turn; and the angle in degrees between the groups' poses.

    The bump is taken to end at two widths, where it has a seventh of its height.
    """
    places = true_places(group, surfaces)
    as_most = agreed(places)
    middle = places[as_most].mean(0)
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    angle = np.arccos(np.clip(middle @ PLACE / np.linalg.norm(PLACE), -1, 1))
    test = sp.shape.group_test(group.models, groups=labels, sphere=LEVEL, permutations=permutations)
    p, weight = np.asarray(test.p_fwe), bench.points(group.models)[1]
    near, far = angle < 2 * WIDTH, angle > 3 * WIDTH
    share = {name: float(weight[part & (p <= 0.05)].sum() / weight[part].sum()) for name, part in (("bump", near), ("else", far))}
    mean = np.asarray(test.mean.surface(LEVEL).vertices)
    turn, shift = measured.rotation(mean, body(middle))
    drawn = sp.Surface(mean @ turn + shift, bench.sphere(LEVEL)[1])
    degrees = degrees_between(group, known, surfaces, as_most, labels)
    return share | {"degrees": degrees, "turned": int((~as_most).sum()), "count": int((p <= 0.05).sum()), "map": (drawn, p)}
