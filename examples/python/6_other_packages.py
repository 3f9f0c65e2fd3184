"""
Coming from SPHARM-PDM, pyshtools, ktch and others
==================================================

All packages use the same harmonics, but with different normalisation, phase and order of the coefficients.
`spharm_rs.convert` converts coefficients from and to the conventions of each package. In this example, the coefficients
of one shape are converted for each package, and the shape is evaluated by the formula of that package.
"""

# %%
# A shape
# -------

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from draw import panels
from scipy.special import sph_harm_y

import spharm_rs as sp
from spharm_rs import convert

surface, sphere = sp.example_surface(4)
L = 12
model = sp.fit(surface, sphere, L)
print(model, model.coefficients.shape)

x, y, z = sphere.vertices.T
theta, phi = np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)


def Y(degree, order):
    """Returns complex, orthonormal harmonics with the Condon-Shortley phase; (n, 1)."""
    return sph_harm_y(degree, order, theta, phi)[:, np.newaxis]


# %%
# SPHARM-PDM
# ----------
# For each degree, a ``.coef`` file has a row for order 0, and then two rows for each order from 1 on: the factors of
# the real part and of the imaginary part of the harmonic Y. spharm_rs reads and writes these files.

with tempfile.TemporaryDirectory() as folder:
    file = Path(folder) / "subject.coef"
    convert.write_spharm_pdm(file, model.coefficients)
    print(file.read_text()[:120], "...")
    read = sp.Model(convert.read_spharm_pdm(file))
assert np.allclose(read.coefficients, model.coefficients, atol=1e-13)

rows = iter(model.to("spharm_pdm"))
pdm = np.zeros((len(x), 3))
for degree in range(L + 1):
    pdm += Y(degree, 0).real * next(rows)
    for order in range(1, degree + 1):
        pdm += Y(degree, order).real * next(rows)
        pdm += Y(degree, order).imag * next(rows)

# %%
# SPHARM-MAT, and SciPy
# ---------------------
# SPHARM-MAT's array ``fvec`` is complex. Degree l and order m are in row l\ :sup:`2` + l + m. The harmonics are those
# of SciPy's ``sph_harm_y``. To read a MATLAB file, use
# ``Model.from_("spharm_mat", scipy.io.loadmat("a01_fix.mat")["fvec"])``.

fvec = model.to("spharm_mat")
mat = sum(Y(d, m) * fvec[d * d + d + m] for d in range(L + 1) for m in range(-d, d + 1)).real

# %%
# pyshtools
# ---------
# ``SHCoeffs.from_array(array[k], normalization="ortho", csphase=1)`` reads channel k. To get such an array from
# coefficients of pyshtools, call ``coeffs.convert(normalization="ortho", csphase=1).to_array()``. The first index is 0
# for the coefficients of cosines and 1 for those of sines.

array = model.to("pyshtools")
shtools = np.zeros((len(x), 3))
for degree in range(L + 1):
    for order in range(degree + 1):
        # SciPy's harmonics have the Condon-Shortley phase and these coefficients don't, so the factor (-1)^m removes
        # it.
        scale = (-1) ** order * (1 if order == 0 else np.sqrt(2))
        shtools += scale * Y(degree, order).real * array[:, 0, degree, order]
        shtools += scale * Y(degree, order).imag * array[:, 1, degree, order]

# %%
# healpy and ducc0
# ----------------
# The array ``alm`` has the complex coefficients of non-negative orders, sorted by order m. For a real function, the
# coefficients of negative orders follow from these.

alm = model.to("healpy")
healpy = np.zeros((len(x), 3))
at = 0
for order in range(L + 1):
    for degree in range(order, L + 1):
        healpy += (1 if order == 0 else 2) * (Y(degree, order) * alm[:, at]).real
        at += 1

# %%
# s2fft
# -----
# The array is ``flm[degree, L - 1 + order]``, where s2fft's L is the number of degrees, one more than L here.

flm = model.to("s2fft")
s2fft = sum(Y(d, m) * flm[:, d, L + m] for d in range(L + 1) for m in range(-d, d + 1)).real

# %%
# ktch and FlowShape
# ------------------
# The coefficients of ktch are those of spharm_rs, transposed. The coefficients of FlowShape have the additional phase
# (-1)\ :sup:`m`.

print("ktch", model.to("ktch").shape, " FlowShape", model.to("flowshape").shape)
orders = np.concatenate([np.arange(-d, d + 1) for d in range(L + 1)])
ktch = sp.Model(model.to("ktch").T).evaluate(sphere.vertices)
flowshape = sp.Model(model.to("flowshape") * (-1.0) ** orders[:, np.newaxis]).evaluate(sphere.vertices)

# %%
# The same shape, seven times
# ---------------------------
# The output shows the largest difference between each package's formula and the evaluation by spharm_rs, in mm. The
# shape is 140 mm long.

own = model.evaluate()
packages = {
    "spharm-rs": own,
    "SPHARM-PDM": pdm,
    "SPHARM-MAT, SciPy": mat,
    "pyshtools": shtools,
    "healpy, ducc0": healpy,
    "s2fft": s2fft,
    "ktch": ktch,
    "FlowShape": flowshape,
}
for name, points in packages.items():
    assert np.abs(points - own).max() < 1e-10, name
panels(
    [sp.Surface(points, sphere.faces) for points in packages.values()],
    titles=[
        name if points is own else f"{name}\noff by {np.abs(points - own).max():.0e} mm"
        for name, points in packages.items()
    ],
    columns=4,
    size=2.3,
)
plt.show()

# %%
# What goes wrong without
# -----------------------
# If coefficients are read with a wrong convention, they still give a closed surface, but a different one. The picture
# shows three such errors: SPHARM-PDM's rows are read as if they were rows of spharm_rs, pyshtools' default
# normalisation (``4pi``) is taken as orthonormal, and a Condon-Shortley phase is ignored. The last error is easy to
# miss, because the surface is the same. However, each of its points belongs to a wrong direction, which is rotated by
# half a turn about z. Colours show the x coordinate on the sphere.

wrong = {
    "right": model.coefficients,
    "rows of SPHARM-PDM": model.to("spharm_pdm"),
    "4pi for orthonormal": model.coefficients / np.sqrt(4 * np.pi),
    "phase forgotten": model.to("flowshape"),
}
shapes = [sp.Model(values).surface(sphere) for values in wrong.values()]
panels(
    shapes,
    [x] * 4,
    [f"{name}\n{np.ptp(shape.vertices[:, 1]):.0f} mm" for name, shape in zip(wrong, shapes)],
    columns=4,
    cmap="coolwarm",
    label="x of the sphere",
    size=2.3,
)
plt.show()

# %%
# `The page on conventions <../conventions.html>`_ lists all formulas in one table.
