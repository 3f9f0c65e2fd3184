#!/usr/bin/env python3
"""Measures correspondence against required limits, row by row: `./run bench correspondence [ROW ...]`.

A row is a function whose name starts with `row_`; without names all rows run, and `--list` lists them. Each row prints
its limit and the value reached; the exit status is 1 if a limit is missed. Measures are those of
`correspondence_measures.py`, area-weighted, in mm. Surfaces are those of ../shared/data (vertebrae, hippocampi), and
groups of `spharm generate --group`, whose true correspondence is known.
"""

import argparse
import csv
import functools
import inspect
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import spharm_rs as sp
from scipy.spatial.transform import Rotation

import correspondence_measures as measured

ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT.parent / "shared" / "data"
PROGRAM = ROOT / "target" / "release" / "spharm"
FOLDER = Path(tempfile.mkdtemp(prefix="correspondence-"))
results = []


def bar(name, limit, reached, least=False):
    """Prints a row of the table: `reached` must be at most the limit or, with `least`, at least the limit."""
    met = bool(reached >= limit if least else reached <= limit)
    results.append(met)
    print(f"{name:<66} {'>=' if least else '<='} {limit:<8g} {reached:10.4g}{'' if met else '  NOT MET'}", flush=True)


def arrays(surface):
    return np.asarray(surface.vertices), np.asarray(surface.faces)


@functools.cache
def sphere(level):
    vertices, faces = arrays(sp.icosphere(level))
    return vertices / np.linalg.norm(vertices, axis=1, keepdims=True), faces


def points(models, level=4):
    """Returns the members at the directions of an icosphere, aligned rigidly, and the weights of the directions."""
    directions, faces = sphere(level)
    members = np.array([model.evaluate(directions) for model in models])
    weight = measured.weights(members, faces)
    return measured.together(members, weight), weight


# Groups of surfaces.


@functools.cache
def vertebrae():
    """Returns the raw surfaces of the vertebrae, and their landmarks."""
    paths = sorted((DATA / "vertebrae").glob("*.ply"))
    marks = [sp.read_landmarks(path.with_suffix(".json")).points for path in paths]
    return [sp.read_surface(path) for path in paths], marks


@functools.cache
def hippocampi():
    """Returns the surfaces a01 to a05, and the five surfaces that are stored separately, if their folder exists."""
    sphere_of = sp.icosphere(5)
    directions, faces = arrays(sphere_of)
    files = sorted((DATA / "shape").glob("hippo_*_r.foe.npy"))
    files += sorted((DATA / "kept-apart").glob("hippo_*.foe.npy"))
    return [sp.Surface(sp.Model(np.load(path)).evaluate(directions), faces) for path in files]


@functools.cache
def generated(family, members=16, upright=False):
    """Returns surfaces, true parameters (n, p) and landmarks of a family."""
    folder = FOLDER / f"{family}-{members}-{upright}"
    options = ["--upright"] if upright else []
    command = [PROGRAM, "generate", "--group", family, "--members", str(members), "--output-dir", folder, *options]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    with open(folder / "truth.csv", newline="") as table:
        rows = list(csv.DictReader(table))
    columns = list(rows[0])
    names = columns[3:columns.index("r11")]
    truth = np.array([[float(row[name]) for name in names] for row in rows])
    marks = [sp.read_landmarks(folder / row["landmarks"]).points for row in rows]
    return [sp.read_surface(folder / row["surface"]) for row in rows], truth, marks


@functools.cache
def corresponding(which, max_degree, template=None):
    """Returns the group of this name, brought into correspondence; the name of a family is an argument of
    `generated`."""
    surfaces = {"vertebrae": lambda: vertebrae()[0], "hippocampi": hippocampi}.get(which, lambda: generated(which)[0])()
    return sp.shape.correspond(surfaces, max_degree, template=template)


def turned_at_random(surface, seed):
    vertices, faces = arrays(surface)
    rng = np.random.default_rng(seed)
    turn = Rotation.random(random_state=rng).as_matrix()
    return sp.Surface(vertices @ turn.T + rng.uniform(-100, 100, 3), faces), turn


# Poses of surfaces.


def row_poses_of_vertebrae():
    """Distance of each subject's landmarks from the mean of the others' landmarks, relative to the distance after the
    best rigid motion."""
    surfaces, marks = vertebrae()
    moved = [turned_at_random(surface, seed)[0] for seed, surface in enumerate(surfaces)]
    inputs = [measured.rotation(np.asarray(a.vertices), np.asarray(b.vertices)) for a, b in zip(surfaces, moved)]
    marks = [own @ turn + shift for own, (turn, shift) in zip(marks, inputs)]
    group = sp.shape.correspond(moved, 12)
    placed = np.array([transform.apply(own) for transform, own in zip(group.transforms, marks)])
    ratios = []
    for i, own in enumerate(placed):
        mean = np.delete(placed, i, 0).mean(0)
        turn, shift = measured.rotation(own, mean)
        best = np.sqrt(((own @ turn + shift - mean) ** 2).sum(1).mean())
        ratios.append(np.sqrt(((own - mean) ** 2).sum(1).mean()) / best)
    bar("poses, vertebrae: landmarks from the others' mean / best rigid", 1.15, float(np.mean(ratios)))


def near_spheres(count=10):
    """Yields near-spheres of radius 20, which vary by 5 % and differ between two members by 0.1, ten times the
    triangles' distance from the sphere."""
    directions, faces = sphere(4)
    for seed in range(count):
        values = np.random.default_rng(seed).normal(size=(16, 3)) / (1 + np.arange(16))[:, None]
        yield sp.Surface(20 * directions + sp.Model(values).evaluate(directions), faces)


def cubes(count=10):
    directions, faces = sphere(4)
    for seed in range(count):
        half = 10 * (1 + 0.02 * np.random.default_rng(seed).normal(size=3))
        radius = (np.abs(directions / half) ** 8).sum(1) ** (-1 / 8)
        yield sp.Surface(directions * radius[:, None], faces)


def row_missed_optima():
    """Aligns each of 50 pairs from 20 random rotations, and counts the results, of 1,000, whose distance exceeds the
    pair's smallest by more than 5 %."""
    made = [generated("rods", 10)[0], generated("growing-bump", 10)[0], list(cubes()), list(near_spheres())]
    groups = [vertebrae()[0], *made]
    missed = 0
    for surfaces in groups:
        for i, surface in enumerate(surfaces):
            target = surfaces[(i + 1) % len(surfaces)]
            ends = []
            for seed in range(20):
                moved = turned_at_random(surface, seed)[0]
                ends.append(sp.shape.pose(moved, target).distance)
            missed += int((np.array(ends) > 1.05 * min(ends) + 1e-6).sum())
    bar("poses: missed optima of 1,000", 0, missed)


# Hippocampi and vertebrae.


def row_hippocampi():
    members, weight = points(corresponding("hippocampi", 12).models)
    print(f"  of {len(members)} members; the limits are for 10 members", flush=True)
    for count, generalisation, specificity in ((1, 1.05, 0.75), (3, 1.00, 0.80)):
        bar(f"hippocampi: generalisation at {count}", generalisation, measured.generalisation(members, weight, count))
        bar(f"hippocampi: specificity at {count}", specificity, measured.specificity(members, weight, count))


def on_surfaces(group, surfaces, marks):
    """Returns the errors of places carried between all pairs, on the target's surface: (n, n - 1, p)."""
    return measured.landmark_errors(group.carry, [arrays(surface) for surface in surfaces], marks)


def errors_of_vertebrae(template=None):
    surfaces, marks = vertebrae()
    group = corresponding("vertebrae", 40, template)
    return on_surfaces(group, surfaces, marks)


def row_landmarks_of_vertebrae():
    errors = errors_of_vertebrae()
    bar("vertebrae: landmarks, mean", 2.6, float(errors.mean()))
    bar("vertebrae: landmarks, median", 2.0, float(np.median(errors)))
    print("  by landmark", np.round(errors.mean((0, 1)), 2))


def row_generalisation_of_vertebrae():
    members, weight = points(corresponding("vertebrae", 40).models, 5)
    for count, limit in ((1, 3.0), (3, 2.6)):
        bar(f"vertebrae: generalisation at {count}", limit, measured.generalisation(members, weight, count))


def row_templates():
    """Uses each vertebra as the first template: spread of the mean landmark errors, divided by their mean."""
    means = [float(errors_of_vertebrae(index).mean()) for index in range(len(vertebrae()[0]))]
    print("  by template", np.round(means, 2))
    bar("vertebrae: spread of the mean error over templates", 0.10, (max(means) - min(means)) / np.mean(means))


def in_group(group, index, surface):
    vertices, faces = arrays(surface)
    return group.transforms[index].apply(vertices), faces


def own_surface(group, index, surface, level):
    """Returns the distances of a subject's own vertices from its model."""
    directions, faces = sphere(level)
    return measured.closest(group.models[index].evaluate(directions), faces, in_group(group, index, surface)[0])[2]


def row_cover_of_vertebrae():
    """Distance of each subject's own surface from its model of degree 40."""
    group = corresponding("vertebrae", 40)
    distances = [own_surface(group, index, surface, 6) for index, surface in enumerate(vertebrae()[0])]
    rms = max(float(np.sqrt((distance**2).mean())) for distance in distances)
    bar("vertebrae: own surface from the model, rms of the worst", 0.3, rms)
    bar("vertebrae: 99 %", 0.8, max(float(np.quantile(distance, 0.99)) for distance in distances))
    bar("vertebrae: farthest", 4, max(float(distance.max()) for distance in distances))


def row_turned_triangles():
    """Share of the registered templates' triangles that face against their subjects' surfaces, among triangles whose
    corners are all reached."""
    for which, degree in (("vertebrae", 40), ("hippocampi", 12), ("rods", 24)):
        group, count, marked = corresponding(which, degree), 0, 0
        surfaces = {"vertebrae": lambda: vertebrae()[0], "hippocampi": hippocampi}.get(which, lambda: generated(which)[0])()
        faces = np.asarray(group.sphere.faces)
        for index, surface in enumerate(surfaces):
            reached = np.asarray(group.reached[index])[faces].all(1)
            count += measured.turned(np.asarray(group.places[index]), faces[reached], in_group(group, index, surface))
            marked += group.report["members"][index]["turned"]
        bar(f"{which}: turned triangles", 0, count)
        print(f"  {marked} of {len(surfaces) * len(faces)} can't be turned back, and are marked as places that aren't reached", flush=True)


def apart(a, b):
    return sp.compare(a, b, surface_distance=True).surface["rms"]


def row_one_sphere():
    """Distance of models over the group's common sphere, relative to models over each surface's own map."""
    group, ratios = corresponding("hippocampi", 12), []
    for index, surface in enumerate(hippocampi()):
        own = apart(sp.fit(surface, max_degree=12).surface(5), surface)
        moved = sp.Surface(*in_group(group, index, surface))
        ratios.append(apart(group.models[index].surface(5), moved) / own)
    bar("hippocampi: rms distance over the one sphere / own map", 1.5, float(np.mean(ratios)))


def row_distortion():
    """Areas of triangles over the refined directions, relative to the icosphere's, after the last stage of the
    refinement."""
    last = corresponding("vertebrae", 40).report["refinement"]["stages"][-1]["log_area"]
    bar("distortion: root mean square of the log area", 0.45, last["rms"])
    bar("distortion: share of triangles within a factor of 8", 0.999, last["within_eight"], least=True)


# Groups of known truth.


def row_moving_bump():
    truth = generated("moving-bump")[1]
    members, weight = points(corresponding("moving-bump", 16).models)
    bar("moving bump, gentle: share of the first mode", 0.985, float(measured.shares_of_modes(members, weight)[0]), least=True)
    score = measured.modes(members, weight)[1][:, 0]
    correlation = float(abs(np.corrcoef(score, truth[:, 0])[0, 1]))
    bar("moving bump, gentle: correlation with the truth", 0.995, correlation, least=True)


def row_sharp_bump():
    members, weight = points(corresponding("sharp-bump", 24).models, 5)
    shares = measured.shares_of_modes(members, weight)
    bar("moving bump, sharp: share of the first mode", 0.9, float(shares[0]), least=True)
    bar("moving bump, sharp: share of the first two", 0.99, float(shares[:2].sum()), least=True)


def row_ellipsoids():
    truth = generated("ellipsoids")[1]
    members, weight = points(corresponding("ellipsoids", 12).models)
    bar("ellipsoids: modes above 1 % of the variance", 2, int((measured.shares_of_modes(members, weight) > 0.01).sum()))
    bar("ellipsoids: R^2 of the truth", 0.999, measured.determination(members, weight, truth, 2), least=True)


def row_known_places():
    """Landmarks that were generated with a group, carried between all pairs. No limit is required, but changes that
    improve the quality must not increase these errors."""
    for family in ("moving-bump", "growing-bump", "ellipsoids", "rods"):
        surfaces, truth, marks = generated(family)
        group = corresponding(family, 16)
        errors = on_surfaces(group, surfaces, marks)
        members, weight = points(group.models)
        shares, count = measured.shares_of_modes(members, weight), truth.shape[1]
        print(f"  {family}: places {errors.mean():.3f} mean {np.median(errors):.3f} median, "
              f"first {count} modes {shares[:count].sum():.4f}, R^2 {measured.determination(members, weight, truth, count):.4f}", flush=True)


def row_cortices():
    """Two folded surfaces on one mesh, in random poses: distance of the first surface's carried vertices from the
    second's own vertices.

    The second surface is 12 % of the way from the first to another subject, a distance of about 0.15 mm. For the entire
    way, 1.3 mm, no limit is required.
    """
    a, b = (sp.example_surface(5, seed)[0] for seed in (0, 1))
    for share in (0.12, 1.0):
        other = sp.Surface(a.vertices + share * (np.asarray(b.vertices) - a.vertices), a.faces)
        turn, shift = measured.rotation(*(np.asarray(surface.vertices) for surface in (a, other)))
        off = np.asarray(a.vertices) @ turn + shift - np.asarray(other.vertices)
        (first, _), (second, _) = turned_at_random(a, 0), turned_at_random(other, 1)
        found = sp.shape.correspond([first, second], 40).carry(first.vertices, 0, 1) - second.vertices
        error, rigid = (float(np.sqrt((values**2).sum(1).mean())) for values in (found, off))
        if share < 1:
            bar("two cortices: error at vertices, mm", 0.4, error)
        print(f"  {share:g} of the way: {error:.3f} mm at vertices, {rigid:.3f} after the best rigid motion", flush=True)


# Validity and power.


@functools.cache
def study(seed, bump):
    """Returns 20 subjects of `generate --study`, 10 with a bump; with bump 0 all are controls."""
    folder = FOLDER / f"study-{seed}-{bump}"
    command = [PROGRAM, "generate", "--study", folder, "--subjects", "20", "--bump", str(bump), "--variant", str(seed)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return [sp.read_surface(path) for path in sorted(folder.glob("*.ply"))]


def found_places(models, groups, permutations=999):
    test = sp.shape.group_test(models, groups=groups, sphere=4, permutations=permutations)
    return int((np.asarray(test.p_fwe) <= 0.05).sum())


def false_findings(seed, labellings=20):
    """Returns the number of random labellings of 20 controls for which the test has a finding; the correspondence
    doesn't use labels."""
    models = sp.shape.correspond(study(seed, 0.0), 12).models
    rng = np.random.default_rng(seed)
    return sum(found_places(models, list(rng.permutation(["a", "b"] * 10)), 199) > 0 for _ in range(labellings))


def row_nulls():
    """15 groups of 20 controls with 20 labellings each: the number of labellings with a finding."""
    errors = sum(false_findings(seed) for seed in range(15))
    bar("nulls: family-wise error of 300 studies, at most", 0.085, errors / 300)
    bar("nulls: family-wise error of 300 studies, at least", 0.02, errors / 300, least=True)


def row_power(studies=3):
    """Area of the bump that the test finds, relative to the area found with the true correspondence; and findings
    outside the bump."""
    import validation_power as power  # imported here because validation_power.py imports this file

    labels = ["a"] * 10 + ["b"] * 10
    for height in (1.0, 2.0, 3.0):
        ratios, rest = [], []
        for seed in range(studies):
            surfaces = study(seed, height)
            known = power.known_group(surfaces, 12)
            true = power.found_of(known, known, surfaces, labels)
            found = power.found_of(sp.shape.correspond(surfaces, 12), known, surfaces, labels)
            ratios.append(found["bump"] / true["bump"])
            rest.append(found["else"])
        if height == 2.0:
            bar("power: bump of 2 mm, its area, of what the truth finds", 0.8, float(np.mean(ratios)), least=True)
            bar("power: bump of 2 mm, share of the rest that is found", 0.05, float(np.mean(rest)))
        print(f"  bump of {height:g} mm: {np.round(ratios, 2)}, and {np.round(rest, 2)} of the rest", flush=True)


# Times of registrations.


def seconds(work):
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def row_time_of_poses():
    a, b = vertebrae()[0][:2]
    times = [seconds(lambda: sp.shape.pose(a, b, threads=2)) for _ in range(5)]
    bar("time: pose of a pair, s", 0.05, float(np.median(times)))


def row_time_of_registration():
    """Seconds to register one subject in one round of a group, with two subjects at a time on two cores."""
    for which, degree, limit in (("hippocampi", 12, 0.3), ("vertebrae", 40, 1.5)):
        group = corresponding(which, degree)
        each = group.report["seconds"]["registration"] / len(group) / 2
        bar(f"time: registration, {which}, s", limit, each)


def row_new_subjects(count=50):
    """New hippocampi added to a group of 20: seconds for each one, and memory that the second half takes in addition to
    the first."""
    turned = [turned_at_random(hippocampi()[i % len(hippocampi())], i)[0] for i in range(20)]
    group = sp.shape.correspond(turned, 15)
    memory, start = [], time.perf_counter()
    for batch in range(0, count, 5):
        surfaces = [turned_at_random(hippocampi()[i % len(hippocampi())], 100 + i)[0] for i in range(batch, batch + 5)]
        group.add(surfaces)
        memory.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    bar("new subjects, in fives: s each", 0.4, (time.perf_counter() - start) / count)
    bar("new subjects: growth of memory, second half, MiB", 8, memory[-1] - memory[len(memory) // 2])


def row_time_of_groups():
    def whole(surfaces, degree):
        return seconds(lambda: sp.shape.quality(sp.shape.correspond(surfaces, degree).models))

    twenty = (hippocampi() * 20)[:20]
    bar("time: 20 hippocampi at degree 15, s", 20, whole([turned_at_random(s, i)[0] for i, s in enumerate(twenty)], 15))
    many = (hippocampi() * 200)[:200]
    bar("time: 200 hippocampi, s", 180, whole([turned_at_random(s, i)[0] for i, s in enumerate(many)], 15))
    bar("time: ten vertebrae at degree 40, s", 60, whole(vertebrae()[0], 40))


def main():
    functions = inspect.getmembers(sys.modules[__name__], inspect.isfunction)
    rows = {name[4:]: row for name, row in functions if name.startswith("row_")}
    rows = dict(sorted(rows.items(), key=lambda item: item[1].__code__.co_firstlineno))
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("rows", nargs="*", metavar="ROW", help="rows to run; all by default")
    parser.add_argument("--list", action="store_true", help="name the rows")
    arguments = parser.parse_args()
    if arguments.list:
        print("\n".join(rows))
        return 0
    for name in arguments.rows or rows:
        if name not in rows:
            parser.error(f"{name}: expected one of {', '.join(rows)}")
        started = time.perf_counter()
        rows[name]()
        print(f"  ({name}: {time.perf_counter() - started:.1f} s)", flush=True)
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
