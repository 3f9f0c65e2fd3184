"""What the pictures of the algorithms share: a body with arms, and the log area ratio of a map."""

import sys
from pathlib import Path

import numpy as np

import spharm_rs as sp

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples" / "python"))


def body(level=4, arms=5, length=1.7):
    """A ball with arms, over an icosphere."""
    sphere = sp.icosphere(level)
    u = sphere.vertices
    radius = np.ones(len(u))
    for k in range(arms):
        angle = 2 * np.pi * k / arms
        tip = np.array([np.cos(angle), 0.35 * (-1) ** k, np.sin(angle)])
        tip /= np.linalg.norm(tip)
        radius += length * np.exp(-(1 - u @ tip) / 0.035)
    return sp.Surface(u * radius[:, np.newaxis], sphere.faces)


def angles_from(axis, sphere):
    """Angle of each direction of a sphere from an axis, 0 for x to 2 for z, in degrees."""
    return np.degrees(np.arccos(np.clip(sphere.vertices[:, axis], -1, 1)))


def areas(mesh):
    """Area of each triangle, all of them 1."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return area / area.sum()


def log_area_ratio(surface, sphere):
    """Logarithm of the area on the sphere over that on the surface, at each vertex."""
    at = [np.bincount(mesh.faces.ravel(), np.repeat(areas(mesh), 3)) for mesh in (sphere, surface)]
    return np.log(at[0] / at[1])


def draw_map(found, title, limits=(-1.5, 1.5), view=(-75, 15)):
    """Surface and sphere, coloured by the log area ratio, with their triangles."""
    from draw import panels

    ratio = log_area_ratio(found.surface, found.sphere)
    quality = found.quality
    ball = sp.Surface(found.sphere.vertices * np.ptp(found.surface.vertices, axis=0).max() * 0.37, found.sphere.faces)
    figure = panels(
        [found.surface, ball],
        [ratio, ratio],
        ["surface", "its sphere"],
        view=view,
        cmap="RdBu_r",
        limits=limits,
        label="log area ratio",
        edges=True,
        size=3.4,
    )
    figure.suptitle(
        f"{title}: area {quality['area_rms']:.2f} rms, angles {quality['angle_rms_degrees']:.0f}° rms, "
        f"worst length {quality['length_worst']:.1f}",
        fontsize=10,
    )
    return figure
