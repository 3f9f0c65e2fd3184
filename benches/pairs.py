"""Compares transforms and least squares of two builds, in pairs of runs.

`./run bench pairs EXAMPLE` runs it: EXAMPLE is the example `peer` of another checkout, built there by `cargo build
--release --example peer`. The ratio is that of the medians, this build's time divided by the other's.
"""

import argparse
import json
import statistics
import subprocess
import tempfile
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent.parent / "target" / "release" / "examples" / "peer"


def run(program, *arguments):
    out = subprocess.run([program, *map(str, arguments)], check=True, stdout=subprocess.PIPE).stdout
    return json.loads(out) if out else {}


def targets(u):
    """Returns a bumpy surface over directions (n, 3)."""
    return 50 * u * (1 + 0.2 * np.sin(3 * u[:, :1] + 2 * u[:, 1:2]) + 0.02 * np.sin(40 * u[:, 1:2]))


def cases(folder):
    """Writes the arrays, and returns the arguments of each case."""
    random = np.random.default_rng(1)
    u = random.normal(size=(200_000, 3))
    np.save(folder / "random.npy", u / np.linalg.norm(u, axis=1)[:, None])
    run(HERE, "sphere", 6, folder / "ico6.npy")
    run(HERE, "sphere", 8, folder / "ico8.npy")
    for name in ["ico6", "ico8", "random"]:
        np.save(folder / f"{name}.targets.npy", targets(np.load(folder / f"{name}.npy")))
    for degree, channels in [(100, 3), (500, 1)]:
        np.save(folder / f"x{degree}.npy", random.normal(size=((degree + 1) ** 2, channels)))
    given = {name: (folder / f"{name}.npy", folder / f"{name}.targets.npy") for name in ["ico6", "ico8", "random"]}
    out = folder / "out"
    return {
        "40,962 directions, L = 100": ["transforms", given["ico6"][0], folder / "x100.npy", 100, 1e-12, 20, out],
        "655,362 directions, L = 500": ["transforms", given["ico8"][0], folder / "x500.npy", 500, 1e-12, 3, out],
        "least squares, 40,962, L = 100": ["lsq", *given["ico6"], 100, 1e-12, 1e-10, 10, out],
        "least squares, 655,362, L = 200": ["lsq", *given["ico8"], 200, 1e-12, 1e-10, 3, out],
        "least squares, 200,000 random, L = 150": ["lsq", *given["random"], 150, 1e-12, 1e-10, 3, out],
        "fit, 40,962, L = 100": ["fit", *given["ico6"], 100, 10],
        "Gram matrix, 40,962, L = 100": ["gram", given["ico6"][0], 100, 3],
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("example", help="the example `peer` of the other build")
    parser.add_argument("--pairs", type=int, default=9)
    given = parser.parse_args()
    times = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, arguments in cases(Path(folder)).items():
            for pair in range(given.pairs):
                builds = [("other", given.example), ("this", HERE)]
                # Each build is first in half of the pairs.
                for build, program in builds[:: 1 if pair % 2 == 0 else -1]:
                    for what, found in run(program, *arguments).items():
                        if isinstance(found, list) and found and isinstance(found[0], float):
                            times.setdefault((name, what), {}).setdefault(build, []).append(statistics.median(found))
    print(f"{'case':<40}{'part':<12}{'other, ms':>12}{'this, ms':>12}{'ratio':>8}")
    for (name, what), found in times.items():
        other, this = (1000 * statistics.median(found[build]) for build in ["other", "this"])
        print(f"{name:<40}{what:<12}{other:>12.2f}{this:>12.2f}{this / other:>8.3f}")


if __name__ == "__main__":
    main()
