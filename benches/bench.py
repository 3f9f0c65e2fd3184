#!/usr/bin/env python3
"""Measures the figures of docs/performance.md and docs/methods.md, each together with its reference.

`./run bench [--data DIR] [--work DIR] [--tmpfs DIR] [--rounds N] [--only NAME ...]`. Uses Python's standard library
only. Programs that are compared run in turn, round after round, and medians are taken. The store is built for n =
40,962 directions and degree L = 100 in f64; it takes 3.3 GB, and up to three copies exist at once.
"""

import argparse
import csv
import json
import math
import os
import platform
import re
import shutil
import statistics
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SPHARM = ROOT / "target" / "release" / "spharm"
N, L = 40962, 100
MIB = 1 << 20


class Bench:
    def __init__(self, arguments):
        self.data, self.rounds, self.only = arguments.data, arguments.rounds, arguments.only
        # A subfolder, so that other files in the given folder are kept.
        self.work, self.tmpfs = Path(arguments.work) / "spharm-bench", Path(arguments.tmpfs)
        self.rows, self.figures = [], {}
        shutil.rmtree(self.work, ignore_errors=True)
        self.work.mkdir(parents=True)
        self.sphere, self.surface = self.work / "sphere.surf.gii", self.work / "cortex.surf.gii"
        run(SPHARM, "generate", "--sphere", self.sphere, "--surface", self.surface)
        self.store = self.work / "store"

    def wanted(self, name):
        return not self.only or name in self.only

    def bar(self, what, found, limit, note="", least=False):
        met = found >= limit if least else found <= limit
        self.rows.append((what, f"{found:.3g}", f"{'>=' if least else '<='} {limit:g}", "yes" if met else "NO", note))
        print(f"{what}: {found:.3g} (bar {limit:g}) {note}", file=sys.stderr, flush=True)

    def skip(self, what, why):
        self.rows.append((what, "-", "-", "skipped", why))
        print(f"{what}: skipped, {why}", file=sys.stderr, flush=True)

    # Commands that are measured.

    def build(self, store):
        return [SPHARM, "basis-build", "--sphere", self.sphere, "--max-degree", L, "--store", store, "-q"]

    def fit(self, *more, surfaces=None, store=None, output=None):
        return [SPHARM, "fit", "--store", store or self.store, "--sphere", self.sphere, "--surface",
                *(surfaces or [self.surface]), "--max-degree", L, "-q", "--force",
                "-o", output or self.work / "out.npz", *more]

    def ensure_store(self):
        if not self.store.exists():
            run(*self.build(self.store))

    # Measurements that are compared with a required limit.

    def building(self):
        """Compares basis-build with dd to the same disk."""
        target, zeros = self.work / "disk", self.work / "zeros"
        ours, theirs = [], []
        size = None
        for _ in range(self.rounds):
            shutil.rmtree(target, ignore_errors=True)
            os.sync()
            ours.append(seconds(*self.build(target)))
            size = sum(f.stat().st_size for f in target.rglob("A_*"))
            shutil.rmtree(target)
            os.sync()
            theirs.append(seconds("dd", "if=/dev/zero", f"of={zeros}", "bs=4M", "conv=fsync", "iflag=fullblock,count_bytes",
                                  f"count={size}"))
            zeros.unlink()
        self.figures["build_disk_s"], self.figures["dd_s"] = median(ours), median(theirs)
        self.bar("basis-build to disk / dd conv=fsync", ratio(ours, theirs), 1.25,
                 f"{median(ours):.2f} s / {median(theirs):.2f} s, {size / 1e9:.2f} GB")

    def building_tmpfs(self):
        """Compares basis-build to tmpfs with cp -r of the finished store within tmpfs."""
        folder = self.tmpfs / f"spharm-bench-{os.getpid()}"
        try:
            ours, theirs = [], []
            # The first build isn't measured, because it includes the first use of the machine's memory.
            for round_ in range(self.rounds + 1):
                shutil.rmtree(folder, ignore_errors=True)
                folder.mkdir()
                mine = seconds(*self.build(folder / "a"))
                copied = seconds("cp", "-r", folder / "a", folder / "b")
                if round_:
                    ours.append(mine)
                    theirs.append(copied)
        finally:
            shutil.rmtree(folder, ignore_errors=True)
        self.figures["build_tmpfs_s"], self.figures["cp_tmpfs_s"] = median(ours), median(theirs)
        self.bar("basis-build to tmpfs / cp -r within it", ratio(ours, theirs), 1.5,
                 f"{median(ours):.2f} s / {median(theirs):.2f} s")

    def fitting(self):
        """Compares a fit from the page cache with its bound: the Gram matrices' flops at the rate of dgemm, plus
        reading the store."""
        self.ensure_store()
        rates = json.loads(run("cargo", "bench", "-q", "--bench", "rates").strip().splitlines()[-1])
        self.figures["rates"] = rates
        one, cat, passes = [], [], []
        report = self.work / "fit.json"
        self.cat()
        run(*self.fit("--granularity", 100, "--report", report))
        blocks = json.loads(report.read_text())["batches"][0]["blocks"]
        flops = sum(N * b["columns"] * (b["columns"] + 1) for b in blocks)
        for _ in range(max(self.rounds, 5)):
            one.append(seconds(*self.fit("--granularity", 100)))
            cat.append(self.cat())
            run(*self.fit("--granularity", 100, "--passes", 4, "--report", report))
            sweeps = json.loads(report.read_text())["batches"][0]["sweeps"]
            passes.append(median([s["seconds"] for s in sweeps[1:]]))
        gram = flops / rates["dgemm_flops"]
        self.figures |= {"fit_1_100_s": median(one), "cat_s": median(cat), "gram_s": gram, "pass_s": median(passes)}
        self.bar("fit (1,100) / (Gram flops at dgemm's rate + cat)", median(one) / (gram + median(cat)), 2.0,
                 f"{median(one):.2f} s / ({gram:.2f} s at {rates['dgemm_flops'] / 1e9:.0f} GFLOP/s + {median(cat):.2f} s)")
        self.bar("streaming pass / cat", median(passes) / median(cat), 3.0, f"{median(passes):.2f} s / {median(cat):.2f} s")

    def batch(self):
        """Compares a call for 32 surfaces with a call for one surface."""
        self.ensure_store()
        surfaces = []
        for variant in range(32):
            surfaces.append(self.work / f"subject{variant}.surf.gii")
            run(SPHARM, "generate", "--surface", surfaces[-1], "--variant", variant, "--force")
        one, many = [], []
        self.cat()
        for _ in range(self.rounds):
            one.append(seconds(*self.fit("--granularity", 100)))
            many.append(seconds(*self.fit("--granularity", 100, surfaces=surfaces, output=self.work / "models")))
        self.figures |= {"batch_32_s": median(many)}
        self.bar("one of a batch of 32 / one alone", ratio(many, one) / 32, 0.25,
                 f"{median(many) / 32:.3f} s / {median(one):.2f} s")

    def memory(self):
        """Measures the fit with one pass and granularity 100 under 256 MiB: anonymous memory, and under a cgroup of 320
        MiB and prlimit."""
        self.ensure_store()
        command = self.fit("--granularity", 100, "--memory", "256MiB")
        peak = peak_anonymous(command)
        self.bar("anonymous memory at --memory 256MiB, MiB", peak / MIB, 256)
        for limit in (320, 256):
            code = subprocess.run(["prlimit", f"--data={limit * MIB}", *map(str, command)], timeout=300,
                                  stdout=subprocess.DEVNULL).returncode
            self.bar(f"exit status under prlimit --data of {limit} MiB", code, 0)
        with Cgroup(320 * MIB) as group:
            if not group.works:
                self.skip("cold fit in a cgroup of 320 MiB / cold fit", group.why)
                return
            capped, free = [], []
            for _ in range(self.rounds):
                self.drop()
                free.append(seconds(*command))
                self.drop()
                capped.append(seconds(*group.inside(command)))
        self.figures |= {"cold_s": median(free), "cold_capped_s": median(capped)}
        self.bar("cold fit in a cgroup of 320 MiB / cold fit", ratio(capped, free), 1.5,
                 f"{median(capped):.2f} s / {median(free):.2f} s")

    def refusal(self):
        """Checks that degree 300 on 163,842 vertices is refused."""
        sphere = self.work / "sphere7.surf.gii"
        run(SPHARM, "generate", "--subdivisions", 7, "--sphere", sphere)
        found = subprocess.run([SPHARM, "basis-build", "--sphere", sphere, "--max-degree", "300", "--store",
                                self.work / "large"], capture_output=True, text=True)
        said = found.returncode == 1 and "118." in found.stderr and "free" in found.stderr
        left = (self.work / "large").exists()
        self.bar("degree 300 on 163,842 vertices refused, nothing left", float(said and not left), 1, found.stderr.strip(),
                 least=True)

    def accuracy(self):
        """Checks every irf and sirf line of reference.json, and the published coefficients."""
        data = Path(self.data)
        if not (data / "reference.json").exists():
            self.skip("reference.json", f"no {data}")
            return
        worst = {"msd": 0.0, "xsd": 0.0}
        for name, expected in json.loads((data / "reference.json").read_text()).items():
            sphere, surface = data / f"{name}.sphere.surf.gii", data / f"{name}.surf.gii"
            store = self.work / "accuracy"
            run(SPHARM, "basis-build", "--sphere", sphere, "--max-degree", L, "--store", store, "-q")
            lines = {}
            for line, values in expected["results"].items():
                if match := re.fullmatch(r"irf p=(\d+) g=(\d+) L=(\d+)", line):
                    p, g, degree = map(int, match.groups())
                    lines.setdefault(("irf", g, degree), {})[p] = values
                elif match := re.match(r"sirf .*?L=(\d+)", line):
                    lines.setdefault(("sirf", 1, int(match.group(1))), {})[1] = values
            for (method, g, degree), by_pass in lines.items():
                report = self.work / "accuracy.json"
                more = ["--granularity", g, "--passes", max(by_pass)] if method == "irf" else []
                run(SPHARM, "fit", "--store", store, "--sphere", sphere, "--surface", surface, "--max-degree", degree,
                    "--method", method, *more, "-q", "--force", "-o", self.work / "a.npz", "--report", report)
                passes = json.loads(report.read_text())["surfaces"][0]["passes"]
                for p, values in by_pass.items():
                    for measure in worst:
                        off = abs(passes[p - 1][measure] / values[measure] - 1)
                        worst[measure] = max(worst[measure], off)
            shutil.rmtree(store)
        self.bar("reference.json, largest relative difference in msd", worst["msd"], 1e-6)
        self.bar("reference.json, largest relative difference in xsd", worst["xsd"], 1e-4)
        largest = 0.0
        for sphere in sorted(data.glob("hippo_*.sphere.obj")):
            name = sphere.name.removesuffix(".sphere.obj")
            store = self.work / "hippo"
            run(SPHARM, "basis-build", "--sphere", sphere, "--max-degree", 15, "--store", store, "-q")
            run(SPHARM, "fit", "--store", store, "--sphere", sphere, "--surface", data / f"{name}.obj", "--max-degree", 15,
                "--method", "nlsf", "-q", "--force", "--coefficients-csv", "-o", self.work / "h.spharm.npz")
            ours, theirs = numbers(self.work / "h.spharm.csv"), numbers(data / f"{name}.degree15.fvec.csv")
            norm = math.sqrt(sum(b * b for b in theirs))
            largest = max(largest, math.sqrt(sum((a - b) ** 2 for a, b in zip(ours, theirs, strict=True))) / norm)
        self.bar("published degree-15 coefficients, largest relative difference", largest, 1e-10)

    def acceleration(self):
        """Counts the passes until the msd is within 1e-6 of the optimum, plain and accelerated; if never, reports the
        final excess."""
        data = Path(self.data)
        if not (data / "reference.json").exists():
            self.skip("accelerated passes", f"no {data}")
            return
        reference = json.loads((data / "reference.json").read_text())
        rows = self.figures["acceleration"] = []
        for name, most in (("cort40962", 16), ("head27618", 32)):
            optimum = reference[name]["results"]["least-squares L=100"]["msd"]
            sphere, surface = data / f"{name}.sphere.surf.gii", data / f"{name}.surf.gii"
            store, report = self.work / "acceleration", self.work / "acceleration.json"
            run(SPHARM, "basis-build", "--sphere", sphere, "--max-degree", L, "--store", store, "-q")
            left, passes = {}, {}
            for how, more in (("plain", []), ("accelerated", ["--accelerate"])):
                run(SPHARM, "fit", "--store", store, "--sphere", sphere, "--surface", surface, "--max-degree", L,
                    "--granularity", 100, "--passes", most, *more, "--memory", "1GiB", "-q", "--force",
                    "-o", self.work / "b.npz", "--report", report)
                told = json.loads(report.read_text())
                excess = [distances["msd"] / optimum - 1 for distances in told["surfaces"][0]["passes"]]
                sweeps = [sweep["pass"] for sweep in told["batches"][0]["sweeps"]]
                left[how] = excess[-1]
                passes[how] = next((p for p, e in zip(sweeps, excess) if e <= 1e-6), None)
                rows.append({"surface": name, "how": how, "passes_to_1e-6": passes[how], "most": most,
                             "excess": dict(zip(sweeps, excess))})
            shutil.rmtree(store)
            if passes["plain"] and passes["accelerated"]:
                self.bar(f"{name}: accelerated passes to 1e-6", passes["accelerated"], 8, f"plain {passes['plain']}")
            else:
                self.bar(f"{name}: final excess after {most} passes, accelerated / plain",
                         left["accelerated"] / left["plain"], 0.5, f"{left['accelerated']:.1e} / {left['plain']:.1e}")

    # Control of the page cache.

    def files(self):
        return sorted(self.store.rglob("A_*"))

    def cat(self):
        """Returns the seconds of `cat store > /dev/null`."""
        with open(os.devnull, "wb") as null:
            start = time.perf_counter()
            subprocess.run(["cat", *map(str, self.files())], stdout=null, check=True)
            return time.perf_counter() - start

    def drop(self):
        """Drops the store's pages from the page cache, and checks that they are gone."""
        os.sync()
        for path in self.files():
            with open(path, "rb") as file:
                os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
        resident = subprocess.run(["fincore", "-b", "-n", "-o", "RES", *map(str, self.files())], capture_output=True, text=True)
        left = sum(map(int, resident.stdout.split()))
        assert left < 64 * MIB, f"{left} bytes of the store are still in memory, so the run wouldn't be cold"

    def table(self):
        head = ("bar", "measured", "limit", "met", "")
        widths = [max(len(row[c]) for row in [head, *self.rows]) for c in range(4)]
        for row in [head, *self.rows]:
            print("  ".join(cell.ljust(width) for cell, width in zip(row, widths)) + "  " + row[4])
        processor = next((line.split(":")[1].strip() for line in Path("/proc/cpuinfo").read_text().splitlines()
                          if line.startswith("model name")), platform.processor())
        print(f"\n{processor}, {os.cpu_count()} cores, {platform.system()} {platform.release()}; medians of {self.rounds}")
        self.figures["bars"] = [dict(zip(("bar", "measured", "limit", "met", "note"), row)) for row in self.rows]
        (self.work / "bench.json").write_text(json.dumps(self.figures, indent=1))


class Cgroup:
    """A memory control group of this size, version 1 or 2, if one can be created."""

    def __init__(self, limit):
        self.limit, self.works, self.why, self.path = limit, False, "cgroups can't be made here", None

    def __enter__(self):
        name = f"spharm-bench-{os.getpid()}"
        for parent, file in ((Path("/sys/fs/cgroup/memory"), "memory.limit_in_bytes"), (Path("/sys/fs/cgroup"), "memory.max")):
            try:
                self.path = parent / name
                self.path.mkdir()
                (self.path / file).write_text(str(self.limit))
                self.works = True
                return self
            except OSError as error:
                self.why = f"cgroups can't be made here ({error})"
                self.leave()
        return self

    def inside(self, command):
        return ["sh", "-c", f'echo $$ > "{self.path}/cgroup.procs" && exec "$@"', "sh", *command]

    def leave(self):
        if self.path and self.path.is_dir():
            try:
                self.path.rmdir()
            except OSError:
                pass

    def __exit__(self, *_):
        self.leave()


def run(*command):
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, cwd=ROOT, timeout=3600)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, command))}\n{done.stderr}")
    return done.stdout


def seconds(*command):
    start = time.perf_counter()
    run(*command)
    return time.perf_counter() - start


def median(values):
    return statistics.median(values)


def ratio(ours, theirs):
    """Returns the median of the ratios of all rounds. Both programs run in each round, because the machine's speed
    drifts."""
    return median([a / b for a, b in zip(ours, theirs, strict=True)])


def peak_anonymous(command):
    """Returns the largest anonymous memory of a command, sampled every two milliseconds."""
    process = subprocess.Popen([str(word) for word in command], stdout=subprocess.DEVNULL)
    peak = 0
    status = Path(f"/proc/{process.pid}/status")
    while process.poll() is None:
        try:
            found = re.search(r"RssAnon:\s+(\d+) kB", status.read_text())
        except (OSError, ProcessLookupError):
            break
        peak = max(peak, int(found.group(1)) * 1024 if found else 0)
        time.sleep(0.002)
    assert process.wait() == 0, "the fit failed"
    return peak


def numbers(path):
    with open(path) as file:
        return [float(cell) for row in list(csv.reader(file))[1:] for cell in row[2:]]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    bars = ["building", "building_tmpfs", "fitting", "batch", "memory", "refusal", "accuracy", "acceleration"]
    parser.add_argument("--data", default=ROOT / "../shared/data", help="surfaces with reference results")
    parser.add_argument("--work", default=ROOT / "bench", help="folder on the disk to measure")
    parser.add_argument("--tmpfs", default="/dev/shm", help="a tmpfs with 7 GB to spare")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--only", nargs="*", choices=bars)
    bench = Bench(parser.parse_args())
    try:
        for name in bars:
            if bench.wanted(name):
                getattr(bench, name)()
    finally:
        bench.table()
        for path in bench.work.iterdir():
            if path.name != "bench.json":
                shutil.rmtree(path) if path.is_dir() else path.unlink()
    sys.exit(any(row[3] == "NO" for row in bench.rows))


if __name__ == "__main__":
    main()
