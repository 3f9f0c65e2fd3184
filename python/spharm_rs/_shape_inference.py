"""Converts blocks, variance groups and regions of tests for the extension module."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ._model import Model, sampling
from ._surface import as_surface


def levels_of(what: str, cells: Any) -> tuple[list[str], list[str]]:
    """Returns the level of each subject, and the distinct levels in order."""
    if cells.dtype.kind in "biu":
        order = np.unique(cells)
        return [str(cell) for cell in cells.tolist()], [str(level) for level in order.tolist()]
    if cells.dtype.kind == "f" and np.isfinite(cells).all():
        return [str(cell) for cell in cells.tolist()], [str(level) for level in np.unique(cells).tolist()]
    found = cells.tolist()
    if cells.dtype.kind in "UO" and all(isinstance(cell, str) for cell in found):
        return found, sorted(set(found))
    raise ValueError(f"{what}: expected a level for each subject, all names or all numbers; found {found!r}")


def column(what: str, values: Any, count: int) -> Any:
    cells = np.asarray(values)
    if cells.shape != (count,):
        raise ValueError(f"{what}: expected shape ({count},), one for each subject; found {cells.shape}")
    return cells


def _names(what: str, cells: Any, count: int) -> list[str] | None:
    """Returns the name of each observation's group."""
    return None if cells is None else levels_of(what, column(what, cells, count))[0]


def inference_of(
    count: int,
    vertices: int,
    relabelled: bool,
    errors: str | None,
    blocks: Any,
    whole_blocks: bool,
    variance_groups: Any,
    tfce: bool,
    cluster: float | None,
    surface: tuple[Any, Any] | None,
) -> dict[str, Any]:
    """Converts what relabellings and regions depend on for the extension module."""
    if errors not in (None, "exchangeable", "symmetric", "both"):
        raise ValueError(f"errors: expected exchangeable, symmetric or both; found {errors!r}")
    if not relabelled and (blocks is not None or errors is not None or tfce or cluster is not None):
        raise ValueError("blocks, errors, tfce, cluster: expected permutations of 1 or more, found 0")
    if whole_blocks and blocks is None:
        raise ValueError("whole_blocks: can only be given with blocks")
    if cluster is not None and not 0 < cluster < 1:
        raise ValueError(f"cluster: expected a p value above 0 and below 1, found {cluster}")
    asked: dict[str, Any] = {
        "errors": errors, "blocks": _names("blocks", blocks, count), "whole_blocks": bool(whole_blocks),
        "variance_groups": _names("variance_groups", variance_groups, count), "tfce": bool(tfce),
        "cluster": None if cluster is None else float(cluster), "surface": None,
    }  # fmt: skip
    if tfce or cluster is not None:
        if surface is None or surface[1] is None:
            raise ValueError("tfce, cluster: expected the surface of the vertices, with triangles; give surface=")
        if len(surface[0]) != vertices:
            raise ValueError(f"surface: expected {vertices} vertices, as many as the values have; found {len(surface[0])}")
        asked["surface"] = (np.ascontiguousarray(surface[0], float), np.ascontiguousarray(surface[1], np.uint32))
    return asked


@dataclass(frozen=True)
class Cluster:
    """Connected vertices whose statistics exceed a threshold and have the same sign.

    Attributes
    ----------
    vertices : int
    area : float
        Area on the surface, in its unit squared.
    peak : int
        Vertex of the largest statistic.
    statistic : float
        Statistic at the peak, signed.
    p : float
        Family-wise p value of the area, by the largest cluster of relabelled studies.
    """

    vertices: int
    area: float
    peak: int
    statistic: float
    p: float


def tested_surface(surface: Any, sphere: Any, mean: Model | None, signal: str) -> tuple[Any, Any] | None:
    """Returns vertices and triangles of the surface on which regions are measured, if it is known."""
    if surface is not None:
        found = as_surface(surface)
        return found.vertices, found.faces
    if mean is None:
        return None
    directions, faces = sampling(sphere)
    if signal == "value" or directions is None:
        return directions, faces
    return mean.evaluate(directions), faces
