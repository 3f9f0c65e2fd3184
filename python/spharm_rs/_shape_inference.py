"""Converts values, blocks, variance groups, regions and masks of tests for the extension module, and back."""

from __future__ import annotations

import os
import pathlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import _arrays
from ._arrays import Floats
from ._model import Model, sampling
from ._shape_columns import names_of
from ._surface import as_surface, surface_of


def check_mask_file(mask: Any, sphere: Any) -> None:
    """Refuses a FreeSurfer label or annotation as the mask of models that are tested at the vertices of an icosphere.

    A label doesn't state the number of vertices, and fsaverage5 has as many vertices as the default icosphere, but in
    another order.
    """
    if not isinstance(mask, (str, os.PathLike)) or pathlib.PurePath(mask).suffix not in (".label", ".annot"):
        return
    if sphere is None or isinstance(sphere, (int, np.integer)) or isinstance(sphere, str) and sphere.startswith("icosphere:"):
        raise ValueError(
            f"mask: {os.fspath(mask)}: expected a mask for the vertices of an icosphere, found a FreeSurfer label or "
            "annotation, whose surface has other vertices; give the mask's own sphere as sphere="
        )


def inference_of(
    count: int,
    relabelled: bool,
    errors: str | None,
    blocks: list[str] | None,
    whole_blocks: bool,
    variance_groups: Any,
    tfce: bool,
    cluster: float | None,
    surface: tuple[Any, Any] | None,
    kept: Any,
) -> dict[str, Any]:
    """Checks the arguments for relabellings and regions, and converts them for the extension module."""
    if errors not in (None, "exchangeable", "symmetric", "both"):
        raise ValueError(f"errors: expected exchangeable, symmetric or both; found {errors!r}")
    if not relabelled and (blocks is not None or errors is not None or tfce or cluster is not None):
        raise ValueError("blocks, errors, tfce, cluster: can only be given with permutations=1 or more, found 0")
    if whole_blocks and blocks is None:
        raise ValueError("whole_blocks: can only be given with blocks")
    if cluster is not None and not 0 < cluster < 1:
        raise ValueError(f"cluster: expected a p value above 0 and below 1, found {cluster}")
    variances = None if variance_groups is None else names_of("variance_groups", variance_groups, count)
    asked: dict[str, Any] = {
        "errors": errors, "blocks": blocks, "whole_blocks": bool(whole_blocks),
        "variance_groups": variances, "tfce": bool(tfce),
        "cluster": None if cluster is None else float(cluster), "surface": None, "kept": None,
    }  # fmt: skip
    if tfce or cluster is not None:
        if surface is None or surface[1] is None:
            raise ValueError("tfce, cluster: expected a surface with triangles; give surface=, or sphere= with triangles")
        asked["surface"] = (np.ascontiguousarray(surface[0], float), np.ascontiguousarray(surface[1], np.uint32))
        asked["kept"] = None if kept is None else kept.tolist()
    return asked


def stacked(what: str, values: Any) -> Any:
    """Returns the values of images with a row for each subject, and anything else unchanged."""
    if _arrays.is_image(values):
        maps = _arrays.unwrapped(what, values)
        if maps.ndim != 2:
            raise ValueError(f"{what}: expected an image for each subject, or one image of shape (V, n); found {maps.shape}")
        return maps.T
    if not isinstance(values, (list, tuple)) or not any(_arrays.is_image(one) for one in values):
        return values
    rows = [np.asarray(_arrays.unwrapped(f"{what}[{index}]", one)) for index, one in enumerate(values)]
    rows = [row[:, 0] if row.ndim == 2 and row.shape[1] == 1 else row for row in rows]
    for index, row in enumerate(rows):
        if row.shape != rows[0].shape:
            raise ValueError(f"{what}[{index}]: expected shape {rows[0].shape}, as in {what}[0]; found {row.shape}")
    return np.stack(rows)


def common_mesh(what: str, images: Any) -> Any:
    """Returns the mesh of an image of nilearn, or of a list of images that have the same one; None for anything else."""
    listed = images if isinstance(images, (list, tuple)) else [images]
    if not listed or not all(_arrays.is_image(image) and hasattr(image, "mesh") for image in listed):
        return None
    first, *others = (surface_of(f"{what}: mesh of image {index}", image.mesh) for index, image in enumerate(listed))
    same = all(
        np.array_equal(first.vertices, other.vertices) and np.array_equal(first.faces, other.faces) for other in others
    )
    return first if same else None


def check_tested(what: str, values: Floats, kept: Any) -> None:
    """Refuses values, (n, V) or (n, V, 3), that are NaN or infinite at tested vertices."""
    if kept is not None and not kept.any():
        raise ValueError("mask: expected at least one vertex to test, found none")
    bad: Any = ~np.isfinite(values)
    bad = bad.any(axis=2) if bad.ndim == 3 else bad
    if kept is not None:
        bad = bad & kept
    if not bad.any():
        return
    row, vertex = (int(at) for at in np.unravel_index(int(bad.argmax()), bad.shape))
    found = f"{'NaN' if np.isnan(values[row, vertex]).any() else 'infinity'} in row {row}, column {vertex}"
    if kept is None:
        raise ValueError(f"{what}: found {found} (counted from 0); leave out vertices without values with mask=")
    raise ValueError(f"{what}: found {found} (counted from 0), which is inside the mask; leave out vertices without values")


def scattered(found: dict[str, Any], kept: Any) -> dict[str, Any]:
    """Returns a test's results at all vertices: NaN outside of the mask, (V,), and no cluster."""
    at = np.flatnonzero(kept)

    def spread(values: Any, left_out: Any) -> Any:
        whole = np.full((len(kept), *values.shape[1:]), left_out, dtype=values.dtype)
        whole[at] = values
        return whole

    arrays = {name: values for name, values in found.items() if isinstance(values, np.ndarray)}
    spread_out = {name: spread(values, 0 if name == "cluster_of" else np.nan) for name, values in arrays.items()}
    if "clusters" in found:
        # Vertices of peaks are counted within the mask.
        spread_out["clusters"] = [(one[0], one[1], int(at[one[2]]), *one[3:]) for one in found["clusters"]]
    return {**found, **spread_out}


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
        Family-wise p value of the area, compared with the largest clusters of relabelled studies.
    """

    vertices: int
    area: float
    peak: int
    statistic: float
    p: float


def tested_surface(
    surface: Any, sphere: Any, mean: Model | None, signal: str | None, vertices: int
) -> tuple[Any, Any] | None:
    """Returns vertices and triangles of the surface on which regions are measured and maps are drawn, if it is known."""
    if surface is not None:
        found = as_surface(surface)
        if len(found.vertices) != vertices:
            raise ValueError(f"surface: expected {vertices} vertices, as many as the values have; found {len(found.vertices)}")
        return found.vertices, found.faces
    if mean is None and sphere is None:
        return None
    directions, faces = sampling(sphere)
    if mean is None and directions is not None and len(directions) != vertices:
        raise ValueError(f"sphere: expected {vertices} vertices, as many as the values have; found {len(directions)}")
    if mean is None or signal == "value" or directions is None:
        return directions, faces
    return mean.evaluate(directions), faces
