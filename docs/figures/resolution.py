"""What a degree resolves: a harmonic with its wavelength, and the wavelength by degree for bodies of several sizes."""

import matplotlib.pyplot as plt
import numpy as np
from draw import paint

import spharm_rs as sp

figure, axes = plt.subplots(1, 2, figsize=(8.4, 3.6), layout="constrained", width_ratios=(1, 1.35))

degree = 10
sphere = sp.icosphere(6)
pattern = np.zeros((degree + 1) ** 2)
pattern[-1] = 1.0  # order m = degree: waves around the equator
values = sp.Transform(sphere.vertices, degree).synthesis(pattern)
paint(axes[0], sphere, values, view=(0, 12), cmap="RdBu_r", limits=(-0.9, 0.9))
# One wave on the equator, on both sides of the viewing direction.
angle = np.linspace(-0.5, 0.5, 50) * 2 * np.pi / degree
along = np.stack([np.sin(angle), -np.sin(np.radians(12)) * np.cos(angle)])
axes[0].plot(*along, color="black", linewidth=3, solid_capstyle="butt")
axes[0].annotate("one wavelength", (0, -0.34), ha="center", fontsize=9)
axes[0].set_title("a harmonic of degree 10", fontsize=10)

degrees = np.geomspace(2, 1000, 200)
for name, radius in (
    ("cortex of a hemisphere, R = 75 mm", 75),
    ("hippocampus, R = 10 mm", 10),
    ("cell, R = 5 micrometres", 5),
):
    axes[1].loglog(degrees, 2 * np.pi * radius / (degrees + 0.5), label=name)
axes[1].set(
    xlabel="degree L", ylabel="wavelength, mm or micrometres", title="wavelength = 2 pi R / (L + 1/2)", ylim=(0.1, 200)
)
axes[1].title.set_fontsize(10)
axes[1].legend(fontsize=8)
axes[1].grid(alpha=0.3, which="both")
