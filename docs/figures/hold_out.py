"""Distances at the vertices of a fit and at those held out, and standard errors beside the errors that were made."""

import matplotlib.pyplot as plt
import numpy as np
import shapes  # noqa: F401

import spharm_rs as sp

sphere = sp.icosphere(4)
rng = np.random.default_rng(3)
clean, _ = sp.example_surface(4)
true = sp.fit(clean, sphere, 12, objective="vertices")
noisy = true.evaluate() + rng.normal(0, 0.8, (len(sphere.vertices), 3))

figure, (left, right) = plt.subplots(1, 2, figsize=(8.8, 3.5), layout="constrained")
degrees = [4, 6, 8, 10, 12, 14, 18, 22, 26, 30, 34]
reports = [sp.fit(noisy, sphere, degree, objective="vertices", hold_out=0.2).report["held_out"] for degree in degrees]
for key, label, style in (("seen", "vertices that the fit saw", "o-"), ("held_out", "vertices held out", "s-")):
    left.plot(degrees, [np.sqrt(r[key]["msd_raw"]) for r in reports], style, markersize=4, label=label)
left.axvline(12, color="gray", linestyle=":")
left.annotate(" degree of the truth", (12, 2.9), color="gray", fontsize=8)
left.set(xlabel="degree of the model", ylabel="rms distance, mm", ylim=(0.8, 4), title="hold-out")
left.legend(fontsize=8, loc="upper right")

model = sp.fit(noisy, sphere, 12, objective="vertices", stderr=True)
error = np.abs(model.coefficients - true.coefficients)[:, 0]
degree = np.sqrt(np.arange(len(error))).astype(int)
right.plot(degree + rng.uniform(-0.3, 0.3, len(error)), error, ".", color="#2b5d8c", markersize=4, label="error of each")
rms = np.sqrt(np.bincount(degree, error**2) / np.bincount(degree))
right.plot(rms, color="#2b5d8c", linewidth=1, label="root mean square")
right.plot(np.bincount(degree, model.standard_errors[:, 0]) / np.bincount(degree), "k--", label="standard error")
right.set(xlabel="degree of the coefficient", ylabel="mm", title="coefficients of x")
right.legend(fontsize=8)
for axes in (left, right):
    axes.grid(alpha=0.3)
