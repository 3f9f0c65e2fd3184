"""Compares the subjects of a group, for quality control."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence

from . import _arrays, _core
from ._model import Model
from ._progress import Progress, callback
from ._shape_modes import pca
from ._shape_poses import cores, named
from ._warnings import warn

#: Names of the measures, in the order of the extension module.
_MEASURES = ("volume", "area", "sphericity", "rms", "distance")


@dataclass(frozen=True, eq=False)
class Check:
    """A subject of a group, compared with the others.

    Attributes
    ----------
    name : str
    flags : tuple of str
        Reasons to look at the subject; empty if nothing is unusual.
    severity : float
        Severity of the worst flag: 1 at the threshold of a robust z, and more beyond it; 0 without flags.
    measures : dict of float or None
        ``volume``, ``area``, ``sphericity``; ``rms``, the distance between model and surface; and ``distance`` from the
        mean. None if unknown.
    z : dict of float or None
        Robust z of each measure; None if unknown for all but a few subjects.
    mode : int or None
        The mode, counted from 1, along which the subject is farthest from the others.
    mode_z : float or None
        Robust z of the score along this mode.
    """

    name: str
    flags: tuple[str, ...]
    severity: float
    measures: dict[str, float | None]
    z: dict[str, float | None]
    mode: int | None
    mode_z: float | None


def check(
    models: Sequence[Model],
    *,
    aligned: Sequence[Model] | None = None,
    names: Sequence[str] | None = None,
    threads: int | None = None,
    progress: Progress = None,
) -> list[Check]:
    """Compares the subjects of a group, and flags those to look at, as ``spharm shape check`` does.

    Flags are unusual measures, equal inputs and models, labels at the border of their volume, unusual voxel sizes, large
    repairs, and modes that are mostly due to one subject. Only data that the models record are compared.

    Parameters
    ----------
    models : sequence of Model
        Models of surfaces, before alignment and scaling. Fewer than five are too few for a robust z.
    aligned : sequence of Model, optional
        The same models in one pose, such as those of `procrustes`, three or more: the distances from their mean and the
        scores along their modes are compared, too.
    names : sequence of str, optional
        Names of the subjects, all different; by default their numbers from 0.
    threads : int, optional
    progress : bool or callable, optional

    Returns
    -------
    list of Check
        In the order of the models.

    Examples
    --------
    >>> import numpy as np, spharm_rs as sp
    >>> group = [sp.Model(np.eye(9)[:, 1:4] * [6 + k / 10, 5, 4]) for k in range(8)]
    >>> group[3] = group[3] * 10
    >>> [found.name for found in sp.shape.check(group) if found.flags]
    ['3']
    """
    members = cores(models)
    for index, model in enumerate(models):
        if not model.is_surface:
            raise ValueError(f"models[{index}]: expected a model of a surface, found {model!r}")
    subjects = named(names, len(members))
    seen: set[str] = set()
    for name in subjects:
        if name in seen:
            raise ValueError(f"names: expected a different name for each subject, found {name!r} twice")
        seen.add(name)
    posed: tuple[list[_core.Model], _core.Model] | None = None
    scores: list[list[float]] | None = None
    if aligned is not None:
        others = cores(aligned)
        if len(others) != len(members):
            raise ValueError(f"aligned: expected {len(members)} models, as many as in models; found {len(others)}")
        modes = pca(aligned, threads=threads)
        posed, scores = (others, modes.mean._inner), modes.scores.tolist()
    found, warnings = _core.shape_check(
        members,
        subjects,
        aligned=posed,
        scores=scores,
        threads=_arrays.threads(threads),
        progress=callback(progress),
    )
    warn(warnings)
    return [_check(name, of) for name, of in zip(subjects, found)]


def _check(
    name: str, subject: tuple[list[float | None], list[float | None], tuple[int, float] | None, list[str], float]
) -> Check:
    measures, z, mode, flags, severity = subject
    number, mode_z = (None, None) if mode is None else mode
    return Check(name, tuple(flags), severity, dict(zip(_MEASURES, measures)), dict(zip(_MEASURES, z)), number, mode_z)
