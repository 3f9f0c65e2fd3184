"""Attacks tests of groups: random designs against statsmodels, all relabellings, and studies without an effect.

    python3 tests/attack/designs.py PROGRAM [--seed 31] [--seconds 60]

Needs the Python package, NumPy, SciPy and statsmodels, which `./run attack statistics` installs into `target/python`. A
third of the time is spent on random designs, the rest on the fifteen designs of `benches/nulls.py`, in turn: the share
of studies with a family-wise p of at most 0.05 must not be significantly outside of 0.03 to 0.07. The last line of the
output is a JSON object with `name`, the counts of the checks, and `failures`.
"""

import argparse
import collections
import itertools
import json
import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "2")
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benches"))

try:
    import numpy as np
    import scipy.stats
    import spharm_rs as sp
    from statsmodels.regression.linear_model import OLS

    import nulls
except ImportError as missing:
    print(json.dumps({"name": "statistics", "skipped": f"no Python with {missing.name}: ./run attack statistics makes one"}))
    sys.exit(0)

#: A share of studies is significantly outside of its bounds if its binomial p is below this.
RARE = 1e-5


def design_of(rng):
    """Returns a random design of full rank, and a contrast of one or more rows."""
    columns = int(rng.integers(1, 5))
    n = int(rng.integers(columns + 3, 30))
    kinds = [np.ones(n), rng.normal(size=n), (np.arange(n) % 2).astype(float), rng.uniform(100, 110, n),
             (np.arange(n) < n // 3).astype(float), rng.exponential(size=n) / 100, rng.integers(0, 3, n).astype(float)]
    while True:
        design = np.column_stack([kinds[k] for k in rng.permutation(len(kinds))[:columns]])
        scaled = design / np.linalg.norm(design, axis=0)
        # Above this condition number, two correct programs differ in digits that the comparison checks.
        if np.linalg.cond(scaled) < 1e4:
            break
        columns = max(1, columns - 1)
    columns = design.shape[1]
    rows = 1 if columns == 1 or rng.random() < 0.6 else int(rng.integers(1, columns + 1))
    while True:
        contrast = rng.integers(-1, 2, size=(rows, columns)).astype(float)
        if np.linalg.matrix_rank(contrast) == rows:
            return design, contrast


def beside_statsmodels(rng):
    """Compares one random design with statsmodels; returns the failures."""
    design, contrast = design_of(rng)
    y = 10.0 ** rng.integers(-6, 7) * (rng.normal(size=(len(design), 6)) + 10 * rng.normal())
    found = sp.shape.test(y, design=design, contrast=contrast[0] if len(contrast) == 1 else contrast, permutations=0)
    fits = [OLS(column, design).fit() for column in y.T]
    tests = [fit.t_test(contrast) if len(contrast) == 1 else fit.f_test(contrast) for fit in fits]
    of = "tvalue" if len(contrast) == 1 else "fvalue"
    statistic, p = (np.array([float(np.squeeze(getattr(test, name))) for test in tests]) for name in (of, "pvalue"))
    what = f"{design.shape[0]} x {design.shape[1]}, contrast {contrast.tolist()}"
    # statsmodels inverts the covariance of the contrast's rows, so its accuracy depends on that matrix's condition
    # number.
    covariance = contrast @ np.linalg.inv(design.T @ design) @ contrast.T
    exact = max(1e-9, 1e-14 * np.linalg.cond(covariance))
    # Both programs lose digits if the mean is large relative to the residual.
    absolute = 1e-11
    failures = []
    for name, mine, theirs in (("statistic", found.statistic, statistic), ("p", found.p, p)):
        if np.abs(mine - theirs).max() > exact * np.abs(theirs).max() + absolute:
            failures.append(f"{what}: {name} {mine} in place of {theirs}")
    return failures


def brute_force(rng):
    """Compares a test of eight subjects (a mean with a covariate, or two groups) with a loop over all relabellings;
    returns the failures."""
    n, flips = 8, rng.random() < 0.5
    y = rng.normal(size=(n, 20)) + 0.5
    age = rng.uniform(20, 80, n)
    age -= age.mean()
    if flips:
        found = sp.shape.test(y, mean=True, covariates={"age": age})
        relabel = [np.diag(signs) for signs in itertools.product([1.0, -1.0], repeat=n)]
        design, nuisance = np.column_stack([np.ones(n), age]), age[:, None]
    else:
        group = np.repeat([1.0, -1.0], n // 2)
        found = sp.shape.test(y, groups=["a"] * (n // 2) + ["b"] * (n // 2))
        # All choices of the first group, each once.
        relabel = []
        for first in itertools.combinations(range(n), n // 2):
            relabel.append(np.eye(n)[[*first, *(k for k in range(n) if k not in first)]])
        design, nuisance = np.column_stack([group, np.ones(n)]), np.ones((n, 1))
    inverse = np.linalg.inv(design.T @ design)
    # Freedman and Lane: residuals of the reduced model are relabelled and tested in the full model.
    residual = y - nuisance @ np.linalg.lstsq(nuisance, y, rcond=None)[0]

    def t_of(values):
        beta = inverse @ (design.T @ values)
        rest = values - design @ beta
        return beta[0] / np.sqrt((rest**2).sum(0) / (n - 2) * inverse[0, 0])

    largest = np.array([np.abs(t_of(matrix @ residual)).max() for matrix in relabel])
    exact = (largest[None] >= np.abs(found.statistic)[:, None] * (1 - 1e-9)).mean(1)
    if np.abs(found.p_fwe - exact).max() > 0:
        return [f"{'flips' if flips else 'exchanges'} of {n}: family-wise p off by {np.abs(found.p_fwe - exact).max()}"]
    return []


def unlikely(hits, studies, low, high):
    """Returns whether a share of studies is outside the bounds by more than chance permits."""
    share = hits / studies
    if low <= share <= high:
        return False
    edge = low if share < low else high
    return scipy.stats.binomtest(hits, studies, edge).pvalue < RARE


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("program", help="the program, which isn't run: its library is, as the Python package")
    parser.add_argument("--seed", type=int, default=31, help="seed of the designs and studies")
    parser.add_argument("--seconds", type=float, default=float(os.environ.get("SPHARM_ATTACK_SECONDS", "60")))
    given = parser.parse_args()
    begun, failures, done = time.monotonic(), [], collections.Counter()
    rng = np.random.default_rng(given.seed)
    while time.monotonic() < begun + given.seconds / 3:
        failures += beside_statsmodels(rng)
        failures += brute_force(rng)
        done["random designs beside statsmodels"] += 1
        done["of eight subjects by brute force"] += 1
    fields, hits = nulls.smooth_fields(), collections.Counter()
    all_nulls, batch, rounds = nulls.nulls(), 10, 0
    while time.monotonic() < begun + given.seconds or rounds == 0:
        for null in all_nulls:
            hits[null.name] += round(batch * nulls.rate(null, batch, fields, given.seed, rounds * batch))
        rounds += 1
    studies = batch * rounds
    for null in all_nulls:
        if unlikely(hits[null.name], studies, *null.bounds):
            failures.append(f"{null.name}: family-wise error {hits[null.name] / studies:.3f} in {studies} studies without an effect")
    shares = [hits[null.name] / studies for null in all_nulls]
    row = {"name": "statistics", **done, f"studies of each of {len(all_nulls)} designs without an effect": studies,
           "family-wise errors": f"{min(shares):.3f} to {max(shares):.3f}", "failures": failures}
    print(json.dumps(row))
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
