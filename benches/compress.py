"""Compares the size of compressed models at a given distance with Draco on the mesh and on simplifications of it.

    python benches/compress.py [--program target/release/spharm] [--fit PROGRAM] [--only cort40962 nefertiti]

Needs NumPy, DracoPy, fast-simplification, libigl and nibabel. The program fits, compresses, expands and evaluates
models, each step in its own process. Distances are measured here, in the same way for models and for Draco: root mean
square of the distances from 100,000 random points on either surface to the other one, with the bounding box scaled to
volume 1. Models are compressed with `--bare`, since Draco's files have no provenance either; the size with provenance
is printed as well.
"""

import argparse
import json
import math
import subprocess
import tempfile
from pathlib import Path

import DracoPy
import fast_simplification
import igl
import nibabel
import numpy as np

ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT.parent / "shared" / "data"
TARGETS = [1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4]
SURFACES = {
    "cort40962": ("cort40962.surf.gii", "cort40962.sphere.surf.gii", 100, 4600),
    "nefertiti": ("nefertiti.obj", None, 100, 3900),
    "fsaverage5": ("fsaverage5.pial_left.gii.gz", "fsaverage5.sphere_left.gii.gz", 80, None),
    "head27618": ("head27618.surf.gii", "head27618.sphere.surf.gii", 60, None),
}
POINTS = 100_000
rows = []


def bar(name, limit, reached, detail):
    rows.append({"bar": name, "limit": limit, "reached": reached, "detail": detail})
    met = "" if limit is None or reached <= limit else "  NOT MET"
    print(f"{name:<40} {'' if limit is None else limit:>6} {reached:>9}  {detail}{met}", flush=True)


def read_mesh(path):
    if ".gii" in path.name:
        image = nibabel.load(path)
        return image.darrays[0].data.astype(float), image.darrays[1].data.astype(np.int64)
    vertices, faces = igl.read_triangle_mesh(str(path))
    return np.asarray(vertices, float), np.asarray(faces, np.int64)


def sample(vertices, faces, seed):
    rng = np.random.default_rng(seed)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    face = rng.choice(len(faces), POINTS, p=area / area.sum())
    s, t = np.sqrt(rng.random(POINTS))[:, None], rng.random(POINTS)[:, None]
    return (1 - s) * a[face] + s * (1 - t) * b[face] + s * t * c[face]


class Original:
    def __init__(self, path):
        self.vertices, self.faces = read_mesh(path)
        self.scale = np.prod(np.ptp(self.vertices, axis=0)) ** (1 / 3)
        self.points = sample(self.vertices, self.faces, 0)

    def distance(self, vertices, faces):
        there = igl.point_mesh_squared_distance(sample(vertices, faces, 1), self.vertices, self.faces)[0]
        back = igl.point_mesh_squared_distance(self.points, vertices, faces)[0]
        return math.sqrt((there.mean() + back.mean()) / 2) / self.scale


class Spharm:
    def __init__(self, program, fit, name, folder, original):
        surface, sphere, degree, _ = SURFACES[name]
        self.program, self.folder, self.original, self.found = program, folder, original, {}
        self.model = folder / f"{name}.spharm.npz"
        spheres = ["--sphere", DATA / sphere] if sphere else []
        command = [fit, "fit", "-q", "--surface", DATA / surface, *spheres, "--max-degree", str(degree), "-o", self.model]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)

    def measured(self, model):
        mesh = self.folder / "mesh.ply"
        self.run("reconstruct", "--model", model, "--icosphere", 7, "--force", "-o", mesh)
        return self.original.distance(*read_mesh(mesh))

    def run(self, *arguments):
        command = [str(self.program), *map(str, arguments), "-q"]
        return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout

    def at(self, log_step, *options):
        """Returns bytes and distance for a step of the coefficients; the file is expanded in another process."""
        if (log_step, options) not in self.found:
            file, model = self.folder / "m.sphz", self.folder / "m.spharm.npz"
            step = repr(2.0**log_step)
            self.run("shape", "compress", self.model, "--step", step, *options, "--force", "-o", file)
            self.run("shape", "expand", file, "--force", "-o", model)
            self.found[log_step, options] = file.stat().st_size, self.measured(model)
        return self.found[log_step, options]

    def smallest(self, target):
        """Searches for the smallest file within a distance, with steps accurate to 1/64 of an octave; returns step,
        bytes and distance."""
        fine, coarse = -17.0, -4.0
        if self.at(fine, "--bare")[1] > target:
            return None
        while coarse - fine > 1 / 64:
            middle = (fine + coarse) / 2
            if self.at(middle, "--bare")[1] <= target:
                fine = middle
            else:
                coarse = middle
        return fine, *self.at(fine, "--bare")


def draco(original):
    """Returns bytes and distance of Draco on the mesh and on its simplifications."""
    found = []
    for part in [0, 0.5, 0.75, 0.875, 0.9375, 0.97, 0.985, 0.9925, 0.996]:
        vertices, faces = original.vertices.astype(np.float32), original.faces.astype(np.int32)
        if len(faces) * (1 - part) < 150:
            continue
        if part:
            vertices, faces = fast_simplification.simplify(vertices, faces, part)
        for bits in [6, 7, 8, 9, 10, 11, 12, 14]:
            data = DracoPy.encode(vertices, faces.astype(np.uint32), quantization_bits=bits, compression_level=10)
            mesh = DracoPy.decode(data)
            distance = original.distance(np.asarray(mesh.points, float), np.asarray(mesh.faces, np.int64))
            found.append((len(data), distance, len(faces) if part else None, bits))
    return found


def measure(program, fit, name):
    original = Original(DATA / SURFACES[name][0])
    with tempfile.TemporaryDirectory() as folder:
        spharm = Spharm(program, fit, name, Path(folder), original)
        print(f"# {name}, L = {SURFACES[name][2]}: the model is {spharm.measured(spharm.model):.2e} from the mesh", flush=True)
        others = draco(original)
        for target in TARGETS:
            mesh = min((n for n, d, faces, _ in others if d <= target and faces is None), default=None)
            simple = min((n for n, d, faces, _ in others if d <= target and faces is not None), default=None)
            peers = f"Draco {mesh}, simplified + Draco {simple}"
            ours = spharm.smallest(target)
            limit = SURFACES[name][3] if target == 1e-3 else None
            if ours is None:
                print(f"{name}, {target:g}: no file within this distance; {peers}", flush=True)
                continue
            step, size, distance = ours
            with_provenance, _ = spharm.at(step)
            detail = f"{distance:.3e}, step 2^{step:.2f}, {with_provenance} with provenance; {peers}"
            bar(f"{name}, bytes at {target:g}", limit, size, detail)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", type=Path, default=ROOT / "target" / "release" / "spharm")
    parser.add_argument("--fit", type=Path, help="program that fits [default: that of --program]")
    parser.add_argument("--only", nargs="*", choices=SURFACES, default=list(SURFACES))
    arguments = parser.parse_args()
    if not DATA.is_dir():
        raise SystemExit(f"{DATA} doesn't exist")
    for name in arguments.only:
        measure(arguments.program, arguments.fit or arguments.program, name)
    out = ROOT / "bench" / "compress.json"
    out.parent.mkdir(exist_ok=True)
    out.write_text(json.dumps(rows, indent=1) + "\n")
    missed = [row["bar"] for row in rows if row["limit"] is not None and row["reached"] > row["limit"]]
    print(f"not met: {', '.join(missed)}" if missed else "all bars met")


if __name__ == "__main__":
    main()
