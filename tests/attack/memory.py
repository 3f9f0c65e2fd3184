#!/usr/bin/env python3
"""Runs every verb with little memory: it must finish within its plan, or refuse with a message and exit status 1.

    python3 tests/attack/memory.py PROGRAM [--limits 64,128,256,512] [--only VERB]

PROGRAM is `spharm`; it must never be killed or abort. Each case runs at each limit (in MiB) in up to four ways:
- with `--memory`, which the peak resident memory may exceed by the size of the program's own pages;
- under RLIMIT_DATA;
- under RLIMIT_AS;
- in a memory control group, version 1 or 2, if one can be created.

The last line of the output is a row of a table as JSON. The exit status is 1 if a case failed.
"""

import argparse
import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

MIB = 1 << 20
# Resident size of the program's file, its libraries, and the stacks of two threads.
BASE = 24 * MIB
SECONDS = 120
# Every refusal contains one of these texts.
WORDS = ["of memory", "memory budget", "--memory", "ulimit", "bytes of memory", "are free"]
MOMENTS = ["--samples", "samples.csv", "--angles", "theta", "phi", "--values", "value"]
# Verbs that read their files in pieces, and so need no `--memory`.
WITHOUT = {"store"}
# Outputs that a verb resumes if they exist.
RESUMED = ("out.bids", "studies/results")
GROUPS = [("/sys/fs/cgroup/memory", "memory.limit_in_bytes"), ("/sys/fs/cgroup", "memory.max")]


def run(command, folder, limit=None, kind="none", group=None):
    """Runs a command; returns exit status (negative for a signal), peak resident bytes and stderr."""
    errors = folder / "stderr"
    child = os.fork()
    if child == 0:
        try:
            if group is not None:
                Path(group, "cgroup.procs").write_text(str(os.getpid()))
            if kind in ("data", "as"):
                which = resource.RLIMIT_DATA if kind == "data" else resource.RLIMIT_AS
                resource.setrlimit(which, (limit, limit))
            os.chdir(folder)
            os.environ["RUST_BACKTRACE"] = "0"
            signal.alarm(SECONDS)
            os.dup2(os.open(errors, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), 2)
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            os.execv(command[0], command)
        finally:
            os._exit(126)
    _, status, usage = os.wait4(child, 0)
    return os.waitstatus_to_exitcode(status), usage.ru_maxrss * 1024, errors.read_text(errors="replace").strip()


def ball(path, size):
    """Writes a label volume: a ball in a cube, as an array of bytes."""
    middle, square = (size - 1) / 2, (0.4 * size) ** 2
    inside = (lambda x, y, z: (x - middle) ** 2 + (y - middle) ** 2 + (z - middle) ** 2 < square)
    voxels = bytes(inside(x, y, z) for x in range(size) for y in range(size) for z in range(size))
    header = f"{{'descr': '|u1', 'fortran_order': False, 'shape': ({size}, {size}, {size}), }}".ljust(117) + "\n"
    path.write_bytes(b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode() + voxels)


def make_inputs(program, folder):
    """Makes meshes, models, a group, modes and maps, without a limit."""

    def spharm(*arguments):
        done = subprocess.run([program, *arguments], cwd=folder, capture_output=True, text=True)
        if done.returncode != 0:
            sys.exit(f"{' '.join(arguments)}: {done.stderr}")

    for level in (2, 4, 6, 8):
        spharm("generate", "--subdivisions", str(level), "--surface", f"g{level}.ply", "--sphere", f"s{level}.ply", "-q")
    spharm("reconstruct", "--help")
    (folder / "group").mkdir()
    for variant in range(8):
        spharm("generate", "--subdivisions", "4", "--variant", str(variant), "--surface", "v.ply", "--force", "-q")
        fit = ["--sphere", "s4.ply", "--surface", "v.ply", "--max-degree", "12", "-o", f"group/v{variant}.npz", "-q"]
        spharm("fit", *fit, "--objective", "vertices")
    spharm("fit", "--sphere", "s6.ply", "--surface", "g6.ply", "--max-degree", "40", "--objective", "vertices", "-o", "m.npz", "-q")
    spharm("shape", "pca", "group", "-o", "g.shape-model.npz", "-q")
    spharm("shape", "compress", "m.npz", "--tolerance", "1e-3", "-o", "m.sphz", "-q")
    spharm("shape", "test", "--a", *(f"group/v{k}.npz" for k in range(4)), "--b", *(f"group/v{k}.npz" for k in range(4, 8)),
           "--icosphere", "4", "--permutations", "100", "-o", "maps", "-q")
    spharm("export", "m.npz", "--to", "csv", "-o", "m.csv")
    spharm("basis-build", "--sphere", "s4.ply", "--store", "basis", "--max-degree", "20", "-q")
    (folder / "subjects/s1/surf").mkdir(parents=True)
    surf = "subjects/s1/surf"
    spharm("generate", "--subdivisions", "5", "--surface", f"{surf}/lh.pial", "--sphere", f"{surf}/lh.sphere.reg", "-q")
    (folder / "data/derivatives/freesurfer").mkdir(parents=True)
    (folder / "data/derivatives/freesurfer/sub-01").symlink_to("../../../subjects/s1")
    (folder / "studies").mkdir()
    spharm("study", "init", "studies/study.toml")
    for level in (3, 6):
        text = (folder / "studies/study.toml").read_text()
        for key, value in {"output": "results", "table": f"subjects{level}.csv"}.items():
            text = re.sub(f'^{key} = .*', f'{key} = "{value}"', text, flags=re.MULTILINE)
        (folder / f"studies/study{level}.toml").write_text(re.sub("^max_degree = .*", f"max_degree = {4 * level}", text, flags=re.MULTILINE))
        rows = []
        for variant in range(4):
            spharm("generate", "--subdivisions", str(level), "--variant", str(variant), "--surface", f"studies/l{level}v{variant}.ply", "-q")
            rows.append(f"s{variant},l{level}v{variant}.ply,{'ab'[variant // 2]}\n")
        (folder / f"studies/subjects{level}.csv").write_text("id,surface,group\n" + "".join(rows))
    ball(folder / "ball.npy", 40)
    rows = "".join(f"{0.001 * k},{0.002 * k},{k}\n" for k in range(1, 1500))
    (folder / "samples.csv").write_text("theta,phi,value\n" + rows)
    spharm("moments", *MOMENTS, "--max-degree", "30", "-o", "s.moments", "-q")


def cases():
    """Yields commands by name: some fit into every limit, some into none, some only into the larger limits."""
    half = [f"group/v{k}.npz" for k in range(4)], [f"group/v{k}.npz" for k in range(4, 8)]
    test = ["shape", "test", "--a", *half[0], "--b", *half[1], "-o", "out"]
    fit = ["fit", "--force", "-o", "out.npz"]
    over = [*fit, "--sphere", "s6.ply", "--surface", "g6.ply"]
    yield from (("generate", ["generate", "--subdivisions", n, "--surface", "out.ply", "--sphere", "out.obj", "--force"]) for n in "4789")
    yield "generate", ["generate", "--subdivisions", "10", "--sphere", "out.surf.gii", "--force"]
    yield "generate", ["generate", "--study", "out.study", "--subjects", "4", "--force"]
    yield from (("parametrize", ["parametrize", "--surface", f"g{n}.ply", "-o", "out.ply", "--force"]) for n in "248")
    yield from (("parametrize", ["parametrize", "--surface", "g4.ply", "--method", method, "-o", "out.ply", "--surface-output", "out2.ply",
                                 "--force"]) for method in ("conformal", "stretch", "deform"))
    yield "parametrize", ["parametrize", "--surface", "g4.ply", "--resample-to", "icosphere:9", "-o", "out.ply", "--surface-output",
                          "out2.ply", "--force"]
    yield from (("reconstruct", ["reconstruct", "--model", "m.npz", "--icosphere", n, "-o", "out.ply", "--force"]) for n in ("5", "7", "8", "12"))
    yield "reconstruct", ["reconstruct", "--model", "m.npz", "-o", "out.obj", "--force"]
    yield "reconstruct", ["reconstruct", "--model", "m.npz", "--sphere", "s8.ply", "-o", "out.surf.gii", "--force"]
    yield from (("compare", ["compare", a, b]) for a, b in (("g4.ply", "s4.ply"), ("g8.ply", "s8.ply")))
    yield from (("compare", ["compare", "g4.ply", "g4.ply", "--surface-distance", "--samples", n, "-o", "out.glb", "--force"])
                for n in ("1000", "1000000", "10000000000", "18446744073709551615"))
    yield "compare", ["compare", "g6.ply", "g6.ply", "--surface-distance"]
    yield "compare", ["compare", "g8.ply", "g8.ply", "--surface-distance"]
    yield from (("picture", ["picture", "g4.ply", "-o", "out.png", "--size", n, "--force"]) for n in ("64", "480", "1024", "4096"))
    yield "picture", ["picture", "g8.ply", "g8.ply", "--error", "-o", "out.png", "--force"]
    yield "picture", ["picture", *["g4.ply"] * 12, "--columns", "4", "--size", "4000", "-o", "out.png", "--force"]
    yield "fit", [*fit, "--surface", "g4.ply", "--max-degree", "10"]
    yield "fit", [*fit, "--surface", "g6.ply", "--max-degree", "10"]
    yield "fit", [*fit, "--surface", "g8.ply", "--max-degree", "10"]
    yield from (("fit", [*over, "--max-degree", n]) for n in ("10", "100", "1000"))
    yield from (("fit", [*over, "--objective", "vertices", "--max-degree", n]) for n in ("10", "100"))
    yield from (("fit quadrature", [*fit, "--sphere", "s4.ply", "--surface", "g4.ply", "--method", "quadrature", "--max-degree", n])
                for n in ("20", "200", "2000"))
    yield "fit irf", [*fit, "--sphere", "s4.ply", "--surface", "g4.ply", "--store", "basis", "--max-degree", "20"]
    yield "basis-build", ["basis-build", "--sphere", "s4.ply", "--store", "out.basis", "--max-degree", "30"]
    yield from (("moments", ["moments", *MOMENTS, "--max-degree", n, "-o", "out.moments", "--force"]) for n in ("20", "300", "2000"))
    yield "moments merge", ["moments", "merge", "s.moments", "-o", "out.moments", "--force"]
    yield "fit moments", [*fit, "--moments", "s.moments", "--max-degree", "20", "--smoothness", "1"]
    yield "shape align", ["shape", "align", "group", "--group", "-o", "out.group", "--force"]
    yield from (("shape correspond", ["shape", "correspond", "g4.ply", "s4.ply", "g6.ply", "--max-degree", n, "-o", "out.corr", "--force"])
                for n in ("8", "20", "60"))
    yield "shape register", ["shape", "register", "g4.ply", "--template", "g6.ply", "-o", "out.reg", "--force"]
    yield "shape mean", ["shape", "mean", "group", "-o", "out.mean.npz", "--force"]
    yield "shape pca", ["shape", "pca", "group", "-o", "out.pca.npz", "--force"]
    yield "shape quality", ["shape", "quality", "group", "--samples", "10000000000", "-o", "out.quality.json", "--force"]
    yield "shape pca", ["shape", "pca", "group", "--quality", "--samples", "10000000000", "-o", "out.pca.npz", "--force"]
    yield from (("shape test", [*test, "--icosphere", n, "--permutations", "100", "--force"]) for n in "469")
    yield "shape test", [*test, "--icosphere", "2", "--permutations", "1000000000000", "--force"]
    yield from (("shape measure", ["shape", "measure", "m.npz", "--maps", "out.maps", "--icosphere", n, "--force"]) for n in "579")
    yield from (("shape remesh", ["shape", "remesh", "group/v0.npz", "--even", "--icosphere", n, "-o", "out.ply", "--force"]) for n in "479")
    yield "shape morph", ["shape", "morph", "group/v0.npz", "group/v1.npz", "--icosphere", "4", "-o", "out.morph", "--force"]
    yield "shape morph", ["shape", "morph", "group/v0.npz", "group/v1.npz", "--icosphere", "7", "--animation", "out.gif", "-o", "out.morph",
                          "--force"]
    yield "shape match", ["shape", "match", "m.npz", "--among", "group"]
    yield "shape describe", ["shape", "describe", "group", "-o", "out.csv", "--force"]
    yield "shape rotate", ["shape", "rotate", "m.npz", "--object", "10,20,30", "-o", "out.npz", "--force"]
    yield "shape smooth", ["shape", "smooth", "m.npz", "--fwhm", "10", "-o", "out.npz", "--force"]
    yield "shape compress", ["shape", "compress", "m.npz", "--tolerance", "1e-3", "-o", "out.sphz", "--force"]
    yield "shape expand", ["shape", "expand", "m.sphz", "-o", "out.npz", "--force"]
    yield "shape sample", ["shape", "sample", "g.shape-model.npz", "--mode", "1=2", "-o", "out.npz", "--force"]
    yield "shape sample", ["shape", "sample", "g.shape-model.npz", "--random", "100000000000", "-o", "out.random", "--force"]
    freesurfer = ["freesurfer", "subjects", "--surface", "pial", "--hemi", "lh", "--max-degree", "10", "-o", "out.fs", "--force"]
    yield from (("freesurfer", [*freesurfer, "--evaluate-on", f"icosphere:{n}"]) for n in "49")
    bids = ["bids", "data", "out.bids", "participant", "--surfaces", "pial", "--hemi", "L", "--no-pages"]
    yield from (("bids", [*bids, "--max-degree", degree, "--icosphere", n]) for degree, n in (("10", "4"), ("10", "8"), ("60", "4")))
    yield from (("study", ["study", f"studies/study{level}.toml"]) for level in "36")
    yield "volumes", ["volumes", "ball.npy", "--voxel-size", "1,1,1", "--max-degree", "8", "-o", "out.volumes", "--force"]
    yield from (("store", ["store", verb, "basis"]) for verb in ("list", "verify"))
    yield "report", ["report", "m.npz", "-o", "out.html", "--force"]
    yield "report", ["report", "group", "--modes", "g.shape-model.npz", "--test", "maps", "-o", "out.html", "--force"]
    yield "export", ["export", "m.npz", "--to", "pdm", "-o", "out.coef", "--force"]
    yield "import", ["import", "m.csv", "-o", "out.npz", "--force"]


def judge(code, peak, errors, limit, kind):
    """Returns the outcome of a case, and the reason if it failed."""
    last = errors.splitlines()[-1] if errors else ""
    if code == 0:
        if kind == "memory" and peak > limit + BASE:
            return "failed", f"{peak // MIB} MiB resident"
        return "done", ""
    # With many surfaces, the reason for each failure is in the surface's own row instead of the last line.
    if code == 1 and last.startswith("error:") and any(word in errors for word in WORDS):
        return "refused", ""
    return "failed", f"exit status {code}: {last[:200]}"


def cgroup(limit):
    """Creates a memory control group, version 1 or 2; returns None if that isn't possible."""
    for parent, file in GROUPS:
        group = Path(parent, cgroup_name(limit))
        try:
            group.mkdir()
        except OSError:
            continue
        try:
            (group / file).write_text(str(limit))
            return group
        except OSError:
            group.rmdir()
    return None


def groups_of(limits):
    """Creates a memory control group for each limit; returns an empty result if that isn't possible."""
    groups = {limit: cgroup(limit) for limit in limits}
    return {} if None in groups.values() else groups


def cgroup_name(limit):
    return f"spharm-attack-{os.getpid()}-{limit // MIB}"


def to_do(program, folder, limits, groups, only, skipped):
    """Yields every case under every limit, as (limit, kind, arguments)."""
    for limit in limits:
        for kind in ("memory", "data", "as", "cgroup"):
            if kind == "cgroup" and not groups:
                skipped.add("no memory cgroup can be made here: those cases were left out")
                continue
            if kind == "as" and run([program, "--version"], folder, limit, kind)[0] != 0:
                skipped.add(f"an address space of {limit // MIB} MiB doesn't hold the program itself")
                continue
            for verb, arguments in cases():
                if verb.startswith(only) and not (kind == "memory" and verb in WITHOUT):
                    yield limit, kind, arguments


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("--limits", default="64,128,256,512", help="MiB")
    parser.add_argument("--only", default="", help="cases whose name begins so")
    parser.add_argument("--seconds", type=float, default=float(os.environ.get("SPHARM_ATTACK_SECONDS", "inf")),
                        help="how long to go on, with cases drawn by chance [default: until all are done]")
    parser.add_argument("-v", "--verbose", action="store_true", help="name every case")
    options = parser.parse_args()
    program, ends = str(Path(options.program).resolve()), time.monotonic() + options.seconds
    limits = [int(text) * MIB for text in options.limits.split(",")]
    row = {"name": "memory", "cases": 0, "done": 0, "refused": 0, "failures": 0, "worst": ""}
    worst, skipped = 0.0, set()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_inputs(program, folder)
        groups = groups_of(limits)
        todo = list(to_do(program, folder, limits, groups, options.only, skipped))
        if options.seconds != float("inf"):
            random.shuffle(todo)
        for limit, kind, arguments in todo:
            if time.monotonic() > ends:
                skipped.add(f"{len(todo) - row['cases']} of {len(todo)} cases, for which there was no time")
                break
            more = ["--memory", str(limit)] if kind == "memory" else []
            group = groups.get(limit) if kind == "cgroup" else None
            for name in RESUMED:
                shutil.rmtree(folder / name, ignore_errors=True)
            code, peak, errors = run([program, *arguments, *more], folder, limit, kind, group)
            outcome, why = judge(code, peak, errors, limit, kind)
            row["cases"] += 1
            row["failures" if outcome == "failed" else outcome] += 1
            text = f"{limit // MIB} MiB, {kind}: {' '.join(arguments)}"
            if outcome == "failed":
                print(f"FAILED {text}: {why}", flush=True)
            elif options.verbose:
                print(f"{outcome} {peak // MIB} MiB, {text}: {errors.splitlines()[-1] if errors else ''}", flush=True)
            if outcome == "done" and kind == "memory" and peak / limit > worst:
                worst = peak / limit
                row["worst"] = f"{peak // MIB} of {limit // MIB} MiB: {' '.join(arguments)}"
        for group in groups.values():
            group.rmdir()
    row["skipped"] = sorted(skipped)
    for text in row["skipped"]:
        print(f"skipped: {text}")
    print(json.dumps(row))
    return 1 if row["failures"] else 0


if __name__ == "__main__":
    sys.exit(main())
