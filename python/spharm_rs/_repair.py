"""Repairs meshes."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from . import _core
from ._surface import Surface, as_surface
from .reports import RepairReport


@dataclass(frozen=True, eq=False)
class Repair:
    """A repaired surface.

    Attributes
    ----------
    surface : Surface
        The repaired surface. The remaining vertices keep their order; vertices added where parts touched or to fill
        holes come last.
    changes : str
        The changes in words, such as ``"1 vertex welded to another, 1 hole filled (2.3 % of the area)"``, or ``"nothing"``.
    report : dict
        The changes as counts, the shares of the area that were dropped and added, and the problems that remain.
    """

    surface: Surface
    changes: str
    report: RepairReport = field(repr=False)


def repair(surface: Any, *, largest_repair: float | None = None, wrap: int | None = None) -> Repair:
    """Repairs common defects of scanned or exported meshes, so that the surface can be mapped to the sphere.

    In this order: welds vertices at the same position, drops degenerate and repeated triangles, welds rims that nearly
    meet, drops fins and inner walls, turns triangles to agree with their neighbours, keeps the largest piece, fills holes
    of up to 500 edges (the larger ones by surfaces that bend least), separates parts that touch at a vertex or along an
    edge, and drops unused vertices. Handles and intersections of the surface with itself remain.

    With ``wrap``, the mesh is replaced by the closed surface around it instead, whatever its defects: the surface of the
    voxels of a grid whose generalized winding number is above 0.5, without handles and cavities, smoothed, and moved onto
    the mesh where it is at most a voxel away. Walls and gaps thinner than a voxel are lost. A wrap that leaves out more
    than 0.05 of the mesh's area, or of the body's voxels, is refused, and so is a wrap with more than 0.25 of its area
    farther than a voxel from the mesh, where it spans holes.

    Parameters
    ----------
    surface : Surface or what `as_surface` takes
    largest_repair : float, optional
        Share of the area, from 0 to 1, that the repair may lose by welding, drop with pieces or add by filling holes,
        if this exceeds the usual limits, 0.05 lost, 0.05 dropped and 0.25 added. With ``wrap``: share of the mesh's
        area and of the body's voxels that the wrap may leave out, and of the wrap's area that may span holes, if this
        exceeds the usual limits, 0.05 and 0.25.
    wrap : int, optional
        Number of voxels along the longest side of the mesh, from 16 to 512; 128 suits most meshes.

    Returns
    -------
    Repair

    Raises
    ------
    MeshError
        If the repair would drop or add a larger share of the area, a wrap would enclose nothing, leave out a larger
        share or span larger holes, or the mesh can't enclose a body: an open sheet, or a one-sided surface with a
        rim.

    Examples
    --------
    >>> import spharm_rs as sp
    >>> ball = sp.icosphere(3)
    >>> below = (ball.vertices[ball.faces, 2] < 0.9).any(axis=1)
    >>> mended = sp.repair((ball.vertices, ball.faces[below]))
    >>> mended.changes
    '1 hole filled (3.3 % of the area), 16 unused vertices dropped'
    >>> sp.fit(mended.surface, max_degree=8).report["parametrization"]["quality"]["flipped"]
    0
    """
    mesh = as_surface(surface)
    share, voxels = _share(largest_repair), _voxels(wrap)
    vertices, faces, report, changes = _core.repair(mesh.vertices, mesh.faces, largest_repair=share, wrap=voxels)
    return Repair(Surface._of(vertices, faces, mesh._meta), changes, json.loads(report))


def changes_of(
    fix: bool, largest_repair: float | None, wrap: int | None, cut_handles: bool
) -> tuple[bool, float | None, int | None, bool]:
    """Returns the changes to make to a surface before it is mapped."""
    if wrap is not None and (fix or cut_handles):
        name = "fix=True" if fix else "cut_handles=True"
        raise ValueError(f"wrap: expected None with {name}, found {wrap!r}")
    if largest_repair is not None and not fix and wrap is None:
        raise ValueError(f"largest_repair: expected None without fix=True or wrap, found {largest_repair!r}")
    return bool(fix), _share(largest_repair), _voxels(wrap), bool(cut_handles)


def named_change(fix: bool, wrap: int | None, cut_handles: bool) -> str | None:
    """Returns the name of the first keyword that asks for a change of the surface, or None."""
    return "fix" if fix else "wrap" if wrap is not None else "cut_handles" if cut_handles else None


def _voxels(wrap: int | None) -> int | None:
    if wrap is None:
        return None
    number = isinstance(wrap, (int, np.integer)) and not isinstance(wrap, bool)
    if not number or not 16 <= wrap <= 512:
        raise ValueError(f"wrap: expected a number of voxels from 16 to 512, found {wrap!r}")
    return int(wrap)


def _share(largest_repair: float | None) -> float | None:
    if largest_repair is None:
        return None
    number = isinstance(largest_repair, (int, float, np.number)) and not isinstance(largest_repair, bool)
    if not number or not 0 <= largest_repair <= 1:
        raise ValueError(f"largest_repair: expected a share from 0 to 1, found {largest_repair!r}")
    return float(largest_repair)
