"""Mutations of our own code, which the tests of the mutated crate must catch.

cargo-mutants changes one place at a time in a copy of the repository. The copy and its build are kept, so that a mutant
costs only the build of its own crate and its tests. A full run takes a day or two, so each run tries a random sample
for its time, at least a few mutants of every crate; `--seed` repeats the sample. `tests/attack/survivors.txt` lists the
mutants that no test can catch, with the reasons.
"""

import json
import os
import random
import shutil
import tempfile
import time
from pathlib import Path

from common import KEPT, ROOT, Row, run

VERSION = "27.1.0"
CRATES = ["spharm-store", "spharm-surface", "spharm-solver"]
#: Number of mutants of a crate that are tried between two checks of the time, and at least, however short the time.
SHARD = 3
#: Smallest permitted share of mutants caught, and the number of mutants from which on this share is required.
LEAST, ENOUGH = 0.9, 20
#: Which tests of a crate are built and run; documentation examples are left out, because they would take most of the
#: time.
TESTS = ["--locked", "--lib", "--tests"]
# Files that aren't compiled here, so that no test could catch a mutant.
OTHER_PLATFORMS = ["--exclude", "crates/store/src/platform/windows.rs"]
OUTCOMES = ["caught", "missed", "timeout", "unviable"]


def run_part(site, seconds):
    row = Row("mutations of the code")
    program = installed(site, row)
    if program is None:
        return row
    bench = Bench(program)
    if not bench.refresh():
        site.skip(row, "git doesn't list the files of the repository")
        return row
    choose, found, whole, untried = random.Random(site.seed), Found(), 0.0, []
    for crate in CRATES:
        site.say(f"building and running the tests of {crate}")
        begun = bench.tests(crate)
        if begun.code != 0:
            site.find(row, "wrong", f"the tests of {crate} fail in {bench.tree}, without a mutant: {begun.last()}")
            continue
        names = bench.mutants(crate)
        limit = max(60, 10 * bench.tests(crate).seconds)
        shards = -(-len(names) // SHARD)
        one, started = Found(), time.monotonic()
        for number, shard in enumerate(choose.sample(range(shards), shards)):
            spent = time.monotonic() - started
            if number > 0 and spent + spent / number > seconds / len(CRATES):
                break
            one.add(bench.tried(crate, f"{shard}/{shards}", limit))
        spent = time.monotonic() - started
        for outcome, name in one.lines:
            site.log(f"{outcome}: {name}")
        each = spent / max(len(one.lines), 1)
        site.say(f"{crate}: {one.counts()}, of {len(names):,}; {each:.0f} s each")
        if one.tried() == 0:
            untried.append(crate)
        found.add(one)
        whole += each * len(names)
    row.done = f"{found.counts()}; all would take {whole / 3600:.0f} hours, ./run attack {whole / 60:.0f} mutants"
    if untried:
        site.skip(row, f"no mutant of {', '.join(untried)} was tried: give it more minutes")
    for name in found.missed():
        site.say(f"survives: {name}")
    if found.tried() >= ENOUGH and found.caught() < LEAST * found.tried():
        site.find(row, "wrong", f"only {found.caught()} of {found.tried()} mutants are caught: " + "; ".join(found.missed()))
    return row


class Found:
    """Outcomes of mutants: pairs of an outcome and a mutant's name."""

    def __init__(self):
        self.lines = []

    def add(self, other):
        self.lines += other.lines

    def of(self, *outcomes):
        return sum(outcome in outcomes for outcome, _ in self.lines)

    def caught(self):
        # A mutant whose tests don't end counts as caught.
        return self.of("caught", "timeout")

    def tried(self):
        return self.caught() + self.of("missed")

    def missed(self):
        return [name for outcome, name in self.lines if outcome == "missed"]

    def counts(self):
        return (f"{self.caught()} of {self.tried()} mutants caught, {self.of('explained')} explained, "
                f"{self.of('unviable')} don't compile")


class Bench:
    """A copy of the repository, with its build, in which cargo-mutants works; both are kept between runs."""

    def __init__(self, program):
        self.program = program
        self.tree, self.out = KEPT / "mutants/tree", KEPT / "mutants/out"
        # Use memory if possible, because the tests write thousands of small files.
        memory = Path("/dev/shm")
        scratch = memory if memory.is_dir() and os.access(memory, os.W_OK) else Path(tempfile.gettempdir())
        # Faster to build; the results of the tests don't depend on these settings.
        self.env = {"CARGO_TARGET_DIR": str(KEPT / "mutants/target"), "TMPDIR": str(scratch), "CARGO_PROFILE_DEV_DEBUG": "0",
                    "CARGO_PROFILE_DEV_OPT_LEVEL": "1"}
        self.reasons = explained()

    def refresh(self):
        """Updates the copy from the repository. Changed files get new modification times, so that cargo builds them
        again."""
        listed = run(["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"], cwd=ROOT)
        if listed.code != 0:
            return False
        names = {name for name in listed.out.decode().split("\0") if name and (ROOT / name).is_file()}
        for name in names:
            source, copy = ROOT / name, self.tree / name
            if not copy.is_file() or source.read_bytes() != copy.read_bytes():
                copy.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(source, copy)
        for path in self.tree.rglob("*"):
            if path.is_file() and str(path.relative_to(self.tree)) not in names:
                path.unlink()
        return True

    def tests(self, crate):
        """Builds and runs the tests of a crate without a mutation."""
        return run(["cargo", "test", "-q", "-p", crate, *TESTS], cwd=self.tree, limit=7200, env=self.env)

    def mutants(self, crate):
        """Returns the names of a crate's mutants."""
        ended = run([self.program, "mutants", "-d", self.tree, "-p", crate, "--list", "--json", *OTHER_PLATFORMS], limit=300)
        return [entry["name"] for entry in json.loads(ended.out)]

    def tried(self, crate, shard, limit):
        """Runs the tests on the mutants of a shard, at most `limit` seconds for each mutant; returns the outcomes."""
        shutil.rmtree(self.out, ignore_errors=True)
        self.out.mkdir(parents=True)
        args = [f"--cargo-arg={word}" for word in TESTS]
        # Never end cargo-mutants early, because the copy would then keep a mutation.
        run([self.program, "mutants", "-d", self.tree, "--in-place", "-p", crate, "-o", self.out, "--shard", shard, "--sharding",
             "round-robin", "--baseline", "skip", "--timeout", str(round(limit)), "--build-timeout", "1800", "--colors", "never",
             *OTHER_PLATFORMS, *args], limit=86400, env=self.env)
        found = Found()
        for outcome in OUTCOMES:
            file = self.out / "mutants.out" / f"{outcome}.txt"
            for name in file.read_text().splitlines() if file.is_file() else []:
                known = outcome == "missed" and without_place(name) in self.reasons
                found.lines.append(("explained" if known else outcome, name))
        return found


def installed(site, row):
    """Installs cargo-mutants if necessary; returns `None` if that isn't possible."""
    folder = KEPT / "attack-tools"
    path = folder / "bin/cargo-mutants"
    if VERSION not in run([path, "mutants", "--version"]).out.decode() if path.exists() else True:
        site.say(f"installing cargo-mutants {VERSION} (minutes)")
        ended = run(["cargo", "install", "-q", "cargo-mutants", "--version", VERSION, "--locked", "--debug", "--root", folder], limit=1800)
        if ended.code != 0:
            site.skip(row, f"cargo-mutants can't be installed: {ended.last()}")
            return None
    return path


def explained():
    """Returns the mutants that are known to survive: the text before the first ` -- ` of each line; a reason follows
    it."""
    path = ROOT / "tests/attack/survivors.txt"
    lines = path.read_text().splitlines() if path.is_file() else []
    return {line.split(" -- ")[0].strip() for line in lines if " -- " in line and not line.startswith("#")}


def without_place(name):
    """Returns `crates/a/src/b.rs:12:3: replace ...` without line and column, which change."""
    file, _, _, text = name.split(":", 3)
    return f"{file}:{text}"

