"""
A sky with a mask, by Transform and solve
=========================================

Functions on the sphere can be fitted without a surface. `spharm_rs.Transform` evaluates functions at any directions.
`spharm_rs.solve` computes their coefficients by least squares from scattered samples, such as a map of the sky without
the plane of the galaxy, or heights along the tracks of a satellite.
"""

# %%
# Samples
# -------
# A random field of degrees up to 48 is observed with noise at 30,000 scattered directions. Its coefficients of degree l
# have the variance l\ :sup:`-3`. Samples within 8 degrees of the equator are removed.

import matplotlib.pyplot as plt
import numpy as np

import spharm_rs as sp

rng = np.random.default_rng(7)
degree = 48
degrees = np.sqrt(np.arange((degree + 1) ** 2)).astype(int)
true = rng.normal(size=len(degrees)) / np.maximum(degrees, 1) ** 1.5
true[0] = 0

directions = rng.normal(size=(30_000, 3))
directions /= np.linalg.norm(directions, axis=1, keepdims=True)
directions = directions[abs(directions[:, 2]) > np.sin(np.radians(8))]

transform = sp.Transform(directions, degree)
clean = transform.synthesis(true)
noise = 0.2
samples = clean + rng.normal(0, noise, len(clean))
print(transform, f"signal {clean.std():.2f}, noise {noise:.2f}")

# %%
# Coefficients
# ------------
# The adjoint of synthesis multiplies the samples by each harmonic and sums up the products. On a full grid, these sums
# are the coefficients. With a mask, they aren't: power leaks from degree to degree.

leaky = 4 * np.pi / len(directions) * transform.adjoint(samples)

# %%
# Least squares inverts synthesis. The gap is 16 degrees wide, four times the resolution of degree 48, so the samples
# don't determine the field there. With a smoothness penalty, there is a unique solution. To choose the penalty, samples
# are left out of the fit by weight zero, and the error at these samples is measured. (``smoothness="auto"`` chooses the
# penalty by generalised cross-validation, which takes a minute on a sampling with a gap.)

seen_by_fit = rng.random(len(samples)) < 0.8
tried = 10.0 ** np.arange(-5, 1)
unseen = []
for smoothness in tried:
    guess, _ = sp.solve(transform, samples, weights=seen_by_fit.astype(float), smoothness=smoothness)
    unseen.append(np.sqrt(np.mean((transform.synthesis(guess) - samples)[~seen_by_fit] ** 2)))
    print(f"smoothness {smoothness:.0e}: rms at the samples left out {unseen[-1]:.4f}")

found, report = sp.solve(transform, samples, smoothness=tried[np.argmin(unseen)])
print("chosen:", report["smoothness"], " optimality:", f"{report['solver']['optimality']:.0e}")

# %%
# Maps
# ----
# The three fields are evaluated on a grid of directions.

longitude, latitude = np.meshgrid(np.linspace(-np.pi, np.pi, 361), np.linspace(-np.pi / 2, np.pi / 2, 181))
grid = np.stack(
    [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)], axis=-1
).reshape(-1, 3)
everywhere = sp.Transform(grid, degree)
fields = {
    "truth": everywhere.synthesis(true),
    "sums of samples (adjoint)": everywhere.synthesis(leaky),
    "least squares": everywhere.synthesis(found),
}

figure, axes = plt.subplots(2, 2, figsize=(9.5, 5), subplot_kw={"projection": "mollweide"}, layout="constrained")
limit = 3 * clean.std()
colours = {"cmap": "RdBu_r", "vmin": -limit, "vmax": limit}
seen = np.arctan2(directions[:, 1], directions[:, 0]), np.arcsin(directions[:, 2])
axes.flat[1].scatter(*seen, c=samples, s=2, linewidths=0, rasterized=True, **colours)
axes.flat[1].set_title("samples", fontsize=10)
for cell, (name, field) in zip((axes.flat[0], axes.flat[2], axes.flat[3]), fields.items()):
    picture = cell.pcolormesh(longitude, latitude, field.reshape(longitude.shape), rasterized=True, **colours)
    cell.set_title(name, fontsize=10)
for cell in axes.flat:
    cell.set(xticklabels=[], yticklabels=[])
    cell.grid(alpha=0.2)
figure.colorbar(picture, ax=axes, shrink=0.7, label="field")
plt.show()

# %%
# How well
# --------
# At the samples, the error of least squares is below the noise. In the gap, the error depends on the smoothness
# penalty.

bins = np.radians(np.arange(-90, 91, 4))
row = np.digitize(latitude.ravel(), bins)
figure, (left, right) = plt.subplots(1, 2, figsize=(9.5, 3.4), layout="constrained")
for name, colour in (("sums of samples (adjoint)", "#c77f2a"), ("least squares", "#2b5d8c")):
    square = (fields[name] - fields["truth"]) ** 2
    rms = [np.sqrt(square[row == k].mean()) for k in range(1, len(bins))]
    left.semilogy(np.degrees(bins[:-1]) + 2, rms, color=colour, label=name)
left.axhline(noise, color="gray", linestyle=":", label="noise of a sample")
left.axvspan(-8, 8, color="gray", alpha=0.2, linewidth=0)
left.set(xlabel="latitude, degrees (grey: no samples)", ylabel="rms error", title="error by latitude")
left.legend(fontsize=8)
for name, values, line in (("truth", true, "k-"), ("adjoint", leaky, "#c77f2a"), ("least squares", found, "#2b5d8c")):
    power = np.bincount(degrees, values**2) / np.bincount(degrees)
    right.semilogy(np.arange(1, degree + 1), power[1:], line, label=name)
right.set(xlabel="degree", ylabel="power of a coefficient", title="spectrum")
right.legend(fontsize=8)
plt.show()

# %%
# Using your own solver
# ---------------------
# The basis is also available as a SciPy ``LinearOperator``, for solvers such as ``lsqr``. The operator doesn't store
# the basis matrix, which would take 8 n K bytes for n samples and K coefficients.

from scipy.sparse.linalg import lsqr

operator = sp.Transform(directions, degree, channels=1).as_linear_operator()
by_lsqr = lsqr(operator, samples, damp=1.0, iter_lim=200)[0]
inside = abs(latitude.ravel()) > np.radians(12)
off = np.sqrt(np.mean((everywhere.synthesis(by_lsqr) - fields["truth"])[inside] ** 2))
print(f"{operator.shape} operator, rms error of lsqr away from the gap: {off:.3f}")

# %%
# healpy and ducc0 store only coefficients of non-negative orders; `spharm_rs.convert` converts to their format.

alm = sp.convert.to_healpy(found)
print(alm.shape, alm.dtype)
