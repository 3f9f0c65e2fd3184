"""Code that the parts share: a row of the table, the log, and running the program under limits."""

import dataclasses
import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
#: Folder for logs, tools, corpora and files of failures.
KEPT = ROOT / "target" / "attack"
#: A program counts as hanging if it takes this many seconds longer than an undisturbed run.
HANG = 10
#: Columns of the table whose values must be 0.
KINDS = ("crashes", "hangs", "half", "wrong")


@dataclasses.dataclass
class Row:
    """The row of the table for one part."""

    part: str
    done: str = ""
    crashes: int = 0
    hangs: int = 0
    half: int = 0
    wrong: int = 0
    skipped: list = dataclasses.field(default_factory=list)
    seconds: float = 0.0

    def failed(self):
        return any(getattr(self, kind) for kind in KINDS)


class Site:
    """The program under attack, the log, and folders to work in."""

    def __init__(self, program, seed, log, executions=None):
        self.program, self.seed, self.log_file = Path(program).resolve(), seed, log
        self.executions = executions
        self.random = random.Random(seed)
        self.lock = threading.Lock()
        self.workers = max(1, os.cpu_count() or 1)
        #: Result of `verbs.learned`.
        self.learned = None

    def log(self, text):
        """Writes a text to the log, but not to stderr."""
        with self.lock:
            self.log_file.write(text.rstrip() + "\n")
            self.log_file.flush()

    def say(self, text):
        """Writes a text to the log and to stderr."""
        self.log(text)
        print(text, file=sys.stderr, flush=True)

    def find(self, row, kind, text):
        """Counts a failure of a kind, and reports it."""
        with self.lock:
            setattr(row, kind, getattr(row, kind) + 1)
        self.say(f"FAILED {row.part}: {kind}: {text}")

    def skip(self, row, text):
        """Records and reports a case that can't be tested on this machine."""
        row.skipped.append(text)
        self.say(f"SKIPPED {row.part}: {text}")

    def folder(self, name):
        """Returns an empty folder."""
        path = KEPT / "work" / name
        shutil.rmtree(path, ignore_errors=True)
        path.mkdir(parents=True)
        return path


@dataclasses.dataclass
class Ended:
    """Outcome of a process."""

    code: int
    out: bytes
    err: bytes
    seconds: float
    hung: bool

    @property
    def killed(self):
        return self.code < 0

    @property
    def crashed(self):
        """Whether the program ended by a signal or a panic instead of `error: ...` and status 1."""
        return self.code < 0 or self.code >= 101 or b"panicked" in self.err

    def last(self):
        lines = self.err.decode(errors="replace").strip().splitlines()
        return lines[-1][:300] if lines else ""


def environment(extra=None):
    """Returns the environment without variables that change the program's defaults."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("SPHARM_", "SLURM_", "RAYON_", "RUST_"))}
    return kept | {"LC_ALL": "C.UTF-8"} | (extra or {})


def run(command, cwd=None, limit=60.0, env=None, setup=None, signals=True):
    """Runs a command to its end, or kills it and its children after `limit` seconds."""
    started = time.monotonic()
    process = subprocess.Popen(
        [word if isinstance(word, bytes) else str(word) for word in command], cwd=cwd, env=environment(env), stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, preexec_fn=setup, restore_signals=signals, start_new_session=True,
    )
    hung = False
    try:
        out, err = process.communicate(timeout=limit)
    except subprocess.TimeoutExpired:
        hung = True
        # The process leads its own process group, which contains only the process and its children.
        os.killpg(process.pid, signal.SIGKILL)
        out, err = process.communicate()
    return Ended(process.returncode, out, err, time.monotonic() - started, hung)


def missing(*names):
    """Returns those of the given programs that aren't installed."""
    return [name for name in names if not shutil.which(name)]


def is_root():
    return os.geteuid() == 0


def unpacked(site, row, package, *others):
    """Unpacks Debian packages into `target/attack/debian`; reports and returns `None` if that isn't possible."""
    folder = KEPT / "debian" / package
    if not (folder / "usr").is_dir():
        if missing("apt-get", "dpkg"):
            site.skip(row, f"{package} isn't here, and there is no apt-get to fetch it")
            return None
        folder.mkdir(parents=True, exist_ok=True)
        got = run(["apt-get", "download", "-q", package, *others], cwd=folder, limit=120)
        if got.code != 0:
            site.skip(row, f"{package} isn't here, and apt-get download can't get it: {got.last()}")
            return None
        for file in folder.glob("*.deb"):
            run(["dpkg", "-x", file, folder])
    return folder


def in_turn(site, seconds, cases, work):
    """Runs the cases in several threads until the time is up; returns the number done. `work` gets a worker's number."""
    end = time.monotonic() + seconds
    todo = iter(cases)
    done, broken = [0] * site.workers, []

    def worker(number):
        while time.monotonic() < end and not broken:
            with site.lock:
                case = next(todo, None)
            if case is None:
                return
            try:
                work(number, case)
            except Exception as error:  # An error in the test suite itself ends all workers and is raised later.
                broken.append(error)
                return
            done[number] += 1

    threads = [threading.Thread(target=worker, args=(number,)) for number in range(site.workers)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if broken:
        raise broken[0]
    return sum(done)
