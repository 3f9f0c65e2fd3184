"""Faults at single system calls, for every verb that writes: kills, errors, interruptions and short writes.

strace counts the calls that concern a verb's folder, and makes one of them fail or kills the program at it. A small
library, loaded before the C library, makes writes short. A limit on the size of files makes one write short and the
next one fail.
"""

import collections
import re
import resource
import subprocess

import verbs
from common import KEPT, Row, in_turn, missing, run

CALLS = ("openat", "write", "pwrite64", "rename", "renameat", "renameat2", "link", "linkat", "fsync", "fdatasync", "unlink",
         "unlinkat", "flock", "mkdir", "mkdirat", "close", "fchmod", "ftruncate")
FAULTS = ("signal=KILL", "error=EIO", "error=ENOSPC", "error=EINTR")
#: Source of a library whose writes write fewer bytes than requested, as any write may.
SHORT = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stdlib.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

static int calls;

/* Every other call writes a part; with SHORT_EINTR every third one is interrupted before it writes. */
static size_t part(size_t size) {
  return size > 1 && __sync_fetch_and_add(&calls, 1) % 2 ? 1 + size / 3 : size;
}
static int interrupted(void) {
  if (!getenv("SHORT_EINTR") || __sync_fetch_and_add(&calls, 1) % 3) return 0;
  errno = EINTR;
  return 1;
}
ssize_t write(int file, const void *data, size_t size) {
  static ssize_t (*real)(int, const void *, size_t);
  if (!real) real = dlsym(RTLD_NEXT, "write");
  return interrupted() ? -1 : real(file, data, part(size));
}
ssize_t pwrite64(int file, const void *data, size_t size, off64_t at) {
  static ssize_t (*real)(int, const void *, size_t, off64_t);
  if (!real) real = dlsym(RTLD_NEXT, "pwrite64");
  return interrupted() ? -1 : real(file, data, part(size), at);
}
ssize_t writev(int file, const struct iovec *parts, int count) {
  if (count > 0 && parts[0].iov_len) return write(file, parts[0].iov_base, parts[0].iov_len);
  static ssize_t (*real)(int, const struct iovec *, int);
  if (!real) real = dlsym(RTLD_NEXT, "writev");
  return real(file, parts, count);
}
"""


def concerns(line, folder):
    """Returns whether a line of strace's output is about a verb's folder or its standard output."""
    name, _, rest = line.partition("(")
    rest = re.sub(r"AT_FDCWD<[^>]*>", "", rest)
    if name in ("write", "pwrite64"):
        rest = rest.split(",", 1)[0]
        return folder in rest or bool(re.match(r"[12]<", rest))
    return folder in rest or bool(re.match(r'[^"]*"(?!/)', rest))


def points(trace, folder):
    """Returns the calls of an undisturbed run as `(call, number within its thread)`.

    strace counts calls in each thread separately. So a call whose number also occurs in the loader, before `main`, is
    left out.
    """
    counts, found, loader, first = collections.Counter(), {}, collections.Counter(), None
    for line in trace.splitlines():
        if match := re.match(r"(\d+) +(\w+\(.*)", line):
            thread, call = match[1], match[2]
            first = first or thread
            name = call.partition("(")[0]
            counts[thread, name] += 1
            if concerns(call, folder):
                found[name, counts[thread, name]] = None
            elif thread == first and not found:
                loader[name] += 1
    return [(name, number) for name, number in found if number > loader[name]]


def run_part(site, seconds):
    row = Row("faults at system calls")
    if absent := missing("strace"):
        site.skip(row, f"{absent[0]} isn't here")
        return row
    inputs, all_verbs = verbs.learned(site)
    places = [verbs.Workplace(site, f"faults{number}", inputs) for number in range(site.workers)]
    cases = []
    for verb in all_verbs:
        places[0].fresh(verb)
        traced = places[0].run(verb, before=strace(places[0], "trace=" + ",".join(CALLS)), limit=120)
        text = (places[0].folder / "trace").read_text(errors="replace")
        found = points(text, str(places[0].folder))
        if traced.code != 0 or not found:
            site.skip(row, f"{verb.name} can't be traced: {traced.last()}")
        site.log(f"{verb.name}: {len(found)} calls, {verb.seconds:.2f} s")
        of_verb = [(verb, call, number, fault) for call, number in found for fault in FAULTS]
        site.random.shuffle(of_verb)
        # Cases are ordered so that every verb gets the same share of the time, whether it is fast or slow.
        cases += [(place * verb.seconds, case) for place, case in enumerate(of_verb)]
    cases = [case for _, case in sorted(cases, key=lambda timed: timed[0])]
    done = collections.Counter()

    def inject(worker, case):
        verb, call, number, fault = case
        place = places[worker]
        place.fresh(verb)
        before = strace(place, f"trace={call}", f"inject={call}:{fault}:when={number}")
        ended = place.run(verb, before=before)
        done[fault] += 1
        place.judge(row, verb, ended, f"{fault} at {call} {number}")

    total = in_turn(site, 0.8 * seconds, cases, inject)
    row.done = f"{total} of {len(cases)} (" + ", ".join(f"{count} {fault.split('=')[1]}" for fault, count in done.items()) + ")"
    shorts = short_writes(site, row, all_verbs, places)
    limits = size_limits(site, row, all_verbs, places, 0.2 * seconds)
    row.done += f"; {shorts} with short writes, {limits} with a limit on sizes; {len(all_verbs)} commands"
    return row


def strace(place, *expressions):
    words = ["strace", "-f", "-qq", "-y", "-o", place.folder / "trace"]
    for expression in expressions:
        words += ["-e", expression]
    return words


def short_writes(site, row, all_verbs, places):
    """Runs every verb with short writes, and with interrupted writes: neither may change the result."""
    if absent := missing("cc"):
        site.skip(row, f"{absent[0]} isn't here: no short writes")
        return 0
    library = KEPT / "short.so"
    built = subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-x", "c", "-", "-o", library, "-ldl"], input=SHORT.encode(),
                           capture_output=True)
    if built.returncode != 0:
        site.skip(row, f"short writes: cc fails: {built.stderr.decode(errors='replace').splitlines()[:1]}")
        return 0
    cases = [(verb, interrupts) for verb in all_verbs for interrupts in (False, True)]

    def shorten(worker, case):
        verb, interrupts = case
        place = places[worker]
        place.fresh(verb)
        env = {"LD_PRELOAD": str(library)} | ({"SHORT_EINTR": "1"} if interrupts else {})
        ended = place.run(verb, env=env)
        what = "short writes" + (" and EINTR" if interrupts else "")
        if ended.code != 0 and not ended.hung:
            site.find(row, "wrong", f"{verb.name}, {what}: status {ended.code}: {ended.last()}")
        place.judge(row, verb, ended, what)

    return in_turn(site, 1e9, cases, shorten)


def size_limits(site, row, all_verbs, places, seconds):
    """Runs every verb with limits on the size of files: the write that crosses a limit is short, the next one fails."""
    cases = [(verb, size) for verb in all_verbs if verb.bytes_written > 1
             for size in sorted({1, 4096, 4097, 70_000, verb.bytes_written // 7, verb.bytes_written // 2})]
    site.random.shuffle(cases)

    def limited(worker, case):
        verb, size = case
        place = places[worker]
        place.fresh(verb)

        def setup():
            resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

        # Python ignores SIGXFSZ, and its children inherit that, so the write fails with EFBIG instead.
        ended = place.run(verb, setup=setup, signals=False)
        place.judge(row, verb, ended, f"files of at most {size} bytes")

    return in_turn(site, seconds, cases, limited)
