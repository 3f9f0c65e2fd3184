"""Draws surfaces with matplotlib for the examples: a panel for each surface, lit, and coloured by values if given."""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize, to_rgb

STONE = "#d8cbb8"


def camera(azimuth, elevation):
    """Returns the rotation to the axes right, up and towards the viewer, for a viewing direction in degrees; z is
    up."""
    azimuth, elevation = np.radians([azimuth, elevation])
    towards = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    return np.stack([right, np.cross(towards, right), towards])


def paint(axes, surface, values=None, *, view=(200, 20), cmap="viridis", limits=None, colour=STONE, edges=False):
    """Draws a closed surface; `values` has a number for each vertex, (n,), or a colour, (n, 3)."""
    vertices, faces = np.asarray(surface.vertices), np.asarray(surface.faces)
    points = vertices @ camera(*view).T
    points -= (points.min(axis=0) + points.max(axis=0)) / 2
    corners = points[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])

    # Shade by the vertices' normals, so that triangles aren't visible.
    smooth = np.zeros_like(points)
    for corner in range(3):
        np.add.at(smooth, faces[:, corner], normals)
    smooth = smooth[faces].mean(axis=1)
    smooth /= np.linalg.norm(smooth, axis=1, keepdims=True) + 1e-30
    lamp = np.array([-0.45, 0.6, 0.75]) / np.linalg.norm([-0.45, 0.6, 0.75])
    light = 0.32 + 0.68 * np.clip(smooth @ lamp, 0, None) + 0.06 * np.clip(smooth @ [0.8, -0.3, 0.5], 0, None)

    if values is None:
        colours = np.tile(to_rgb(colour), (len(faces), 1))
    elif np.ndim(values) == 2:
        colours = np.asarray(values)[faces].mean(axis=1)
    else:
        values = np.asarray(values, dtype=float)
        norm = Normalize(*(limits or (values.min(), values.max())))
        colours = plt.get_cmap(cmap)(norm(values[faces].mean(axis=1)))[:, :3]
    colours = np.clip(colours * light[:, np.newaxis], 0, 1)

    front = np.flatnonzero(normals[:, 2] > 0)
    front = front[np.argsort(corners[front, :, 2].mean(axis=1))]
    lines = {"edgecolors": colours[front], "linewidths": 0.4}
    if edges:
        lines = {"edgecolors": (0, 0, 0, 0.55), "linewidths": 0.25}
    axes.add_collection(PolyCollection(corners[front, :, :2], facecolors=colours[front], **lines))
    extent = np.abs(points[:, :2]).max(axis=0) * 1.04
    axes.set(xlim=(-extent[0], extent[0]), ylim=(-extent[1], extent[1]), aspect="equal")
    axes.set_axis_off()


def panels(
    surfaces,
    values=None,
    titles=None,
    *,
    columns=None,
    view=(200, 20),
    cmap="viridis",
    limits=None,
    label=None,
    edges=False,
    size=2.6,
):
    """Draws surfaces side by side at one scale, with one colour bar for all values; returns the figure.

    `values` has an array or None for each surface; `limits` are the values at the ends of the colour scale, by default
    the extremes of all values.
    """
    count = len(surfaces)
    values = [None] * count if values is None else list(values)
    columns = columns or min(count, 4)
    rows = -(-count // columns)
    scalars = [v for v in values if v is not None and np.ndim(v) == 1]
    if scalars and limits is None:
        limits = min(v.min() for v in scalars), max(v.max() for v in scalars)
    # A panel's width is proportional to the width of its surface.
    rotation = camera(*view)
    seen = [np.ptp(np.asarray(surface.vertices) @ rotation.T, axis=0)[:2] for surface in surfaces]
    width, height = np.max(seen, axis=0)
    shape = size, size * height / width
    bar = 0.9 if scalars else 0.0
    title = 0.35 if titles else 0.05
    figure, axes = plt.subplots(
        rows, columns, figsize=(columns * shape[0] + bar, rows * (shape[1] + title)), squeeze=False, layout="constrained"
    )
    for at, cell in enumerate(axes.flat):
        if at >= count:
            cell.set_axis_off()
            continue
        paint(cell, surfaces[at], values[at], view=view, cmap=cmap, limits=limits, edges=edges)
        cell.set(xlim=(-width * 0.52, width * 0.52), ylim=(-height * 0.52, height * 0.52))
        if titles:
            cell.set_title(titles[at], fontsize=10)
    if scalars:
        mappable = ScalarMappable(Normalize(*limits), cmap)
        figure.colorbar(mappable, ax=axes, shrink=0.75, aspect=25, label=label, pad=0.01)
    return figure
