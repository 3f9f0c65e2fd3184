"""Signals, callbacks, threads and forked processes."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Callable

import numpy as np
import pytest

import spharm_rs as sp

#: Maximum time from a signal to the exception, in seconds.
SOON = 0.25


def interrupted(work: Callable[[], Any], after: float) -> float | None:
    """Returns the seconds from SIGINT to KeyboardInterrupt; None if the work was done before."""
    timer = threading.Timer(after, lambda: os.kill(os.getpid(), signal.SIGINT))
    start = time.perf_counter()
    timer.start()
    try:
        work()
    except KeyboardInterrupt:
        return time.perf_counter() - start - after
    finally:
        timer.cancel()
        timer.join()
    return None


def _works(folder: Path) -> dict[str, Callable[[], Any]]:
    surface, sphere = sp.example_surface(7)
    rough = np.random.default_rng(0).normal(size=(20_000, 3))
    store = sp.Store(folder / "store")
    poses = 360 * np.random.default_rng(1).uniform(size=(40, 2, 3))
    model = sp.fit(*sp.example_surface(4), 12)
    group = [sp.shape.rotate(model, parameters=p, object=o) for p, o in poses]
    return {
        "fit": lambda: sp.fit(rough, rough, 120, tolerance=1e-14),
        "parametrize": lambda: sp.parametrize(surface),
        "basis": lambda: store.build(sphere, 60),
        "factor": lambda: store.factor(rough, 70),
        "distance": lambda: sp.compare(surface, sphere, surface_distance=True, samples=4_000_000),
        "procrustes": lambda: sp.shape.procrustes(group, templates=40),
        "test": lambda: sp.shape.test(rough.T.repeat(20, axis=0), [0, 1] * 30, permutations=1_000_000),
    }


@pytest.mark.parametrize("work", ["fit", "parametrize", "basis", "factor", "distance", "procrustes", "test"])
def test_an_interrupt_is_raised_soon(work: str, tmp_path: Path) -> None:
    call = _works(tmp_path)[work]
    late = interrupted(call, 0.5)
    assert late is not None, f"{work} was done within half a second"
    # Other processes may slow this test down, so the limit is loose: it only shows that the work doesn't run to its
    # end. `bench_python.py` measures the times.
    assert late < 4 * SOON


def test_progress_is_reported_and_its_exception_raised() -> None:
    surface, sphere = sp.example_surface(5)
    calls: list[tuple[str, int, int]] = []
    sp.fit(surface, sphere, 60, progress=lambda *now: calls.append(now))
    assert calls and all(done <= total or total == 0 for _, done, total in calls)

    def failing(stage: str, done: int, total: int) -> None:
        raise LookupError(stage)

    with pytest.raises(LookupError):
        sp.parametrize(surface, progress=failing)
    with pytest.raises(ValueError, match="progress"):
        sp.parametrize(surface, progress=3)  # type: ignore[arg-type]
    sp.fit(surface, sphere, 20, progress=True)


def test_the_interpreter_is_free_during_a_fit() -> None:
    surface, sphere = sp.example_surface(6)
    gaps: list[float] = []
    stop = threading.Event()

    def watch() -> None:
        last = time.perf_counter()
        while not stop.is_set():
            time.sleep(0.001)
            now = time.perf_counter()
            gaps.append(now - last)
            last = now

    thread = threading.Thread(target=watch)
    thread.start()
    sp.fit(surface, sphere, 100)
    sp.Transform(sphere.vertices, 200).synthesis(np.ones((201**2, 3)))
    stop.set()
    thread.join()
    # The thread's ticks of a millisecond continued throughout.
    assert len(gaps) > 10 and np.median(gaps) < 0.05


def _child(queue: Any, transform: sp.Transform | None) -> None:
    if transform is not None:
        queue.put(float(transform.synthesis(np.ones((121, 3))).sum()))
    else:
        queue.put(float(sp.fit(*sp.example_surface(3), 8).coefficients.sum()))


@pytest.mark.parametrize("inherited", [False, True])
def test_a_forked_child_works(inherited: bool) -> None:
    surface, sphere = sp.example_surface(3)
    expected = float(sp.fit(surface, sphere, 8).coefficients.sum())
    transform = sp.Transform(sphere.vertices, 10) if inherited else None
    if transform is not None:
        expected = float(transform.synthesis(np.ones((121, 3))).sum())
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    for _ in range(5):
        process = context.Process(target=_child, args=(queue, transform))
        process.start()
        assert queue.get(timeout=60) == expected
        process.join(60)
        assert process.exitcode == 0


def test_threads_of_python_get_the_same_bits() -> None:
    surface, sphere = sp.example_surface(4)
    found: list[np.ndarray] = []
    threads = [threading.Thread(target=lambda: found.append(sp.fit(surface, sphere, 20).coefficients)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 4 and all(np.array_equal(found[0], other) for other in found)


def test_calls_with_one_thread_run_at_the_same_time() -> None:
    values = np.random.default_rng(0).normal(size=(60, 20_000))
    both = threading.Barrier(2, timeout=20)

    def meet(*_: Any) -> None:
        both.wait()
        raise LookupError

    def work(_: int) -> None:
        # Takes minutes: if the calls waited for each other, the barrier would break.
        with pytest.raises(LookupError):
            sp.shape.test(values, [0, 1] * 30, permutations=1_000_000, threads=1, progress=meet)

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(work, range(2)))


#: Prints the growth in bytes of the process's largest memory during 10,000 rounds of small calls.
SMALL_CALLS = """
import resource
import sys
import numpy as np
import spharm_rs as sp

surface, _ = sp.example_surface(2)
transform = sp.Transform(surface.vertices, 4)

def once():
    model = sp.Model(np.ones((25, 3)))
    model.evaluate(np.eye(3))
    (2 * model - model).truncate(2)
    sp.shape.describe(model)
    sp.as_surface((surface.vertices, surface.faces)).area
    transform.synthesis(np.ones((25, 3)))
    try:
        sp.repair((surface.vertices, surface.faces + 1))
    except sp.MeshError:
        pass

def largest():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)

for _ in range(1000):
    once()
before = largest()
for _ in range(10000):
    once()
print(largest() - before)
"""


def test_small_calls_lose_no_memory() -> None:
    done = subprocess.run([sys.executable, "-c", SMALL_CALLS], capture_output=True, text=True, check=True)
    assert int(done.stdout) < 2**20, done.stdout


def test_threads_may_solve_with_a_new_transform_at_once() -> None:
    code = """
import threading
import numpy as np, spharm_rs as sp
u = np.random.default_rng(0).normal(size=(300_000, 3))
for _ in range(10):
    transform = sp.Transform(u, 0)
    threads = [threading.Thread(target=sp.solve, args=(transform, u[:, 0])) for _ in range(6)]
    for thread in threads: thread.start()
    for thread in threads: thread.join()
"""
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)
