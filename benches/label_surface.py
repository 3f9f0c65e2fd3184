#!/usr/bin/env python3
"""Measures models of labels against the bodies that were turned into voxels: `./run bench label-surface`.

Balls and ellipsoids (half axes 1.6, 0.8, 0.8 times the radius, in six orientations) of 3 to 10 voxels' radius, in
voxels of three anisotropies, are fitted at degrees 8 to 20 with `spharm fit`: the label by default and as voxels, and
the shares of the voxels inside the body with --probability. `--radii 30` takes a quarter of an hour. Prints for each
radius first the label's own errors: that of its volume, and that of the area of the same body scaled to the label's
volume, which no surface with this volume and shape can avoid; then the largest errors of area (bar 2 %), sphericity
(bar 0.01) and volume (bar 0.5 % of the voxels' or shares' volume); and last the time of fitting the last label,
relative to fitting the voxels' own faces (bar 1.3). The exit status is 1 if the default or --probability misses a bar.
"""

import argparse
import csv
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from quality_control import PROGRAM, write

DEGREES = (8, 12, 16, 20)
VOXELS = ((1, 1, 1), (0.9, 0.9, 1.5), (0.2, 0.2, 0.6))
RADII = (3, 5, 10)
AXES = np.array([1.6, 0.8, 0.8])


def rotations():
    """Returns six orientations: along an axis, along two diagonals, and three that are generic."""
    random = np.random.default_rng(3)
    generic = [np.linalg.qr(random.standard_normal((3, 3)))[0] for _ in range(3)]
    half = np.sqrt(0.5)
    diagonal = np.array([[half, -half, 0], [half, half, 0], [0, 0, 1]])
    upright = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]])
    return [np.eye(3), upright, diagonal, *generic]


def ellipsoid(axes):
    """Returns area, volume and sphericity of an ellipsoid of revolution about the first axis, or a ball."""
    a, b = axes[0], axes[1]
    volume = 4 / 3 * np.pi * a * b * b
    e = np.sqrt(1 - (b / a) ** 2)
    area = 4 * np.pi * a * a if e == 0 else 2 * np.pi * b * b * (1 + a / (b * e) * np.arcsin(e))
    return area, volume, np.cbrt(36 * np.pi * volume**2) / area


def bodies(radius):
    yield "ball", np.full(3, float(radius)), np.eye(3)
    for number, rotation in enumerate(rotations()):
        yield f"ellipsoid{number}", radius * AXES, rotation


def label(axes, rotation, voxel, offset):
    """Returns the voxels whose centre is inside the ellipsoid."""
    size = np.ceil(2 * np.abs(rotation) @ axes / voxel).astype(int) + 5
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in size), indexing="ij"), -1)
    points = (grid - 0.5 * (size - 1) + offset) * voxel @ rotation
    return ((points / axes) ** 2).sum(-1) < 1


def shares(axes, rotation, voxel, offset, samples=6):
    """Returns the share of each voxel inside the ellipsoid, from samples ** 3 points in each voxel."""
    points = (np.arange(samples) + 0.5) / samples - 0.5
    moved = (offset + np.array([x, y, z]) for x in points for y in points for z in points)
    return sum(label(axes, rotation, voxel, at).astype(np.float32) for at in moved) / samples**3


def run(*arguments):
    return subprocess.run([PROGRAM, *map(str, arguments)], capture_output=True, text=True)


def show(radius, surface, degree, errors, refused):
    """Prints the ranges of the errors of area, sphericity and volume."""
    spans = [f"{low:+.3f} {high:+.3f}" for low, high in zip(errors.min(0), errors.max(0))]
    print(f"{radius:6g} {surface:>8} {degree:>6} {spans[0]:>16} {spans[1]:>20} {spans[2]:>16} {refused:8}", flush=True)


def seconds(path, models, surface):
    """Returns the seconds of one fit of a label at degree 12 with a kind of surface."""
    start = time.perf_counter()
    ran = run("fit", path, "--label-surface", surface, "--max-degree", 12, "-o", models, "--force", "-q")
    if ran.returncode:
        sys.exit(ran.stderr)
    return time.perf_counter() - start


def time_fits(path, pairs=9):
    """Times fits of a label with both kinds of surface in turn; prints the medians, and returns the median ratio."""
    models = path.with_suffix(".spharm.npz")
    for surface in ("smooth", "voxels"):
        seconds(path, models, surface)
    times = [[seconds(path, models, surface) for surface in ("smooth", "voxels")] for _ in range(pairs)]
    smooth, voxels = (statistics.median(column) for column in zip(*times))
    ratio = statistics.median(a / b for a, b in times)
    print(f"fit of {path.stem}, degree 12: {smooth:.3f} s, {voxels:.3f} s with voxels' faces, {ratio:.2f} times", flush=True)
    return ratio


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--radii", type=float, nargs="*", default=RADII)
    given = parser.parse_args()
    random = np.random.default_rng(1)
    missed = False
    print(f"{'radius':>6} {'surface':>8} {'degree':>6} {'area, %':>16} {'sphericity':>20} {'volume, %':>16} {'refused':>8}")
    for radius in given.radii:
        with tempfile.TemporaryDirectory() as folder:
            folder = Path(folder)
            truth, rows = {}, {"label": ["id\tsurface"], "shares": ["id\tsurface"]}
            for v, voxel in enumerate(VOXELS):
                voxel = np.array(voxel) / np.cbrt(np.prod(voxel))
                for name, axes, rotation in bodies(radius):
                    offset = random.uniform(-0.5, 0.5, 3)
                    volumes = {"label": label(axes, rotation, voxel, offset), "shares": shares(axes, rotation, voxel, offset)}
                    for kind, values in volumes.items():
                        path = folder / f"{name}.{v}.{kind}.nii"
                        write(path, values, voxel)
                        truth[path.stem] = (*ellipsoid(axes), values.sum())
                        rows[kind].append(f"{path.stem}\t{path.name}")
            for kind, lines in rows.items():
                (folder / f"{kind}.tsv").write_text("\n".join(lines) + "\n")
            own = np.array([voxels / volume - 1 for id, (_, volume, _, voxels) in truth.items() if id.endswith("label")])
            show(radius, "itself", "", 100 * np.column_stack([(1 + own) ** (2 / 3) - 1, np.zeros_like(own), own]), 0)
            for kind, surface, arguments in (
                ("label", "smooth", []),
                ("label", "voxels", ["--label-surface", "voxels"]),
                ("shares", "shares", ["--probability"]),
            ):
                for degree in DEGREES:
                    models = folder / f"{surface}{degree}"
                    ran = run("fit", "--manifest", folder / f"{kind}.tsv", "--max-degree", degree, "-o", models, "--keep-going",
                              "--no-surface-distance", "-q", *arguments)  # fmt: skip
                    table = folder / f"{surface}{degree}.csv"
                    measured = run("shape", "measure", models, "--names", "-o", table, "-q")
                    if measured.returncode:
                        sys.exit(ran.stderr + measured.stderr)
                    errors = []
                    for row in csv.DictReader(table.open()):
                        area, volume, sphericity, voxels = truth[row["model"]]
                        errors.append(
                            [
                                100 * (float(row["area"]) / area - 1),
                                float(row["sphericity"]) - sphericity,
                                100 * (float(row["volume"]) / voxels - 1),
                            ]
                        )
                    errors = np.array(errors)
                    show(radius, surface, degree, errors, len(rows[kind]) - 1 - len(errors))
                    if surface != "voxels":
                        missed |= bool((np.abs(errors).max(0) > [2, 0.01, 0.5]).any())
            missed |= time_fits(folder / f"{name}.{v}.label.nii") > 1.3
    sys.exit(missed)


if __name__ == "__main__":
    main()
