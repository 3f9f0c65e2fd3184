"""A study of 15 and 15 subjects on a sphere with two known effects, and what each kind of p value finds of them."""

import matplotlib.pyplot as plt
import numpy as np
from draw import paint
from matplotlib.lines import Line2D

import spharm_rs as sp

sphere = sp.icosphere(5)
u = sphere.vertices
rng = np.random.default_rng(3)


def smooth(number, degree=18):
    """Random smooth fields of variance 1 on the sphere, (number, V)."""
    degrees = np.sqrt(np.arange((degree + 1) ** 2)).astype(int)
    size = np.exp(-degrees * (degrees + 1) * 0.006)
    size *= np.sqrt(4 * np.pi / np.sum(size**2))
    return np.array([sp.Transform(u, degree).synthesis(rng.normal(size=len(size)) * size) for _ in range(number)])


def cap(longitude, latitude, radius):
    """Cosine of the angle from the centre of a cap, and that of its rim."""
    a, b = np.radians([longitude, latitude])
    return u @ [np.cos(b) * np.cos(a), np.cos(b) * np.sin(a), np.sin(b)], np.cos(np.radians(radius))


small, small_rim = cap(-38, 30, 12)
wide, wide_rim = cap(18, -8, 38)
effect = 2.0 * (small > small_rim) + 1.0 * (wide > wide_rim)
groups = np.repeat(["patient", "control"], 15)
values = smooth(30) + effect * (groups == "patient")[:, np.newaxis]
found = sp.shape.group_test(values, groups, levels=["patient", "control"], sphere=sphere, surface=sphere, tfce=True,
                            cluster=0.01, permutations=1000)  # fmt: skip
in_clusters = np.array([number > 0 and found.clusters[number - 1].p <= 0.05 for number in found.cluster_of])
shown = {
    "t": None,
    "p, uncorrected": found.p <= 0.05,
    "q, false discovery rate": found.q <= 0.05,
    "p-fwe, largest t": found.p_fwe <= 0.05,
    "p-tfce": found.p_tfce <= 0.05,
    "clusters": in_clusters,
}
figure, axes = plt.subplots(2, 3, figsize=(8.2, 6), layout="constrained")
turn = np.linspace(0, 2 * np.pi, 200)
for cell, (title, marked) in zip(axes.flat, shown.items()):
    if marked is None:
        paint(cell, sphere, found.statistic, view=(0, 0), cmap="RdBu_r", limits=(-6, 6))
    else:
        colours = np.where(marked[:, np.newaxis], [0.85, 0.35, 0.1], [0.85, 0.83, 0.8])
        paint(cell, sphere, colours, view=(0, 0))
        shares = [100 * np.mean(marked[place]) for place in (small > small_rim, wide > wide_rim, effect == 0)]
        title += "\nsmall {:.0f} %, wide {:.0f} %, elsewhere {:.1f} %".format(*shares)
    for longitude, latitude, radius in ((-38, 30, 12), (18, -8, 38)):
        a, b, r = np.radians([longitude, latitude, radius])
        centre = np.array([np.cos(b) * np.cos(a), np.cos(b) * np.sin(a), np.sin(b)])
        east, north = np.array([-np.sin(a), np.cos(a), 0]), np.cross(centre, [-np.sin(a), np.cos(a), 0])
        rim = np.cos(r) * centre + np.sin(r) * (np.outer(np.cos(turn), east) + np.outer(np.sin(turn), north))
        cell.plot(rim[:, 1], rim[:, 2], color="black", linewidth=1)
    cell.set_title(title, fontsize=9)
line = Line2D([], [], color="black", label="where there is an effect")
figure.legend(handles=[line], loc="outside lower center", fontsize=9)
