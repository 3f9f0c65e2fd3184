"""
From meshes to a classifier
===========================

This example cross-validates a scikit-learn pipeline that takes bare meshes. In each fold, the pipeline makes the
training meshes correspond, finds their modes of variation, and registers the test meshes to the training group's mean.
"""

# %%
# Forty meshes
# ------------
# The generated shapes are bars of 36 by 11 by 8 mm in two groups. Bend, taper and thickness vary in the same way in
# both groups. Patients also have a shallow bump of varying height. Each mesh has its own vertices and pose, and no mesh
# has a sphere.

import matplotlib.pyplot as plt
import numpy as np
from draw import panels
from scipy.spatial.transform import Rotation
from sklearn.linear_model import LogisticRegression
from sklearn.model_selection import StratifiedKFold, cross_validate
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

import spharm_rs as sp
from spharm_rs.sklearn import ShapeFeatures

rng = np.random.default_rng(5)
ball = sp.icosphere(3)


def mesh(patient):
    """Returns a mesh of a random shape in a random pose."""
    x, y, z = (ball.vertices @ Rotation.random(random_state=rng).as_matrix()).T
    bend, taper, thick = rng.normal([4.0, 0.25, 1.0], [1.0, 0.08, 0.06])
    width = thick * (1 + taper * x)
    bar = np.stack([18 * x, 5.5 * width * y + bend * x**2, 4 * width * z], axis=1)
    bump = np.exp(-8 * ((x - 0.3) ** 2 + y**2)) * (z > 0)
    bar[:, 2] += rng.normal(1.2 if patient else 0.0, 0.4) * bump
    return sp.Surface(bar @ Rotation.random(random_state=rng).as_matrix() + rng.normal(0, 20, 3), ball.faces)


patient = np.tile([0, 1], 20)
meshes = [mesh(own) for own in patient]

panels(meshes[:6], titles=["control", "patient"] * 3, columns=3, size=2.4)
plt.show()

# %%
# The classifier
# --------------
# `spharm_rs.sklearn.ShapeFeatures` is used like any transformer of scikit-learn. A classifier is trained with each half
# of the meshes and tested on the other half. Correspondence and modes are computed from the training half alone, so
# that the features contain no information about the test meshes.

features = ShapeFeatures(max_degree=6, modes=6, subdivisions=3)
classifier = make_pipeline(features, StandardScaler(), LogisticRegression())
halves = StratifiedKFold(2, shuffle=True, random_state=0)
found = cross_validate(classifier, meshes, patient, cv=halves, return_estimator=True)
print("accuracy in the two halves:", found["test_score"])

# %%
# What it has learned
# -------------------
# The weights of a linear classifier are a direction in the space of the modes. Points along this direction can be
# converted back to surfaces. Colours show the distance from the mean along the normals; outward distances are positive.
# The picture shows that the classifier has found the bump, and hardly uses bend, taper and thickness.

first = found["estimator"][0]
transformers, weights = first[:-1], first[-1].coef_[0]
steps = np.array([-2, 0, 2])
shapes = transformers.inverse_transform(np.outer(steps, weights / np.linalg.norm(weights)))
normals = sp.fit(shapes[1], sp.icosphere(4), 6).normals()
outwards = [((shape.vertices - shapes[1].vertices) * normals).sum(axis=1) for shape in shapes]
titles = ["mean" if step == 0 else f"{abs(step)} sd towards {'patients' if step > 0 else 'controls'}" for step in steps]
most = np.abs(outwards).max()
panels(shapes, outwards, titles, columns=3, cmap="RdBu_r", limits=(-most, most), label="mm", size=2.7)
plt.show()
