"""Compares rotation of surfaces with ducc0's, and alignment with SPHARM-MAT's published results.

`./run bench shape` runs it, in a virtual environment with ducc0 and NumPy. Times of rotations are CPU seconds of one
thread of either program on the same arrays. Times of alignments are seconds with two threads, and CPU seconds as well.
The hippocampi are those of ../shared/data/shape; without them the rows 2a to 2e are skipped.
"""

import argparse
import json
import os
import subprocess
import tempfile
import time
from pathlib import Path

import ducc0
import numpy as np

ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT.parent / "shared" / "data" / "shape"
rows = []


def bar(name, limit, reached, detail=""):
    rows.append({"bar": name, "limit": limit, "reached": reached, "detail": detail})
    met = "" if reached <= limit else "  NOT MET"
    print(f"{name:<66} {limit:>10.6g} {reached:>12.7g}  {detail}{met}", flush=True)


class Program:
    """Runs the example `shape`, built by `./run bench shape`."""

    def __init__(self, folder):
        self.path = ROOT / "target" / "release" / "examples" / "shape"
        self.folder = folder
        if not self.path.exists():
            raise SystemExit(f"{self.path} is missing: ./run bench shape builds it")

    def run(self, threads, command, *arguments):
        """Writes the arrays and runs the program; returns its report and its output array."""
        given = []
        for at, argument in enumerate(arguments):
            if isinstance(argument, np.ndarray):
                path = self.folder / f"{at}.npy"
                np.save(path, argument)
                argument = path
            given.append(str(argument))
        out = self.folder / "out.npy"
        environment = os.environ | {"RAYON_NUM_THREADS": str(threads)}
        done = subprocess.run([self.path, command, *given, out], check=True, stdout=subprocess.PIPE, env=environment)
        return json.loads(done.stdout), np.load(out)


def degrees(max_degree):
    l = np.repeat(np.arange(max_degree + 1), 2 * np.arange(max_degree + 1) + 1)
    return l, np.arange((max_degree + 1) ** 2) - l * l - l


def to_alm(a):
    """Converts canonical real coefficients (K, c) to ducc0's (c, nalm), with the Condon-Shortley phase."""
    max_degree = int(round(np.sqrt(len(a)))) - 1
    alm = np.zeros((a.shape[1], (max_degree + 1) * (max_degree + 2) // 2), complex)
    for m in range(max_degree + 1):
        l = np.arange(m, max_degree + 1)
        at = m * (2 * max_degree + 1 - m) // 2 + l
        plus, minus = a[l * l + l + m].T, a[l * l + l - m].T
        alm[:, at] = plus if m == 0 else (-1) ** m / np.sqrt(2) * (plus - 1j * minus)
    return alm


def from_alm(alm, max_degree):
    a = np.zeros(((max_degree + 1) ** 2, len(alm)))
    for m in range(max_degree + 1):
        l = np.arange(m, max_degree + 1)
        values = alm[:, m * (2 * max_degree + 1 - m) // 2 + l].T
        if m == 0:
            a[l * l + l] = values.real
        else:
            a[l * l + l + m] = (-1) ** m * np.sqrt(2) * values.real
            a[l * l + l - m] = -((-1) ** m) * np.sqrt(2) * values.imag
    return a


def synthesis(a, u):
    max_degree = int(round(np.sqrt(len(a)))) - 1
    loc = np.stack([np.arctan2(np.hypot(u[:, 0], u[:, 1]), u[:, 2]), np.arctan2(u[:, 1], u[:, 0]) % (2 * np.pi)], 1)
    values = [
        ducc0.sht.synthesis_general(alm=alm[None], spin=0, lmax=max_degree, loc=loc, epsilon=1e-13, nthreads=2)[0]
        for alm in to_alm(a)
    ]
    return np.stack(values, 1)


def random_rotation(rng):
    w, x, y, z = (q := rng.normal(size=4)) / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def theirs(a, rotation):
    """Rotates with ducc0; returns the coefficients, and the CPU seconds of its three calls."""
    max_degree = int(round(np.sqrt(len(a)))) - 1
    alpha = np.arctan2(rotation[1, 2], rotation[0, 2])
    beta = np.arctan2(np.hypot(rotation[0, 2], rotation[1, 2]), rotation[2, 2])
    gamma = np.arctan2(rotation[2, 1], -rotation[2, 0])
    alm = to_alm(a)
    start = time.process_time()
    rotated = [ducc0.sht.rotate_alm(column, max_degree, gamma, beta, alpha, nthreads=1) for column in alm]
    seconds = time.process_time() - start
    return from_alm(np.stack(rotated), max_degree), seconds


def norms(a):
    max_degree = int(round(np.sqrt(len(a)))) - 1
    return np.sqrt(np.bincount(degrees(max_degree)[0], (a**2).sum(1)))


def rotations(program, repeats):
    rng = np.random.default_rng(1)
    limits = {100: (1e-13, 1e-14), 1000: (2e-12, 1e-13), 2000: (2e-12, 2e-13)}
    for max_degree, (of_values, of_coefficients) in limits.items():
        a = rng.normal(size=((max_degree + 1) ** 2, 3)) / (1 + degrees(max_degree)[0][:, None])
        rotation = random_rotation(rng)
        u = rng.normal(size=(2000, 3))
        u /= np.linalg.norm(u, axis=1)[:, None]
        count = repeats if max_degree < 2000 else 3
        mine, seconds = [], []
        for _ in range(count):
            # Both programs run in turn, because the load of the machine changes.
            times, b = program.run(1, "rotate", a, rotation, 2)
            c, first = theirs(a, rotation)
            mine.append(min(times["cpu"]))
            seconds.append(min(first, theirs(a, rotation)[1]))
        expected = synthesis(a, u @ rotation)
        off = [abs(synthesis(x, u) - expected).max() / abs(expected).max() for x in (b, c)]
        bar(f"1a rotation against resynthesis, L = {max_degree}", of_values, off[0], f"ducc0 {off[1]:.1e}")
        off = np.linalg.norm(b - c) / np.linalg.norm(a)
        bar(f"1b coefficients against ducc0, L = {max_degree}", of_coefficients, off)
        drift = [abs(norms(x) / norms(a) - 1).max() for x in (b, c)]
        if max_degree == 2000:
            bar(f"1c norms of degrees, L = {max_degree}", 5e-14, drift[0], f"ducc0 {drift[1]:.1e}")
        mine, seconds = np.median(mine), np.median(seconds)
        bar(f"1d CPU time / ducc0's, three columns, L = {max_degree}", 1.5, mine / seconds, f"{mine:.4f} s / {seconds:.4f} s")


def posed(a, rng):
    """Returns the surface after random rotations of parameters and space, by ducc0."""
    return theirs(a, random_rotation(rng))[0] @ random_rotation(rng).T


def rmsd(a, b):
    return np.linalg.norm(a - b) / np.sqrt(4 * np.pi)


def aligned(program, moving, targets, bandwidth=0, starts=0):
    """Aligns surfaces with the program; returns the remaining distances, and the program's times."""
    times, surfaces = program.run(2, "align", np.stack(moving), np.stack(targets), bandwidth, starts)
    return np.array([rmsd(a, b) for a, b in zip(surfaces, targets)]), times


def alignments(program):
    rng = np.random.default_rng(2)
    names = ["a01", "a02", "a03", "a04", "a05"]
    foe, shrec = ([np.load(DATA / f"hippo_{name}_r.{step}.npy") for name in names] for step in ["foe", "shrec"])
    known = [3.8725, 3.6126, 2.0627, 4.0112]
    target = foe[0]
    found, _ = aligned(program, foe[1:], [target] * 4)
    again, _ = aligned(program, [posed(a, rng) for a in foe[1:]], [target] * 4)
    for at, name in enumerate(names[1:]):
        registered = rmsd(shrec[at + 1], target)
        bar(f"2a rmsd of {name} to a01", known[at] + 1e-3, found[at], f"SPHARM-MAT {registered:.4f}")
    bar("2b the same after random rotations, largest difference", 1e-6, np.abs(again - found).max())
    itself, _ = aligned(program, [posed(target, rng) for _ in range(5)], [target] * 5)
    bar("2c to its own rotated copy / size", 1e-11, itself.max() / rmsd(target, 0 * target))
    pairs = [rng.choice(5, 2, replace=False) for _ in range(30)]
    moving, targets = [posed(foe[a], rng) for a, _ in pairs], [foe[b] for _, b in pairs]
    mine, spent = aligned(program, moving, targets)
    best = np.full(30, np.inf)
    for bandwidth, starts in [(5, 16), (8, 16), (13, 24)]:
        best = np.minimum(best, aligned(program, moving, targets, bandwidth, starts)[0])
    bar("2d random pairs of 30 whose best optimum was missed", 0, (mine > best * (1 + 1e-9)).sum())
    bar("2d CPU seconds of a pair", 0.1, np.median(spent["cpu"]))
    bar("   seconds of a pair, L = 12", 0.02, np.median(spent["seconds"]))
    group = np.stack([posed(a, rng) for a in foe])
    found, mean = program.run(2, "procrustes", group)
    ends = " ".join(f"{end[1]:.5f}" for end in found["found"]["ends"])
    registered = np.sqrt(np.mean([rmsd(a[1:], np.mean(shrec, 0)[1:]) ** 2 for a in shrec]))
    bar("2e spread of a01 to a05", 2.0840, found["found"]["spread"], f"SPHARM-MAT {registered:.4f}; starts {ends}")
    other = np.stack([posed(a, rng) for a in foe])
    _, mean_other = program.run(2, "procrustes", other)
    bar("   mean of the group in other poses, relative", 1e-6, np.abs(mean - mean_other).max() / np.abs(mean).max())


def times(program):
    """Measures times on generated surfaces: an ellipsoid with smooth bumps."""
    rng = np.random.default_rng(3)

    def surface(max_degree, base, own):
        l = degrees(max_degree)[0][:, None]
        decay = 1 / (1 + l) ** 2.5
        a = (base[: len(l)] + own * rng.normal(size=(len(l), 3))) * decay
        a[[3, 1, 2], [0, 1, 2]] += [6, 4, 3]
        return a

    for max_degree, limit in [(60, 0.2)]:
        base = rng.normal(size=((max_degree + 1) ** 2, 3))
        moving = [posed(surface(max_degree, base, 0.3), rng) for _ in range(10)]
        _, found = aligned(program, moving, [surface(max_degree, base, 0.3) for _ in range(10)])
        seconds, cpu = np.median(found["seconds"]), np.median(found["cpu"])
        bar(f"   seconds of a pair, L = {max_degree}", limit, seconds, f"CPU {cpu:.4f} s")
    base = rng.normal(size=(21**2, 3))
    group = np.stack([posed(surface(20, base, 0.5), rng) for _ in range(200)])
    found, _ = program.run(2, "procrustes", group)
    detail = f"CPU {found['cpu'][0]:.2f} s; rounds {[end[2] for end in found['found']['ends']]}"
    bar("   seconds of 200 surfaces in Procrustes, L = 20", 20, found["seconds"][0], detail)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    names = ["rotations", "alignments", "times"]
    parser.add_argument("--only", nargs="*", choices=names, default=names)
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    print(f"{'bar':<66} {'limit':>10} {'reached':>12}")
    with tempfile.TemporaryDirectory(dir=ROOT / "target") as folder:
        program = Program(Path(folder))
        if "rotations" in arguments.only:
            rotations(program, arguments.repeats)
        if "alignments" in arguments.only:
            if DATA.is_dir():
                alignments(program)
            else:
                print(f"# {DATA} doesn't exist: 2a to 2e are left out")
        if "times" in arguments.only:
            times(program)
    out = ROOT / "bench" / "shape.json"
    out.parent.mkdir(exist_ok=True)
    out.write_text(json.dumps(rows, indent=1, default=float) + "\n")
    missed = [row["bar"] for row in rows if row["reached"] > row["limit"]]
    print(f"{len(rows) - len(missed)} of {len(rows)} bars met" + (f"; not met: {', '.join(missed)}" if missed else ""))


if __name__ == "__main__":
    main()
