"""Fits the labels of volumes."""

from __future__ import annotations

import os
import re
from contextlib import closing
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Generator, Iterable, Iterator, Literal

import numpy as np
from numpy.typing import ArrayLike

from . import _arrays, _core
from ._fit import fit_mapped
from ._fit_many import FitSettings, in_parallel, processors
from ._model import Model
from ._parametrize import Parametrization, _image, _volume, with_warnings
from ._progress import Callback, Progress, callback
from ._surface import Path
from ._warnings import Problem, issue, warn
from .errors import MeshError, SpharmError, SpharmWarning
from .shape import Measures, _measured

if TYPE_CHECKING:
    from typing_extensions import Unpack

#: Relative change of the area at which its quadrature stops, as in ``spharm volumes``: far below the accuracy of a surface
#: made of voxels.
_AREA = 1e-5

#: Relative differences between the volumes of the model and of the label above which there is a warning, as in
#: ``spharm volumes``: for labels whose handles were cut, and for labels that were neither repaired nor cut.
_CUT, _INEXACT = 0.05, 0.02


@dataclass(frozen=True, eq=False)
class LabelFit:
    """Outcome of a label of a volume.

    Attributes
    ----------
    label : int
    voxels : int
        Number of the label's voxels; 0 if the volume doesn't have the label.
    at_border : bool
        Whether the label touches the border of the volume, which may have cut off a part of it.
    model : Model or None
        None if the label can't be fitted.
    measures : shape.Measures or None
        Area, volume and centroid of the model, in the unit of the voxel size.
    error : Exception or None
        Why the label can't be fitted.
    """

    label: int
    voxels: int
    at_border: bool
    model: Model | None = None
    measures: Measures | None = field(default=None, repr=False)
    error: Exception | None = None

    @property
    def volume(self) -> float:
        """Volume of the model; NaN if there is no model."""
        return float("nan") if self.measures is None else self.measures.volume

    @property
    def centroid(self) -> tuple[float, float, float]:
        """Centre of mass of the model; NaN if there is no model."""
        nan = float("nan")
        return (nan, nan, nan) if self.measures is None else self.measures.centroid


def fit_labels(
    volume: Path | ArrayLike,
    max_degree: int | None = None,
    *,
    labels: Iterable[int] | int | None = None,
    channel: int | None = None,
    time: int | None = None,
    label_surface: str = "smooth",
    smooth_radius: float | None = None,
    affine: ArrayLike | None = None,
    spacing: ArrayLike | None = None,
    axes: str = "xyz",
    min_voxels: int = 1,
    skip_border: bool = False,
    fix: bool = False,
    cut_handles: bool = False,
    on_error: Literal["raise", "collect"] = "raise",
    progress: Progress = None,
    **settings: Unpack[FitSettings],
) -> Iterator[LabelFit]:
    """Maps and fits the labels of a volume, as ``spharm volumes`` does, and yields each result when it is ready.

    The volume is read once. Several labels are fitted at a time, each by one thread.

    Parameters
    ----------
    volume : str, os.PathLike or array_like of int, (i, j, k)
        As for `parametrize_volume`; floats are taken if they are whole numbers.
    max_degree : int, optional
        Highest degree L, inclusive. By default from 4 to 60, so that the model of a label with the median number of
        voxels resolves one and a half voxels. Give the same degree for all volumes that you compare.
    labels : iterable of int, or int, optional
        Labels to fit; by default all but 0, the background.
    channel, time, label_surface, smooth_radius, affine, spacing, axes
        As for `parametrize_volume`.
    min_voxels : int
        Leave out labels with fewer voxels.
    skip_border : bool
        Leave out labels that touch the border of the volume. With ``fix``, only the piece that the repair keeps counts.
    fix, cut_handles
        As for `parametrize_volume`.
    on_error : {"raise", "collect"}
        Raise the error of a label that can't be fitted; or yield it as `LabelFit.error` and go on.
    progress : bool or callable, optional
        As for `fit`; called for each result.
    **settings
        The other arguments of `fit`; ``threads`` is the number of labels that are fitted at a time, by default the number
        of CPUs, and each may take ``memory``.

    Yields
    ------
    LabelFit
        In the order of the labels.

    Raises
    ------
    MeshError
        If a label can't be fitted, or if the volume has only background.

    Warns
    -----
    NotDetermined, NotConverged, Oscillation
        Doubts about the fit of a label, which are also in the report of its model.
    SpharmWarning
        If a repair or a cut changed a label, or if its measures or the voxel size are doubtful; or if the model's
        volume differs from that of the label's voxels, which is in the report of the model, too.

    Examples
    --------
    >>> import numpy as np, spharm_rs as sp
    >>> image = np.zeros((9, 20, 20), int)
    >>> image[2:7, 2:8, 2:8], image[2:7, 10:17, 10:17] = 1, 2
    >>> for cell in sp.fit_labels(image, 6, axes="zyx", spacing=(0.5, 0.2, 0.2)):
    ...     print(cell.label, cell.voxels, cell.at_border, cell.model.max_degree)
    1 180 False 6
    2 245 False 6
    """
    collects = _arrays.on_error(on_error)
    least = _arrays.whole("min_voxels", min_voxels)
    chosen = None if labels is None else _chosen(labels)
    core = _core.Labels(_volume(_whole(volume), False, affine, spacing, axes), image=_image(channel, time, volume))
    warn(core.warnings())
    there = core.labels(bool(fix), chosen)
    name = os.fspath(volume) if isinstance(volume, (str, os.PathLike)) else "the volume"
    if not there:
        raise MeshError(f"{name}: expected a label, found only 0, the background")
    items = [_item(there, label) for label in (there if chosen is None else chosen)]
    # Labels that the volume doesn't have are kept, so that fitting them raises an error.
    items = [one for one in items if one.label not in there or one.voxels >= least and not (skip_border and one.at_border)]
    sizes = [one.voxels for one in items if one.voxels > 0]
    degree = core.degree(sizes) if max_degree is None else _arrays.whole("max_degree", max_degree)
    each: dict[str, Any] = {**settings, "max_degree": degree}
    workers = _arrays.threads(each.pop("threads", None)) or processors()
    mapping: dict[str, Any] = {
        "label_surface": str(label_surface),
        "smooth_radius": None if smooth_radius is None else float(smooth_radius),
        "fix": bool(fix),
        "cut_handles": bool(cut_handles),
        "memory": _arrays.size(each.get("memory")),
    }

    def work(item: LabelFit, check: Callback) -> tuple[LabelFit, list[Problem]]:
        try:
            mapped, changes = with_warnings(core.parametrize(item.label, **mapping, threads=1, progress=check))
            model, doubts = fit_mapped(mapped, check, threads=1, **each)
            measures, flaws = _measured(model, None, _AREA, 1, check)
            inexact = _inexact(measures.volume, mapped, item.voxels * core.voxel())
            model.report["warnings"] += inexact
        except (SpharmError, ValueError) as error:
            _name_label(error, name, item.label)
            raise
        problems: list[Problem] = [*((SpharmWarning, text) for text in [*changes, *flaws, *inexact]), *doubts]
        named = [(category, f"{name}: label {item.label}: {text}") for category, text in problems]
        return LabelFit(item.label, item.voxels, item.at_border, model, measures), named

    def failed(item: LabelFit, error: Exception) -> tuple[LabelFit, list[Problem]]:
        return LabelFit(item.label, item.voxels, item.at_border, error=error), []

    found = in_parallel(work, items, workers, failed if collects else None)
    return _warned(found, len(items), callback(progress))


def _whole(volume: Path | ArrayLike) -> Any:
    """Returns a volume, with an array of floats converted to integers if all are whole numbers."""
    if isinstance(volume, (str, os.PathLike)) or np.ma.is_masked(volume):
        return volume
    array = np.asarray(volume)
    if array.dtype.kind != "f":
        return array
    if np.isnan(array).any():
        raise ValueError("volume: expected whole numbers as labels, found NaN; if NaN is the background, set it to 0")
    # Other numbers are refused later, when the array is checked.
    return array.astype(np.int64) if (array == np.rint(array)).all() and (abs(array) < 2**53).all() else array


def _chosen(labels: Iterable[int] | int) -> list[int]:
    """Returns the chosen labels, each once."""
    several: Any = [labels] if isinstance(labels, (int, np.integer)) else labels
    if isinstance(several, str) or not hasattr(several, "__iter__"):
        raise ValueError(f"labels: expected whole numbers, found {labels!r}")
    return list(dict.fromkeys(_arrays.whole("labels", label, -(2**62)) for label in several))


def _item(there: dict[int, tuple[int, bool]], label: int) -> LabelFit:
    """Returns the outcome of a label before it is fitted."""
    voxels, at_border = there.get(label, (0, False))
    return LabelFit(label, voxels, at_border)


def _inexact(volume: float, mapped: Parametrization, voxels: float) -> list[str]:
    """Returns a warning if a model's volume differs from the volume of the label's voxels."""
    change = volume / voxels - 1
    if mapped.report.get("handles") is not None:
        if abs(change) <= _CUT:
            return []
        return [
            f"the model has a volume of {volume:.4g}, but before its handles were cut, the label's surface had a "
            f"volume of {voxels:.4g} ({100 * change:+.1f} %)"
        ]
    if mapped.report.get("repair") is not None or abs(change) <= _INEXACT:
        return []
    return [
        f"the volume of the model differs from that of the label's voxels by {100 * abs(change):.1f} %: the label is "
        "too small for a shape model, or the degree is too low for the label's shape; min_voxels=N leaves out small "
        "labels"
    ]


def _name_label(error: Exception, volume: str, label: int) -> None:
    """Adds the volume and the label to the text of an error that doesn't name the label."""
    # An error of the operating system has several arguments.
    if len(error.args) == 1 and not re.search(rf"\blabel {label}\b", str(error.args[0])):
        text = str(error.args[0]).removeprefix(f"{volume}: ")
        error.args = (f"{volume}: label {label}: {text}",)


def _warned(
    found: Generator[tuple[LabelFit, list[Problem]], None, None], total: int, shown: Callback | None
) -> Iterator[LabelFit]:
    """Yields results, and issues their warnings on the thread of the caller."""
    with closing(found):
        for done, (result, problems) in enumerate(found, 1):
            issue(problems)
            if shown is not None:
                shown("fit", done, total)
            yield result
