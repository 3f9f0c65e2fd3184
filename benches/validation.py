#!/usr/bin/env python3
"""Measures the tables and pictures of docs/validation.md: `./run validation [PART ...] [--quick]`.

A part is a function whose name starts with `part_`; without names all parts run. Each part writes its tables into the
page when it ends, so that parts may be measured separately. `--quick` uses few members and few labellings, and writes a
copy of the page to target/validation. Groups, studies and measures are those of correspondence.py and
correspondence_measures.py.
"""

import argparse
import sys
import time
import warnings

import numpy as np
import scipy.stats
import spharm_rs as sp

import correspondence as bench
import correspondence_measures as measured
import validation_power as power
from validation_page import COLOURS, Page, bars, curves, maps, scores

ALIGNMENTS = {"plain": "plain alignment", "registered": "registered", "correspond": "refined"}
FAMILIES = {"moving-bump": "moving bump", "growing-bump": "growing bump", "ellipsoids": "ellipsoids", "rods": "rods with a knob",
            "tori": "tori"}  # fmt: skip


class Plain:
    """The plain alignment: each surface is mapped to the sphere separately, and models are aligned at equal directions.

    Has members, transforms and `carry`, as the result of `spharm_rs.shape.correspond` has.
    """

    def __init__(self, surfaces, max_degree, level=5):
        own = [sp.fit(surface, max_degree=max_degree) for surface in surfaces]
        found = sp.shape.procrustes(own, method="joint", degree=min(max_degree, 12))
        self.models, self.transforms = found.models, found.transforms
        self.places = [surface.vertices for surface in (model.surface(level) for model in self.models)]
        self.faces = np.asarray(self.models[0].surface(level).faces)

    def carry(self, points, source, target):
        """Maps points from the source's model to the same direction of the target's, each in its own frame."""
        placed = self.transforms[source].apply(np.asarray(points))
        at, which, _ = measured.closest(self.places[source], self.faces, placed)
        corners = self.places[source][self.faces[which]]
        share = np.array([np.linalg.lstsq(np.c_[own, np.ones(3)].T, np.r_[point, 1], rcond=None)[0] for own, point in zip(corners, at)])
        there = np.einsum("pk,pkc->pc", share, self.places[target][self.faces[which]])
        return self.transforms[target].inverse().apply(there)


def aligned(surfaces, max_degree, plain=True, registered=True):
    """Returns the group by each alignment; None for the plain alignment if surfaces can't be mapped without repair."""
    started = time.perf_counter()
    found = {"plain": Plain(surfaces, max_degree) if plain else None}
    if registered:
        found["registered"] = sp.shape.correspond(surfaces, max_degree, refine=False)
    found["correspond"] = sp.shape.correspond(surfaces, max_degree)
    print(f"  ({len(surfaces)} members, {len(found)} ways: {time.perf_counter() - started:.0f} s)", flush=True)
    return found


def part_truths(page, quick):
    """Families with a known truth, in random poses, with a new mesh for each member."""
    members, degree = (4, 8) if quick else (12, 12)
    rows, places, panels = [], {name: [] for name in ALIGNMENTS}, []
    for family, title in FAMILIES.items():
        if quick and "bump" not in family:
            for name in places:
                places[name].append(None)
            continue
        surfaces, truth, marks = bench.generated(family, members)
        count, series = truth.shape[1], {}
        for name, group in aligned(surfaces, degree, family != "tori").items():
            if group is None:
                rows.append([title, ALIGNMENTS[name], f"{count}", "no map", "", "", ""])
                places[name].append(None)
                continue
            points, weight = bench.points(group.models)
            errors = bench.on_surfaces(group, surfaces, marks)
            share = measured.shares_of_modes(points, weight)[:count].sum()
            told = measured.determination(points, weight, truth, count)
            rows.append([title, ALIGNMENTS[name], f"{count}", f"{share:.3f}", f"{told:.4f}", f"{errors.mean():.2f}",
                         f"{np.median(errors):.2f}"])  # fmt: skip
            places[name].append(float(errors.mean()))
            series[ALIGNMENTS[name]] = (COLOURS[name], measured.modes(points, weight)[1][:, 0])
        if count == 1:
            series.pop(ALIGNMENTS["registered"])
            panels.append((title, truth[:, 0], series))
    page.table("truths", ["family", "alignment", "p", "first p modes", "R^2", "places, mm", "median"], rows)
    page.measured("truths")
    page.picture("scores", scores(panels))
    # Ellipsoids have four equivalent poses, so their errors are far larger than the others' and aren't shown.
    shown = [index for index, family in enumerate(FAMILIES) if family != "ellipsoids"]
    heads = {ALIGNMENTS[name]: (COLOURS[name], [values[index] for index in shown]) for name, values in places.items()}
    page.picture("places", bars([list(FAMILIES.values())[index] for index in shown], heads, "error of known places, mm"))


def part_anatomy(page, quick):
    """Vertebrae with landmarks, and hippocampi; skipped if the data doesn't exist."""
    rows, panels = [], []
    for which, degree, level in (("vertebrae", 40, 5), ("hippocampi", 12, 4)):
        surfaces, marks = bench.vertebrae() if which == "vertebrae" else (bench.hippocampi(), None)
        if not surfaces:
            print(f"{which}: not in {bench.DATA}, left out", flush=True)
            rows.append([which, "left out", "", "", "", "", "", ""])
            continue
        if quick:
            surfaces, degree, level = surfaces[:3], 8, 4
        series = {}
        # The number of modes is two less than that of members, because generalisation leaves out a member.
        counts = range(1, len(surfaces) - 1)
        for name, group in aligned(surfaces, degree, which != "vertebrae").items():
            if group is None:
                rows.append([which, ALIGNMENTS[name], "not measured", "", "", "", "", ""])
                continue
            points, weight = bench.points(group.models, level)
            landmarks = "–"
            if marks is not None:
                errors = bench.on_surfaces(group, surfaces, marks[: len(surfaces)])
                landmarks = f"{errors.mean():.2f}, {np.median(errors):.2f}"
            general = [measured.generalisation(points, weight, count) for count in counts]
            special = [measured.specificity(points, weight, count) for count in counts]
            off = [bench.own_surface(group, index, surface, level + 1) for index, surface in enumerate(surfaces)]
            rows.append([which, ALIGNMENTS[name], landmarks, *(f"{values[at]:.2f}" for values in (general, special)
                         for at in (0, min(2, len(values) - 1))), f"{max(np.sqrt((d**2).mean()) for d in off):.2f}",
                         f"{max(d.max() for d in off):.1f}"])  # fmt: skip
            series[ALIGNMENTS[name]] = (COLOURS[name], general)
        panels.append((f"{which}: generalisation", series))
    head = ["group", "alignment", "landmarks, mm", "generalisation 1", "3", "specificity 1", "3", "own surface, rms", "farthest"]
    page.table("anatomy", head, [row + [""] * (len(head) - len(row)) for row in rows])
    page.measured("anatomy")
    if len(panels) == 2:
        page.picture("generalisation", curves(panels))


def interval(errors, trials):
    """Returns the Clopper-Pearson 95 % interval of a share."""
    found = scipy.stats.binomtest(errors, trials).proportion_ci(0.95)
    return f"{found.low:.3f} to {found.high:.3f}"


def part_nulls(page, quick):
    """Studies without an effect, in which the correspondence is computed as part of the study."""
    groups, labellings = (1, 10) if quick else (15, 20)
    by_group = [bench.false_findings(seed, labellings) for seed in range(groups)]
    errors, trials = sum(by_group), groups * labellings
    page.table("nulls", ["groups", "labellings of each", "that find anything", "share", "95 % interval", "most in a group"],
               [[groups, labellings, errors, f"{errors / trials:.3f}", interval(errors, trials), max(by_group)]])  # fmt: skip
    page.measured("nulls")


def part_power(page, quick):
    """A study of 10 subjects with a bump and 10 without: the area found by the true correspondence and by each
    alignment."""
    labels, names = ["a"] * 10 + ["b"] * 10, {"truth": "true correspondence"} | ALIGNMENTS
    rows, drawn = [], []
    for title, taper, heights in (("nearly symmetric", False, (1.0, 2.0, 3.0)), ("tapered", True, (0.5, 1.0, 2.0, 3.0))):
        if quick and not taper:
            continue
        for height in (2.0,) if quick else heights:
            found = {name: [] for name in names}
            for seed in range(1 if quick else 2):
                surfaces = power.study(seed, height, taper)
                groups = {"truth": power.known_group(surfaces, 12)} | aligned(surfaces, 12, registered=False)
                for name, group in groups.items():
                    found[name].append(power.found_of(group, groups["truth"], surfaces, labels))
            for name, seeds in found.items():
                if not seeds:
                    continue
                rows.append([title, f"{height:g} mm", names[name], *(f"{100 * np.mean([one[part] for one in seeds]):.0f} %"
                             for part in ("bump", "else")), *(", ".join(str(one[key]) for one in seeds)
                             for key in ("count", "turned")), f"{np.mean([one['degrees'] for one in seeds]):.1f}"])  # fmt: skip
                if height == 2.0:
                    drawn.append((f"{title},\n{names[name]}", *seeds[0]["map"]))
    page.table("power", ["bodies", "bump", "alignment", "of the bump", "of the rest", "vertices", "turned", "degrees"], rows)
    page.measured("power")
    page.picture("power", maps(drawn))


def part_limits(page, quick):
    """Cases that a correspondence can't determine, or only in part."""
    members, degree = (6, 8) if quick else (12, 12)
    turns = [np.diag(signs) for signs in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1))]
    surfaces, _, marks = bench.generated("ellipsoids", members)
    upright = [measured.rotation(*pair) for pair in zip(marks, bench.generated("ellipsoids", members, True)[2])]
    group = sp.shape.correspond(surfaces, degree)
    raw, best = [], []
    for source in range(members):
        for target in (index for index in range(members) if index != source):
            turn, shift = upright[target]
            carried = group.carry(marks[source], source, target) @ turn + shift
            own = marks[target] @ turn + shift
            each = [np.linalg.norm(carried @ half - own, axis=1).mean() for half in turns]
            raw.append(each[0])
            best.append(min(each))
    turned = float((np.array(raw) > np.array(best) + 1e-9).mean())
    doubt = sum("pose is doubtful" in text for text in group.warnings)
    page.table("poses", ["ellipsoids", "pairs a half turn apart", "places, mm", "after the best half turn", "named as in doubt"],
               [[members, f"{100 * turned:.0f} %", f"{np.mean(raw):.2f}", f"{np.mean(best):.2f}", doubt]])  # fmt: skip
    parts(page, quick)
    page.measured("limits")


def bodies(count):
    """Returns bodies with three unequal axes. The last but one has a horn of 8 mm; the last lacks its end beyond 13
    mm."""
    directions, faces = bench.sphere(5)
    horn, found = np.array([0, 0.6, 0.8]), []
    for seed in range(count):
        waves = np.random.default_rng(seed).normal(size=(16, 3)) * 0.5 / (1 + np.arange(16))[:, None]
        vertices = directions * [20, 13, 9] + sp.Model(waves).evaluate(directions)
        # One end is raised, so that no half turn maps a body to itself.
        vertices[:, 2] += 3 * np.maximum(directions[:, 0], 0) ** 3
        if seed == count - 2:
            vertices += 8 * np.exp((directions @ horn - 1) / 0.02)[:, None] * horn
        found.append(vertices)
    cut = faces[(found[-1][faces][:, :, 0] < 13).all(1)]
    return found, [faces] * (count - 1) + [cut]


def parts(page, quick):
    """Parts missing in the template, and parts missing in a subject."""
    vertices, faces = bodies(5 if quick else 8)
    surfaces = [bench.turned_at_random(sp.Surface(*each), seed)[0] for seed, each in enumerate(zip(vertices, faces))]
    last = len(surfaces) - 1
    group = sp.shape.correspond(surfaces, 12, template=0)
    *usual, horned, cut = group.report["members"]
    rows = []
    for title, members in (("the others, at most", usual), ("with a horn of 8 mm", [horned]), ("without its end", [cut])):
        named = sum(text.startswith(f"{member['name']}:") for member in members for text in group.warnings)
        rows.append([title, *(f"{max(member[key] for member in members):.3g}"
                     for key in ("cover_farthest", "unreached", "without_counterpart")), named])  # fmt: skip
    page.table("parts", ["member", "farthest from the template, mm", "share not reached", "places without counterpart", "warnings"], rows)
    # All bodies have corresponding vertices, so the vertices of the last body's missing end are known.
    gone = vertices[last][:, 0] > 13
    told = ~np.asarray(group.carried(np.asarray(surfaces[0].vertices), 0, last).reached)
    page.table("told", ["places", "number", "marked as without counterpart"],
               [["on the end that the member lacks", int(gone.sum()), f"{100 * told[gone].mean():.0f} %"],
                ["elsewhere", int((~gone).sum()), f"{100 * told[~gone].mean():.1f} %"]])  # fmt: skip
    print("\n".join(group.warnings), flush=True)


def main():
    warnings.simplefilter("ignore", sp.errors.SpharmWarning)
    known = {name[5:]: part for name, part in globals().items() if name.startswith("part_")}
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(known)}; all by default")
    parser.add_argument("--quick", action="store_true", help="few members and labellings, into target/validation")
    arguments = parser.parse_args()
    page = Page(arguments.quick)
    for name in arguments.parts or known:
        if name not in known:
            parser.error(f"{name}: expected one of {', '.join(known)}")
        started = time.perf_counter()
        known[name](page, arguments.quick)
        print(f"({name}: {time.perf_counter() - started:.0f} s)", flush=True)


if __name__ == "__main__":
    sys.exit(main())
