#!/usr/bin/env python3
"""Measures the table of docs/parameterisation.md: the quality of each method's map of each mesh, and of a fit over it.

`./run parametrize-table` calls it; it needs `parametrize`, `fit`, `reconstruct`, `compare` and `generate` on the PATH.
Uses Python's standard library only. Exits with 1 if a required limit is missed.
"""

import argparse
import json
import math
import pathlib
import subprocess
import sys
import tempfile
import time

# name, file, subdivisions before the fit, degree, largest permitted msd of a fit over cald (None: no limit)
MESHES = [
    ("head", "head.obj", 2, 100, 3e-7),
    ("bowl", "bowl.obj", 1, 50, 1e-6),
    ("spot", "spot.obj", 0, 40, 8e-6),
    ("homer", "homer.obj", 0, 60, 5e-6),
    ("nefertiti", "nefertiti.obj", 0, 100, 8e-7),
    ("hippo_a01_l", "hippo_a01_l.obj", 0, None, None),
    ("hippo_a02_l", "hippo_a02_l.obj", 0, None, None),
    ("hippo_a03_l", "hippo_a03_l.obj", 0, None, None),
    ("fsaverage5", "fsaverage5.pial_left.gii.gz", 0, 80, 9e-7),
    ("cortex", None, 0, None, None),
]
VOLUMES = ["hippo_a01_l.nii.gz", "hippo_a02_l.nii.gz", "hippo_a03_l.nii.gz"]
# name, file, degree, largest permitted root mean square and Hausdorff distance between surface and model, with a
# bounding box of volume 1
SURFACES = [
    ("head", "head.obj", 60, 4.5e-4, 6.8e-3),
    ("homer", "homer.obj", 60, 5.5e-4, 6.5e-3),
    ("nefertiti", "nefertiti.obj", 100, 3.3e-4, 4.5e-3),
    ("fsaverage5", "fsaverage5.pial_left.gii.gz", 80, 7.5e-4, 6.9e-3),
    ("spot", "spot.obj", 40, 7.1e-4, 5.5e-3),
    ("bowl", "bowl.obj", 40, 1.00e-3, 8.7e-3),
    ("cort40962", "cort40962.surf.gii", 100, 1.7e-4, 2.5e-3),
    ("hippo_a01_l", "hippo_a01_l.obj", 30, 1.07e-2, 4.5e-2),
]
ICOSPHERE = 7  # subdivisions of the icosphere on which the model is measured
AREA_BAR = 0.10
QUADS_BAR = 5.0  # per cent
SECONDS_BAR = 60  # for meshes of at most 50,000 vertices


def read_obj(path):
    vertices, faces = [], []
    for line in open(path):
        words = line.split()
        if words[:1] == ["v"]:
            vertices.append([float(x) for x in words[1:4]])
        elif words[:1] == ["f"]:
            faces.append([int(word.split("/")[0]) - 1 for word in words[1:4]])
    return vertices, faces


def write_obj(path, vertices, faces):
    with open(path, "w") as out:
        out.writelines("v %r %r %r\n" % tuple(v) for v in vertices)
        out.writelines("f %d %d %d\n" % (a + 1, b + 1, c + 1) for a, b, c in faces)


def subdivide(vertices, faces, on_sphere):
    """Divides each triangle into four at the midpoints of its edges."""
    vertices, middles, split = list(vertices), {}, []

    def middle(a, b):
        key = (min(a, b), max(a, b))
        if key not in middles:
            point = [(x + y) / 2 for x, y in zip(vertices[a], vertices[b])]
            length = math.sqrt(sum(x * x for x in point)) if on_sphere else 1.0
            middles[key] = len(vertices)
            vertices.append([x / length for x in point])
        return middles[key]

    for a, b, c in faces:
        ab, bc, ca = middle(a, b), middle(b, c), middle(c, a)
        split += [[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]
    return vertices, split


def densify(source, target, times, on_sphere):
    vertices, faces = read_obj(source)
    for _ in range(times):
        vertices, faces = subdivide(vertices, faces, on_sphere)
    write_obj(target, vertices, faces)


def run(*command):
    """Runs a verb of spharm and returns its output."""
    done = subprocess.run(["spharm", *map(str, command)], capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{command[0]}: {done.stderr.strip()}")
    return done.stdout


def least_squares(folder, surface, sphere, degree):
    """Returns the msd of the least squares at the vertices, and the Hausdorff distance at four times as many points,
    both for a bounding box of volume 1."""
    report, model, dense, back = (folder / name for name in ["fit.json", "model.spharm.npz", "four.obj", "back.ply"])
    run("fit", "--sphere", sphere, "--surface", surface, "--objective", "vertices", "--max-degree", degree, "-o", model,
        "--report", report, "--force", "-q")
    densify(sphere, dense, 1, True)
    run("reconstruct", "--model", model, "--sphere", dense, "--double", "-o", back, "--force", "-q")
    compared = json.loads(run("compare", surface, back, "--surface-distance", "--json"))
    msd = json.loads(report.read_text())["surfaces"][0]["passes"][-1]["msd"]
    return dict(degree=degree, msd=msd, hausdorff=compared["surface_distance"]["hausdorff"] / compared["scale"])


def bare_fit(folder, surface, degree):
    """Fits a bare mesh; returns the distances between the mesh and its model on an icosphere, both ways, and the
    seconds of mapping and fitting."""
    report, model, back = (folder / name for name in ["fit.json", "model.spharm.npz", "back.ply"])
    started = time.monotonic()
    run("fit", "--surface", surface, "--max-degree", degree, "-o", model, "--report", report, "--force", "-q")
    seconds = time.monotonic() - started
    run("reconstruct", "--model", model, "--icosphere", ICOSPHERE, "--double", "-o", back, "--force", "-q")
    compared = json.loads(run("compare", surface, back, "--surface-distance", "--json"))
    found, scale = compared["surface_distance"], compared["scale"]
    reported = json.loads(report.read_text())["surfaces"][0]
    return dict(degree=degree, rms=found["rms"] / scale, hausdorff=found["hausdorff"] / scale, seconds=seconds,
                msd=reported["passes"][-1]["msd"], reported=reported["surface_distance"],
                mapping=reported["parametrization"]["seconds"], area_rms=reported["parametrization"]["quality"]["area_rms"])


def surfaces_table(data, wanted):
    """Returns the table of bare fits, and the limits that are missed."""
    rows, missed = [], []
    layout = "{:<12} {:>6} {:>9} {:>5} {:>9} {:>5} {:>9} {:>9} {:>9} {:>8} {:>7}"
    print(layout.format("surface", "degree", "rms", "/bar", "hausdorff", "/bar", "95 %", "msd", "area rms", "mapping", "seconds"))
    for name, file, degree, rms, hausdorff in SURFACES:
        surface = data / file
        if name not in wanted:
            continue
        if not surface.exists():
            print(f"{name}: {surface} doesn't exist: skipped", file=sys.stderr)
            continue
        with tempfile.TemporaryDirectory() as folder:
            row = bare_fit(pathlib.Path(folder), surface, degree)
        rows.append(row | dict(mesh=name))
        shares = row["rms"] / rms, row["hausdorff"] / hausdorff
        print(layout.format(
            name, degree, f"{row['rms']:.2e}", f"{shares[0]:.2f}", f"{row['hausdorff']:.2e}", f"{shares[1]:.2f}",
            f"{row['reported']['percentile95']:.2e}", f"{row['msd']:.2e}", f"{row['area_rms']:.2f}",
            f"{row['mapping']:.1f}", f"{row['seconds']:.1f}"), flush=True)
        for what, share in zip(["rms", "Hausdorff distance"], shares):
            if share > 1:
                missed.append(f"{name}, bare fit: {what} {share:.2f} times its bar")
    return rows, missed


def parametrize(folder, surface, method, *options):
    """Maps a surface to the sphere; returns the sphere and the report."""
    sphere, report = folder / f"{method}.obj", folder / f"{method}.json"
    run("parametrize", "--surface", surface, "--method", method, "--output", sphere, "--surface-output",
        folder / "its surface.obj", "--report", report, "--force", "-q", *options)
    return sphere, json.loads(report.read_text()) | dict(degree=None, msd=None, hausdorff=None)


HEADER = ("mesh", "method", "n", "flips", "area rms", "length", "stretch", "angle", "seconds", "degree", "msd", "hausdorff")
LAYOUT = "{:<12} {:<10} {:>6} {:>5} {:>8} {:>9} {:>8} {:>6} {:>7} {:>6} {:>9} {:>9}"


def line(name, method, row):
    """Formats a line of the table."""
    q, small = row["quality"], lambda x: f"{x:.2e}" if x else ""
    return LAYOUT.format(
        name, method, row["vertices"], q["flipped"] + q["degenerate"], f"{q['area_rms']:.4f}", f"{q['length_worst']:.3f}",
        f"{q['stretch']:.4f}", f"{q['angle_rms_degrees']:.2f}", f"{row['seconds']:.1f}", row["degree"] or "",
        small(row["msd"]), small(row["hausdorff"]))


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--data", type=pathlib.Path, default=pathlib.Path("../shared/data"))
    parser.add_argument("--methods", nargs="+", default=["cald", "conformal", "stretch", "deform"])
    parser.add_argument("--meshes", nargs="+", default=[name for name, *_ in MESHES])
    parser.add_argument("--surfaces", nargs="*", default=[name for name, *_ in SURFACES], help="bare meshes to fit")
    parser.add_argument("--fits", nargs="*", default=["cald"], help="methods to fit over")
    parser.add_argument("--json", type=pathlib.Path, help="write the rows to a file")
    arguments = parser.parse_args()

    rows, missed = [], []
    print(LAYOUT.format(*HEADER), flush=True)

    def add(name, method, row):
        rows.append(row | dict(mesh=name, method=method))
        print(line(name, method, row), flush=True)
        flips = row["quality"]["flipped"] + row["quality"]["degenerate"]
        if flips:
            missed.append(f"{name}, {method}: {flips} triangles flipped or degenerate")
        if row["seconds"] > SECONDS_BAR:
            missed.append(f"{name}, {method}: {row['seconds']:.0f} s, at most {SECONDS_BAR}")

    for name, file, subdivisions, degree, bar in MESHES:
        if name not in arguments.meshes:
            continue
        with tempfile.TemporaryDirectory() as folder:
            folder = pathlib.Path(folder)
            surface = arguments.data / file if file else folder / "cortex.surf.gii"
            if not file:
                run("generate", "--surface", surface, "-q")
            elif not surface.exists():
                print(f"{name}: {surface} doesn't exist: skipped", file=sys.stderr)
                continue
            dense = surface
            if degree and subdivisions:
                dense = folder / "surface.obj"
                densify(surface, dense, subdivisions, False)
            by_method = {}
            for method in arguments.methods:
                sphere, row = parametrize(folder, surface, method)
                by_method[method] = row["quality"]
                if degree and method in arguments.fits:
                    fine = sphere
                    if subdivisions:
                        fine = folder / "dense.obj"
                        densify(sphere, fine, subdivisions, True)
                    row |= least_squares(folder, dense, fine, degree)
                add(name, method, row)
                if method == "cald" and row["quality"]["area_rms"] > AREA_BAR:
                    missed.append(f"{name}, cald: area rms {row['quality']['area_rms']:.3f}, at most {AREA_BAR}")
                if method == "cald" and bar and row["msd"] and row["msd"] > bar:
                    missed.append(f"{name}, cald: msd {row['msd']:.2e} at degree {degree}, at most {bar:.0e}")
            worst = {method: quality["length_worst"] for method, quality in by_method.items()}
            if worst.get("cald", 0.0) >= worst.get("conformal", math.inf):
                missed.append(f"{name}: worst length distortion {worst['cald']:.2f} by cald, {worst['conformal']:.2f} by "
                              "conformal")
    for volume in VOLUMES if arguments.meshes == [name for name, *_ in MESHES] else []:
        path = arguments.data / volume
        if not path.exists():
            print(f"{volume}: {path} doesn't exist: skipped", file=sys.stderr)
            continue
        with tempfile.TemporaryDirectory() as folder:
            _, row = parametrize(pathlib.Path(folder), path, "equal-area")
        add(volume.split(".")[0], "equal-area", row)
        most = row["quad_area_deviation"] * 100
        print(f"{'':<12} areas of quadrangles within {most:.3f} % of equal", flush=True)
        if most > QUADS_BAR:
            missed.append(f"{volume}: quadrangles differ by {most:.1f} % in area, at most {QUADS_BAR:.0f} %")

    print("\n`fit` of bare meshes: distances between surface and model, both ways, and msd at the vertices")
    found, missing = surfaces_table(arguments.data, arguments.surfaces)
    rows += found
    missed += missing
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1))
    print("\n" + ("\n".join(["missed:"] + missed) if missed else "every bar is met"))
    sys.exit(1 if missed else 0)


if __name__ == "__main__":
    main()
