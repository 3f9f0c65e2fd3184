"""Measures the quality of a group's correspondence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence

import numpy as np
from numpy.typing import ArrayLike

from . import _arrays, _core
from ._arrays import Floats
from ._landmarks import Landmarks, matched
from ._model import Model
from ._progress import Progress, callback
from ._shape_poses import cores
from ._surface import Path
from ._warnings import warn


@dataclass(frozen=True, eq=False)
class Curve:
    """A measure of the first k modes, for k = 1 to m.

    Attributes
    ----------
    values : ndarray of float, (m,)
    low, high : ndarray of float, (m,)
        The 95 % band by a bootstrap over the members; (0,) without a bootstrap.
    """

    values: Floats
    low: Floats
    high: Floats

    @classmethod
    def _of(cls, found: tuple[list[float], list[float], list[float]]) -> Curve:
        return cls(*(np.array(values, dtype=float) for values in found))


@dataclass(frozen=True, eq=False)
class LandmarkErrors:
    """Distances on members' surfaces between a member's own landmark and that carried from another member, over all
    pairs.

    Attributes
    ----------
    mean, median : float
        Over all pairs of members and all landmarks.
    band : ndarray of float, (2,), optional
        95 % band of the mean.
    by_landmark : ndarray of float, (p,)
        Mean over all pairs of members, for each landmark.
    off_surface : ndarray of float, (n, p)
        Distance of each landmark from its own member's surface.
    names : tuple of str, optional
        Names of the landmarks, if they have any.
    """

    mean: float
    median: float
    band: Floats | None
    by_landmark: Floats
    off_surface: Floats
    names: tuple[str, ...] | None


@dataclass(frozen=True, eq=False)
class GroupQuality:
    """Quality of a group's correspondence; lengths are in the surfaces' unit.

    Attributes
    ----------
    variance : float
        Variance along all modes, weighted by area, in the square of the unit.
    variances : ndarray of float, (m,)
    compactness : Curve
        Share of the variance along the first k modes.
    generalisation : Curve
        Mean distance of a member from its nearest shape in the modes of all other members.
    specificity : Curve
        Mean distance of a random shape in the modes from the nearest member.
    surface_generalisation, surface_specificity : Curve, optional
        Generalisation and specificity for distances between surfaces: the mean distance to the nearest point, both
        ways.
    landmarks : LandmarkErrors, optional
    warnings : tuple of str
    """

    variance: float
    variances: Floats
    compactness: Curve
    generalisation: Curve
    specificity: Curve
    surface_generalisation: Curve | None
    surface_specificity: Curve | None
    landmarks: LandmarkErrors | None
    warnings: tuple[str, ...]


def quality(
    models: Sequence[Model],
    *,
    modes: int = 10,
    samples: int = 1000,
    bands: int = 200,
    landmarks: Sequence[Landmarks | ArrayLike | Path] | None = None,
    rigid: bool = False,
    surfaces: bool = True,
    degree: int | None = None,
    sphere: int = 4,
    seed: int = 0,
    mask: ArrayLike | None = None,
    threads: int | None = None,
    progress: Progress = None,
) -> GroupQuality:
    """Measures how well surfaces correspond; places are weighted by their share of the area.

    Compactness, generalisation and specificity also improve if directions slide to places where members differ least; only
    landmarks show whether places correspond.

    Parameters
    ----------
    models : sequence of Model
        Three or more corresponding models, such as those of `procrustes`. Their position in space is ignored.
    modes : int
        Number of modes to measure, m; at most one fewer than models.
    samples : int
        Number of random shapes for the specificity.
    bands : int
        Number of bootstrap samples for the bands; 0 for none.
    landmarks : sequence of Landmarks, of array_like of float, (p, 3), or of paths, optional
        The same places on each model, in the model's own frame; landmarks with names are matched by name.
    rigid : bool
        Align members rigidly first, weighted by area, at equal directions.
    surfaces : bool
        Also measure distances between surfaces, which takes most of the time.
    degree : int, optional
        Highest degree; by default the lowest of the models'.
    sphere : int
        Subdivisions of the icosphere on which models are evaluated, 2 to 7.
    seed : int
        Seed of the random shapes and of the bootstrap.
    mask : array_like of bool, (V,), optional
        Vertices of ``icosphere(sphere)`` to compare, (V,); by default all.
    threads : int, optional
    progress : bool or callable, optional

    Returns
    -------
    GroupQuality

    Examples
    --------
    >>> import numpy as np, spharm_rs as sp
    >>> rng = np.random.default_rng(0)
    >>> group = [sp.Model(np.eye(9)[:, [3, 1, 2]] * [9 + a, 5, 3]) for a in rng.normal(size=6)]
    >>> found = sp.shape.quality(group, modes=2, bands=0)
    >>> bool(found.compactness.values[0] > 0.999999)
    True
    """
    members = cores(models)
    level = _arrays.whole("sphere", sphere, 2)
    if level > 7:
        raise ValueError(f"sphere: expected 2 to 7 subdivisions, found {level}")
    kept = _arrays.mask(mask, 10 * 4**level + 2)
    names, points = (None, None) if landmarks is None else matched(landmarks, len(members))
    settings = {
        "degree": None if degree is None else _arrays.whole("degree", degree),
        "modes": _arrays.whole("modes", modes, 1),
        "samples": _arrays.whole("samples", samples, 1),
        "bands": _arrays.whole("bands", bands),
        "sphere": level,
        "rigid": bool(rigid),
        "surfaces": bool(surfaces),
        "seed": _arrays.whole("seed", seed),
        "mask": None if kept is None else kept.tolist(),
    }
    variance, variances, points_curves, surface_curves, apart, warnings = _core.shape_quality(
        members, points, settings=settings, threads=_arrays.threads(threads), progress=callback(progress)
    )
    warn(warnings)
    errors = None
    if apart is not None:
        mean, median, band, by_landmark, off = apart
        errors = LandmarkErrors(
            mean, median, None if band is None else np.array(band), np.array(by_landmark), np.array(off), names
        )
    compactness, generalisation, specificity = (Curve._of(found) for found in points_curves)
    between = [None if found is None else Curve._of(found) for found in surface_curves]
    return GroupQuality(
        variance=variance,
        variances=np.array(variances),
        compactness=compactness,
        generalisation=generalisation,
        specificity=specificity,
        surface_generalisation=between[0],
        surface_specificity=between[1],
        landmarks=errors,
        warnings=tuple(warnings),
    )
