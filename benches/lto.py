#!/usr/bin/env python3
"""Compares the transforms built with and without link-time optimisation: `./run bench lto [--rounds N]`.

Conda, distributions and sanitizers build with `lto = "off"`, which must not slow down the transforms. Each setting is
built in its own folder, and the programs are run in turn.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LIMIT = 1.3


def build(setting):
    target = ROOT / "target" / f"lto-{setting}"
    environment = {**os.environ, "CARGO_PROFILE_RELEASE_LTO": setting}
    command = ["cargo", "build", "-q", "--release", "--example", "peer", "--target-dir", target]
    subprocess.run(command, cwd=ROOT, env=environment, check=True)
    return target / "release" / "examples" / "peer"


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--rounds", type=int, default=5)
    arguments = parser.parse_args()
    settings = ["thin", "off"]
    programs = {setting: build(setting) for setting in settings}
    found = {setting: {"synthesis": [], "adjoint": []} for setting in settings}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        subprocess.run([programs["thin"], "sphere", "6", folder / "d.npy"], check=True)
        degree = 100
        # Writes an .npy file of three channels of ones without NumPy: the format's header, then the numbers.
        rows = (degree + 1) ** 2
        head = f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({rows}, 3), }}".ljust(117) + "\n"
        (folder / "x.npy").write_bytes(
            b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head.encode() + b"\0\0\0\0\0\0\xf0\x3f" * (3 * rows)
        )
        for _ in range(arguments.rounds):
            for setting in settings:
                command = [programs[setting], "transforms", "d.npy", "x.npy", str(degree), "1e-12", "30", "out"]
                done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
                report = json.loads(done.stdout)
                for what in found[setting]:
                    found[setting][what].append(statistics.median(report[what]))
    missed = False
    for what in ["synthesis", "adjoint"]:
        pairs = [b / a for a, b in zip(found["thin"][what], found["off"][what])]
        ratio = statistics.median(pairs)
        missed |= ratio > LIMIT
        times = ", ".join(f"{setting} {1e3 * statistics.median(found[setting][what]):.2f} ms" for setting in settings)
        print(f"{what}, L = 100, n = 40,962, three channels: {times}; off over thin {ratio:.2f}, at most {LIMIT}")
    return int(missed)


if __name__ == "__main__":
    sys.exit(main())
