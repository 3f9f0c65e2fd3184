"""Inputs that aren't regular files, and names that aren't UTF-8, for the inputs of every verb.

One input at a time is replaced by a pipe without a writer, a device, a socket, a folder, an empty file, or a link to a
missing file or to itself. The verb must end at once, with status 1 and a line that names the input, and leave no
half-written file. Then one input at a time gets a name that isn't UTF-8; the verb must write as many outputs as in an
undisturbed run.
"""

import os
import resource
import shutil
import socket

import verbs
from common import HANG, Row, in_turn, run

#: Limit of a verb's address space, in bytes; without it, reading /dev/zero to the end would take all memory.
MEMORY = 8 << 30
#: Inputs that aren't named by an argument: patterns within the folder of the inputs.
UNNAMED = {
    "fit --manifest": ("a.ply", "b.ply"),
    "shape correspond --table": ("a.ply", "b.ply", "c.ply", "marks.csv", "?.near.csv"),
    "study": ("study.csv", "s?.ply"),
    "freesurfer": ("subjects/*/surf/*",),
    "bids": ("subjects/*/surf/*",),
}
#: Files of a store that a fit over it doesn't read.
UNREAD = (".lock", "factor_")
#: Folders of a group with members' places and records.
OF_MEMBERS = {"members", "places"}
#: Verbs that read a group without these folders.
WITHOUT_MEMBERS = {"shape correspond --to", "shape quality --mask"}
#: Beginning of a name that isn't UTF-8.
BYTES = b"\xff\xe9 "


def pipe(path):
    os.mkfifo(path)


def listening(path):
    # Socket paths have at most 107 bytes, so bind within the folder.
    here = os.open(".", os.O_RDONLY)
    try:
        os.chdir(path.parent)
        with socket.socket(socket.AF_UNIX) as made:
            made.bind(path.name)
    finally:
        os.fchdir(here)
        os.close(here)


#: Replacements of an input: description, and the function that makes it.
ODD = {
    "a pipe": pipe,
    "/dev/zero": lambda path: path.symlink_to("/dev/zero"),
    "/dev/full": lambda path: path.symlink_to("/dev/full"),
    "a socket": listening,
    "a folder": lambda path: path.mkdir(),
    "an empty file": lambda path: path.touch(),
    "a link to nothing": lambda path: path.symlink_to("nothing"),
    "a link to itself": lambda path: path.symlink_to(path.name),
}


def limited():
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))


def files_of(verb, folder):
    """Returns the input files of a verb, relative to the folder of all inputs."""
    named = [word.partition("/")[2] for word in verb.arguments.split() if word.startswith(("in/", "INPUTS/"))]
    found = set()
    for pattern in [*named, *UNNAMED.get(verb.name, ())]:
        for path in folder.glob(pattern):
            inside = path.rglob("*") if path.is_dir() and not path.is_symlink() else [path]
            files = {file.relative_to(folder) for file in inside if file.is_file() and not file.name.startswith(UNREAD)}
            if verb.name in WITHOUT_MEMBERS:
                files = {file for file in files if file.parent.name not in OF_MEMBERS}
            found |= files
    return sorted(found)


def run_part(site, seconds):
    row = Row("odd inputs and names")
    inputs, all_verbs = verbs.learned(site)
    cases = [(verb, file, odd) for verb in all_verbs for file in files_of(verb, inputs) for odd in [*ODD, None]]
    site.random.shuffle(cases)
    places = []
    for number in range(site.workers):
        copy = site.folder(f"odd-inputs{number}") / "inputs"
        shutil.copytree(inputs, copy, symlinks=True)
        places.append(verbs.Workplace(site, f"odd{number}", copy))

    def replace(number, case):
        verb, file, odd = case
        place, kept = places[number], inputs / file
        path = place.inputs / file
        place.fresh(verb)
        path.unlink()
        try:
            if odd:
                ODD[odd](path)
                ended = place.run(verb, setup=limited)
                judge(site, row, place, verb, ended, file, odd)
            else:
                named(site, row, place, verb, file, kept)
        finally:
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            elif os.path.lexists(path):
                path.unlink()
            shutil.copy2(kept, path)

    total = in_turn(site, seconds, cases, replace)
    row.done = f"{total} of {len(cases)} commands of {len(all_verbs)} with one input that is no file, or whose name is no text"
    return row


def judge(site, row, place, verb, ended, file, odd):
    what = f"{verb.name}, {file} is {odd}"
    text = (ended.err + ended.out).decode(errors="replace")
    if ended.hung:
        site.find(row, "hangs", f"{what}: no end")
    elif ended.crashed:
        site.find(row, "crashes", f"{what}: status {ended.code}: {ended.last()}")
    elif ended.code == 0:
        site.find(row, "wrong", f"{what}: status 0: {ended.last()}")
    elif ended.code != 1:
        site.find(row, "wrong", f"{what}: status {ended.code}: {ended.last()}")
    elif file.name not in text and file.parent.name not in text:
        site.find(row, "wrong", f"{what}: not named: {ended.last()}")
    if not ended.hung:
        for kind, flaw in place.flaws(verb, ended.killed, False):
            if "/logs/participant-" in flaw:
                # The file is named after a hash of the dataset's path, which differs here.
                continue
            site.find(row, kind, f"{what}: {flaw}")


def named(site, row, place, verb, file, kept):
    """Runs a verb with an input of another name, if an argument names this input."""
    what = f"{verb.name}, {file} with bytes in its name"
    other = BYTES + os.fsencode(file.name)
    path = os.path.join(os.fsencode(place.inputs / file.parent), other)
    words = [os.fsencode(str(word)) for word in verb.command(place.site.program, place.inputs)]
    old = os.fsencode(f"in/{file}")
    if old not in words:
        return
    shutil.copy2(kept, path)
    try:
        ended = run([os.path.join(b"in", os.fsencode(file.parent), other) if word == old else word for word in words],
                    cwd=place.folder, limit=HANG + 10 * verb.seconds)
    finally:
        os.unlink(path)
    if ended.hung:
        site.find(row, "hangs", f"{what}: no end")
    elif ended.crashed:
        site.find(row, "crashes", f"{what}: status {ended.code}: {ended.last()}")
    elif ended.code != 0:
        site.find(row, "wrong", f"{what}: status {ended.code}: {ended.last()}")
    elif len(place.files()) != len(verb.expected):
        site.find(row, "wrong", f"{what}: {len(place.files())} outputs in place of {len(verb.expected)}")
