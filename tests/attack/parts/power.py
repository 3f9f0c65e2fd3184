"""Power cuts: a file system stops in the middle of a verb's work; its contents are checked after it is mounted again.

The file system is in a file behind a loop device. FS_IOC_SHUTDOWN stops it at once, either flushing its log or not; a
real power cut doesn't flush the log. Mounting the file system again replays the journal.
"""

import contextlib
import fcntl
import os
import struct
import subprocess
import time

import verbs
from common import Row, environment, is_root, missing, run, unpacked

#: The ioctl FS_IOC_SHUTDOWN, which is the same for ext4 and xfs, and its modes.
SHUTDOWN, LOGFLUSH, NOLOGFLUSH = 0x8004587D, 1, 2
MAKERS = {"ext4": ("mkfs.ext4", "-q", "-F", 64), "xfs": ("mkfs.xfs", "-q", "-f", 320)}


class Disk:
    """A file system in a file, mounted by a loop device."""

    def __init__(self, site, kind, maker):
        self.kind, self.mounted = kind, False
        self.image, self.folder = site.folder(f"power-{kind}") / "image", site.folder(f"power-{kind}-mount")
        name, quiet, force, megabytes = MAKERS[kind]
        with open(self.image, "wb") as file:
            file.truncate(megabytes << 20)
        made = run([maker or name, quiet, force, self.image])
        if made.code != 0:
            raise OSError(f"{name}: {made.last()}")

    def mount(self):
        done = run(["mount", "-t", self.kind, "-o", "loop", self.image, self.folder])
        if done.code != 0:
            raise OSError(f"a {self.kind} can't be mounted: {done.last()}")
        self.mounted = True

    def cut(self, way):
        folder = os.open(self.folder, os.O_RDONLY)
        try:
            fcntl.ioctl(folder, SHUTDOWN, struct.pack("I", way))
        finally:
            os.close(folder)

    def unmount(self):
        while self.mounted:
            done = run(["umount", self.folder])
            if done.code == 0:
                self.mounted = False
            else:
                # A process that has just ended may still be using the file system, so try again.
                time.sleep(0.05)


def run_part(site, seconds):
    row = Row("power cuts")
    if absent := missing("mount", "umount", "losetup"):
        site.skip(row, f"{absent[0]} isn't here")
        return row
    if not is_root():
        site.skip(row, "only root can mount a disk and cut its power")
        return row
    inputs, all_verbs = verbs.learned(site)
    disks = []
    for kind in MAKERS:
        maker = None
        if missing(MAKERS[kind][0]):
            folder = unpacked(site, row, "xfsprogs", "libinih1", "liburcu8") if kind == "xfs" else None
            if folder is None:
                site.skip(row, f"no {kind}: {MAKERS[kind][0]} isn't here")
                continue
            maker = folder / "sbin" / MAKERS[kind][0]
            libraries = ":".join(str(path) for path in (folder / "usr/lib/x86_64-linux-gnu", folder / "lib/x86_64-linux-gnu"))
            os.environ["LD_LIBRARY_PATH"] = libraries
        try:
            disk = Disk(site, kind, maker)
            disk.mount()
            disk.cut(NOLOGFLUSH)
            disk.unmount()
            disks.append(disk)
        except OSError as error:
            site.skip(row, f"no {kind}: {error}")
        finally:
            os.environ.pop("LD_LIBRARY_PATH", None)
    cuts = {disk.kind: 0 for disk in disks}
    after = dict.fromkeys(cuts, 0)
    end = time.monotonic() + seconds
    # Verbs that build and replace files are cut most often in the second half of their work, when they publish files.
    chosen = [verb for verb in all_verbs if verb.name != "study"]
    while disks and time.monotonic() < end:
        disk, verb = site.random.choice(disks), site.random.choice(chosen)
        moment = site.random.random() if site.random.random() < 0.5 else 0.5 + 0.6 * site.random.random()
        finished = one(site, row, inputs, disk, verb, moment, site.random.choice((LOGFLUSH, NOLOGFLUSH)))
        cuts[disk.kind] += 1
        after[disk.kind] += finished
    row.done = ", ".join(f"{count} on {kind} ({after[kind]} just after the end)" for kind, count in cuts.items())
    return row


def one(site, row, inputs, disk, verb, moment, way):
    """Cuts the power at a fraction of a verb's undisturbed time. Returns whether the verb had finished."""
    disk.mount()
    with contextlib.ExitStack() as stack:
        stack.callback(disk.unmount)
        place = verbs.Workplace(site, "power", inputs, disk.folder)
        place.fresh(verb)
        run(["sync", "-f", disk.folder])
        process = subprocess.Popen([str(word) for word in verb.command(site.program, inputs)], cwd=place.folder, env=environment(),
                                   stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        time.sleep(moment * verb.seconds)
        finished = process.poll() == 0
        disk.cut(way)
        process.kill()
        process.communicate()
        disk.unmount()
        disk.mount()
        what = f"power cut on {disk.kind} at {moment:.2f}, {'with' if way == LOGFLUSH else 'without'} its log flushed"
        failures = list(place.flaws(verb, True, finished))
        again = place.run(verb, again=True)
        if again.code != 0:
            failures.append(("wrong", f"the rerun ends with {again.code}: {again.last()}"))
        else:
            failures += [(kind, "after the rerun: " + text) for kind, text in place.flaws(verb, True, True)]
        for kind, text in failures:
            site.find(row, kind, f"{verb.name}, {what}: {text}")
    return finished
