"""The distances between a surface and its model of degree 20, as a map and as a histogram with the usual figures."""

import matplotlib.pyplot as plt
import numpy as np
from draw import paint
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

import spharm_rs as sp

surface, sphere = sp.example_surface(5)
model = sp.fit(surface, sphere, 20)
found = sp.compare(surface, model.surface(), surface_distance=True)
distances = found.per_vertex
figures = {"rms": found.surface["rms"], "95 %": found.surface["percentile95"], "hausdorff": found.surface["hausdorff"]}

figure, axes = plt.subplots(1, 2, figsize=(8.6, 3.4), layout="constrained", width_ratios=(1.2, 1))
top = 4.0
paint(axes[0], model.surface(), distances, cmap="YlOrRd", limits=(0, top))
axes[0].set_title("model of degree 20", fontsize=10)
figure.colorbar(ScalarMappable(Normalize(0, top), "YlOrRd"), ax=axes[0], shrink=0.7, label="distance, mm")
axes[1].hist(distances, bins=60, color="#c9a27a")
for (name, value), colour in zip(figures.items(), ("#1b5e8c", "#7a3b8c", "#a8201a")):
    axes[1].axvline(value, color=colour, label=f"{name}: {value:.2f} mm")
axes[1].set(xlabel="distance, mm", ylabel="vertices", xlim=(0, figures["hausdorff"] * 1.05))
axes[1].legend(fontsize=9)
