"""
Principal components of twenty shapes
=====================================

If the vertices of several surfaces correspond, the surfaces' coefficients can be used as rows of a table for
scikit-learn. The mean and the modes can be converted back to surfaces.
"""

# %%
# Twenty shapes
# -------------
# The generated shapes resemble a hippocampus: a bar that is bent, and thicker at one end. Bend and taper vary from
# shape to shape, and each shape has its own bumps. All shapes have the same icosphere as sphere, so their vertices
# correspond. If surfaces have different spheres, `spharm_rs.resample` establishes such a correspondence.

import matplotlib.pyplot as plt
import numpy as np
from draw import panels
from sklearn.decomposition import PCA
from sklearn.pipeline import make_pipeline

import spharm_rs as sp
from spharm_rs.sklearn import SpharmTransformer

sphere = sp.icosphere(4)
rng = np.random.default_rng(2)
bend, taper = rng.normal(0.0, 1.0, (2, 20))
bumps = sp.Transform(sphere.vertices, 8)


def shape(bend, taper, noise):
    """Returns the vertices of a bar of 36 by 10 by 8 mm."""
    x, y, z = sphere.vertices.T
    thick = 1 + (0.25 + 0.12 * taper) * x
    bar = np.stack([18 * x, 5 * thick * y, 4 * thick * z], axis=1)
    bar[:, 1] += (5 + 1.5 * bend) * x**2
    return bar * (1 + 0.01 * bumps.synthesis(noise)[:, np.newaxis])


X = np.stack([shape(b, t, rng.normal(size=81)) for b, t in zip(bend, taper)])
X -= X.mean(axis=1, keepdims=True)
print(X.shape)

names = [f"shape {k + 1}" for k in range(10)]
panels([sp.Surface(x, sphere.faces) for x in X[:10]], titles=names, columns=5, view=(-90, 65), size=1.9)
plt.show()

# %%
# Components
# ----------
# Harmonics are orthonormal. The distance between two rows of coefficients is therefore the root mean square distance
# between the surfaces times sqrt(4 pi), and the principal components of the rows are those of the surfaces.

pipeline = make_pipeline(SpharmTransformer(12, sphere=sphere), PCA(5))
scores = pipeline.fit_transform(X)
pca = pipeline[-1]
print(scores.shape, "variance explained:", np.round(pca.explained_variance_ratio_, 3))

# %%
# Modes
# -----
# The figure shows the mean, and the shapes two standard deviations along the first two modes. Colours show how far each
# point moves.

sd = np.sqrt(pca.explained_variance_)
mean = pipeline.inverse_transform(np.zeros((1, 5)))[0]
drawn, moved, titles = [], [], []
for mode in range(2):
    for step in (-2, 0, 2):
        at = np.zeros((1, 5))
        at[0, mode] = step * sd[mode]
        vertices = pipeline.inverse_transform(at)[0]
        drawn.append(sp.Surface(vertices, sphere.faces))
        moved.append(np.linalg.norm(vertices - mean, axis=1))
        titles.append("mean" if step == 0 else f"mode {mode + 1}, {step:+d} sd")
panels(drawn, moved, titles, columns=3, view=(-90, 65), cmap="YlOrRd", label="distance from the mean, mm", size=2.7)
plt.show()

# %%
# Because the shapes were generated, the meaning of the modes is known. The scores of the first two modes are
# nearly proportional to bend and taper:

figure, axes = plt.subplots(1, 2, figsize=(8, 3.2), layout="constrained")
for mode, (cell, name, truth) in enumerate(zip(axes, ("bend", "taper"), (bend, taper))):
    score = scores[:, mode] / sd[mode]
    r = np.corrcoef(truth, score)[0, 1]
    cell.scatter(truth, score, color="#2b5d8c")
    cell.set(xlabel=f"{name} that was put in", ylabel=f"score of mode {mode + 1}, sd", title=f"r = {r:+.3f}")
    cell.grid(alpha=0.3)
plt.show()

# %%
# As an alternative to a scikit-learn pipeline, `spharm_rs.fit_many` returns models, whose ``coefficients`` are the same
# numbers. Surfaces in different poses have to be aligned first, because a rotation changes the coefficients.
