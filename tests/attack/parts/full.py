"""Full disks: every verb that writes runs on file systems of increasing sizes, and with every number of free inodes."""

import contextlib
import time

import verbs
from common import Row, in_turn, is_root, missing, run

STEP = 4096


@contextlib.contextmanager
def mounted(folder, options):
    """Mounts a file system in memory with these mount options."""
    made = run(["mount", "-t", "tmpfs", "-o", options, "attack", folder])
    if made.code != 0:
        raise OSError(f"tmpfs can't be mounted: {made.last()}")
    try:
        yield
    finally:
        # Unmounting may fail for a while, if a program that scans the machine's files has one open.
        for _ in range(50):
            if run(["umount", folder]).code == 0:
                break
            time.sleep(0.1)
        else:
            raise OSError(f"{folder} can't be unmounted")


def run_part(site, seconds):
    row = Row("full disks")
    if absent := missing("mount", "umount"):
        site.skip(row, f"{absent[0]} isn't here")
        return row
    if not is_root():
        site.skip(row, "only root can mount a small file system")
        return row
    disks = [site.folder(f"disk{number}") for number in range(site.workers)]
    try:
        with mounted(disks[0], "size=64k"):
            pass
    except OSError as error:
        site.skip(row, str(error))
        return row
    inputs, all_verbs = verbs.learned(site)
    cases = []
    for verb in all_verbs:
        sizes = range(STEP, verb.bytes_written + 8 * STEP, STEP)
        files = len(verb.expected)
        of_verb = [(verb, f"size={size}") for size in sizes] + [(verb, f"nr_inodes={count}") for count in range(2, files + 6)]
        site.random.shuffle(of_verb)
        cases += [(place * verb.seconds, case) for place, case in enumerate(of_verb)]
    cases = [case for _, case in sorted(cases, key=lambda timed: timed[0])]
    counts = {"failed": 0, "succeeded": 0}

    def fill(worker, case):
        verb, options = case
        place = verbs.Workplace(site, f"full{worker}", inputs, disks[worker])
        with mounted(disks[worker], options + (",size=64m" if "inodes" in options else "")):
            try:
                place.fresh(verb)
            except (RuntimeError, OSError):
                # There isn't enough space for the files that the verb extends.
                return
            ended = place.run(verb)
            counts["failed" if ended.code else "succeeded"] += 1
            if ended.code == 1 and not ended.hung and not says_so(ended.err):
                site.find(row, "wrong", f"{verb.name} with {options} doesn't say why it fails: {ended.last()}")
            run(["mount", "-o", "remount,size=64m,nr_inodes=100k", disks[worker]])
            place.judge(row, verb, ended, options)

    total = in_turn(site, seconds, cases, fill)
    row.done = f"{total} of {len(cases)} sizes and numbers of inodes: {counts['failed']} failed, {counts['succeeded']} had room"
    return row


def says_so(err):
    """Returns whether a message reports missing space, in the system's words or as a plan that doesn't fit."""
    text = err.decode(errors="replace").lower()
    return any(word in text for word in ("no space", "disk", "free", "inode", "room"))
