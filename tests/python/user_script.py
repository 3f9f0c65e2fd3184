"""A script as users write one. Type checkers accept it without annotations, and it runs (test_types.py)."""

import tempfile
from pathlib import Path

import numpy as np

import spharm_rs as sp
from spharm_rs import convert, shape, spectra
from spharm_rs.sklearn import Descriptors, ShapeFeatures

folder = Path(tempfile.mkdtemp())

# Surfaces: examples, files, arrays; pictures; repairs.
surface, sphere = sp.example_surface(3)
surface.save(folder / "brain.ply")
again = sp.read_surface(folder / "brain.ply")
print(again, again.area + again.volume, again.vertices[0] + 1, again.faces.max())
sp.write_signal(folder / "thickness.csv", np.linalg.norm(surface.vertices, axis=1))
thickness = sp.read_signal(folder / "thickness.csv")
(folder / "brain.png").write_bytes(sp.picture(surface, thickness[:, 0], size=64).png)
mended = sp.repair((surface.vertices, surface.faces[1:]))
print(mended.changes, mended.report["holes_filled"] + 1, mended.report["problems"], 100 * mended.report["filled_area"])

# Maps.
mapped = sp.parametrize(mended.surface, method="cald", degree=8)
print(mapped.quality["area_rms"] < 1, mapped.report["method"], mapped.report["converged"], mapped.sphere.vertices.shape)
labels = np.zeros((8, 8, 8), int)
labels[2:6, 2:6, 2:5] = 3
print({label: count for label, count in sp.labels(labels).items() if label > 0})
block = sp.parametrize_volume(labels, label=3)
same = sp.resample(mended.surface, mapped, "icosphere:3")
print(block.surface, same.report["distance_rms"] < 1)

# Fits and models.
model = sp.fit(surface, max_degree=8, progress=lambda stage, done, total: None)
print(model.report["surface_distance"]["rms_raw"] < 9, model.report["scheme_key"], model.report["solver"]["channels"])
print([step["name"] for step in model.report["solver"]["steps"]], model.report["warnings"])
residual = model.rms
print(residual is not None and residual < 9, model.area + model.volume, len(model.provenance))
difference = 2 * (model + model) / 4 - model
print(len(model), difference == model, model[2], model[2, -1], model.coefficients[1:4, 0], model.spectrum().sum())
print(model.at(np.eye(3)).shape, model.normals(np.eye(3)).shape, model.curvature(np.eye(3)).shape)
model.save(folder / "brain.npz")
restored = sp.Model.load(folder / "brain.npz").truncate(6)
print(restored.max_degree + 1, restored.surface("icosphere:3").vertices.shape, restored.to("pyshtools").shape)
print(sp.Model.from_("pyshtools", restored.to("pyshtools")).coefficients.shape, sp.choose_degree(surface, accuracy="3%") + 1)
for fitted in sp.fit_many([surface, surface], None, 4, on_error="collect"):
    print(fitted if isinstance(fitted, Exception) else fitted.max_degree + 1)
for fitted in sp.fit_each([surface], 4):
    print(fitted.max_degree + 1)
for row in sp.fit_cohort([{"id": "a", "surface": folder / "brain.ply"}], folder, 4, on_error="collect"):
    print(row.id, row.state, row.error, row.model.max_degree if row.model is not None else "-")

# Signals on the sphere.
points = np.random.default_rng(0).normal(size=(500, 3))
transform = sp.Transform(points, 6)
coefficients, report = sp.solve(transform, points[:, 0], weights=np.ones(500))
print(coefficients.shape, report["smoothness"] + 1, transform.synthesis(coefficients).shape)
moments = sp.Moments(points, points[:, :2], max_degree=6)
print(moments.fit(max_degree=4).coefficients.shape)
power = spectra.spectrum(coefficients, unit="per_lm")
print(power.power.sum() + power.sample_error[0], spectra.correlation(coefficients, coefficients).correlation[1])
print(spectra.directions([90.0], [0.0]) + 1, convert.to_pyshtools(coefficients).shape)

# Groups.
subjects = [sp.example_surface(3, seed)[0] for seed in range(10)]
models = [sp.fit(subject, sphere, 6) for subject in subjects]
average = shape.mean(models)
print(average.max_degree + 1, shape.measure(average).sphericity < 2, shape.describe(average)[0].shape)
aligned = shape.align(models[1], models[0])
print(aligned.rmsd_before > aligned.rmsd_after, (aligned.transform.inverse() @ aligned.transform).matrix.shape, aligned.model.max_degree + 1)
modes = shape.pca(models)
print(modes.shares.sum(), modes.shape([1.0]).max_degree + 1, [sample.max_degree for sample in modes.sample(2, seed=1)])
tested = shape.group_test(models, ["patient"] * 5 + ["control"] * 5, permutations=99)
print(tested.p.min() <= 1, tested.p_fwe is not None and tested.p_fwe.min() <= 1, tested.meaning)
features = ShapeFeatures(max_degree=4, subdivisions=3).fit_transform(subjects[:3])
print(np.asarray(features).shape, np.asarray(Descriptors(4).fit_transform([surface])).shape)

try:
    sp.fit(sp.Surface(surface.vertices, surface.faces[100:]), max_degree=4)
except sp.MeshError as error:
    print(error)
try:
    sp.fit(surface, max_degree=200, memory="1MiB")
except sp.MemoryBudgetError as error:
    print(error.needed > error.budget)
