"""
Spectra of topography and gravity
=================================

Two fields are sampled at scattered latitudes and longitudes, and fitted by `spharm_rs.solve`. ``spharm_rs.spectra``
then computes their power by degree, their correlation, the admittance of one field to the other, and the spectrum of a
field that was observed on a part of the sphere. pyshtools and healpy give the same numbers.
"""

# %%
# Samples
# -------
# The first field is a synthetic topography of degrees up to 60, in km, whose power decreases with the degree. The
# second field is gravity, in mGal: the topography times an admittance, plus a part that is independent of the
# topography. Both fields are measured with noise at 12,000 positions.

import matplotlib.pyplot as plt
import numpy as np

import spharm_rs as sp
from spharm_rs import spectra

rng = np.random.default_rng(11)
L = 60
degrees = np.sqrt(np.arange((L + 1) ** 2)).astype(int)
topography = rng.normal(size=len(degrees)) * 3 / (degrees + 1.0) ** 1.5
topography[0] = 0
true_admittance = 60 * np.exp(-np.arange(L + 1) / 30)
gravity = true_admittance[degrees] * topography + rng.normal(size=len(degrees)) * 40 / (degrees + 1.0) ** 1.5

latitude = np.degrees(np.arcsin(rng.uniform(-1, 1, 12_000)))
longitude = rng.uniform(-180, 180, len(latitude))
directions = spectra.directions(latitude, longitude)
truth = np.stack([topography, gravity], axis=1)
noise = np.array([0.2, 6.0])
samples = sp.Transform(directions, L, channels=2).synthesis(truth) + noise * rng.normal(size=(len(directions), 2))

figure, axes = plt.subplots(1, 2, figsize=(9.5, 2.8), subplot_kw={"projection": "mollweide"}, layout="constrained")
for cell, field, name in zip(axes, samples.T, ("topography, km", "gravity, mGal")):
    limit = 3 * field.std()
    colours = {"cmap": "RdBu_r", "vmin": -limit, "vmax": limit}
    picture = cell.scatter(np.radians(longitude), np.radians(latitude), c=field, s=1, rasterized=True, **colours)
    cell.set(xticklabels=[], yticklabels=[])
    cell.grid(alpha=0.2)
    figure.colorbar(picture, ax=cell, shrink=0.7, label=name)
plt.show()

# %%
# Coefficients
# ------------
# One call of `spharm_rs.solve` computes the coefficients of both fields (channels). `spharm_rs.fit` returns the same
# coefficients and, on request, their standard errors, for which it estimates the noise from the residuals.

coefficients, report = sp.solve(directions, samples, L)
errors = sp.fit(samples, directions, L, stderr=True).standard_errors
print(f"rms error of the coefficients: {np.sqrt(np.mean((coefficients - truth) ** 2, axis=0)).round(5)}")
print(f"standard errors, rms:          {np.sqrt(np.mean(errors**2, axis=0)).round(5)}")

# %%
# Power by degree
# ---------------
# The powers of all degrees add up to the mean square of the field. There are two errors. ``noise_error`` is the error
# of this topography's power, due to noise in the samples. ``sample_error`` applies if this topography is
# considered as one realisation of a random process: it is the error of the process's spectrum, which is estimated from
# only 2 l + 1 coefficients for degree l. ``noise`` is the average power that noise adds.

power = spectra.spectrum(coefficients, errors=errors)
exact = spectra.spectrum(truth)
rows, columns = (a.ravel() for a in np.meshgrid(np.arange(-89.5, 90), np.arange(360.0), indexing="ij"))
field = sp.Transform(spectra.directions(rows, columns), L).synthesis(coefficients[:, 0])
mean_square = np.average(field**2, weights=np.cos(np.radians(rows)))
print(f"sum of the powers {power.power[:, 0].sum():.4f}, mean square over the sphere {mean_square:.4f} km²")

shown = slice(1, None)
figure, axes = plt.subplots(1, 2, figsize=(9.5, 3.4), layout="constrained")
for at, (cell, unit) in enumerate(zip(axes, ("km²", "mGal²"))):
    height = power.power[shown, at]
    sampled = power.sample_error[shown, at]
    cell.fill_between(power.degree[shown], np.maximum(height - sampled, 1e-9), height + sampled, color="#d5e0ec")
    cell.errorbar(power.degree[shown], height, power.noise_error[shown, at], fmt=".", ms=3, lw=1, color="#2b5d8c")
    cell.plot(power.degree[shown], exact.power[shown, at], "k-", lw=0.8, label="truth")
    cell.plot(power.degree[shown], power.noise[shown, at], ":", color="gray", label="noise")
    cell.set(yscale="log", xlabel="degree", ylabel=f"power, {unit}", title=("topography", "gravity")[at])
    cell.set_ylim(power.noise[1, at] / 3)
    cell.legend(fontsize=8)
plt.show()

# %%
# Correlation and admittance
# --------------------------
# If gravity is an admittance times the topography, plus a part that is independent of the topography, the admittance is
# the cross-power divided by the power of the topography. Noise in the topography adds to its power. At degrees where
# noise dominates, the estimated admittance is therefore too close to zero.

admittance = spectra.admittance(coefficients[:, 1], coefficients[:, 0])
correlation = spectra.correlation(coefficients[:, 1], coefficients[:, 0])

figure, (left, right) = plt.subplots(1, 2, figsize=(9.5, 3.4), layout="constrained")
left.plot(correlation.degree[shown], correlation.correlation[shown], ".-", color="#2b5d8c", lw=0.8)
doubtful = correlation.confidence < 0.95
left.plot(correlation.degree[doubtful], correlation.correlation[doubtful], "o", color="#c77f2a", label="p > 0.05")
left.set(xlabel="degree", ylabel="correlation", ylim=(-0.2, 1.05))
left.legend(fontsize=8)
bars = {"fmt": ".", "ms": 4, "lw": 1, "color": "#2b5d8c"}
right.errorbar(admittance.degree[shown], admittance.admittance[shown], admittance.error[shown], **bars)
right.plot(np.arange(1, L + 1), true_admittance[shown], "k-", lw=0.8, label="truth")
right.set(xlabel="degree", ylabel="admittance, mGal / km", ylim=(0, 75))
right.legend(fontsize=8)
plt.show()

# %%
# The same by other packages
# --------------------------
# The functions of pyshtools and healpy give the same numbers from converted coefficients. The output has the numbers of
# spharm_rs in the first column, and those of pyshtools or healpy in the second. If a package isn't installed, its
# numbers are left out.

cross = spectra.cross_spectrum(coefficients[:, 1], coefficients[:, 0])
c_l = spectra.spectrum(coefficients[:, 0], unit="per_lm", convention="energy")
ours = {
    "power": power.power[:, 0],
    "cross-power": cross.power,
    "admittance": admittance.admittance,
    "its error": admittance.error,
    "correlation": correlation.correlation,
    "C_l": c_l.power,
}
others = {}
try:
    from pyshtools import spectralanalysis
except ImportError:
    print("pyshtools isn't installed")
else:
    theirs = sp.convert.to_pyshtools(coefficients)
    others["power"] = spectralanalysis.spectrum(theirs[0], normalization="ortho")
    others["cross-power"] = spectralanalysis.cross_spectrum(theirs[1], theirs[0], normalization="ortho")
    found = spectralanalysis.SHAdmitCorr(theirs[1], theirs[0])
    others.update(zip(("admittance", "its error", "correlation"), found))
try:
    import healpy
except ImportError:
    print("healpy isn't installed")
else:
    others["C_l"] = healpy.alm2cl(sp.convert.to_healpy(coefficients[:, 0])[0])

for degree in (1, 10, 60):
    print(f"degree {degree}")
    for name, values in ours.items():
        beside = f"{others[name][degree]:22.15g}" if name in others else ""
        print(f"  {name:12} {values[degree]:22.15g} {beside}")

# %%
# A part of the sphere
# --------------------
# Without the samples within 20 degrees of the equator, the coefficients of single harmonics aren't determined. However,
# the spectrum of an isotropic field can still be estimated. ``pseudo_spectrum`` returns the spectrum of the field times
# the mask. In this spectrum, power leaks from degree to degree, and scattered samples spread a share of all power and
# noise over all degrees. ``decoupled_spectrum`` corrects for this coupling of the degrees, in bins of degrees. With
# ``noise="auto"``, products of a sample with itself are left out, so that noise doesn't add to the power. The errors
# are those of the process's spectrum, and so include cosmic variance.

seen = abs(latitude) > 20
pseudo = spectra.pseudo_spectrum(directions, samples[:, 0], L, mask=seen)
edges = np.array([0, 1, 3, 6, 10, 15, 21, 28, 36, 44, 52, L + 1])
bands = spectra.decoupled_spectrum(directions, samples[:, 0], L, mask=seen, bins=edges, noise="auto")
exact_c_l = spectra.spectrum(topography, unit="per_lm", convention="energy").power
print(f"observed fraction of the sphere {pseudo.f_sky:.3f}")

figure, cell = plt.subplots(figsize=(6, 3.8), layout="constrained")
cell.plot(np.arange(1, L + 1), exact_c_l[1:], "k-", lw=0.8, label="truth")
cell.plot(np.arange(1, L + 1), 9 / (np.arange(1, L + 1) + 1.0) ** 3, "k:", lw=0.8, label="process")
cell.plot(pseudo.degree[1:], pseudo.power[1:] / pseudo.f_sky, color="#c77f2a", label="pseudo-spectrum over f_sky")
half = (bands.last - bands.first) / 2
cell.errorbar(bands.degree[1:], bands.power[1:], bands.error[1:], half[1:], label="decoupled", **bars)
cell.set(yscale="log", xscale="log", xlabel="degree", ylabel="C_l, km²", ylim=(1e-5, 4))
cell.legend(fontsize=8)
plt.show()
