"""Runs the same fit with real schedulers: Slurm, Snakemake, Dask. `./run cluster` calls it, with the program in PATH.

Slurm's daemons run on loopback as a cluster of one node. They come from the distribution's packages, unpacked into
target/cluster; configuration, state and logs are in a temporary folder, and nothing is installed into the system.
Snakemake is installed from PyPI into target/cluster; Dask is used if this Python has it. Each scheduler must give the
model of a single process to 1e-12, otherwise the exit status is 1.
"""

import atexit
import contextlib
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES, CACHE = ROOT / "examples" / "cluster", ROOT / "target" / "cluster"
SAMPLES, PARTS, MOMENTS_DEGREE, FIT_DEGREE = 400_000, 5, 60, 40
TOLERANCE = 1e-12
#: Number of the part whose task is killed, or whose file is deleted.
LOST = 3
#: Time limit in seconds; every step here takes less.
PATIENCE = 180


class Skipped(Exception):
    """A scheduler can't be tested on this machine; the message is the reason."""


def run(command, **more):
    """Runs a command; the error contains its output if it fails."""
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, timeout=600, **more)
    if done.returncode:
        raise RuntimeError(f"{command[0]} ended with {done.returncode}:\n{done.stdout}{done.stderr}")
    return done.stdout + done.stderr


def say(text):
    print(f"\n== {text}", file=sys.stderr, flush=True)


def write_samples(path):
    """Writes samples of a wavy field with noise at random, unevenly distributed directions."""
    rng = np.random.default_rng(0)
    v = rng.normal(size=(SAMPLES, 3)) + [0.2, 0, 0]
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    f = np.cos(5 * v[:, 0]) + v[:, 1] * v[:, 2] + 0.1 * rng.normal(size=SAMPLES)
    np.save(path, np.column_stack([v, f]))


def coefficients(path):
    with np.load(path) as model:
        return model["coefficients"]


def wait_for(what, ready, patience=PATIENCE):
    end = time.monotonic() + patience
    while not ready():
        if time.monotonic() > end:
            raise RuntimeError(f"{what}: not within {patience} s")
        time.sleep(0.2)


# --- Slurm -----------------------------------------------------------------------------------------------------------

PACKAGES = ["slurmctld", "slurmd", "slurm-client", "slurm-wlm-basic-plugins", "munge", "libmunge2"]
#: Suffix of Debian's programs; the links without it are made on installation, and missing in unpacked packages.
SUFFIX = "-wlm"


def unpacked_slurm():
    """Returns the folder of Slurm's packages, and a description of the packages that were fetched."""
    folder = CACHE / "slurm"
    if (folder / "complete").exists():
        return folder, "nothing"
    for tool in ("apt-get", "dpkg-deb"):
        if not shutil.which(tool):
            raise Skipped(f"no {tool} on this machine, which fetching Slurm's Debian packages needs")
    try:
        # Also fetches the libraries that are missing on this machine.
        plan = run(["apt-get", "install", "-s", "--no-install-recommends", *PACKAGES])
        names = sorted({*PACKAGES, *re.findall(r"^Inst (\S+)", plan, re.M)})
        with tempfile.TemporaryDirectory() as downloads:
            run(["apt-get", "download", *names], cwd=downloads)
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
            for package in Path(downloads).glob("*.deb"):
                run(["dpkg-deb", "-x", package, folder])
    except RuntimeError as error:
        raise Skipped(f"Slurm's packages can't be fetched; `apt-get update` may help: {str(error).strip().splitlines()[-1]}")
    (folder / "complete").touch()
    return folder, f"{len(names)} Debian packages, unpacked"


def free_ports(count):
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket()) for _ in range(count)]
        for each in sockets:
            each.bind(("127.0.0.1", 0))
        return [each.getsockname()[1] for each in sockets]


class Slurm:
    """A cluster of one node; its daemons run within the `with` block."""

    def __init__(self, folder, packages):
        self.folder, self.packages = folder / "daemons", packages
        self.processes = []
        for name in ("state", "spool", "log", "bin"):
            (self.folder / name).mkdir(parents=True)
        for program in [*(packages / "usr/bin").glob("*"), *(packages / "usr/sbin").glob("*")]:
            (self.folder / "bin" / program.name.removesuffix(SUFFIX)).symlink_to(program)
        [self.libraries] = (packages / "usr/lib").glob("*/slurm-wlm")
        paths = [self.folder / "bin", os.environ["PATH"]]
        libraries = [self.libraries, self.libraries.parent, os.environ.get("LD_LIBRARY_PATH", "")]
        self.environment = os.environ | {
            "PATH": os.pathsep.join(map(str, paths)),
            "LD_LIBRARY_PATH": os.pathsep.join(filter(None, map(str, libraries))),
            "SLURM_CONF": str(self.folder / "slurm.conf"),
        }

    def __enter__(self):
        atexit.register(self.stop)
        try:
            self.start()
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(self, *_):
        self.stop()

    def start(self):
        key = self.folder / "munge.key"
        key.write_bytes(os.urandom(128))
        key.chmod(0o600)
        here = lambda name: self.folder / name  # noqa: E731
        self.daemon("munged", "--foreground", "--force", f"--socket={here('munge')}", f"--key-file={key}",
                    f"--pid-file={here('munge.pid')}", f"--seed-file={here('seed')}", f"--log-file={here('log/munged')}")
        wait_for("munged", here("munge").exists)
        host, user = socket.gethostname().split(".")[0], run(["id", "-un"]).strip()
        controller, node = free_ports(2)
        here("slurm.conf").write_text(f"""ClusterName=spharm
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={controller}
SlurmdPort={node}
AuthType=auth/munge
CredType=cred/munge
AuthInfo=socket={here('munge')}
PluginDir={self.libraries}
SlurmUser={user}
SlurmdUser={user}
StateSaveLocation={here('state')}
SlurmdSpoolDir={here('spool')}
SlurmctldPidFile={here('slurmctld.pid')}
SlurmdPidFile={here('slurmd.pid')}
SlurmctldLogFile={here('log/slurmctld')}
SlurmdLogFile={here('log/slurmd')}
MpiDefault=none
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SchedulerParameters=batch_sched_delay=0,sched_min_interval=0
SlurmdParameters=config_overrides
ReturnToService=2
KillWait=5
NodeName={host} NodeAddr=127.0.0.1 CPUs={max(2, os.cpu_count() or 2)} State=UNKNOWN
PartitionName=main Nodes={host} Default=YES MaxTime=INFINITE State=UP
""")
        self.daemon("slurmctld", "-D")
        self.daemon("slurmd", "-D", "-d", here("bin/slurmstepd"))
        wait_for("a node that is idle", lambda: "idle" in self.ask("sinfo", "-h", "-o", "%T"))

    def daemon(self, *command):
        log = (self.folder / "log" / f"{command[0]}.out").open("w")
        words = [str(word) for word in command]
        # With setpriv the daemon ends when this process ends, for any reason. It has its own process group, so that all
        # of its children can be ended.
        if shutil.which("setpriv"):
            words = ["setpriv", "--pdeathsig", "TERM", *words]
        self.processes.append(subprocess.Popen(words, env=self.environment, stdout=log, stderr=log, start_new_session=True))

    def ask(self, *command):
        """Returns a client's output, or nothing if the controller doesn't answer."""
        done = subprocess.run(command, env=self.environment, capture_output=True, text=True, timeout=60)
        for process in self.processes:
            if process.poll() is not None:
                raise RuntimeError(f"{' '.join(process.args)} ended with {process.returncode}:\n{self.logs()}")
        return done.stdout if done.returncode == 0 else ""

    def logs(self):
        return "".join(f"--- {log.name}\n{log.read_text()[-2000:]}\n" for log in sorted((self.folder / "log").iterdir()))

    def idle(self, patience=PATIENCE):
        wait_for("an empty queue", lambda: self.ask("sinfo", "-h") and not self.ask("squeue", "-h"), patience)

    def stop(self):
        for process in reversed(self.processes):
            process.terminate()
        for process in reversed(self.processes):
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        self.processes = []
        # Steps and their commands run in separate sessions; they are identified by the folder in their environment.
        mark = f"SLURM_CONF={self.environment['SLURM_CONF']}".encode()
        for entry in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                if mark in (entry / "environ").read_bytes().split(b"\0"):
                    os.kill(int(entry.name), signal.SIGKILL)


def by_slurm(folder, samples):
    """Runs an array of tasks, kills one of them, and submits it again; then adds the moments and fits the model."""
    packages, fetched = unpacked_slurm()
    # A task can only be killed reliably if it runs long enough, so the task that will be killed waits first.
    spharm, wait = folder / "path" / "spharm", folder / "wait"
    spharm.parent.mkdir()
    real = shutil.which("spharm")
    spharm.write_text(f'#!/bin/sh\ncase "$*" in *"--shard {LOST}/"*) test -e {wait} && sleep 300;; esac\nexec {real} "$@"\n')
    spharm.chmod(0o755)
    wait.touch()
    with Slurm(folder, packages) as slurm:
        started = time.monotonic()
        slurm.environment["PATH"] = f"{spharm.parent}{os.pathsep}{slurm.environment['PATH']}"
        degrees = {"MOMENTS_DEGREE": str(MOMENTS_DEGREE), "FIT_DEGREE": str(FIT_DEGREE)}

        def submit(**more):
            environment = slurm.environment | degrees | more
            return run(["sh", EXAMPLES / "slurm.sh", samples, PARTS], env=environment, cwd=folder).split()

        array, *_ = submit()
        running = lambda: slurm.ask("squeue", "-h", "-r", "-t", "R", "-j", array, "-o", "%K").split()  # noqa: E731
        try:
            wait_for(f"task {LOST}", lambda: str(LOST) in running())
            run(["scancel", "--signal=KILL", "--full", f"{array}_{LOST}"], env=slurm.environment)
            slurm.idle()
        except RuntimeError as error:
            raise RuntimeError(f"{error}\n{slurm.logs()}") from error
        there = sorted(path.name for path in folder.glob("*.moments"))
        expected = [f"part{i}.moments" for i in range(PARTS) if i != LOST]
        if there != expected or (folder / "all.spharm.npz").exists():
            raise RuntimeError(f"after a killed task: expected {expected}, found {there}\n{slurm.logs()}")
        before = {name: (folder / name).stat().st_mtime_ns for name in expected}
        wait.unlink()
        submit(TASKS=str(LOST))
        slurm.idle()
        if {name: (folder / name).stat().st_mtime_ns for name in expected} != before:
            raise RuntimeError("existing parts were computed again")
        if not (folder / "all.spharm.npz").exists():
            outputs = "".join(path.read_text() for path in sorted(folder.glob("slurm-*.out")))
            raise RuntimeError(f"no model:\n{outputs}{slurm.logs()}")
        seconds = time.monotonic() - started
        version = slurm.ask("sinfo", "--version").split()[-1]
    return f"Slurm {version}", fetched, seconds, f"task {LOST} killed, and submitted again alone"


# --- Snakemake -------------------------------------------------------------------------------------------------------


def by_snakemake(folder, samples):
    """Runs the workflow, deletes a part, and runs the workflow again."""
    program, fetched = CACHE / "venv" / "bin" / "snakemake", "nothing"
    if not program.exists():
        try:
            run([sys.executable, "-m", "venv", CACHE / "venv"])
            run([CACHE / "venv" / "bin" / "pip", "install", "-q", "snakemake"])
        except RuntimeError as error:
            raise Skipped(f"Snakemake can't be installed: {str(error).strip().splitlines()[-1]}")
        fetched = "snakemake, from PyPI"
    config = [f"samples={samples}", f"parts={PARTS}", f"moments_degree={MOMENTS_DEGREE}", f"fit_degree={FIT_DEGREE}"]
    environment = os.environ | {"PATH": f"{program.parent}{os.pathsep}{os.environ['PATH']}", "HOME": str(folder)}
    command = [program, "--snakefile", EXAMPLES / "Snakefile", "--directory", folder, "--cores", "2", "--config", *config]

    def rules():
        said = run(command, env=environment, cwd=folder)
        return sorted(re.findall(r"^(?:local)?rule (\w+):", said, re.M))

    started = time.monotonic()
    first = rules()
    seconds = time.monotonic() - started
    if first != sorted(["all", "fit", "merge", *["part"] * PARTS]):
        raise RuntimeError(f"the workflow ran {first}")
    for name in (f"part{LOST}.moments", "all.moments", "all.spharm.npz"):
        (folder / name).unlink()
    again = rules()
    if again != ["all", "fit", "merge", "part"]:
        raise RuntimeError(f"with one part lost the workflow ran {again}")
    if rules():
        raise RuntimeError("the workflow ran rules although all files existed")
    version = run([program, "--version"], env=environment).strip()
    return f"Snakemake {version}", fetched, seconds, f"part {LOST} deleted: only this part is computed again"


# --- Dask ------------------------------------------------------------------------------------------------------------

DASK = """
import json, os, sys, time
import dask.array as da, distributed, numpy as np
import spharm_rs.dask

def main():
    samples, output, degree, parts = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
    cluster = distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None)
    with cluster, distributed.Client(cluster) as client:
        started = time.monotonic()
        table = np.load(samples, mmap_mode="r")
        table = da.from_array(table, chunks=(-(-len(table) // parts), -1))
        model = spharm_rs.dask.fit(table[:, :3], table[:, 3], degree)
        seconds = time.monotonic() - started
        workers = set(client.run(os.getpid).values()) - {os.getpid()}
    model.save(output)
    print(json.dumps({"seconds": seconds, "workers": len(workers), "version": distributed.__version__}))

if __name__ == "__main__":
    main()
"""


def by_dask(folder, samples):
    """Runs the fit with Dask on two worker processes."""
    try:
        run([sys.executable, "-c", "import spharm_rs, distributed, dask.array"])
    except RuntimeError as error:
        raise Skipped(f"this Python lacks the packages: {str(error).strip().splitlines()[-1]}")
    script = folder / "fit.py"
    script.write_text(DASK)
    said = run([sys.executable, script, samples, folder / "all.spharm.npz", FIT_DEGREE, PARTS], cwd=folder)
    report = json.loads([line for line in said.splitlines() if line.startswith("{")][-1])
    if report["workers"] != 2:
        raise RuntimeError(f"{report['workers']} worker processes in place of 2")
    return f"Dask {report['version']}", "nothing", report["seconds"], "two worker processes"


def main():
    # A signal to this script must also stop the daemons and remove the folders, so it is converted to an exception.
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda number, _: sys.exit(128 + number))
    wrong, rows = [], []
    with tempfile.TemporaryDirectory(prefix="spharm-cluster-") as folder:
        folder = Path(folder)
        samples = folder / "samples.npy"
        write_samples(samples)
        say(f"one process: {SAMPLES:,} samples, moments to degree {MOMENTS_DEGREE}, a fit to {FIT_DEGREE}")
        started = time.monotonic()
        whole = folder / "whole.moments"
        run(["spharm", "moments", "--samples", samples, "--vectors", *"012", "--values", "3", "--max-degree", MOMENTS_DEGREE,
             "-o", whole])
        run(["spharm", "fit", "--moments", whole, "--max-degree", FIT_DEGREE, "-o", folder / "whole.spharm.npz"])
        rows.append(("one process", "nothing", time.monotonic() - started, 0.0, ""))
        expected = coefficients(folder / "whole.spharm.npz")
        scale = np.abs(expected).max()
        for name, way in [("Slurm", by_slurm), ("Snakemake", by_snakemake), ("Dask", by_dask)]:
            say(name)
            place = folder / name
            place.mkdir()
            try:
                title, fetched, seconds, note = way(place, samples)
                off = np.abs(coefficients(place / "all.spharm.npz") - expected).max() / scale
                rows.append((title, fetched, seconds, off, note))
                if not off <= TOLERANCE:
                    wrong.append(f"{title}: coefficients differ by {off:.1e}, more than {TOLERANCE:.0e}")
            except Skipped as why:
                rows.append((name, "", None, None, f"skipped: {why}"))
            except (RuntimeError, subprocess.TimeoutExpired) as error:
                wrong.append(f"{name}: {error}")
                rows.append((name, "", None, None, "failed, see above"))
                print(f"error: {name}: {error}", file=sys.stderr)
    shown = [("way", "fetched", "seconds", "difference", "")]
    shown += [
        (name, fetched, "" if seconds is None else f"{seconds:.1f}", "" if off is None else f"{off:.1e}", note)
        for name, fetched, seconds, off, note in rows
    ]
    widths = [max(len(row[column]) for row in shown) for column in range(5)]
    print()
    for row in shown:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip())
    for text in wrong:
        print(f"error: {text.splitlines()[0]}", file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
