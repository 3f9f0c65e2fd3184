"""
From a bare mesh to a model
===========================

This example maps a closed mesh to the sphere, expands it in spherical harmonics, and evaluates the model up to several
degrees.
"""

# %%
# The surface
# -----------
# Any closed mesh without holes or handles can be used. ``sp.read_surface("cell.ply")`` reads a mesh from a file, and
# `spharm_rs.as_surface` converts meshes of trimesh, pyvista, meshio, nibabel and nilearn. This example generates a
# folded surface. Its sphere, which is generated with it, isn't used.

import matplotlib.pyplot as plt
import numpy as np
from draw import panels

import spharm_rs as sp

surface, _ = sp.example_surface(5)
surface

# %%
# The model
# ---------
# One call maps the surface to the sphere, and fits the coordinates x, y and z by least squares up to degree 60. Each
# coordinate has 61\ :sup:`2` = 3,721 coefficients.

model = sp.fit(surface, max_degree=60)
print(model)
print("mean squared distance, bounding box of volume 1:", f"{model.report['msd']:.1e}")
print("root mean square distance in mm:", f"{np.sqrt(model.report['passes'][-1]['msd_raw']):.2f}")

# %%
# The map to the sphere is part of the model. The map is one to one: no triangle is flipped. Areas on the sphere differ
# from areas on the surface by some 25 per cent, because parts where the model's error is large get a larger share of
# the sphere. Colours show the logarithm of the area ratio: the area on the sphere divided by the area on the surface,
# with both total areas scaled to 4 pi.


def areas(mesh):
    corners = mesh.vertices[mesh.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    return area / area.sum()


sphere = model.sphere
log_ratio = np.log(areas(sphere) / areas(surface))
at_vertices = np.zeros(len(surface.vertices))
np.add.at(at_vertices, surface.faces, log_ratio[:, np.newaxis] / 6)

# The surface and the sphere have the same triangles; the sphere is drawn at the surface's size.
ball = sp.Surface(sphere.vertices * 45, sphere.faces)
panels(
    [surface, ball],
    [at_vertices] * 2,
    ["surface", "its sphere"],
    limits=(-0.6, 0.6),
    cmap="RdBu_r",
    label="log area ratio",
    size=3.5,
)
plt.show()

# %%
# From coarse to fine
# -------------------
# A model of degree 60 contains all models of lower degrees. The titles show the root mean square distance between
# corresponding vertices for each degree.

degrees = [5, 10, 20, 40, 60]
coarse = [model.surface(degree=degree) for degree in degrees]
distances = [sp.compare(surface, mesh) for mesh in coarse]
panels(
    [surface, *coarse],
    titles=["original", *(f"degree {d}: {found.rms:.2f} mm" for d, found in zip(degrees, distances))],
    columns=3,
    size=2.9,
)
plt.show()

# %%
# Where it is off
# ---------------
# The distance between the surfaces is measured everywhere, not only at the vertices.

found = sp.compare(surface, model.surface(), surface_distance=True)
print({name: round(found.surface[name], 3) for name in ("mean", "rms", "percentile95", "hausdorff")})
panels(
    [model.surface()],
    [found.per_vertex],
    [f"95 % of the surface within {found.surface['percentile95']:.2f} mm"],
    cmap="YlOrRd",
    limits=(0, 0.3),
    label="distance from the original, mm",
    size=4.5,
)
plt.show()

# %%
# What a degree adds
# ------------------
# The power of each degree falls steeply: low degrees hold the overall shape, high degrees the folds.

degrees, power = np.arange(1, model.max_degree + 1), model.spectrum()[1:]
figure, axes = plt.subplots(figsize=(6, 3), layout="constrained")
axes.semilogy(degrees, power, ".-", color="#8c3a2b")
axes.set(xlabel="degree", ylabel="power, mm²", title="spectrum of the model")
axes.grid(alpha=0.3)
plt.show()

# %%
# ``model.save("folded.spharm.npz")`` saves the model, and ``model.surface(6).save("smooth.ply")`` writes its surface
# with 40,962 vertices. These commands do the same on the command line:
#
# .. code-block:: sh
#
#    spharm generate --subdivisions 5 --surface folded.ply
#    spharm fit --surface folded.ply --max-degree 60 --output folded.spharm.npz
#    spharm reconstruct --model folded.spharm.npz --icosphere 6 --output smooth.ply
