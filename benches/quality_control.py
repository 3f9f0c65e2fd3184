#!/usr/bin/env python3
"""Measures how many spoilt subjects the quality control of a study finds: `./run bench quality-control`.

Makes 200 label volumes of bent, tapered bodies the size of a hippocampus (0.9 x 0.9 x 1.5 mm), of which 40 are spoilt in
eight ways, five subjects each, and runs `spharm study` on them. Prints the flags by the way of spoiling, the number of
flags of subjects that aren't spoilt, and the size of the page. The exit status is 1 if a spoilt subject isn't flagged, or
more than 4 others are.
"""

import argparse
import csv
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

PROGRAM = Path(__file__).resolve().parent.parent / "target" / "release" / "spharm"
VOXEL = np.array([0.9, 0.9, 1.5])
SHAPE = (72, 56, 40)
MOST_FALSE = 4

STUDY = """
title = "Quality control"
output = "out"
[subjects]
table = "subjects.tsv"
[fit]
max_degree = 12
arguments = ["--fix"]
[quality]
plain = false
[[test]]
name = "group"
effect = "group"
permutations = 200
"""


def body(random, scale=1.0):
    """Returns the mask of a body: a tube of radius r(t) around a bent curve, in a slightly different pose each time."""
    vary = lambda spread: 1 + spread * np.clip(random.standard_normal(), -2.5, 2.5)
    length, radius, bend, taper = 17 * vary(0.06), 6.2 * vary(0.06), 9 * vary(0.12), 0.3 * vary(0.15)
    angles = 0.1 * random.standard_normal(3)
    turn = np.eye(3)
    for axis, angle in enumerate(angles):
        a, b = [k for k in range(3) if k != axis]
        step = np.eye(3)
        step[a, a] = step[b, b] = np.cos(angle)
        step[a, b], step[b, a] = -np.sin(angle), np.sin(angle)
        turn = step @ turn
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in SHAPE), indexing="ij"), -1) * VOXEL
    points = (grid - 0.5 * VOXEL * SHAPE + random.uniform(-1, 1, 3)) @ turn / scale
    inside = np.zeros(SHAPE, bool)
    for t in np.linspace(-1, 1, 81):
        centre = np.array([length * t, bend * (t * t - 0.4), 2.5 * t**3])
        r = radius * (1 + taper * t) * np.sqrt(max(0.0, 1 - 0.6 * t**4))
        inside |= ((points - centre) ** 2).sum(-1) < r * r
    return inside


def write(path, values, voxel=VOXEL):
    """Writes a NIfTI-1 file with an sform, of bytes or of 32-bit floats."""
    values = values.astype("<f4" if values.dtype.kind == "f" else "u1")
    header = np.zeros(352, np.uint8)
    put = lambda at, values, kind: header.__setitem__(
        slice(at, at + np.asarray(values, kind).nbytes), np.frombuffer(np.asarray(values, kind).tobytes(), np.uint8)
    )
    put(0, [348], "<i4")
    put(40, [3, *values.shape, 1, 1, 1, 1], "<i2")
    put(70, [16, 32] if values.dtype.kind == "f" else [2, 8], "<i2")
    put(76, [1, *voxel, 0, 0, 0, 0], "<f4")
    put(108, [352], "<f4")
    put(123, [2], "u1")
    put(254, [1], "<i2")
    for row in range(3):
        put(280 + 16 * row, [voxel[row] * (k == row) for k in range(3)] + [0], "<f4")
    header[344:348] = np.frombuffer(b"n+1\0", np.uint8)
    path.write_bytes(header.tobytes() + values.tobytes(order="F"))


def spoilt(kind, random, path, others):
    """Writes the volume of a spoilt subject."""
    mask = body(random)
    if kind == "unit":
        write(path, mask, VOXEL / 10)
    elif kind == "spacing":
        write(path, mask, VOXEL * [1, 1, 2])
    elif kind == "flipped side":
        write(path, mask[::-1] if random.random() < 0.5 else mask[:, :, ::-1])
    elif kind == "cut":
        first = np.flatnonzero(mask.any((1, 2)))
        write(path, mask[(first[0] + 2 * first[-1]) // 3 - 12 :])
    elif kind == "duplicate":
        path.write_bytes(others[random.integers(len(others))].read_bytes())
    elif kind == "other organ":
        points = (np.stack(np.meshgrid(*(np.arange(n) for n in SHAPE), indexing="ij"), -1) - 0.5 * np.array(SHAPE)) * VOXEL
        write(path, (points**2 / np.array([13, 8, 10]) ** 2).sum(-1) < 1)
    elif kind == "noise":
        for _ in range(4):
            near = np.zeros_like(mask)
            for axis in range(3):
                near |= mask ^ np.roll(mask, 1, axis)
            mask = mask ^ (near & (random.random(mask.shape) < 0.25))
        write(path, mask)
    elif kind == "two pieces":
        middle = int(np.flatnonzero(mask.any((1, 2))).mean()) + random.integers(-4, 5)
        mask[middle - 1 : middle + 1] = False
        write(path, mask)


KINDS = ["unit", "spacing", "flipped side", "cut", "duplicate", "other organ", "noise", "two pieces"]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--subjects", type=int, default=200)
    parser.add_argument("--each", type=int, default=5, help="subjects of each kind of spoiling")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="folder for the study, kept")
    given = parser.parse_args()
    random = np.random.default_rng(given.seed)
    folder = given.keep or Path(tempfile.mkdtemp(prefix="quality-control-"))
    folder.mkdir(parents=True, exist_ok=True)
    kinds = [kind for kind in KINDS for _ in range(given.each)]
    places = random.choice(given.subjects, len(kinds), replace=False)
    of = {f"s{place:03}": kind for place, kind in zip(places, kinds)}
    ids = [f"s{k:03}" for k in range(given.subjects)]
    fine = [folder / f"{name}.nii" for name in ids if name not in of]
    for path in fine:
        write(path, body(random))
    for name, kind in of.items():
        spoilt(kind, random, folder / f"{name}.nii", fine)
    rows = [f"{name}\t{name}.nii\t{'ab'[k % 2]}" for k, name in enumerate(ids)]
    (folder / "subjects.tsv").write_text("\n".join(["id\tsurface\tgroup", *rows]) + "\n")
    (folder / "study.toml").write_text(STUDY)
    started = time.monotonic()
    ran = subprocess.run([PROGRAM, "study", folder / "study.toml", "-q"], capture_output=True, text=True)
    seconds = time.monotonic() - started
    if not (folder / "out" / "quality.tsv").is_file():
        sys.exit(ran.stderr)
    table = list(csv.DictReader((folder / "out" / "quality.tsv").open(), delimiter="\t"))
    flagged = {row["id"]: row["flags"] for row in table if row["state"] in ("flagged", "failed")}
    copied = {name for name in flagged if name not in of and "same input" in flagged[name]}
    missed = [name for name in of if name not in flagged]
    false = [name for name in flagged if name not in of and name not in copied]
    counts, found = Counter(of.values()), Counter(of[name] for name in of if name in flagged)
    print(f"{'spoilt by':<16} {'subjects':>8} {'flagged':>8}  first flag of the first")
    for kind in KINDS:
        example = next((flagged[name] for name in of if of[name] == kind and name in flagged), "")
        print(f"{kind:<16} {counts[kind]:8} {found[kind]:8}  {example[:100]}")
    print(f"others flagged: {len(false)} of {given.subjects - len(of)}, at most {MOST_FALSE} allowed")
    for name in false:
        print(f"  {name}: {flagged[name][:150]}")
    for name in missed:
        print(f"missed: {name}, {of[name]}")
    page = (folder / "out" / "report.html").stat().st_size / 1e6
    pictures = sum(path.stat().st_size for path in (folder / "out" / "thumbnails").iterdir()) / given.subjects
    print(f"study: {seconds:.0f} s; page {page:.1f} MB; a picture {pictures:.0f} bytes")
    sys.exit(1 if missed or len(false) > MOST_FALSE else 0)


if __name__ == "__main__":
    main()
