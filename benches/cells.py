#!/usr/bin/env python3
"""Measures docs/cells.md on a made-up stack of 200 labels: `./run bench cells`.

Prints the seconds from the stack to a table of all cells, with one thread and with all threads; the seconds for the
clusters, and for a montage coloured by them; and the share of cells in the cluster of their kind (round, long or flat).
The exit status is 1 if the table takes more than 0.65 of one thread's time on two processors (ideal would be half, but
a part of the work can't be divided), or if less than 95 % of the cells are in their kind's cluster.
"""

import collections
import csv
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from quality_control import PROGRAM

COUNT, EDGE = 200, 40
KINDS = {"round": (11.0, 11.0, 11.0), "long": (16.0, 9.0, 9.0), "flat": (14.0, 14.0, 6.5)}


def stack(path):
    """Writes a stack of labels, one in each cell of a grid, in random poses; returns the kind of each label."""
    random = np.random.default_rng(0)
    volume = np.zeros((EDGE * 8, EDGE * 5, EDGE * 5), np.uint16)
    axes = np.arange(EDGE) - 0.5 * (EDGE - 1)
    points = np.stack(np.meshgrid(axes, axes, axes, indexing="ij"), -1)
    kinds = {}
    for index in range(COUNT):
        name = list(KINDS)[index % len(KINDS)]
        half = np.array(KINDS[name]) * random.normal(1, 0.03, 3)
        rotation = np.linalg.qr(random.standard_normal((3, 3)))[0]
        inside = (((points + random.uniform(-1, 1, 3)) @ rotation / half) ** 2).sum(-1) < 1
        i, j, k = np.unravel_index(index, (8, 5, 5))
        place = tuple(slice(at * EDGE, (at + 1) * EDGE) for at in (i, j, k))
        volume[place][inside] = index + 1
        kinds[index + 1] = name
    np.save(path, volume)
    return kinds


def timed(*arguments):
    started = time.perf_counter()
    subprocess.run([PROGRAM, *map(str, arguments), "--quiet", "--force"], check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - started


def in_their_cluster(table, kinds):
    """Returns the share of cells in the cluster that most cells of their kind are in."""
    with open(table, newline="") as rows:
        clusters = {int(row["model"].rsplit(".", 1)[-1]): row["cluster"] for row in csv.DictReader(rows)}
    by_kind = collections.defaultdict(collections.Counter)
    for label, cluster in clusters.items():
        by_kind[kinds[label]][cluster] += 1
    most = {kind: counts.most_common(1)[0] for kind, counts in by_kind.items()}
    if len({cluster for cluster, _ in most.values()}) < len(KINDS):
        return 0.0
    return sum(count for _, count in most.values()) / len(clusters)


def main():
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        kinds = stack(folder / "cells.npy")
        fit = ("volumes", folder / "cells.npy", "--voxel-size", "0.2,0.2,0.2", "--max-degree", "12", "-o", folder / "cells")
        one = timed(*fit, "--threads", "1")
        many = timed(*fit)
        clusters = timed("shape", "cluster", folder / "cells", "--clusters", "3", "-o", folder / "clusters.csv")
        colours = f"{folder / 'clusters.csv'}:cluster"
        montage = timed("picture", folder / "cells", "--centre", "--colour-by", colours, "--size", "96", "-o", folder / "m.png")
        share = in_their_cluster(folder / "clusters.csv", kinds)
    threads = len(os.sched_getaffinity(0))
    print(f"{COUNT} cells to a table, one thread   {one:6.1f} s")
    print(f"{COUNT} cells to a table, {threads} threads    {many:6.1f} s  {many / one:.2f} of one thread's")
    print(f"clusters                        {clusters:6.1f} s  {100 * share:.1f} % in the cluster of their kind")
    print(f"montage coloured by cluster     {montage:6.1f} s")
    return 0 if (threads < 2 or many <= 0.65 * one) and share >= 0.95 else 1


if __name__ == "__main__":
    sys.exit(main())
