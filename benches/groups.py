"""Compares tests of groups with SciPy, statsmodels and nilearn, and with the simulated effects.

`./run bench statistics` runs it, with the Python package and these packages installed. The program generates groups
(`spharm generate --study`); the hippocampi of ../shared/data are also used if they exist.
"""

import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "2")

import numpy as np
import scipy.stats
import spharm_rs as sp
from nilearn.mass_univariate import permuted_ols
from statsmodels.regression.linear_model import OLS
from statsmodels.stats.multitest import multipletests

import nulls

DATA = Path(__file__).resolve().parent.parent.parent / "shared" / "data" / "shape"
PROGRAM = sys.argv[1] if len(sys.argv) > 1 else str(Path(sys.executable).parent / "spharm")
rows = []


def bar(name, limit, reached, detail="", lowest=None):
    met = reached <= limit and (lowest is None or reached >= lowest)
    rows.append(met)
    asked = f"{limit:g}" if lowest is None else f"{lowest:g} to {limit:g}"
    print(f"{name:<58} {asked:>14} {reached:>10.3g}  {detail}{'' if met else '  NOT MET'}", flush=True)


def values(seed, n=10, vertices=642):
    return np.random.default_rng(seed).normal(size=(n, vertices))


def against_others():
    y, groups = values(0), ["a"] * 5 + ["b"] * 5
    found = sp.shape.group_test(y, groups=groups)
    t, p = scipy.stats.ttest_ind(y[:5], y[5:])
    bar("4a t and p / SciPy's, relative", 1e-12, max(abs(found.statistic / t - 1).max(), abs(found.p / p - 1).max()))
    welch = sp.shape.group_test(y, groups=groups, welch=True, permutations=0)
    t, p = scipy.stats.ttest_ind(y[:5], y[5:], equal_var=False)
    bar("   Welch's", 1e-12, max(abs(welch.statistic / t - 1).max(), abs(welch.p / p - 1).max()))
    bar("   q / statsmodels' Benjamini-Hochberg", 1e-12, abs(found.q - multipletests(found.p, method="fdr_bh")[1]).max())
    first = np.array([g == "a" for g in groups], float)[:, None]
    theirs = permuted_ols(first, y, n_perm=20_000, random_state=0, n_jobs=1, verbose=0, output_type="dict")
    bar("   t / nilearn's, relative", 1e-12, abs(theirs["t"][0] / found.statistic - 1).max())
    largest = []
    for chosen in itertools.combinations(range(10), 5):
        mask = np.isin(np.arange(10), chosen)
        largest.append(abs(scipy.stats.ttest_ind(y[mask], y[~mask]).statistic).max())
    largest = np.array(largest)
    exact = (largest[None] >= abs(found.statistic)[:, None] * (1 - 1e-9)).mean(1)
    bar("4b family-wise p / brute force of all 252", 0.0, abs(found.p_fwe - exact).max())
    bar("   nilearn's 20,000 random ones", 0.012, abs(10 ** -theirs["logp_max_t"][0] - found.p_fwe).max())


def means():
    """Compares tests of means with a covariate, by sign flips, with statsmodels, with a loop over all flips, and with
    nilearn."""
    y = values(3, 10, 60) + 0.4
    age = np.random.default_rng(4).uniform(20, 80, 10)
    found = sp.shape.group_test(y, mean=True, covariates={"age": age})
    design = np.column_stack([np.ones(10), age - age.mean()])
    fits = [OLS(column, design).fit() for column in y.T]
    bar("a mean with a covariate: t / statsmodels', relative", 1e-11, abs(found.statistic / [fit.tvalues[0] for fit in fits] - 1).max())
    bar("   p", 1e-10, abs(found.p / [fit.pvalues[0] for fit in fits] - 1).max())
    slope = design[:, 1:] / np.linalg.norm(design[:, 1])
    residual = y - slope @ (slope.T @ y)
    largest = []
    for signs in itertools.product([1.0, -1.0], repeat=10):
        flipped = np.array(signs)[:, None] * residual
        flipped -= slope @ (slope.T @ flipped)
        mean = flipped.mean(0)
        square = ((flipped - mean) ** 2).sum(0) / 8
        largest.append(abs(mean / np.sqrt(square / 10)).max())
    exact = (np.array(largest)[None] >= abs(found.statistic)[:, None] * (1 - 1e-9)).mean(1)
    bar("   family-wise p / brute force of all 1,024 flips", 0.0, abs(found.p_fwe - exact).max())
    theirs = permuted_ols(
        np.ones((10, 1)), y, confounding_vars=design[:, 1:], model_intercept=False, n_perm=20_000, random_state=0, n_jobs=1,
        verbose=0, output_type="dict",
    )  # fmt: skip
    bar("   nilearn's 20,000 random ones", 0.012, abs(10 ** -theirs["logp_max_t"][0] - found.p_fwe).max())


def calibration(studies=1000):
    """Measures the share of false findings in studies without an effect."""
    fields = nulls.smooth_fields()
    for null in nulls.nulls():
        low, high = null.bounds
        bar(f"4c {null.name}", high, nulls.rate(null, studies, fields), f"family-wise error, {studies} nulls", lowest=low)
    for null in nulls.unequal():
        bar(f"4c {null.name}", null.bounds[1], nulls.rate(null, studies // 2, fields), f"{studies // 2} nulls")
    for a, b, effect in [(10, 10, 1.8), (5, 15, 2.0), (20, 60, 1.0)]:
        for components, of in [(1, "t"), (3, "T^2")]:
            shares = [nulls.power(a, b, welch, 300, fields, components, effect) for welch in (False, True)]
            print(f"   {a} and {b}, {effect} sd on a cap, {of}: found in {shares[0]:.2f}, by Welch's in {shares[1]:.2f} of 300 studies")


def speed():
    y = values(1, 100, 10_242)
    start = time.perf_counter()
    found = sp.shape.group_test(y, groups=[0] * 50 + [1] * 50, permutations=10_000)
    seconds = time.perf_counter() - start
    bar("10,000 permutations, 2 x 50 at 10,242 vertices, s", 20, seconds, f"{found.relabellings} relabellings")
    y = values(2, 100, 3 * 10_242).reshape(100, 10_242, 3)
    start = time.perf_counter()
    sp.shape.group_test(y, groups=[0] * 50 + [1] * 50, permutations=10_000)
    bar("   of positions (Hotelling's T-squared), s", 20, time.perf_counter() - start)


def hippocampi():
    """Tests two groups in random poses; the largest statistics don't depend on the positions of the vertices."""
    files = sorted(DATA.glob("*.foe.npy"))
    if not files:
        print(f"# {DATA} doesn't exist: 4d and 4e are left out")
        return
    rng = np.random.default_rng(7)
    models = [sp.Model(np.load(path)) for path in files]
    maxima = []
    for _ in range(2):
        posed = []
        for model in models:
            q = rng.normal(size=(2, 4))
            posed.append(sp.shape.rotate(model, parameters=q[0] / np.linalg.norm(q[0]), object=q[1] / np.linalg.norm(q[1])))
        group = sp.shape.procrustes(posed)
        found = sp.shape.group_test(group.models, groups=["a", "a", "a", "b", "b"], sphere=5, permutations=0)
        maxima.append(abs(found.statistic).max())
    bar("4e largest |t| of two random poses, relative", 1e-6, abs(maxima[0] / maxima[1] - 1), f"{maxima[0]:.6f}")


def published(name, degree=12):
    """Converts a hippocampus's published coefficients (complex, orthonormal, Condon-Shortley phase) to the canonical
    basis."""
    table = np.genfromtxt(DATA.parent / f"{name}.degree15.fvec.csv", delimiter=",", names=True)
    rows = np.zeros(((degree + 1) ** 2, 3))
    for entry in table:
        l, m = int(entry["l"]), int(entry["m"])
        if l <= degree and m >= 0:
            c = np.array([entry[f"{axis}_re"] + 1j * entry[f"{axis}_im"] for axis in "xyz"])
            other = table[(table["l"] == l) & (table["m"] == -m)][0]
            d = np.array([other[f"{axis}_re"] + 1j * other[f"{axis}_im"] for axis in "xyz"])
            # The published expansion describes a surface by the real part of its sum.
            if m == 0:
                rows[l * l + l] = c.real
            else:
                rows[l * l + l + m] = (c.real * (-1) ** m + d.real) / np.sqrt(2)
                rows[l * l + l - m] = (-c.imag * (-1) ** m + d.imag) / np.sqrt(2)
    return rows


def half_way():
    """Morphs halfway between two hippocampi in random poses."""
    if not (DATA.parent / "hippo_a01_l.degree15.fvec.csv").exists():
        return
    rng = np.random.default_rng(3)
    first, last = (sp.Model(published(name)) for name in ["hippo_a01_l", "hippo_a02_l"])
    q = rng.normal(size=(2, 4))
    posed = sp.shape.rotate(first, parameters=q[0] / np.linalg.norm(q[0]), object=q[1] / np.linalg.norm(q[1]))
    aligned = sp.shape.align(posed, last).model
    ends = [abs(sp.shape.measure(model).volume) for model in (first, last)]
    middle = abs(sp.shape.measure(sp.Model(0.5 * (aligned.coefficients + last.coefficients))).volume)
    bar("4d volume half way between two hippocampi, off 2899", 5, abs(middle - 2899), f"{middle:.1f}; ends {ends[0]:.0f}, {ends[1]:.0f}")


def retrieval(count=10_000, queries=50):
    """Perturbs some generated shapes, moves them to other poses, and searches for the originals among all generated
    shapes."""
    rng = np.random.default_rng(11)
    with tempfile.TemporaryDirectory() as folder:
        for name in ["among", "queries"]:
            Path(folder, name).mkdir()
        l = np.floor(np.sqrt(np.arange(121)))
        chosen = set(rng.choice(count, queries, replace=False).tolist())
        for number in range(count):
            x = rng.normal(size=(121, 3)) / (1 + l[:, None]) ** 2
            x[[3, 1, 2], [0, 1, 2]] += [9, 5, 3]
            sp.Model(x).save(Path(folder, "among", f"{number}.spharm.npz"))
            if number in chosen:
                noise = rng.normal(size=x.shape)
                x = x + 0.02 * noise * np.linalg.norm(x[1:]) / np.linalg.norm(noise)
                q = rng.normal(size=(2, 4))
                q /= np.linalg.norm(q, axis=1)[:, None]
                posed = sp.shape.rotate(sp.Model(x), parameters=q[0], object=q[1], translation=rng.normal(size=3))
                posed.save(Path(folder, "queries", f"{number}.spharm.npz"))
        done = subprocess.run(
            [PROGRAM, "shape", "match", "queries", "--among", "among", "--top", "1", "--json", "-q"],
            cwd=folder, check=True, stdout=subprocess.PIPE,
        )
        report = json.loads(done.stdout)
        first = [Path(q["query"]).name == Path(q["matches"][0]["model"]).name for q in report["queries"]]
        bar("3 perturbed and posed, first of 10,000: missed", 0, queries - sum(first), f"of {queries}")
        seconds = report["seconds"]
        bar("  seconds a query, after loading", 0.1, seconds["search"] / queries, f"loading {seconds['read']:.1f} s")


def study():
    with tempfile.TemporaryDirectory() as folder:
        def run(*arguments):
            subprocess.run([PROGRAM, *arguments], cwd=folder, check=True, stdout=subprocess.DEVNULL)

        start = time.perf_counter()
        run("generate", "--study", "meshes", "--subjects", "12", "--bump", "1.5")
        meshes = sorted(str(path) for path in Path(folder, "meshes").glob("*.ply"))
        run("fit", "--surface", *meshes, "--max-degree", "15", "-o", "models", "-q")
        run("shape", "align", "models", "--group", "-o", "aligned", "-q")
        groups = [sorted(str(path) for path in Path(folder, "aligned").glob(f"{name}*")) for name in "ab"]
        run("shape", "test", "--a", *groups[0], "--b", *groups[1], "-o", "test", "-q")
        seconds = time.perf_counter() - start
        table = np.genfromtxt(Path(folder, "test", "test.csv"), delimiter=",", names=True)
        peak = abs(table["effect"]).argmax()
        bar("a bump of 1.5 mm, 6 against 6: least family-wise p", 0.05, table["pfwe"].min(), f"{seconds:.1f} s from meshes")
        bar("   p where the effect is largest", 0.05, table["pfwe"][peak], f"effect {table['effect'][peak]:.2f} mm")


if __name__ == "__main__":
    print(f"{'bar':<58} {'limit':>14} {'reached':>10}")
    for part in [against_others, means, speed, calibration, hippocampi, half_way, retrieval, study]:
        part()
    print(f"{sum(rows)} of {len(rows)} bars met")
