"""Races for one store: concurrent builders, extensions, readers and `gc`, on file systems with and without locks.

strace simulates a file system without locks: every `flock` of some of the processes fails with ENOLCK.
"""

import hashlib
import subprocess
import time

import verbs
from common import HANG, Row, environment, missing

BUILDERS = 16
DEGREE, EXTENDED = 8, 12


def tree(store):
    """Returns names and hashes of all files in a store."""
    return {
        str(path.relative_to(store)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in store.rglob("*") if path.is_file() and path.name != ".lock"
    }


class Race:
    """Processes that are started together, and then waited for."""

    def __init__(self, site, row, folder, inputs):
        self.site, self.row, self.folder, self.inputs = site, row, folder, inputs
        self.store = folder / "store"
        self.processes = []

    def start(self, words, locks=True, may_fail=False):
        # With --seccomp-bpf, strace interrupts the process only at flock.
        before = [] if locks else ["strace", "-f", "-qq", "--seccomp-bpf", "-o", "/dev/null", "-e", "trace=flock", "-e",
                                   "inject=flock:error=ENOLCK"]
        process = subprocess.Popen([str(word) for word in [*before, self.site.program, *words]], cwd=self.folder, env=environment(),
                                   stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        self.processes.append((process, words, may_fail))

    def build(self, degree, locks=True, more=()):
        self.start(["basis-build", "--sphere", self.inputs / "sphere.ply", "--store", self.store, "--max-degree", degree,
                    "--threads", 1, "-q", *more], locks)

    def end(self, what):
        """Waits for all processes; counts a failed process as a failure unless it may fail."""
        patience = time.monotonic() + 6 * HANG
        for process, words, may_fail in self.processes:
            name = " ".join(str(word) for word in words[:2])
            try:
                _, err = process.communicate(timeout=max(0.1, patience - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.communicate()
                self.site.find(self.row, "hangs", f"{what}: {name}")
                continue
            if process.returncode < 0 or process.returncode >= 101 or b"panicked" in err:
                self.site.find(self.row, "crashes", f"{what}: {name}: {process.returncode}: {err[-300:].decode(errors='replace')}")
            elif process.returncode != 0 and not may_fail:
                self.site.find(self.row, "wrong", f"{what}: {name} fails: {err[-300:].decode(errors='replace')}")
        self.processes = []

    def same(self, expected, what):
        found = tree(self.store)
        for name in found.keys() | expected.keys():
            if name not in expected:
                self.site.find(self.row, "half", f"{what}: {name} is left over")
            elif found.get(name) != expected[name]:
                self.site.find(self.row, "wrong", f"{what}: {name} is {'missing' if name not in found else 'another'}")


def reference(site, row, inputs, degree):
    race = Race(site, row, site.folder(f"race-{degree}"), inputs)
    race.build(degree, more=("--factor", 4))
    race.end("undisturbed")
    return tree(race.store)


def run_part(site, seconds):
    row = Row("races")
    inputs, _ = verbs.learned(site)
    expected, extended = reference(site, row, inputs, DEGREE), reference(site, row, inputs, EXTENDED)
    strace = not missing("strace")
    if not strace:
        site.skip(row, "strace isn't here: no races without locks")
    kinds = [builders, builders_and_gc, extension]
    counts = dict.fromkeys(kinds, 0)
    end, number = time.monotonic() + seconds, 0
    # Run each kind at least once, with locks and without.
    while time.monotonic() < end or number < 2 * len(kinds):
        kind, locks = kinds[number % len(kinds)], not strace or number // len(kinds) % 2 == 0
        what = f"round {number}, {kind.__name__.replace('_', ' ')}{'' if locks else ', no locks'}"
        kind(Race(site, row, site.folder("race"), inputs), expected, extended, locks, what)
        counts[kind] += 1
        number += 1
    words = {builders: f"of {BUILDERS} builders", builders_and_gc: "of builders with gc",
             extension: "of an extension with readers, verify and gc"}
    row.done = f"{number} rounds, half of them without locks: " + ", ".join(f"{counts[kind]} {words[kind]}" for kind in kinds)
    return row


def builders(race, expected, _, locks, what):
    for _ in range(BUILDERS):
        race.build(DEGREE, locks, ("--factor", 4))
    race.end(what)
    race.same(expected, what)


def builders_and_gc(race, expected, _, locks, what):
    for number in range(BUILDERS // 2):
        # Without locks, only files older than a day count as leftovers, so gc removes none of these files.
        race.build(DEGREE, locks, ("--factor", 4))
        if number % 2:
            # The store may not exist yet.
            race.start(["store", "gc", race.store], locks, may_fail=True)
    race.end(what)
    race.same(expected, what)


def extension(race, expected, extended, locks, what):
    race.build(DEGREE, more=("--factor", 4))
    race.end(what)
    for _ in range(2):
        race.build(EXTENDED, locks, ("--factor", 4))
    for number in range(4):
        race.start(["fit", "--store", race.store, "--sphere", race.inputs / "sphere.ply", "--surface", race.inputs / "a.ply",
                    "--max-degree", DEGREE, "-o", f"{number}.npz", "-q", "--threads", 1], locks)
        race.start(["store", "gc" if number % 2 else "verify", race.store], locks)
    race.end(what)
    race.same(extended, what)
    models = {hashlib.sha256(path.read_bytes()).digest() for path in race.folder.glob("*.npz")}
    if len(models) != 1:
        race.site.find(race.row, "wrong", f"{what}: {len(models)} different models of one surface")
