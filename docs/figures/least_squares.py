"""Iterations of the least squares on an even and on two uneven samplings."""

import warnings

import matplotlib.pyplot as plt
from shapes import body

import spharm_rs as sp

warnings.simplefilter("ignore", sp.SpharmWarning)
surface = body()
samplings = {
    "icosphere": sp.icosphere(4),
    "map by cald": sp.parametrize(surface).sphere,
    "map by stretch": sp.parametrize(surface, method="stretch").sphere,
}
figure, axes = plt.subplots(figsize=(6.2, 3.6), layout="constrained")
for (name, sphere), marker in zip(samplings.items(), "os^"):
    transform = sp.Transform(sphere.vertices, 20)
    reached, counts = [], [1, 2, 3, 5, 8, 12, 18, 26, 40, 60, 90, 130, 180, 240]
    for most in counts:
        _, report = sp.solve(transform, surface.vertices, max_iterations=most, preconditioner="none")
        reached.append(report["solver"]["optimality"])
        if reached[-1] < 1e-10:
            break
    axes.semilogy(counts[: len(reached)], reached, marker + "-", markersize=4, label=name)
axes.axhline(1e-10, color="gray", linestyle=":")
axes.annotate("tolerance", (0.98, 1.4e-10), xycoords=("axes fraction", "data"), ha="right", color="gray", fontsize=8)
axes.set(xlabel="iterations", ylabel="optimality", title="2,562 vertices, degree 20")
axes.legend(fontsize=8)
axes.grid(alpha=0.3)
