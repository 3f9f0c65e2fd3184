"""Compares transforms and least squares of this project with ducc0's, on the same arrays, with two threads.

`./run bench peer` runs it, in a virtual environment with ducc0, NumPy and nibabel. All solutions are assessed by the
same code: msd and optimality are recomputed from the coefficients with ducc0's transforms at an accuracy of 1e-13.
"""

import argparse
import json
import os
import shutil
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

for name in ["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"]:
    os.environ.setdefault(name, "2")

import ducc0
import numpy as np

from bench import Cgroup

THREADS = 2
ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT.parent / "shared" / "data"
rows = []


def bar(name, limit, reached, detail):
    rows.append({"bar": name, "limit": limit, "reached": reached, "detail": detail})
    met = "" if limit is None or reached <= limit else "  NOT MET"
    print(f"{name:<58} {'' if limit is None else limit:>6} {reached:>9.3g}  {detail}{met}", flush=True)


def seconds(work, repeats):
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        result = work()
        times.append(time.perf_counter() - start)
    return statistics.median(times), result


class Peer:
    """Runs the example `peer`, built by `./run bench peer`."""

    def __init__(self):
        self.path = ROOT / "target" / "release" / "examples" / "peer"
        if not self.path.exists():
            raise SystemExit(f"{self.path} is missing: ./run bench peer builds it")

    def run(self, *arguments, wrap=lambda command: command):
        command = wrap([str(self.path), *map(str, arguments)])
        out = subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout
        return json.loads(out) if out else None


class Problem:
    """Directions and targets, as files for `peer` and as arrays in ducc0's layout."""

    def __init__(self, folder, name, directions, targets, max_degree):
        self.directions, self.targets, self.max_degree = directions, targets, max_degree
        self.files = [folder / f"{name}.{what}.npy" for what in ["directions", "targets"]]
        np.save(self.files[0], directions)
        np.save(self.files[1], targets)
        # The file has the vertices without normalisation, because `peer` normalises them: normalising them twice would
        # change the sampling.
        u = directions / np.linalg.norm(directions, axis=1)[:, None]
        self.loc = np.stack(
            [np.arctan2(np.hypot(u[:, 0], u[:, 1]), u[:, 2]), np.arctan2(u[:, 1], u[:, 0]) % (2 * np.pi)], axis=1
        )
        extent = targets.max(axis=0) - targets.min(axis=0)
        self.scale = extent.prod() ** (-1 / 3)

    def synthesis(self, alm, epsilon=1e-13):
        return ducc0.sht.synthesis_general(
            alm=alm, loc=self.loc, lmax=self.max_degree, spin=0, epsilon=epsilon, nthreads=THREADS
        )[0]

    def adjoint(self, samples, epsilon=1e-13):
        return ducc0.sht.adjoint_synthesis_general(
            map=samples[None].copy(), loc=self.loc, lmax=self.max_degree, spin=0, epsilon=epsilon, nthreads=THREADS
        )

    def analysis(self, epsilon, iterations):
        alms = []
        for column in self.targets.T:
            alms.append(
                ducc0.sht.pseudo_analysis_general(
                    lmax=self.max_degree,
                    map=column[None].copy(),
                    loc=self.loc,
                    spin=0,
                    nthreads=THREADS,
                    maxiter=iterations,
                    epsilon=epsilon,
                )[0]
            )
        return alms

    def judge(self, alms):
        """Returns the msd for a bounding box of volume 1, and the largest optimality among the columns."""
        square, optimality = 0.0, 0.0
        for alm, column in zip(alms, self.targets.T):
            residual = column - self.synthesis(alm)
            square += (residual**2).sum()
            optimality = max(optimality, norm(self.adjoint(residual)) / norm(self.adjoint(column)))
        return square / len(self.targets) * self.scale**2, optimality


def orders(max_degree):
    """Returns (degree, order) of ducc0's coefficients, which begin with order 0."""
    m = np.concatenate([np.full(max_degree + 1 - m, m) for m in range(max_degree + 1)])
    l = np.concatenate([np.arange(m, max_degree + 1) for m in range(max_degree + 1)])
    return l, m


def norm(alm):
    """Returns the norm of the real coefficients represented by these complex ones."""
    alm = np.asarray(alm)[0] if np.ndim(alm) == 2 else np.asarray(alm)
    max_degree = int((np.sqrt(8 * alm.size + 1) - 3) / 2)
    zero = alm[: max_degree + 1].real
    rest = alm[max_degree + 1 :]
    return np.sqrt((zero**2).sum() + 2 * (np.abs(rest) ** 2).sum())


def to_alm(coefficients, max_degree):
    """Converts canonical real coefficients (K,) to ducc0's, with the Condon-Shortley phase."""
    l, m = orders(max_degree)
    plus, minus = coefficients[l * l + l + m], coefficients[l * l + l - m]
    alm = np.where(m == 0, plus, (plus - 1j * minus) / np.sqrt(2) * (-1.0) ** m)
    return alm[None].astype(complex)


def canonical(max_degree, seed):
    return np.random.default_rng(seed).normal(size=((max_degree + 1) ** 2, 3))


def load(folder, name, max_degree):
    import nibabel

    sphere = nibabel.load(DATA / f"{name}.sphere.surf.gii").darrays[0].data.astype(float)
    surface = nibabel.load(DATA / f"{name}.surf.gii").darrays[0].data.astype(float)
    return Problem(folder, name, sphere, surface, max_degree)


def generated(peer, folder, name, subdivisions, max_degree):
    """Returns a problem: an icosphere, and a bumpy surface over it."""
    peer.run("sphere", subdivisions, folder / "sphere.npy")
    u = np.load(folder / "sphere.npy")
    radius = 1 + 0.2 * np.sin(3 * u[:, 0] + 2 * u[:, 1]) + 0.1 * np.cos(7 * u[:, 2] * u[:, 0]) + 0.02 * np.sin(40 * u[:, 1])
    return Problem(folder, name, u, 50 * u * radius[:, None], max_degree)


def transforms(peer, folder, repeats):
    rng = np.random.default_rng(1)
    for n, max_degree, limit in [(40_962, 100, 0.5), (1_000_000, 1_000, 0.9)]:
        u = rng.normal(size=(n, 3))
        u /= np.linalg.norm(u, axis=1)[:, None]
        problem = Problem(folder, "transforms", u, rng.normal(size=(n, 3)), max_degree)
        x = canonical(max_degree, 2)
        np.save(folder / "x.npy", x)
        count = 10 * repeats if n < 100_000 else max(3, repeats // 5)
        ours = peer.run("transforms", problem.files[0], folder / "x.npy", max_degree, 1e-12, count, folder / "out")
        alms = [to_alm(column, max_degree) for column in x.T]
        theirs, samples = seconds(lambda: [problem.synthesis(alm, 1e-12) for alm in alms], count)
        back, _ = seconds(lambda: [problem.adjoint(s, 1e-12) for s in samples], count)
        found = np.load(folder / "out.samples.npy")
        off = np.abs(found - np.stack(samples, axis=1)).max() / np.abs(found).max()
        assert off < 1e-11, f"the transforms differ from ducc0's by {off:.1e}"
        for what, time_theirs in [("synthesis", theirs), ("adjoint", back)]:
            mine = statistics.median(ours[what])
            bar(f"{what}, n = {n:,}, L = {max_degree}", limit, mine / time_theirs, f"{mine:.4f} s / {time_theirs:.4f} s")


def lsq(peer, problem, accuracy, tolerance, repeats, *more):
    out = problem.files[0].with_suffix("")
    ours = peer.run("lsq", *problem.files, problem.max_degree, accuracy, tolerance, repeats, out, *more)
    x = np.load(out.with_suffix(".coefficients.npy"))
    alms = [to_alm(column, problem.max_degree) for column in x.T[:3]]
    return statistics.median(ours["seconds"]), alms, ours["report"]


def scattered(folder, n, max_degree):
    """Returns a problem: random directions, and a smooth function with noise at them."""
    rng = np.random.default_rng(0)
    u = rng.normal(size=(n, 3))
    u /= np.linalg.norm(u, axis=1)[:, None]
    problem = Problem(folder, "samples", u, np.zeros((n, 1)), max_degree)
    x = rng.normal(size=(max_degree + 1) ** 2)
    x /= 1 + np.floor(np.sqrt(np.arange(x.size)))
    problem.targets = (problem.synthesis(to_alm(x, max_degree), 1e-12) + 0.1 * rng.normal(size=n))[:, None]
    np.save(problem.files[1], problem.targets)
    return problem


def samples(peer, folder, sizes):
    """Fits one channel on random directions, to an optimality of 1e-10."""
    limits = {(10**6, 100): 0.1, (10**7, 500): 0.1, (10**7, 1000): 0.12}
    per_iteration = {}
    for n, max_degree in [(int(float(n)), int(degree)) for n, degree in sizes]:
        limit = limits.get((n, max_degree))
        problem = scattered(folder, n, max_degree)
        repeats = 5 if n * max_degree <= 10**8 else 1
        mine, theirs = [], []
        for _ in range(repeats):
            # Both programs run in turn, because the load of the machine changes.
            seconds_mine, alms, report = lsq(peer, problem, 1e-12, 1e-10, 1)
            mine.append(seconds_mine)
            if limit is not None:
                seconds_theirs, found = seconds(lambda: problem.analysis(1e-10, 200), 1)
                theirs.append(seconds_theirs)
        _, optimality = problem.judge(alms)
        spent = report["seconds"]
        per_iteration[n, max_degree] = spent["iterations"] / report["iterations"]
        parts = f"moments {spent['moments']:.2f} s, {report['iterations']} iterations {spent['iterations']:.2f} s"
        print(f"# n = {n:,}, L = {max_degree}: optimality {optimality:.1e}, {parts}", flush=True)
        assert optimality <= 2e-10, optimality
        if limit is not None:
            mine, theirs = statistics.median(mine), statistics.median(theirs)
            _, reached = problem.judge(found)
            detail = f"{mine:.3f} s / {theirs:.3f} s; optimality {optimality:.1e}, ducc0's {reached:.1e}"
            bar(f"random samples, n = {n:,}, L = {max_degree}", limit, mine / theirs, detail)
    few, many = (10**6, 500), (10**7, 500)
    if few in per_iteration and many in per_iteration:
        few, many = per_iteration[few], per_iteration[many]
        bar("  an iteration at n = 10^7 / at 10^6, L = 500", 1.05, many / few, f"{many:.4f} s / {few:.4f} s")


def cortex(peer, folder, repeats):
    problem = load(folder, "cort40962", 100)
    reference = json.loads((DATA / "reference.json").read_text())["cort40962"]["results"]["least-squares L=100"]["msd"]
    # Searches for the coarsest epsilon at which ducc0 reaches the reference.
    for epsilon in [1e-3, 1e-4, 1e-5, 1e-6]:
        theirs, alms = seconds(lambda: problem.analysis(epsilon, 500), repeats)
        msd, optimality = problem.judge(alms)
        if abs(msd / reference - 1) <= 1e-6:
            break
    print(f"# ducc0 at epsilon {epsilon:g}: {theirs:.4f} s, msd {msd / reference - 1:+.1e}, optimality {optimality:.1e}")
    mine, alms, report = lsq(peer, problem, 1e-9, optimality, repeats)
    ours_msd, ours_optimality = problem.judge(alms)
    assert abs(ours_msd / reference - 1) <= 1e-6 and ours_optimality <= 1.5 * optimality, (ours_msd, ours_optimality)
    detail = f"{mine:.4f} s / {theirs:.4f} s; msd {ours_msd / reference - 1:+.1e}, optimality {ours_optimality:.1e}"
    bar("cort40962, L = 100, least squares", 0.2, mine / theirs, detail)
    many = Problem(folder, "batch", problem.directions, np.tile(problem.targets, (1, 32)), 100)
    many.targets = problem.targets
    mine, alms, report = lsq(peer, many, 1e-9, optimality, max(3, repeats // 3))
    msd, ours_optimality = problem.judge(alms)
    assert abs(msd / reference - 1) <= 1e-6 and ours_optimality <= 1.5 * optimality, (msd, ours_optimality)
    detail = f"{mine / 32:.4f} s / {theirs:.4f} s; optimality {ours_optimality:.1e}, by {report['products']}"
    bar("  each of a batch of 32", 0.08, mine / 32 / theirs, detail)
    stored(peer, folder, problem, reference, theirs, repeats)


def stored(peer, folder, problem, reference, theirs, repeats):
    store = folder / "store"
    spharm = ROOT / "target" / "release" / "spharm"
    sphere = DATA / "cort40962.sphere.surf.gii"
    command = [spharm, "basis-build", "--sphere", sphere, "--factor", 100, "--factor-only"]
    command += ["--store", store, "--memory", "4GiB", "-q"]
    subprocess.run(list(map(str, command)), check=True, stdout=subprocess.DEVNULL)
    # Write the store to the disk first, because otherwise writing would slow down the timed fits.
    os.sync()
    mine, alms, _ = lsq(peer, problem, 1e-9, 1e-7, repeats, "--store", store)
    msd, optimality = problem.judge(alms)
    assert abs(msd / reference - 1) <= 1e-6
    bar("  with the factor, one surface", 0.3, mine / theirs, f"{mine:.4f} s / {theirs:.4f} s; optimality {optimality:.1e}")
    many = Problem(folder, "batch", problem.directions, np.tile(problem.targets, (1, 32)), 100)
    many.targets = problem.targets
    mine, alms, report = lsq(peer, many, 1e-9, 1e-7, max(3, repeats // 3), "--store", store)
    msd, optimality = problem.judge(alms)
    assert abs(msd / reference - 1) <= 1e-6
    detail = f"{mine / 32:.4f} s / {theirs:.4f} s; optimality {optimality:.1e}, {report['preconditioner']}"
    bar("  with the factor, each of a batch of 32", 0.08, mine / 32 / theirs, detail)
    shutil.rmtree(store)


def head(peer, folder):
    problem = load(folder, "head27618", 100)
    reference = json.loads((DATA / "reference.json").read_text())["head27618"]["results"]["least-squares L=100"]["msd"]
    theirs, alms = seconds(lambda: problem.analysis(1e-13, 500), 3)
    msd, optimality = problem.judge(alms)
    print(f"# ducc0, 500 iterations: {theirs:.3f} s, msd {msd / reference - 1:+.1e}, optimality {optimality:.1e}")
    mine, alms, report = lsq(peer, problem, 1e-12, 1e-10, 3)
    msd, optimality = problem.judge(alms)
    assert abs(msd / reference - 1) <= 1e-4, msd / reference - 1
    detail = f"{mine:.3f} s / {theirs:.3f} s; msd {msd / reference - 1:+.1e}, optimality {optimality:.1e}, {report['preconditioner']}"
    bar("head27618, L = 100, least squares", 1.1, mine / theirs, detail)


def gram(peer, folder, repeats):
    n = 4642
    a = np.ones((n, n))
    dgemm, _ = seconds(lambda: a @ a, 3)
    mine = {}
    for subdivisions in [6, 8]:
        problem = generated(peer, folder, "gram", subdivisions, 100)
        mine[subdivisions] = statistics.median(peer.run("gram", problem.files[0], 100, max(3, repeats // 3))["seconds"])
    bar("Gram matrix, L = 100, n = 40,962 / dgemm of 2e11 flops", 1.0, mine[6] / dgemm, f"{mine[6]:.3f} s / {dgemm:.3f} s")
    bar("  n = 655,362 / n = 40,962", 1.3, mine[8] / mine[6], f"{mine[8]:.3f} s / {mine[6]:.3f} s")


def large(peer, folder, subdivisions, max_degree):
    problem = generated(peer, folder, "large", subdivisions, max_degree)
    out = problem.files[0].with_suffix("")
    with Cgroup(8 << 30) as group:
        if not group.works:
            print(f"# not in a cgroup of 8 GiB: {group.why}")
        wrap = group.inside if group.works else lambda command: command
        ours = peer.run("lsq", *problem.files, max_degree, 1e-10, 1e-8, 1, out, wrap=wrap)
    x = np.load(out.with_suffix(".coefficients.npy"))
    _, optimality = problem.judge([to_alm(column, max_degree) for column in x.T])
    mine = statistics.median(ours["seconds"])
    print(f"# ours: {mine:.1f} s, optimality {optimality:.1e}, peak {ours['peak'] / 2**30:.2f} GiB", flush=True)
    for epsilon in [1e-6, 1e-7, 1e-8]:
        theirs, alms = seconds(lambda: problem.analysis(epsilon, 500), 1)
        _, reached = problem.judge(alms)
        print(f"# ducc0 at epsilon {epsilon:g}: {theirs:.1f} s, optimality {reached:.1e}", flush=True)
        if reached <= 1e-8:
            break
    detail = f"{mine:.1f} s / {theirs:.1f} s; optimality {optimality:.1e}, ducc0's {reached:.1e}"
    bar(f"n = {len(problem.targets):,}, L = {max_degree}, least squares", 1.0, mine / theirs, detail)
    bar("  optimality / 1e-8", 1.0, optimality / 1e-8, f"{optimality:.1e}")
    bar("  peak memory / 6 GiB, in a cgroup of 8 GiB", 1.0, ours["peak"] / (6 << 30), f"{ours['peak'] / 2**30:.2f} GiB")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    names = ["transforms", "gram", "samples", "cortex", "head", "large"]
    parser.add_argument("--only", nargs="*", choices=names, default=names)
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--large", nargs=2, type=int, default=[10, 1000], metavar=("SUBDIVISIONS", "DEGREE"))
    sizes = ["1e6,100", "1e6,500", "1e7,500", "1e7,1000"]
    parser.add_argument("--samples", nargs="*", default=sizes, metavar="N,DEGREE")
    arguments = parser.parse_args()
    peer = Peer()
    print(f"{'bar':<58} {'limit':>6} {'reached':>9}")
    with tempfile.TemporaryDirectory(dir=ROOT / "target") as folder:
        folder = Path(folder)
        if "transforms" in arguments.only:
            transforms(peer, folder, arguments.repeats)
        if "gram" in arguments.only:
            gram(peer, folder, arguments.repeats)
        if "samples" in arguments.only:
            samples(peer, folder, [size.split(",") for size in arguments.samples])
        if DATA.is_dir():
            if "cortex" in arguments.only:
                cortex(peer, folder, arguments.repeats)
            if "head" in arguments.only:
                head(peer, folder)
        elif {"cortex", "head"} & set(arguments.only):
            print(f"# {DATA} doesn't exist: cort40962 and head27618 are left out")
        if "large" in arguments.only:
            large(peer, folder, *arguments.large)
    out = ROOT / "bench" / "peer.json"
    out.parent.mkdir(exist_ok=True)
    out.write_text(json.dumps(rows, indent=1) + "\n")
    missed = [row["bar"] for row in rows if row["limit"] is not None and row["reached"] > row["limit"]]
    print(f"{len(rows) - len(missed)} of {len(rows)} bars met" + (f"; not met: {', '.join(missed)}" if missed else ""))


if __name__ == "__main__":
    main()
