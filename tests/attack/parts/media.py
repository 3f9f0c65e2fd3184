"""Bad media: every verb that reads runs on a file system with flipped bits, unreadable bytes and short reads.

A flipped bit in a file with checksums must give the right result or an error. Unreadable bytes must give an error. A
short read must have no effect.
"""

import json
import subprocess
import sys
import time
from pathlib import Path

import verbs
from common import HANG, KEPT, Row, environment, is_root, missing, run

KINDS = ("flip", "EIO", "short")
#: Commands, the files that they read, and whether checksums cover every bit of these files.
READERS = (
    ("fit over a store", "fit --store disk/store --sphere in/sphere.ply --surface in/a.ply --max-degree 4 -o out/m.npz --threads 1",
     "store/*/A_*", True),
    ("fit over a factor", "fit --store disk/store --sphere in/sphere.ply --surface in/a.ply --max-degree 3 --method lsq --objective vertices "
     "-o out/m.npz --threads 1", "store/*/factor_*", True),
    ("store verify", "store verify disk/store", "store/*/*_*", True),
    ("fit", "fit --sphere disk/sphere.ply --surface disk/a.ply --max-degree 4 -o out/m.npz --threads 1", "*a.ply", False),
    ("reconstruct", "reconstruct --model disk/a.npz --icosphere 2 -o out/r.ply --threads 1", "a.npz", False),
    ("fit --moments", "fit --moments disk/1.moments --max-degree 2 -o out", "1.moments", True),
    ("shape expand", "shape expand disk/a.sphz -o out/e.npz", "a.sphz", True),
    ("import", "import disk/a.coef -o out/i.npz", "a.coef", False),
    ("volumes", "volumes disk/labels.nii --max-degree 2 -o out/v --threads 1", "labels.nii", False),
    ("moments", "moments --samples disk/samples.csv --values v --max-degree 2 -o out/s.moments --threads 1", "samples.csv", False),
)


def python(site, row):
    """Returns a Python with mfusepy, or `None`."""
    venv = KEPT / "venv"
    path = venv / "bin/python"
    if run([path, "-c", "import mfusepy"]).code == 0 if path.exists() else False:
        return path
    for command in ([sys.executable, "-m", "venv", venv], [path, "-m", "pip", "install", "-q", "mfusepy==3.1.1"]):
        ended = run(command, limit=300)
        if ended.code != 0:
            site.skip(row, f"mfusepy can't be installed: {ended.last()}")
            return None
    if run([path, "-c", "import mfusepy"]).code != 0:
        site.skip(row, "mfusepy finds no libfuse (Debian: libfuse3-3)")
        return None
    return path


def run_part(site, seconds):
    row = Row("bad media")
    if not Path("/dev/fuse").exists():
        site.skip(row, "there is no /dev/fuse")
        return row
    if not is_root() and missing("fusermount3"):
        site.skip(row, "only root mounts without fusermount3")
        return row
    found = python(site, row)
    if found is None:
        return row
    inputs, _ = verbs.learned(site)
    place = verbs.Workplace(site, "media", inputs)
    disk, control = place.folder / "disk", place.folder / "control.json"
    disk.mkdir()
    control.write_text("{}")
    log = open(KEPT / "disk.log", "w")
    server = subprocess.Popen([found, Path(__file__).with_name("disk.py"), inputs, disk, control], env=environment(), stdout=log,
                              stderr=log, stdin=subprocess.DEVNULL)
    try:
        end = time.monotonic() + 10
        while not (disk / "sphere.ply").exists():
            if time.monotonic() > end or server.poll() is not None:
                site.skip(row, f"the file system can't be mounted: {(KEPT / 'disk.log').read_text()[-200:]}")
                return row
            time.sleep(0.05)
        attack(site, row, place, control, inputs, seconds)
    finally:
        run(["umount" if is_root() else "fusermount3", *([] if is_root() else ["-u"]), disk])
        server.terminate()
        server.wait()
        log.close()
    return row


def attack(site, row, place, control, inputs, seconds):
    readers = []
    for name, arguments, pattern, summed in READERS:
        verb = verbs.Verb(name, arguments, goes_on=name == "volumes")
        place.learn(verb)
        readers.append((verb, sorted(inputs.glob(pattern)), summed))
    counts = dict.fromkeys(KINDS, 0)
    noticed = 0
    end = time.monotonic() + seconds
    number = 0
    while time.monotonic() < end:
        verb, files, summed = readers[number % len(readers)]
        kind = KINDS[number // len(readers) % len(KINDS)]
        number += 1
        file = site.random.choice(files)
        if kind == "short" and "store" in file.parts:
            # The file system bypasses the page cache for short reads, and such files can't be mapped.
            continue
        fault = {"name": str(file.relative_to(inputs)), "offset": site.random.randrange(file.stat().st_size), "kind": kind,
                 "bit": site.random.randrange(8)}
        place.fresh(verb)
        control.write_text(json.dumps(fault))
        ended = place.run(verb)
        control.write_text("{}")
        counts[kind] += 1
        noticed += ended.code == 1
        what = f"{verb.name}, {fault}"
        if ended.hung:
            site.find(row, "hangs", f"{what}: over {HANG} s")
        elif ended.crashed:
            site.find(row, "crashes", f"{what}: status {ended.code}: {ended.last()}")
        elif ended.code not in (0, 1):
            site.find(row, "wrong", f"{what}: status {ended.code}: {ended.last()}")
        elif ended.code == 1 and kind == "short":
            site.find(row, "wrong", f"{what}: a short read isn't an error: {ended.last()}")
        # A flipped bit in a file without checksums may change the result. With labels, one label may fail while the
        # flipped bit changes the files of other labels.
        sure = summed or kind != "flip"
        for problem, text in place.flaws(verb, False, ended.code == 0) if sure or ended.code == 1 and not verb.goes_on else ():
            site.find(row, problem, f"{what}: {text}")
    row.done = ", ".join(f"{count} {kind}" for kind, count in counts.items()) + f" in files of {len(READERS)} commands, {noticed} noticed"
