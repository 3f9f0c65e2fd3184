"""Compares every method of `fit` with least squares in 50 digits, on small problems that are hard in 64-bit arithmetic.

    python3 tests/attack/numerics.py target/release/spharm [--problems 200] [--seed 14] [--verbose]

The problems have samplings of the entire sphere and of caps (conditions to 1e12 and beyond), weights over 20 decades,
repeated and missing rows, fewer rows than coefficients, values from 1e-290 to 1e290, and weights down to 1e-300 and up
to 1e300. The last line of the output is a JSON object: `name`, `cases` (number of fits checked), `failures`, `worst`
(the largest error of each method) and `skipped`. Exits with 1 if there are failures. Uses Python's standard library
only.
"""

import argparse
import collections
import json
import math
import os
import random
import subprocess
import sys
import tempfile
import time
import zipfile
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path
from typing import Any

from reference.least_squares import NOTHING, ZERO, Problem, harmonics, norm

# Largest error of a result reported as converged: the transforms' accuracy is 1e-12, the tolerance 1e-10.
OPTIMAL = 1e-9
# Largest condition of the basis at which methods that solve blocks by their Gram matrices still have correct digits.
CLEAR = 1e5
# Largest difference between the fitted values of a method that solves blocks and exact ones, relative to the targets:
# at condition 1, and its growth with the square of the condition.
FITTED = [1e-9, 1e-14]


@dataclass
class Case:
    """A random problem and the data of its files."""

    degree: int
    angles: list[tuple[float, float]]
    weights: list[float]
    values: list[float]
    what: str
    rows: list[list[Decimal]] = field(default_factory=list)

    def size(self) -> int:
        return (self.degree + 1) ** 2

    def exact(self, smoothness: float = 0.0) -> Problem:
        if not self.rows:
            self.rows = [harmonics(theta, phi, self.degree) for theta, phi in self.angles]
        order = [l for l in range(self.degree + 1) for _ in range(2 * l + 1)]
        penalty = [Decimal(smoothness) * (l * (l + 1)) ** 2 for l in order]
        return Problem(self.rows, self.weights, self.values, penalty)


def made(random: random.Random) -> Case:
    """Returns a random problem; each source of difficulty is drawn independently."""
    degree = random.choice([1, 2, 3, 3, 4, 4, 5])
    size = (degree + 1) ** 2
    rows = random.choice([size + 3, 2 * size, 3 * size, 3 * size, max(4, size // 2)])
    cap = random.choice([math.pi, math.pi, math.pi, 1.0, 0.3, 0.1])
    angles = []
    for _ in range(rows):
        theta = math.acos(1 - random.random() * (1 - math.cos(cap)))
        angles.append((theta, random.uniform(0, 2 * math.pi)))
    what = [f"degree {degree}", f"{rows} rows", f"cap {cap:.1f}"]
    if random.random() < 0.3:
        for _ in range(rows // 4):
            angles[random.randrange(rows)] = angles[random.randrange(rows)]
        what.append("repeated rows")
    decades = random.choice([0, 0, 2, 20])
    weights = [10.0 ** random.uniform(-decades / 2, decades / 2) for _ in range(rows)]
    what.append(f"weights over {decades} decades")
    if random.random() < 0.3:
        for _ in range(rows // 5):
            weights[random.randrange(rows)] = 0.0
        what.append("missing rows")
    unit = random.choice([0, 0, -290, -170, 155, 290])
    weight_unit = random.choice([0, 0, 0, -300, 290])
    weights = [weight * 10.0**weight_unit for weight in weights]
    values = [random.gauss(0, 1) * 10.0**unit for _ in range(rows)]
    what += [f"values of 1e{unit}", f"weights of 1e{weight_unit}"]
    return Case(degree, angles, weights, values, ", ".join(what))


class Program:
    """Runs the program on one case's files."""

    def __init__(self, program: Path, folder: Path, case: Case):
        self.program, self.folder, self.case = program, folder, case
        self.write("sphere.csv", ["theta,phi"], case.angles)
        self.write("f.csv", ["f"], [(value,) for value in case.values])
        self.write("weights.csv", ["w"], [(weight,) for weight in case.weights])
        self.write("table.csv", ["theta,phi,f,w"], [(*a, f, w) for a, f, w in zip(case.angles, case.values, case.weights)])

    def write(self, name: str, header: list[str], rows: list[tuple[float, ...]]) -> None:
        lines = header + [",".join(map(repr, row)) for row in rows]
        (self.folder / name).write_text("\n".join(lines) + "\n")

    def run(self, *arguments: str) -> tuple[str, str]:
        """Returns the output, or the error line; any other end of the program is a failure."""
        command = [str(self.program), *arguments]
        done = subprocess.run(command, cwd=self.folder, capture_output=True, text=True, timeout=120, check=False)
        if done.returncode == 0:
            return done.stdout, ""
        lines = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
        if done.returncode != 1 or len(lines) != 1:
            raise Failure(f"exit {done.returncode}: {done.stderr.strip()[-300:]}")
        return "", lines[0]

    def fit(self, *arguments: str) -> tuple[list[Decimal], dict[str, Any]] | str:
        """Returns coefficients and report, or the error line of a refusal."""
        (self.folder / "f.spharm.npz").unlink(missing_ok=True)
        given = [] if "--moments" in arguments else ["--sphere", "sphere.csv", "--surface", "f.csv", "--weights", "weights.csv"]
        degree = ["--max-degree", str(self.case.degree), "-o", "f.spharm.npz", "--json", "-q"]
        text, error = self.run("fit", *given, *degree, *arguments)
        return error or (coefficients(self.folder / "f.spharm.npz"), json.loads(text))


class Failure(Exception):
    """A wrong result, or a failure without an error message."""


def coefficients(path: Path) -> list[Decimal]:
    with zipfile.ZipFile(path) as archive:
        data = archive.read("coefficients.npy")
    header = 10 + int.from_bytes(data[8:10], "little")
    values = memoryview(data[header:]).cast("d")
    if not all(map(math.isfinite, values)):
        raise Failure("a coefficient that isn't finite was written")
    return [Decimal(value) for value in values]


def warned(report: dict[str, Any]) -> str:
    """Returns a report's warnings about numerical accuracy; that of a poorly determined degree is about noise."""
    parts = [*report.get("surfaces", [report]), report.get("fit", {})]
    told = [str(warning) for one in parts for warning in one.get("warnings", [])]
    return " ".join(warning for warning in told if "is poorly determined" not in warning)


def solver_report(report: dict[str, Any]) -> dict[str, Any]:
    return report["batches"][0] if "batches" in report else report.get("solver", report)


def full(case: Case, found: list[Decimal], report: dict[str, Any], smoothness: float = 0.0) -> float:
    """Checks a full least-squares fit against what its report claims, and against the smallest possible residual."""
    problem = case.exact(smoothness)
    _, condition, rank = problem.solve()
    optimality = float(problem.optimality(found))
    told = warned(report)
    clear = rank == case.size() and condition < CLEAR
    said = any(word in told for word in ("determine", "optimality", "rank"))
    # The coefficients have 53 bits; this is the effect on the gradient of rounding each of them.
    weight = sum(problem.weights, ZERO)
    scale = norm(problem.gradient([ZERO] * len(found)))
    rounding = float(norm(found) * (weight + max(problem.penalty)) / scale) * 1e-12 if scale else 0.0
    nothing = problem.objective([ZERO] * len(found))
    if problem.objective(found) > nothing * Decimal("1.000001"):
        raise Failure(f"is further from its target than zero is: {told}")
    if clear and said:
        raise Failure(f"warns of a problem of condition {float(condition):.1e}: {told}")
    if optimality > OPTIMAL + rounding and not said:
        raise Failure(f"claims to be optimal, and is to {optimality:.1e} (condition {float(condition):.1e})")
    if clear:
        least, _, _ = problem.solve()
        off = float(norm([a - b for a, b in zip(found, least)]) / max(norm(least), NOTHING * scale))
        if off > 1e-9 * float(condition) ** 2 + 1e-9:
            raise Failure(f"coefficients are off by {off:.1e} at condition {float(condition):.1e}")
    return optimality


def blocks(case: Case, found: list[Decimal], report: dict[str, Any]) -> float:
    """Compares the fitted values of passes over blocks with the same passes in exact arithmetic."""
    batch = solver_report(report)
    ranges = [(b["first_degree"] ** 2, (b["last_degree"] + 1) ** 2) for b in batch["blocks"]]
    refinements = sum(sweep["refinement"] for sweep in batch["sweeps"])
    problem = case.exact()
    x, worst = [ZERO] * case.size(), Decimal(1)
    for _ in range(len(batch["sweeps"]) - refinements):
        for first, end in ranges:
            left = Problem(problem.rows, case.weights, [0.0] * len(case.values), problem.penalty)
            left.targets = problem.residual(x)
            step, condition, rank = left.solve(range(first, end))
            worst = max(worst, condition if rank == end - first else Decimal(10) ** 30)
            x = [a + b for a, b in zip(x, step)]
    off = Problem(problem.rows, case.weights, case.values, problem.penalty)
    off.targets = [a - b for a, b in zip(problem.residual(x), problem.residual(found))]
    zero = [ZERO] * case.size()
    all_of_it = problem.objective(zero)
    error = float((off.objective(zero) / all_of_it).sqrt()) if all_of_it else 0.0
    allowed = FITTED[0] + FITTED[1] * float(worst) ** 2
    if error > allowed and worst < CLEAR and not refinements:
        raise Failure(f"fitted values are off by {error:.1e} at condition {float(worst):.1e}")
    if float((problem.objective(found) / all_of_it).sqrt()) > 1 + 1e-6:
        raise Failure("the fit is further from its target than none would be")
    return error if worst < CLEAR else 0.0


def norms(case: Case, found: list[Decimal], report: dict[str, Any]) -> None:
    """Compares the reported rms with the residual in 50 digits, also if the square of the rms is out of range."""
    if "surfaces" not in report:
        return
    last = report["surfaces"][0]["passes"][-1]
    told = last.get("rms_raw") or math.sqrt(last["msd_raw"])
    residual = case.exact().residual(found)
    rms = (sum((r * r for r in residual), ZERO) / len(residual)).sqrt()
    values = (sum((f * f for f in case.exact().targets), ZERO) / len(residual)).sqrt()
    rounding = Decimal("1e-11") * values + Decimal("1e-13") * norm(found)
    if abs(Decimal(told) - rms) > Decimal("1e-6") * rms + rounding:
        raise Failure(f"reports an rms of {told:.6e}, it is {rms:.6e}")


def check(program: Path, case: Case, tally: collections.Counter[str], worst: dict[str, float]) -> list[str]:
    failures = []
    with tempfile.TemporaryDirectory() as folder:
        run = Program(program, Path(folder), case)
        total = sum(case.weights)
        ridge = repr(1e-3 * total / case.size())
        basis, refused = run.run("basis-build", "--sphere", "sphere.csv", "--store", "store", "--max-degree", str(case.degree), "-q")
        moments = "--samples table.csv --angles theta phi --values f --weight w -o m.moments -q --max-degree".split()
        _, no_moments = run.run("moments", *moments, str(case.degree))
        store = ["--store", "store"]
        methods: list[tuple[str, list[str], Any]] = [
            ("lsq", [], full),
            ("lsq factor", ["--preconditioner", "factor"], full),
            ("lsq none", ["--preconditioner", "none"], full),
            ("lsq smoothness", ["--smoothness", ridge], lambda *a: full(*a, smoothness=float(ridge))),
            ("lsq store", ["--method", "lsq", *store], full),
            ("lsq moments", ["--moments", "m.moments"], full),
            ("nlsf", ["--method", "nlsf", *store], full),
            ("irf", ["--method", "irf", "--passes", "1", *store], blocks),
            ("irf passes", ["--method", "irf", "--passes", "3", "--granularity", "9", *store], blocks),
            ("sirf", ["--method", "sirf", *store], blocks),
            ("mirf", ["--method", "mirf", "--passes", "2", *store], blocks),
        ]
        for name, arguments, judge in methods:
            if (name == "lsq moments" and no_moments) or ("--store" in arguments and refused):
                # If squares of values are out of range, a program that sums them refuses the problem.
                tally["refused"] += 1
                continue
            try:
                found = run.fit(*arguments)
                if isinstance(found, str):
                    tally["refused"] += 1
                    if not any(word in found for word in ("determine", "range", "rank", "few", "more rows", "singular")):
                        raise Failure(f"refused: {found}")
                    continue
                error = judge(case, *found)
                norms(case, *found)
                worst[name] = max(worst.get(name, 0.0), error)
                tally["cases"] += 1
            except (Failure, subprocess.TimeoutExpired, KeyError) as problem:
                failures.append(f"{name}: {case.what}: {type(problem).__name__ if not str(problem) else problem}")
    return failures


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("program", type=Path, help="the program spharm")
    parser.add_argument("--problems", type=int, default=200, help="number of problems")
    parser.add_argument("--seconds", type=float, default=float(os.environ.get("SPHARM_ATTACK_SECONDS", "inf")),
                        help="how long to go on with them [default: until all are done]")
    parser.add_argument("--seed", type=int, default=14, help="seed of the problems")
    parser.add_argument("--verbose", action="store_true", help="print each problem")
    given = parser.parse_args()
    draw, failures = random.Random(given.seed), []
    tally: collections.Counter[str] = collections.Counter()
    worst: dict[str, float] = {}
    ends, problems = time.monotonic() + given.seconds, 0
    while problems < given.problems and time.monotonic() < ends:
        problems += 1
        case = made(draw)
        found = check(given.program.resolve(), case, tally, worst)
        failures += found
        if given.verbose or found:
            print(case.what, *found, sep="\n  ", flush=True)
    row = {
        "name": "numbers",
        "problems": problems,
        "cases": tally["cases"],
        "refused": tally["refused"],
        "failures": len(failures),
        "worst": {name: float(f"{error:.1e}") for name, error in worst.items()},
        "skipped": "quadrature and fits of surfaces, which are no least squares of rows",
    }
    print(json.dumps(row))
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
