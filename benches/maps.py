#!/usr/bin/env python3
"""Compares time, growth and memory of `cald` on folded surfaces with another build: `./run bench maps --beside PROGRAM`.

PROGRAM is a `spharm` of another commit: `git worktree add --detach target/start e2187b2`, then `cargo build --release`
there. Both programs run in turn, round after round, with the same number of threads, and medians are taken. Without
PROGRAM only the measurements of this build are made. Uses Python's standard library only. Exits with 1 if a required
limit is missed.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

SPHARM = Path(__file__).resolve().parent.parent / "target" / "release" / "spharm"
# For each number of subdivisions of the icosphere, the largest permitted time relative to the other program's.
SIZES = {6: 1 / 3, 7: 1 / 4, 8: 1 / 8}
GROWTH = 20  # largest ratio of the times of the largest and the smallest mesh, which has 1/16 of the vertices
BYTES = 2500  # largest memory of the largest mesh, in bytes per vertex
WORSE = 1.05
LAYOUT = "{:<8} {:>8} {:>9} {:>9} {:>9} {:>6} {:>9} {:>8} {:>8}"


def run(program, *arguments):
    """Runs a verb; returns its CPU seconds and its peak memory in bytes."""
    process = subprocess.Popen([program, *map(str, arguments), "-q"], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    # os.wait4 has already waited for the process, so Popen gets the exit status from here.
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"{program} {arguments[0]} exited with {process.returncode}")
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def measure(program, surface, folder, threads):
    report = folder / "map.json"
    processor, memory = run(program, "parametrize", "--surface", surface, "--method", "cald", "--threads", threads,
                            "--output", folder / "map.ply", "--report", report, "--force")
    found = json.loads(report.read_text())
    return dict(seconds=found["seconds"], processor=processor, memory=memory, vertices=found["vertices"],
                quality=found["quality"])


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--beside", type=Path, help="spharm of another commit")
    parser.add_argument("--sizes", type=int, nargs="+", default=list(SIZES), choices=list(SIZES))
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--json", type=Path, help="write the rows to a file")
    arguments = parser.parse_args()
    programs = {"this": SPHARM} | ({"other": arguments.beside} if arguments.beside else {})

    missed, rows, seconds = [], [], {}

    def bar(what, found, limit):
        print(f"{what}: {found:.3g}, at most {limit:.3g}", flush=True)
        if not found <= limit:
            missed.append(f"{what}: {found:.3g}, at most {limit:.3g}")

    print(LAYOUT.format("program", "vertices", "seconds", "cpu s", "B/vertex", "flips", "area rms", "length", "stretch"))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for size in arguments.sizes:
            surface = folder / "surface.ply"
            run(SPHARM, "generate", "--subdivisions", size, "--surface", surface, "--force")
            found = {program: [] for program in programs}
            for _ in range(arguments.rounds):
                for program, path in programs.items():
                    found[program].append(measure(path, surface, folder, arguments.threads))
            medians = {}
            for program, rounds in found.items():
                median = {key: statistics.median(r[key] for r in rounds) for key in ("seconds", "processor", "memory")}
                row = rounds[0] | median | dict(program=program)
                q = row["quality"]
                flips = q["flipped"] + q["degenerate"]
                medians[program] = row
                rows.append(row)
                print(LAYOUT.format(program, row["vertices"], f"{row['seconds']:.2f}", f"{row['processor']:.2f}",
                                    f"{row['memory'] / row['vertices']:.0f}", flips, f"{q['area_rms']:.4f}",
                                    f"{q['length_worst']:.3f}", f"{q['stretch']:.4f}"), flush=True)
            mine = medians["this"]
            seconds[size] = mine["seconds"]
            bar(f"n = {mine['vertices']}: flips", mine["quality"]["flipped"] + mine["quality"]["degenerate"], 0)
            if size == max(SIZES):
                bar(f"n = {mine['vertices']}: bytes a vertex", mine["memory"] / mine["vertices"], BYTES)
            if other := medians.get("other"):
                bar(f"n = {mine['vertices']}: share of the other's seconds", mine["seconds"] / other["seconds"], SIZES[size])
                for key in ("area_rms", "length_worst"):
                    bar(f"n = {mine['vertices']}: {key} over the other's", mine["quality"][key] / other["quality"][key], WORSE)
    first, last = min(SIZES), max(SIZES)
    if first in seconds and last in seconds:
        bar("seconds, 16 times the vertices", seconds[last] / seconds[first], GROWTH)
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1))
    print("\n" + ("\n".join(["missed:"] + missed) if missed else "every bar is met"))
    sys.exit(1 if missed else 0)


if __name__ == "__main__":
    main()
