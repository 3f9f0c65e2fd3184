#!/usr/bin/env python3
"""Measures the Python package against required limits: `./run bench python [--rounds N]`.

Speed is compared with `examples/peer` and with ducc0 on the same arrays, in turn; interrupts and forks are repeated as often as
requested.
"""

import argparse
import json
import multiprocessing
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import spharm_rs as sp

ROOT = Path(__file__).resolve().parent.parent
PEER = ROOT / "target" / "release" / "examples" / "peer"

sys.path.insert(0, str(ROOT / "tests" / "python"))
from test_process import interrupted


class Rows:
    def __init__(self):
        self.missed = False

    def bar(self, what, found, limit, unit=""):
        met = found <= limit
        self.missed |= not met
        print(f"{what:<66}{found:>10.3f}{unit:<4}{limit:>8.3f}{unit:<4}{'met' if met else 'MISSED'}", flush=True)


def seconds(work, rounds):
    work()
    found = []
    for _ in range(rounds):
        start = time.perf_counter()
        work()
        found.append(time.perf_counter() - start)
    return statistics.median(found)


def speed(rows, rounds):
    """Compares synthesis and fits with the library's own, in turn."""
    surface, sphere = sp.example_surface(6)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        coefficients = np.random.default_rng(0).normal(size=(101**2, 3))
        for file, array in [("d", sphere.vertices), ("f", surface.vertices), ("x", coefficients)]:
            np.save(folder / f"{file}.npy", array)
        transform = sp.Transform(sphere.vertices, 100)
        here, there, fits = [], [], []
        for _ in range(rounds):
            here.append(seconds(lambda: transform.synthesis(coefficients), 30))
            found = peer("transforms", folder / "d.npy", folder / "x.npy", 100, 1e-12, 30, folder / "out")
            there.append(statistics.median(found["synthesis"]))
            ours = seconds(lambda: sp.fit(surface.vertices, sphere.vertices, 100), 9)
            found = peer("fit", folder / "d.npy", folder / "f.npy", 100, 10)
            fits.append(ours / statistics.median(found["seconds"][1:]))
        rows.bar("synthesis, L = 100, n = 40,962, over the library's", statistics.median(a / b for a, b in zip(here, there)), 1.05)
        rows.bar("fit of arrays, L = 100, n = 40,962, over the library's", statistics.median(fits), 1.1)


def reported(rows, rounds):
    """Compares the time of a call with the seconds of its report, for a million and ten million samples."""
    for n, degree in [(10**6, 100), (10**7, 500)]:
        directions = fibonacci(n)
        surface = directions * (1 + 0.1 * directions[:, :1])
        planning, solving, bare, fitting = [], [], [], []
        for _ in range(rounds):
            plan, transform = timed(lambda: sp.Transform(directions, degree))
            first, _ = timed(lambda: sp.solve(transform, surface[:, 0]))  # computes moments, which the transform keeps
            ours, (_, report) = timed(lambda: sp.solve(transform, surface[:, 0]))
            planning.append(plan)
            solving.append(ours / sum(report["seconds"].values()))
            del transform
            bare.append(timed(lambda: sp.solve(directions, surface[:, 0], degree))[0] / (plan + 1.15 * first))
            ours, model = timed(lambda: sp.fit(surface, directions, degree))
            fitting.append(ours / sum(model.report["seconds"].values()))
            del model
        what = f"n = {n:,}, L = {degree}"
        print(f"planning, {what}: {statistics.median(planning):.3f} s")
        rows.bar(f"solve with a Transform, {what}, over its report", statistics.median(solving), 1.15)
        rows.bar(f"solve of directions, {what}, over planning and 1.15 first solves", statistics.median(bare), 1)
        rows.bar(f"fit of arrays, {what}, over its report", statistics.median(fitting), 1.15)


def beside_ducc0(rows, rounds):
    """Compares least squares of one channel at random directions with ducc0's, in turn, both to 1e-10: ours with a plan and
    moments of an earlier solve, neither of which ducc0 keeps."""
    import ducc0

    for n, degree, limit in [(10**6, 100, 0.1), (10**7, 500, 0.1), (10**7, 1000, 0.12)]:
        random = np.random.default_rng(0)
        at = random.normal(size=(n, 3))
        at /= np.linalg.norm(at, axis=1)[:, np.newaxis]
        values = 1 + 0.3 * at[:, 0] - 0.1 * at[:, 1] * at[:, 2] + random.normal(0, 0.01, n)
        location = np.stack([np.arccos(at[:, 2]), np.arctan2(at[:, 1], at[:, 0]) % (2 * np.pi)], axis=1)
        transform = sp.Transform(at, degree)
        first, _ = timed(lambda: sp.solve(transform, values))  # computes moments, which the transform keeps
        settings = {"lmax": degree, "loc": location, "spin": 0, "nthreads": os.cpu_count(), "maxiter": 500}
        ratios, ours, theirs, off = [], [], [], 0.0
        for _ in range(rounds if n < 10**7 else 1):
            mine, (found, _) = timed(lambda: sp.solve(transform, values))
            other, analysed = timed(lambda: ducc0.sht.pseudo_analysis_general(map=values[None].copy(), epsilon=1e-10, **settings))
            ours.append(mine)
            theirs.append(other)
            ratios.append(mine / other)
            off = max(off, np.abs(sp.convert.from_healpy(analysed[0])[:, 0] - found).max() / np.abs(found).max())
        what = f"n = {n:,}, L = {degree}"
        print(f"{what}: {statistics.median(ours):.3f} s (the first {first:.3f} s), ducc0 {statistics.median(theirs):.3f} s; coefficients differ by {off:.1e}")
        rows.bar(f"solve with a Transform, {what}, over ducc0", statistics.median(ratios), limit)
        del transform


def timed(work):
    start = time.perf_counter()
    result = work()
    return time.perf_counter() - start, result


def fibonacci(n):
    i = np.arange(n) + 0.5
    theta, phi = np.arccos(1 - 2 * i / n), np.pi * (1 + 5**0.5) * i
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], 1)


def peer(*arguments):
    done = subprocess.run([PEER, *map(str, arguments)], capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


MEMORY = """
import re, sys
import numpy as np, spharm_rs as sp
def status(field):
    return int(re.search(field + r":\\s+(\\d+) kB", open("/proc/self/status").read())[1]) * 1024
d = np.load(sys.argv[1])
sp.fit(d[:100], d[:100], 2, threads=2)  # so that memory used once per process isn't counted
before = status("VmRSS")
m = sp.fit(d, d, 50, threads=2)
print(status("VmHWM") - before)
"""


def memory(rows):
    """Measures the memory that a fit of (10^6, 3) takes in addition to the memory resident before, relative to the
    library's on the same arrays."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        np.save(folder / "d.npy", fibonacci(1_000_000))
        child = [sys.executable, "-c", MEMORY, str(folder / "d.npy")]
        ours = int(subprocess.run(child, capture_output=True, text=True, check=True).stdout)
        found = peer("fit", folder / "d.npy", folder / "d.npy", 50, 1)
    theirs = found["peak"] - found["before"]
    print(f"peak of a fit of (10^6, 3) above the arrays: {ours / 2**20:.0f} MiB, the library's {theirs / 2**20:.0f} MiB")
    rows.bar("memory of (10^6, 3), over the library's", ours / theirs, 1.1)


def interrupts(rows, times):
    surface, sphere = sp.example_surface(7)
    rough = np.random.default_rng(0).normal(size=(20_000, 3))
    rng = np.random.default_rng(1)
    with tempfile.TemporaryDirectory() as name:
        number = iter(range(10**6))
        works = {
            "fit": lambda: sp.fit(rough, rough, 100, tolerance=1e-14),
            "parametrize, 163,842 vertices": lambda: sp.parametrize(surface),
            "basis": lambda: sp.Store(Path(name) / str(next(number))).build(sphere, 60),
            "factor": lambda: sp.Store(Path(name) / str(next(number))).factor(rough, 80, memory="2GiB"),
            "surface distance": lambda: sp.compare(surface, sphere, surface_distance=True, samples=4_000_000),
        }
        for what, work in works.items():
            found = [interrupted(work, rng.uniform(0.1, 0.8)) for _ in range(times)]
            done = found.count(None)
            worst = max((x for x in found if x is not None), default=float("inf"))
            rows.bar(f"KeyboardInterrupt in {what}, worst of {times - done}", worst, 0.25, " s")


def child(queue, transform, x):
    queue.put(float(transform.synthesis(x).sum() + sp.fit(*sp.example_surface(3), 8).coefficients.sum()))


def forks(rows, times):
    transform, x = sp.Transform(sp.icosphere(3).vertices, 10), np.ones((121, 3))
    expected = float(transform.synthesis(x).sum() + sp.fit(*sp.example_surface(3), 8).coefficients.sum())
    context, wrong = multiprocessing.get_context("fork"), 0
    for _ in range(times):
        queue = context.Queue()
        process = context.Process(target=child, args=(queue, transform, x))
        process.start()
        try:
            wrong += queue.get(timeout=60) != expected
        except Exception:
            wrong += 1
        process.join(10)
        process.kill()
    rows.bar(f"forked children without the result, of {times}", wrong, 0)


def interpreter(rows):
    """Measures the longest time for which a call blocks other Python threads, compared with calls that keep both cores
    busy."""
    surface, sphere = sp.example_surface(6)
    calls = {
        "fit": lambda: sp.fit(surface, sphere, 100, threads=1),
        "parametrize": lambda: sp.parametrize(sp.example_surface(4)[0], threads=1),
        "synthesis": lambda: sp.Transform(sphere.vertices, 500, threads=1).synthesis(np.ones((501**2, 3))),
        "compare": lambda: sp.compare(surface, sphere, surface_distance=True, threads=1),
    }
    for what, call in calls.items():
        gaps, stop = [], threading.Event()

        def watch():
            last = time.perf_counter()
            while not stop.is_set():
                time.sleep(0.001)
                now = time.perf_counter()
                gaps.append(now - last)
                last = now

        thread = threading.Thread(target=watch)
        thread.start()
        call()
        stop.set()
        thread.join()
        rows.bar(f"{what} holds the interpreter for at most", max(gaps), 0.05, " s")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--interrupts", type=int, default=20)
    parser.add_argument("--forks", type=int, default=50)
    arguments = parser.parse_args()
    cpu = next((line.split(":")[1].strip() for line in open("/proc/cpuinfo") if line.startswith("model name")), "")
    print(f"{platform.machine()} {cpu}, {os.cpu_count()} cores, Python {platform.python_version()}, NumPy {np.__version__}")
    rows = Rows()
    reported(rows, arguments.rounds)
    beside_ducc0(rows, arguments.rounds)
    speed(rows, arguments.rounds)
    memory(rows)
    interpreter(rows)
    interrupts(rows, arguments.interrupts)
    forks(rows, arguments.forks)
    return int(rows.missed)


if __name__ == "__main__":
    sys.exit(main())
