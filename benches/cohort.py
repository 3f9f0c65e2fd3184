"""Fits a cohort of 10,000 rows by real Slurm, with bad files, kills and a full disk.

`./run cluster cohort` calls it, with the program in PATH.

A table of icospheres with 2,562 vertices is fitted to degree 20 in ten shards. Every hundredth file is bad. During the
run, three tasks are killed by SIGKILL and two by SIGTERM, and one shard's models are written to a file system that is
soon full. Then the same array is submitted again. Required results: 9,900 models, each with the same bytes as in one
undisturbed call (for a sample, also as in a call for this surface alone); 100 failures, each listed once; and a status
that agrees. Then costs are measured: start, memory, and time beyond reading and writing.
"""

import argparse
import contextlib
import json
import os
import random
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from cluster import EXAMPLES, Skipped, Slurm, run, say, unpacked_slurm

SHARDS, DEGREE = 10, 20
KILLED, STOPPED, FULL = (0, 1, 2), (3, 4), 5
#: Size of the disk for the models of one shard.
SMALL_DISK = "16M"
SEED = 20
#: Number of timed runs at each of the two degrees.
PAIRS = 5
#: Time limit in seconds; every step here takes less.
PATIENCE = 1800


def read_ply(path):
    """Returns vertices and triangles of a binary PLY file written by the program."""
    data = path.read_bytes()
    head, _, body = data.partition(b"end_header\n")
    counts = {line.split()[1]: int(line.split()[2]) for line in head.decode().splitlines() if line.startswith("element")}
    kind = "<f8" if b"property double x" in head else "<f4"
    vertices = np.frombuffer(body, kind, 3 * counts["vertex"]).reshape(-1, 3)
    faces = np.frombuffer(body, np.dtype([("n", "u1"), ("v", "<i4", 3)]), counts["face"], vertices.nbytes)
    return vertices.astype(float), faces["v"]


def ply(vertices, faces):
    rows = np.empty(len(faces), np.dtype([("n", "u1"), ("v", "<i4", 3)]))
    rows["n"], rows["v"] = 3, faces
    head = (f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\nproperty float x\nproperty float y\n"
            f"property float z\nelement face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n")
    return head.encode() + vertices.astype("<f4").tobytes() + rows.tobytes()


def write_surfaces(folder, count):
    """Writes surfaces interpolated between some from `spharm generate`, every hundredth file bad; returns the ids of
    the bad files."""
    bases = []
    for variant in range(6):
        run(["spharm", "generate", "--subdivisions", "4", "--variant", variant, "--surface", folder / "base.ply", "--sphere",
             folder / "sphere.ply", "--force", "-q"])
        vertices, faces = read_ply(folder / "base.ply")
        bases.append(vertices)
    rng, bad = np.random.default_rng(SEED), []
    (folder / "surfaces").mkdir()
    rows = ["id\tsurface\tsphere\toutput\tage\n"]
    for number in range(count):
        name = f"sub-{number:05d}"
        path = folder / "surfaces" / f"{name}.ply"
        mix = rng.dirichlet(np.ones(len(bases)))
        data = ply(sum(weight * base for weight, base in zip(mix, bases)), faces)
        if number % 100 == 57 + number // 100 % 10:
            bad.append(name)
            kind = len(bad) % 5
            broken = np.array(bases[0])
            broken[5, 1] = np.nan
            data = [data[: len(data) // 2], None, ply(broken, faces), ply(bases[0][:-1], faces[(faces < 2561).all(1)]), b"no mesh"][kind]
        if data is not None:
            path.write_bytes(data)
        output = f"small/{name}" if number % SHARDS == FULL else ""
        rows.append(f"{name}\tsurfaces/{name}.ply\tsphere.ply\t{output}\t{rng.integers(20, 80)}\n")
    (folder / "subjects.tsv").write_text("".join(rows))
    return bad


def models(folder):
    return {path.name: path for path in folder.rglob("*.spharm.npz")}


def fit(folder, out, *more, degree=DEGREE, threads=1, check=True):
    command = ["spharm", "fit", "--max-degree", degree, "--threads", threads, "-q", "--no-surface-distance", "-o", out, *more]
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, cwd=folder)
    if check and done.returncode:
        raise RuntimeError(f"{' '.join(map(str, command))} ended with {done.returncode}:\n{done.stderr}")
    return done


def by_several(folder, calls):
    """Fits all rows by several concurrent calls, to save time."""
    command = ["spharm", "fit", "--max-degree", DEGREE, "--threads", 1, "-q", "--no-surface-distance", "-o", folder / "one",
               "--manifest", folder / "subjects.tsv", "--keep-going", "--shard"]
    shards = [subprocess.Popen([*map(str, command), f"{shard}/{calls}"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
              for shard in range(calls)]
    if any(shard.wait() != 1 for shard in shards):
        raise RuntimeError("the undisturbed calls failed")


def undisturbed(folder, count, bad):
    """Fits all rows in one call. Returns its seconds and its report."""
    started = time.monotonic()
    done = fit(folder, folder / "one", "--manifest", folder / "subjects.tsv", "--keep-going", "--report", folder / "one.json", check=False)
    if done.returncode != 1 or f"{len(bad)} of {count} surfaces failed" not in done.stderr:
        raise RuntimeError(f"one call ended with {done.returncode}:\n{done.stderr}")
    return time.monotonic() - started, json.loads((folder / "one.json").read_text())


@contextlib.contextmanager
def small_disk(place):
    """Mounts a file system with space for a few models. If mounting isn't permitted, this run has no full disk."""
    place.mkdir(parents=True)
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={SMALL_DISK}", "tmpfs", place], capture_output=True).returncode == 0
    try:
        yield mounted
    finally:
        if mounted:
            subprocess.run(["umount", place], check=False)


def by_slurm(folder, count, bad):
    """Submits the array, disturbs it, and submits it again. Returns seconds, and notes on the disturbances."""
    packages, _ = unpacked_slurm()
    out = folder / "out"
    notes = []
    with small_disk(out / "small") as mounted, Slurm(folder, packages) as slurm:
        environment = slurm.environment | {"DEGREE": str(DEGREE), "CPUS": "1", "MORE": "--no-surface-distance"}

        def submit():
            return run(["sh", EXAMPLES / "cohort.sh", folder / "subjects.tsv", out, SHARDS], env=environment, cwd=folder).strip()

        def lines(shard):
            path = out / "status" / f"{shard}.tsv"
            return len(path.read_text(errors="replace").splitlines()) if path.exists() else 0

        def program(shard):
            """Returns the process that fits a shard."""
            for entry in Path("/proc").glob("[0-9]*"):
                with contextlib.suppress(OSError):
                    words = (entry / "cmdline").read_bytes().split(b"\0")
                    if words[0].endswith(b"spharm") and f"{shard}/{SHARDS}".encode() in words and str(folder).encode() in b" ".join(words):
                        return int(entry.name)
            return None

        started = time.monotonic()
        array = submit()
        chance = random.Random(SEED)
        share = count // SHARDS
        try:
            waiting = {shard: chance.randrange(share // 10, share // 2) for shard in (*KILLED, *STOPPED)}
            end = started + PATIENCE
            while waiting and time.monotonic() < end:
                for shard in [shard for shard, after in waiting.items() if lines(shard) > after]:
                    after, pid = waiting.pop(shard), program(shard)
                    if pid and shard in KILLED:
                        os.kill(pid, signal.SIGKILL)
                        notes.append(f"shard {shard} killed after {after} rows")
                    elif pid:
                        stop = ["scancel", "--signal=TERM", "--batch", f"{array}_{shard}"]
                        # scancel waits until the task has ended, or reports an error if the task is being queued again.
                        subprocess.Popen(stop, env=slurm.environment, stderr=subprocess.DEVNULL)
                        notes.append(f"shard {shard} stopped after {after} rows, and queued again")
                time.sleep(0.05)
            if len(notes) < len(KILLED) + len(STOPPED):
                raise RuntimeError(f"only {notes}: the tasks ended too early")
            slurm.idle(patience=PATIENCE)
        except RuntimeError as error:
            raise RuntimeError(f"{error}\n{slurm.logs()}") from error
        first = time.monotonic() - started
        found = models(out)
        notes.append(f"then {len(found):,} models")
        if mounted:
            said = (out / "log" / f"{FULL}.out").read_text()
            if "No space left on device" not in said:
                raise RuntimeError(f"the small disk isn't full:\n{said}")
            notes.append(f"shard {FULL} ended with a full disk after {len(list((out / 'small').glob('*.npz')))} models")
            run(["mount", "-o", "remount,size=4G", out / "small"])
        else:
            notes.append("no permission to mount a file system: no full disk in this run")
        for entry in out.rglob("*.npz"):
            if entry.stat().st_size == 0:
                raise RuntimeError(f"{entry} is empty")
        again = time.monotonic()
        submit()
        slurm.idle(patience=PATIENCE)
        seconds = first + time.monotonic() - again
        compare(folder, out, count, bad)
        version = slurm.ask("sinfo", "--version").split()[-1]
    return f"Slurm {version}", seconds, notes


def compare(folder, out, count, bad):
    """Checks that every model has the bytes of the undisturbed call's, and that the status agrees with the models."""
    expected, found = models(folder / "one"), models(out)
    if sorted(expected) != sorted(found) or len(found) != count - len(bad):
        raise RuntimeError(f"expected {count - len(bad)} models, found {len(found)}, {len(expected)} in one call")
    differ = [name for name in expected if expected[name].read_bytes() != found[name].read_bytes()]
    if differ:
        raise RuntimeError(f"{len(differ)} models differ from those of one call, the first {differ[0]}")
    said = run(["spharm", "status", out / "status", "--manifest", folder / "subjects.tsv", "--json"])
    status = json.loads(said[: said.rindex("}") + 1])
    named = [failure["id"] for failure in status["failures"]]
    if status["done"] + status["skipped"] != count - len(bad) or status["failed"] != len(bad) or sorted(named) != sorted(bad):
        raise RuntimeError(f"the status doesn't agree: {said}")


def alone(folder, sample, bad):
    """Fits a sample of the rows again, each in its own call, and compares the models' bytes."""
    rows = [line.split("\t") for line in (folder / "subjects.tsv").read_text().splitlines()[1:]]
    chosen = random.Random(SEED).sample([row for row in rows if row[0] not in bad], sample)
    one = models(folder / "one")
    for name, surface, sphere, *_ in chosen:
        (folder / "lone.tsv").write_text(f"id\tsurface\tsphere\n{name}\t{surface}\t{sphere}\n")
        fit(folder, folder / "alone", "--manifest", folder / "lone.tsv")
        if (folder / "alone" / f"{name}.spharm.npz").read_bytes() != one[f"{name}.spharm.npz"].read_bytes():
            raise RuntimeError(f"{name}: the model of a separate call has other bytes")


def start(folder, count):
    """Returns the seconds of a shard apart from its fits: the table has `count` rows, of which this shard has two."""
    best = None
    for _ in range(5):
        began = time.monotonic()
        fit(folder, folder / "start", "--manifest", folder / "subjects.tsv", "--shard", f"1/{count // 2}", "--report",
            folder / "start.json", "--force")
        total = time.monotonic() - began
        seconds = json.loads((folder / "start.json").read_text())["seconds"]
        beyond = total - seconds["plan"] - seconds["solve"] - seconds["write"]
        best = min(best or beyond, beyond)
    return best


def parsing(folder):
    """Returns the seconds to read a table of 10^5 rows and to check the files of one row."""
    table = folder / "large.tsv"
    rows = (f"sub-{k:06d}\tsurfaces/sub-{k:06d}.ply\tsphere.ply\t{k % 2}\t{k % 60}\n" for k in range(100_000))
    table.write_text("id\tsurface\tsphere\tgroup\tage\n" + "".join(rows))
    shutil.copy(folder / "surfaces/sub-00000.ply", folder / "surfaces/sub-000000.ply")
    times = []
    for _ in range(5):
        began = time.monotonic()
        fit(folder, folder / "none", "--manifest", table, "--shard", "0/100000", "--dry-run")
        times.append(time.monotonic() - began)
    return min(times)


def memory(folder, bad):
    """Returns the peak memory of a call for 100 good rows."""
    lines = [line for line in (folder / "subjects.tsv").read_text().splitlines(True) if line.split("\t")[0] not in bad]
    (folder / "hundred.tsv").write_text("".join(lines[:101]))
    fit(folder, folder / "hundred", "--manifest", folder / "hundred.tsv", "--report", folder / "hundred.json")
    return json.loads((folder / "hundred.json").read_text())["memory"]["peak_resident"]


def cost(folder, count):
    """Returns seconds per surface of 40,962 vertices at degree 100 on a common sphere, and the part of them for reading
    the surface and writing its model."""
    rows = ["id\tsurface\tsphere\n"]
    for variant in range(8):
        run(["spharm", "generate", "--variant", variant, "--surface", folder / f"c{variant}.surf.gii", "--sphere",
             folder / "c.sphere.surf.gii", "--force", "-q"])
    rows += [f"c{number}\tc{number % 8}.surf.gii\tc.sphere.surf.gii\n" for number in range(count)]
    (folder / "cortex.tsv").write_text("".join(rows))
    seconds = {100: [], 0: []}
    # A fit to degree 0 solves almost nothing, but reads the same surface and writes the same sphere, which is nearly
    # the entire file. The two degrees run in turn, because the load of the machine changes.
    for _ in range(PAIRS):
        for degree, times in seconds.items():
            began = time.monotonic()
            fit(folder, folder / "cortex", "--manifest", folder / "cortex.tsv", "--report", folder / f"cortex{degree}.json",
                "--force", degree=degree, threads=os.cpu_count())
            times.append((time.monotonic() - began) / count)
            shutil.rmtree(folder / "cortex")
    parts = json.loads((folder / "cortex100.json").read_text())["seconds"]
    return ({degree: statistics.median(times) for degree, times in seconds.items()},
            {name: parts[name] / count for name in ("read", "plan", "solve", "write")})


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=10_000)
    parser.add_argument("--alone", type=int, default=200, help="models that are made again, each by its own call")
    parser.add_argument("--calls", type=int, default=1, help="undisturbed calls; with more than one, their costs aren't measured")
    parser.add_argument("--cortices", type=int, default=200)
    parser.add_argument("--only", choices=["slurm", "cost"])
    args = parser.parse_args()
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda number, _: sys.exit(128 + number))
    # Uses a file system in memory, because 20,000 files are synchronised, so a disk would dominate the measured times.
    memory_disk = Path("/dev/shm")
    place = memory_disk if memory_disk.is_dir() and shutil.disk_usage(memory_disk).free > 6e9 else None
    with tempfile.TemporaryDirectory(prefix="spharm-cohort-", dir=place) as folder:
        folder = Path(folder)
        if args.only != "cost":
            say(f"{args.rows:,} surfaces")
            bad = write_surfaces(folder, args.rows)
            if args.calls > 1:
                by_several(folder, args.calls)
            else:
                say("one call for all of them")
                seconds, report = undisturbed(folder, args.rows, bad)
                print(f"one call: {args.rows:,} rows, {len(bad)} bad, {seconds:.0f} s, {1e3 * seconds / args.rows:.1f} ms a row")
                more = report["memory"]["peak_resident"] - memory(folder, bad)
                print(f"memory: {more / 2**20:.0f} MiB more than for 100 rows (at most 64)")
            print(f"start: {start(folder, args.rows):.3f} s a shard beyond its fits (at most 0.15)")
            print(f"a table of 100,000 rows: {parsing(folder):.3f} s with the start of the program (at most 0.2)")
            say(f"{args.alone} models alone")
            alone(folder, args.alone, bad)
            print(f"alone: {args.alone} models have the same bytes")
            say(f"{SHARDS} shards by Slurm")
            try:
                name, seconds, notes = by_slurm(folder, args.rows, bad)
                print(f"{name}: {args.rows - len(bad):,} models with the same bytes, {len(bad)} failures named once, {seconds:.0f} s")
                print("".join(f"  {note}\n" for note in notes), end="")
            except Skipped as why:
                print(f"Slurm: skipped: {why}")
        if args.only != "slurm":
            say(f"{args.cortices} cortices at degree 100")
            seconds, parts = cost(folder, args.cortices)
            ratio = seconds[100] / seconds[0]
            shown = ", ".join(f"{name} {1e3 * value:.0f}" for name, value in parts.items())
            print(f"40,962 vertices, degree 100: {1e3 * seconds[100]:.0f} ms a surface ({shown}), {ratio:.2f} times that of degree 0 "
                  "(at most 1.3)")


if __name__ == "__main__":
    try:
        main()
    except RuntimeError as error:
        sys.exit(f"error: {error}")
