"""Distances of models by quadrature and by least squares, at the vertices and between them, for each degree."""

import matplotlib.pyplot as plt
import shapes  # noqa: F401

import spharm_rs as sp

surface, sphere = sp.example_surface(5)
degrees = [5, 10, 15, 20, 30, 40, 50, 60, 70, 80]
figure, axes = plt.subplots(figsize=(6.2, 3.6), layout="constrained")
for method, colour in (("lsq", "#2b5d8c"), ("quadrature", "#c77f2a")):
    reports = [sp.fit(surface, sphere, degree, method=method, objective="vertices").report for degree in degrees]
    name = "least squares" if method == "lsq" else method
    axes.semilogy(degrees, [r["msd"] for r in reports], "o-", color=colour, markersize=4, label=f"{name}, at the vertices")
    axes.semilogy(degrees, [r["between"]["msd"] for r in reports], "o--", color=colour, markersize=4, label=f"{name}, between")
axes.set(xlabel="degree", ylabel="msd", title="a folded surface of 10,242 vertices")
axes.legend(fontsize=8)
axes.grid(alpha=0.3)
