"""Excess of the msd over the optimum, pass by pass, over an even and an uneven sampling."""

import tempfile

import matplotlib.pyplot as plt
from shapes import body

import spharm_rs as sp

surface, degree = body(), 20
figure, axes = plt.subplots(1, 2, figsize=(8.6, 3.6), sharey=True, layout="constrained")
for cell, (name, sphere) in zip(axes, {"icosphere": sp.icosphere(4), "map by cald": sp.parametrize(surface).sphere}.items()):
    best = sp.fit(surface, sphere, degree, objective="vertices").report["msd"]
    with tempfile.TemporaryDirectory() as folder:
        store = sp.Store(folder)
        store.build(sphere, degree)
        for label, style, settings in (
            ("one degree a block (MIRF)", "o-", {"method": "mirf"}),
            ("g = 100", "s-", {"granularity": 100}),
            ("g = 100, accelerated", "^-", {"granularity": 100, "accelerate": True}),
        ):
            passes = [2, 4, 6, 8, 12, 16]
            msd = [sp.fit(surface, sphere, degree, store=store, passes=p, **settings).report["msd"] for p in passes]
            cell.semilogy(passes, [max(m / best - 1, 1e-13) for m in msd], style, markersize=4, label=label)
    cell.set(xlabel="passes", title=name)
    cell.grid(alpha=0.3)
axes[0].set_ylabel("msd / optimum - 1")
axes[1].legend(fontsize=8)
