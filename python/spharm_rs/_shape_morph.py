"""Interpolates shapes between two models."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from . import _arrays, _core
from ._arrays import Floats
from ._model import Model, core, maps_differ
from ._progress import Progress, callback
from ._warnings import warn


@dataclass(frozen=True, eq=False)
class Morph:
    """A path between two surfaces.

    Attributes
    ----------
    models : list of Model
        Shapes at the times; their degree is the lower one of the two models'.
    times : ndarray of float, (n,)
        Times from 0, the first surface, to 1, the second surface.
    volume_ratio : float
        Volume half way divided by the smaller volume of the two ends. Below 0.8 the surfaces don't correspond, and a
        warning is given.
    warnings : tuple of str
    """

    models: list[Model] = field(repr=False)
    times: Floats = field(repr=False)
    volume_ratio: float
    warnings: tuple[str, ...] = ()


_MAPPED_APART = (
    "the models were mapped separately, so their parameters agree only approximately, and shapes between them may lack detail; "
    "shape.correspond brings surfaces into correspondence"
)


def morph(
    start: Model,
    end: Model,
    steps: int | ArrayLike = 11,
    *,
    method: Literal["joint", "fixed"] | None = None,
    keep_pose: bool = False,
    mirror: bool = False,
    threads: int | None = None,
    progress: Progress = None,
) -> Morph:
    """Interpolates between two surfaces: the first is aligned to the second, then shapes are interpolated linearly.

    Parameters
    ----------
    start, end : Model
        Models of surfaces, in any poses. Points at equal directions are paired, so models that were mapped separately give a
        warning; `correspond` makes models that correspond.
    steps : int or array_like of float, (n,)
        Number of shapes, both ends included, at least 2; or the shapes' times.
    method : {"joint", "fixed"}, optional
        ``"fixed"`` aligns the first surface to the second by a rotation of space only, for models whose equal directions
        correspond; ``"joint"`` also rotates the parameters, as `align` does. By default ``"fixed"`` for two models of a group
        of `correspond`, without ``mirror``; otherwise ``"joint"``.
    keep_pose : bool
        Begin in the first surface's pose and rotate towards the second's; by default all shapes are in the second
        surface's pose.
    mirror : bool
        Also match mirror images.
    threads : int, optional
    progress : bool or callable, optional

    Returns
    -------
    Morph

    Examples
    --------
    >>> import spharm_rs as sp
    >>> sphere = sp.icosphere(4)
    >>> first, last = (sp.fit(sp.example_surface(4, seed)[0], sphere, 8) for seed in (0, 1))
    >>> path = sp.shape.morph(first, last, 5)
    >>> path.times.tolist()
    [0.0, 0.25, 0.5, 0.75, 1.0]
    >>> path.models[2].surface(3)
    Surface(642 vertices, 1280 faces)
    """
    if np.ndim(steps) == 0:
        count = _arrays.whole("steps", steps, 2)
        times: Floats = np.arange(count) / (count - 1)
    else:
        times = _arrays.real("steps", steps, "(n,)")
        if times.ndim != 1:
            raise ValueError(f"steps: expected a whole number or times, (n,), found shape {times.shape}")
    first, last = core("start", start), core("end", end)
    noted = [_MAPPED_APART] if maps_differ(start, end) else []
    found, ratio, warnings = _core.shape_morph(
        first,
        last,
        times.tolist(),
        fixed=None if method is None else _arrays.choice("method", method, ("joint", "fixed")) == "fixed",
        keep_pose=bool(keep_pose),
        mirror=bool(mirror),
        threads=_arrays.threads(threads),
        progress=callback(progress),
    )
    return Morph([Model._of(model) for model in found], times, ratio, warn(noted + warnings))
