"""Computes the moments of 10^8 samples from disk, in a control group that is limited to 2 GiB. `./run bench moments`
calls it.

The table, 3.2 GB, is made in a temporary folder. It is dropped from the page cache before it is read, because cached
pages would be charged to the process that wrote them. The limit applies to all memory of the run, including the page
cache of the files that it reads. --samples and --degree set other sizes.
"""

import argparse
import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

LIMIT = 2 << 30
CHUNK = 5_000_000


def write_samples(path, count):
    """Writes unit vectors, nearly uniform on the sphere and in random order, and a wavy field with noise."""
    rng = np.random.default_rng(0)
    with open(path, "wb") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": (count, 4)})
        for start in range(0, count, CHUNK):
            rows = min(CHUNK, count - start)
            z, phi = rng.uniform(-1, 1, rows), rng.uniform(-np.pi, np.pi, rows)
            s = np.sqrt(1 - z * z)
            x, y = s * np.cos(phi), s * np.sin(phi)
            f = np.sin(7 * x) + y * z + 0.1 * rng.standard_normal(rows)
            np.stack([x, y, z, f], axis=1).tofile(file)
        file.flush()
        os.fsync(file.fileno())
        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)


@contextlib.contextmanager
def limited():
    """Yields the folder of a limited control group (version 1 or 2), and the name of its file with the peak memory, or
    None if it has no such file."""
    for parent, limit, peak in [
        ("/sys/fs/cgroup/memory", "memory.limit_in_bytes", "memory.max_usage_in_bytes"),
        ("/sys/fs/cgroup", "memory.max", "memory.peak"),
    ]:
        group = Path(parent) / f"spharm-bench-{os.getpid()}"
        try:
            group.mkdir()
        except OSError:
            continue
        try:
            (group / limit).write_text(str(LIMIT))
            yield group, peak
            return
        except OSError:
            continue
        finally:
            group.rmdir()
    yield None, None


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--samples", type=int, default=10**8)
    parser.add_argument("--degree", type=int, default=1000)
    parser.add_argument("--runs", type=int, default=2, help="the first from the disk, the others from memory")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="spharm-moments-") as folder:
        samples = Path(folder) / "samples.npy"
        started = time.monotonic()
        write_samples(samples, args.samples)
        size = samples.stat().st_size
        print(f"{args.samples:,} samples, {size / 1e9:.2f} GB, made in {time.monotonic() - started:.0f} s", file=sys.stderr)
        for number in range(args.runs):
            command = ["spharm", "moments", "--samples", samples, "--vectors", *"012", "--values", "3", "--json", "--force",
                       "--max-degree", args.degree, "--output", Path(folder) / "all.moments"]
            command = [str(word) for word in command]
            with limited() as (group, peak):
                where = "no control groups here: no limit"
                if group is not None:
                    # The shell joins the group, and is then replaced by the program.
                    command = ["sh", "-c", f'echo $$ > {group}/cgroup.procs && exec "$@"', "sh", *command]
                    where = f"limit {LIMIT / 2**30:.0f} GiB"
                done = subprocess.run(command, capture_output=True, text=True)
                if group is not None and (group / peak).exists():
                    where += f", peak with the system's copies {int((group / peak).read_text()) / 2**30:.2f} GiB"
            if done.returncode:
                raise SystemExit(f"error: the run ended with {done.returncode}: {done.stderr}")
            report = json.loads(done.stdout)
            seconds = report["seconds"]
            alone = seconds["place"] + seconds["spread"]
            print(
                f"{'from the disk' if number == 0 else 'from memory'}: {seconds['total']:.1f} s, {seconds['total'] / alone:.3f} "
                f"times placing and spreading ({seconds['place']:.1f} + {seconds['spread']:.1f}); converting "
                f"{seconds['convert']:.1f}, transforms {seconds['transform']:.1f}, reading beside them {seconds['read']:.1f}; "
                f"resident {report['memory']['peak_resident'] / 1e9:.2f} GB; {where}"
            )


if __name__ == "__main__":
    main()
