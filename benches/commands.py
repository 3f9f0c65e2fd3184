#!/usr/bin/env python3
"""Compares time and memory of the README's commands with another build: `./run bench commands --beside PROGRAM`.

PROGRAM is the program `spharm` of another checkout. Each command is run in pairs, and each build is first in half of the
pairs. The table has the medians of time and peak memory, and the ratios of these medians: this build's divided by the
other's. Python's standard library only; on Unix.
"""

import argparse
import os
import shutil
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

SPHARM = Path(__file__).resolve().parent.parent / "target" / "release" / "spharm"

#: The commands of the README's "Use it", then those of `./run demo`, in an order in which all inputs exist. Each command
#: has the folders to remove before a run, so that the program can't reuse its results.
COMMANDS = [
    ("generate --subdivisions 5 --surface folded.ply --force", []),
    ("fit --surface folded.ply --max-degree 60 --output folded.spharm.npz --force", []),
    ("reconstruct --model folded.spharm.npz --icosphere 6 --output folded60.ply --force", []),
    ("generate --study meshes --subjects 12 --force", []),
    ("study init --table meshes/study.csv --force", []),
    ("study study.toml", ["study", ".study"]),
    ("generate --force --surface cortex.surf.gii --sphere sphere.surf.gii", []),
    ("generate --force --variant 1 --surface subject1.surf.gii", []),
    ("basis-build --sphere sphere.surf.gii --max-degree 100 --store store", ["store"]),
    ("fit {on} --surface cortex.surf.gii --passes 1 --granularity 100 -o cortex.1-100.spharm.npz", []),
    ("fit {on} --surface cortex.surf.gii --passes 2 --granularity 1 -o cortex.spharm.npz", []),
    ("fit {on} --surface cortex.surf.gii subject1.surf.gii --passes 2 --granularity 1 -o models", ["models"]),
    ("reconstruct --model cortex.spharm.npz --max-degree 100 -o degree100.ply --double --force", []),
    ("compare cortex.surf.gii degree100.ply -o error.ply --force", []),
    ("picture cortex.surf.gii degree100.ply --error -o picture.png --force", []),
    ("fit --surface cortex.surf.gii --max-degree 60 -o bare.spharm.npz --force", []),
]
STORE = "--store store --sphere sphere.surf.gii --max-degree 100 --force"


def run(program, command, folder):
    """Runs a command in a folder, and returns its seconds and its peak memory in MiB."""
    started = time.perf_counter()
    process = subprocess.Popen([program, *command.split(), "-q"], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    seconds = time.perf_counter() - started
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"error: {program} {command}: exit status {process.returncode}; run it in a terminal to see why")
    return seconds, usage.ru_maxrss / 1024


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--beside", type=Path, required=True, help="spharm of another commit")
    parser.add_argument("--pairs", type=int, default=5)
    given = parser.parse_args()
    print(f"{'command':<60}{'other':>9}{'this':>9}{'ratio':>8}{'other':>9}{'this':>9}{'ratio':>8}", flush=True)
    print(f"{'':<60}{'s':>9}{'s':>9}{'':>8}{'MiB':>9}{'MiB':>9}", flush=True)
    with tempfile.TemporaryDirectory() as site:
        builds = {}
        for name, program in [("other", given.beside), ("this", SPHARM)]:
            # Copies, because the size of a mapped program in memory depends on how its file was written.
            (Path(site) / name).mkdir()
            builds[name] = shutil.copy(program, Path(site) / f"spharm-{name}")
        for command, stale in COMMANDS:
            found = {name: [] for name in builds}
            for pair in range(given.pairs):
                for name in list(builds)[:: 1 if pair % 2 == 0 else -1]:
                    folder = Path(site) / name
                    for path in stale:
                        shutil.rmtree(folder / path, ignore_errors=True)
                    found[name].append(run(builds[name], command.format(on=STORE), folder))
            cells = ""
            for at, places in [(0, 3), (1, 0)]:
                other, this = (statistics.median(row[at] for row in found[name]) for name in ["other", "this"])
                cells += f"{other:>9.{places}f}{this:>9.{places}f}{this / other:>8.3f}"
            print(f"{command[:58]:<60}{cells}", flush=True)


if __name__ == "__main__":
    main()
