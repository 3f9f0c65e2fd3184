"""Hostile files: libFuzzer runs every reader, with seeds of every format; the folder `fuzz` has the targets.

The targets are built without a sanitizer on the stable toolchain, as cargo-fuzz does: `cargo fuzz run --sanitizer none
NAME` runs a single target. The corpora are kept in `target/attack/corpus`, and failing inputs in
`target/attack/crashes`.
"""

import re
import shutil
import tempfile
import time
import tomllib
from pathlib import Path

import seeds
from common import KEPT, ROOT, Row, in_turn, run

TARGET = "x86_64-unknown-linux-gnu"
#: Compiler flags for coverage, and for comparisons that guide the mutations. The target is named explicitly, so that
#: build scripts are built without them.
FLAGS = (
    "--cfg fuzzing -Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 "
    "-Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table "
    "-Cllvm-args=-sanitizer-coverage-trace-compares -Cllvm-args=-simplifycfg-branch-fold-threshold=0 -Cdebug-assertions"
)
#: Limits for an input: seconds, MiB in total, MiB in one allocation, and bytes of the input.
LIMITS = ("-timeout=10", "-rss_limit_mb=1024", "-malloc_limit_mb=512", "-max_len=16384")
#: Kind of failure for each of libFuzzer's names of failing inputs.
FAILURES = {"crash": "crashes", "oom": "crashes", "leak": "crashes", "timeout": "hangs"}


def build(site, row):
    """Builds the targets; returns `None` if that isn't possible."""
    env = {"CARGO_TARGET_DIR": str(KEPT / "fuzz"), "RUSTFLAGS": FLAGS}
    site.say("building the fuzz targets (some minutes the first time)")
    ended = run(["cargo", "build", "-q", "--release", "--locked", "--target", TARGET], cwd=ROOT / "fuzz", limit=3600, env=env)
    if ended.code != 0:
        site.skip(row, f"the targets can't be built: {ended.last()}")
        return None
    return KEPT / "fuzz" / TARGET / "release"


def targets():
    with open(ROOT / "fuzz/Cargo.toml", "rb") as file:
        return [entry["name"] for entry in tomllib.load(file)["bin"]]


def run_part(site, seconds):
    row = Row("hostile files, fuzzed")
    folder = build(site, row)
    if folder is None:
        return row
    made = KEPT / "seeds"
    shutil.rmtree(made, ignore_errors=True)
    seeds.make(site, made)
    names = targets()
    each = seconds * site.workers / len(names)
    memory = Path("/dev/shm") if Path("/dev/shm").is_dir() else None
    counts, peaks = {}, {}

    def fuzz(_, name):
        corpus, crashes = KEPT / "corpus" / name, KEPT / "crashes" / name
        corpus.mkdir(parents=True, exist_ok=True)
        crashes.mkdir(parents=True, exist_ok=True)
        before = set(crashes.iterdir())
        executions, end = 0, time.monotonic() + each
        with tempfile.TemporaryDirectory(dir=memory, prefix="spharm-attack.") as scratch:
            # A failing input ends libFuzzer, so it is restarted for the remaining inputs, at most three times.
            for _ in range(4):
                rest = [f"-runs={max(1, int(site.executions - executions))}"] if site.executions else [
                    f"-max_total_time={max(1, int(end - time.monotonic()))}"]
                ended = run(
                    [folder / name, *LIMITS, *rest, f"-seed={site.seed % (1 << 31)}", f"-dict={made / 'words.dict'}",
                     f"-artifact_prefix={crashes}/", "-print_final_stats=1", "-verbosity=0", corpus, made / name],
                    limit=1e6 if site.executions else each + 600, env={"SPHARM_FUZZ_FOLDER": scratch, "RAYON_NUM_THREADS": "1"})
                text = ended.err.decode(errors="replace")
                executions += int(found[1]) if (found := re.search(r"number_of_executed_units: *(\d+)", text)) else 0
                peaks[name] = max(peaks.get(name, 0), int(found[1]) if (found := re.search(r"peak_rss_mb: *(\d+)", text)) else 0)
                counts[name] = executions
                new = sorted(path for path in crashes.iterdir() if path not in before)
                before.update(new)
                for path in new:
                    why = [line for line in text.splitlines() if "panicked" in line or "ERROR" in line or "ALARM" in line][:2]
                    kind = FAILURES.get(path.name.split("-")[0], "wrong")
                    site.find(row, kind, f"{name}: {path.relative_to(ROOT)}: {' '.join(why)[:300]}")
                if ended.code != 0 and not new:
                    site.find(row, "crashes", f"{name} ends with {ended.code}: {ended.last()}")
                if ended.code == 0 or (not site.executions and time.monotonic() > end):
                    break
        site.log(f"{name}: {executions} executions, {len(list(corpus.iterdir()))} inputs kept, peak {peaks.get(name)} MiB")

    in_turn(site, 1e9, names, fuzz)
    row.done = f"{sum(counts.values())} executions of {len(names)} readers, peak {max(peaks.values(), default=0)} MiB (" + ", ".join(
        f"{name} {count}" for name, count in counts.items()) + ")"
    return row
