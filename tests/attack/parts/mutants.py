"""Mutations of our own code: what is broken must be caught by the tests of its own crate.

cargo-mutants changes a function at a time in a copy of the repository. A full run takes many hours, so that each run takes a
sample for its time. `tests/attack/survivors.txt` has the mutants that no test can catch, and why.
"""

import json
import random
import shutil

from common import KEPT, ROOT, Row, run

VERSION = "27.1.0"
#: Crates by their share of the time.
CRATES = {"spharm-store": 3, "spharm-surface": 3, "spharm-solver": 1}
#: Most mutants of a crate in one run.
MOST = 300
#: The least part that is caught, where there are enough to say.
LEAST, ENOUGH = 0.9, 20


def program(site, row):
    """cargo-mutants, installed where it isn't there; `None` where that can't be done."""
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
    """The mutants that survive for a reason: the text before the first ` -- ` of each line."""
    path = ROOT / "tests/attack/survivors.txt"
    lines = path.read_text().splitlines() if path.is_file() else []
    return {line.split(" -- ")[0].strip() for line in lines if " -- " in line and not line.startswith("#")}


def without_place(name):
    """`crates/a/src/b.rs:12:3: replace ...` without line and column, which change."""
    file, _, _, text = name.split(":", 3)
    return f"{file}:{text}"


def run_part(site, seconds):
    row = Row("mutations of the code")
    mutants = program(site, row)
    if mutants is None:
        return row
    tree = KEPT / "mutants/tree"
    env = {"CARGO_TARGET_DIR": str(KEPT / "mutants/target"), "TMPDIR": str(tree)}
    reasons, counts, new = explained(), {"caught": 0, "missed": 0, "timeout": 0, "unviable": 0, "explained": 0}, []
    choose = random.Random(site.seed)
    for crate, weight in CRATES.items():
        site.say(f"building the tests of {crate}")
        ended = run(["cargo", "test", "-q", "--no-run", "--locked", "-p", crate], cwd=ROOT, limit=3600, env=env | {"TMPDIR": "/tmp"})
        if ended.code != 0:
            site.skip(row, f"the tests of {crate} can't be built: {ended.last()}")
            continue
        names = listed(mutants, crate)
        chosen = choose.sample(names, min(MOST, len(names)))
        for folder in (KEPT / "mutants/out", tree):
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
        exact = [word for name in chosen for word in ("--re", "^" + escaped(name) + "$")]
        # It is ended when its time is up; what it has found by then is in its files.
        run([mutants, "mutants", "-d", ROOT, "-p", crate, "-o", KEPT / "mutants/out", *exact, "--baseline", "skip", "--timeout", "120",
             "--colors", "never", "--", "--locked"], limit=max(30, seconds * weight / sum(CRATES.values())), env=env)
        shutil.rmtree(tree, ignore_errors=True)
        for outcome in ("caught", "missed", "timeout", "unviable"):
            file = KEPT / "mutants/out/mutants.out" / f"{outcome}.txt"
            for name in file.read_text().splitlines() if file.is_file() else []:
                if outcome == "missed" and without_place(name) in reasons:
                    counts["explained"] += 1
                    continue
                counts[outcome] += 1
                site.log(f"{outcome}: {name}")
                if outcome == "missed":
                    new.append(name)
    caught, tried = counts["caught"] + counts["timeout"], counts["caught"] + counts["timeout"] + counts["missed"]
    row.done = f"{caught} of {tried} caught, {counts['explained']} explained, {counts['unviable']} don't compile; of " + ", ".join(CRATES)
    if tried >= ENOUGH and caught < LEAST * tried:
        site.find(row, "wrong", f"only {caught} of {tried} mutants are caught: " + "; ".join(new))
    for name in new:
        site.say(f"survives: {name}")
    return row


def listed(mutants, crate):
    """The names of a crate's mutants."""
    ended = run([mutants, "mutants", "-d", ROOT, "-p", crate, "--list", "--json"], limit=300)
    return [entry["name"] for entry in json.loads(ended.out)]


def escaped(text):
    return "".join("\\" + c if c in r"\.+*?()[]{}|^$" else c for c in text)
