"""
Cells from a label volume
=========================

CellProfiler, Cellpose and ilastik write segmentations with an integer label for each voxel. This example makes a model
of each label.
"""

# %%
# The volume
# ----------
# NIfTI and MGH files are given by name, as in ``sp.parametrize_volume("cells.nii.gz", label=3)``; images of other
# formats are given as arrays. This example makes a clump of twelve cells with NumPy. Each voxel that is near enough to
# one of twelve centres belongs to the nearest centre; the boundaries between cells are slightly bent. Voxels are 0.5 by
# 0.5 by 1 micrometre.

import matplotlib.pyplot as plt
import numpy as np
from draw import panels
from matplotlib import colormaps

import spharm_rs as sp

rng = np.random.default_rng(4)
voxel = np.array([0.5, 0.5, 1.0])
shape = (80, 80, 40)
position = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1) * voxel
position -= position.reshape(-1, 3).mean(axis=0)
bent = position + 1.2 * np.sin(position[..., [1, 2, 0]] / 3.0)

centres = []
while len(centres) < 12:
    candidate = rng.uniform(-12, 12, 3)
    if np.linalg.norm(candidate) < 12 and all(np.linalg.norm(candidate - c) > 7 for c in centres):
        centres.append(candidate)
distance = np.linalg.norm(bent[..., np.newaxis, :] - np.array(centres), axis=-1)
volume = np.where(distance.min(axis=-1) < 6.5, distance.argmin(axis=-1) + 1, 0).astype(np.int32)

print("voxels of each label:", sp.labels(volume))

# %%
# Surfaces and models
# -------------------
# `spharm_rs.parametrize_volume` makes the surface around a label from the outer faces of its voxels. It maps the
# surface to the sphere such that the area of each face on the sphere is proportional to its area on the surface. A fit
# of degree 10 smooths the steps of the voxels. Labels with several pieces or with holes can't be mapped; ``fix=True``
# repairs such labels first.

affine = np.diag([*voxel, 1.0])
cells = {label: sp.parametrize_volume(volume, label=label, affine=affine, fix=True) for label in sp.labels(volume)}
models = {label: sp.fit(cell, max_degree=10) for label, cell in cells.items()}


def together(surfaces, values):
    """Joins several surfaces to one, with a colour for each."""
    first = np.cumsum([0, *(len(s.vertices) for s in surfaces)])
    vertices = np.concatenate([s.vertices for s in surfaces])
    faces = np.concatenate([s.faces + start for s, start in zip(surfaces, first)])
    return sp.Surface(vertices, faces), np.repeat(values, np.diff(first), axis=0)


palette = colormaps["tab20"](np.arange(len(cells)))[:, :3]
voxels, voxel_colours = together([cell.surface for cell in cells.values()], palette)
smooth, smooth_colours = together([model.surface(4) for model in models.values()], palette)
panels(
    [voxels, smooth],
    [voxel_colours, smooth_colours],
    ["faces of the voxels", "models of degree 10"],
    view=(35, 25),
    size=4.2,
)
plt.show()

# %%
# What the models measure
# -----------------------
# The area of a voxel surface includes its steps, and is about one and a half times the cell's area, however small the
# voxels are. The model's surface has no steps. Its sphericity is therefore meaningful: the area of a ball of the same
# volume divided by the area of the surface.


def volume_and_area(surface):
    a, b, c = np.moveaxis(surface.vertices[surface.faces], 1, 0)
    cross = np.cross(b - a, c - a)
    return np.einsum("ij,ij->", a, np.cross(b, c)) / 6, np.linalg.norm(cross, axis=1).sum() / 2


def sphericity(surface):
    volume, area = volume_and_area(surface)
    return np.pi ** (1 / 3) * (6 * volume) ** (2 / 3) / area


by_voxels = np.array([sphericity(cell.surface) for cell in cells.values()])
by_model = np.array([sphericity(model.surface(5)) for model in models.values()])
ratios = [volume_and_area(models[k].surface(5))[0] / volume_and_area(cells[k].surface)[0] for k in cells]
print("volume, model / voxels:", np.round(ratios, 3))

# %%
# The picture shows the sphericity of the models. The cells are moved apart so that all of them are visible.

apart = []
for label, model in models.items():
    mesh = model.surface(4)
    apart.append(sp.Surface(mesh.vertices + 0.55 * mesh.vertices.mean(axis=0), mesh.faces))
whole, values = together(apart, by_model)
figure = panels(
    [whole], [values], ["sphericity of the models"], view=(35, 25), limits=(by_model.min(), by_model.max()), size=4.5
)
plt.show()

# %%
figure, axes = plt.subplots(figsize=(4.2, 3.4), layout="constrained")
axes.scatter(by_voxels, by_model, c=palette, s=60, edgecolor="black", linewidth=0.5)
axes.plot([0.5, 1], [0.5, 1], color="gray", linewidth=0.8)
axes.annotate("equal", (0.8, 0.79), color="gray", fontsize=8)
axes.set(xlabel="sphericity by the faces of the voxels", ylabel="sphericity by the model", xlim=(0.5, 1), ylim=(0.5, 1))
axes.grid(alpha=0.3)
plt.show()

# %%
# On the command line, one call fits all labels of a file:
#
# .. code-block:: sh
#
#    spharm fit --surface cells.nii.gz --label all --fix --max-degree 10 --output models
