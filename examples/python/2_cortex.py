"""
Surfaces with spheres, and thickness on them
============================================

The subjects of a study often come with spheres made by FreeSurfer, CIVET or the Human Connectome Project. These spheres
are used unchanged. Values measured at the vertices, such as cortical thickness, are modelled in the same way.
"""

# %%
# The files of FreeSurfer
# -----------------------
# A subject's ``lh.pial`` and ``lh.sphere.reg`` have the same vertices in the same order. spharm_rs recognises these two
# files and the thickness by their names. They may be gzipped. GIfTI files can be read, too:
#
# .. code-block:: python
#
#    pial = sp.read_surface("sub-01/surf/lh.pial")
#    sphere = sp.read_surface("sub-01/surf/lh.sphere.reg")
#    thickness = sp.read_signal("sub-01/surf/lh.thickness")  # (n, 1)
#
# This example generates a folded surface with an invented thickness. The thickness is about 2.5 mm, and larger on the
# crowns of folds. It has noise of 0.5 mm, as a measurement would have.

import matplotlib.pyplot as plt
import numpy as np
from draw import panels

import spharm_rs as sp

pial, sphere = sp.example_surface(6)
rng = np.random.default_rng(1)
depth = sp.fit(pial, sphere, 60).evaluate() - sp.fit(pial, sphere, 12).evaluate()
outward = np.sum(depth * sphere.vertices, axis=1)
true = 2.5 + 0.7 * np.tanh(outward / 3)
thickness = true + rng.normal(0, 0.5, len(true))

# %%
# One fit each
# ------------
# If the sphere is given, a fit takes some hundredths of a second. The density of vertices varies strongly over
# ``sphere.reg``. Therefore ``weights="area"`` weights each vertex by its share of the sphere.

shape = sp.fit(pial, sphere, 80, weights="area")
print(f"surface: {shape}, msd {shape.report['msd']:.1e}, {shape.report['solver']['iterations']} iterations")

# %%
# A signal is an array with a row for each vertex. Noisy signals need a smoothness penalty; ``"auto"`` chooses it by
# generalised cross-validation.

smooth = sp.fit(thickness, sphere, 60, weights="area", smoothness="auto")
rough = sp.fit(thickness, sphere, 60, weights="area", stderr=True)
print("chosen smoothness:", f"{smooth.report['smoothness']:.1e}")
for name, model in (("no smoothness", rough), ("chosen by cross-validation", smooth)):
    off = np.sqrt(np.mean((model.evaluate()[:, 0] - true) ** 2))
    print(f"rms error of the thickness, {name}: {off:.3f} mm; as measured: {np.sqrt(np.mean((thickness - true) ** 2)):.3f} mm")

# %%
# Both models together
# --------------------
# Both models are functions on the same sphere, so the modelled thickness can be shown on the modelled surface, on any
# sampling. Here the sampling is that of the fitted vertices.

modelled = shape.surface()
panels(
    [modelled] * 3,
    [thickness, smooth.evaluate()[:, 0], true],
    ["as measured", "model of degree 60", "truth"],
    limits=(1.7, 3.3),
    cmap="viridis",
    label="thickness, mm",
    columns=3,
    size=3.0,
)
plt.show()

# %%
# Standard errors show how well the data determine each coefficient. With noise of 0.5 mm at 40,962 vertices, all
# coefficients have about the same standard error. Without a smoothness penalty, coefficients of high degrees are mostly
# noise. With the penalty chosen by cross-validation, these coefficients are smaller.


def by_degree(values):
    degrees = np.sqrt(np.arange(len(values))).astype(int)
    return np.sqrt(np.bincount(degrees, values**2) / np.bincount(degrees))


figure, axes = plt.subplots(figsize=(6.5, 3.3), layout="constrained")
for label, values, line in (
    ("coefficients, no smoothness", rough.coefficients, "-"),
    ("coefficients, smoothness chosen", smooth.coefficients, "-"),
    ("standard errors, no smoothness", rough.standard_errors, "--"),
):
    axes.semilogy(np.arange(1, 61), by_degree(values[:, 0])[1:], line, label=label)
axes.set(xlabel="degree", ylabel="root mean square, mm")
axes.legend(fontsize=8)
axes.grid(alpha=0.3)
plt.show()

# %%
# Many subjects
# -------------
# FreeSurfer's ``sphere.reg`` of each subject is registered to a common frame, so coefficients of several subjects are
# comparable. If all subjects' vertices lie at the same directions, as after `spharm_rs.resample`, fit the subjects
# together with `spharm_rs.fit_many`. On the command line:
#
# .. code-block:: sh
#
#    spharm fit --sphere lh.sphere.reg --surface lh.pial --weights area --max-degree 80 --output models
#    spharm fit --sphere lh.sphere.reg --surface lh.thickness --weights area --max-degree 60 --smoothness auto --output models
