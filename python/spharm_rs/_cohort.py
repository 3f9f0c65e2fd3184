"""Fits cohorts: many surfaces from files, whose outcomes are returned as they finish."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path as _Path
from typing import Any, Iterable, Iterator, Literal, Mapping

from . import _arrays, _core, errors
from ._fit import _settings
from ._model import Model
from ._parametrize import _axes, _image, _volume_settings
from ._progress import Progress, callback
from ._repair import changes_of
from ._store import Store
from ._surface import Path
from ._warnings import warn
from .reports import FitReport

#: Columns of a table of surfaces.
_COLUMNS = ("id", "surface", "sphere", "weights", "output", "label", "signal_mask")


@dataclass(frozen=True)
class CohortFit:
    """Outcome of a row of a cohort.

    Attributes
    ----------
    id : str
        The row's id.
    state : {"done", "skipped", "failed", "interrupted"}
        Whether the model was made, existed already, couldn't be made, or wasn't finished.
    path : pathlib.Path
        Path of the model's file.
    error : str, optional
        Why the row failed, or which error ended the run before the row was finished.
    report : dict, optional
        For a model that was made: as `Model.report`, without `solver`, `smoothness` and `seconds`.
    seconds : float, optional
        Time from reading the surface until its model was written; rows that are fitted together share the time.
    """

    id: str
    state: str
    path: _Path
    error: str | None
    report: FitReport | None
    seconds: float | None

    @property
    def model(self) -> Model:
        """The model, read from its file.

        Raises
        ------
        SpharmError
            If the row has no model.
        """
        if self.state not in ("done", "skipped"):
            raise errors.SpharmError(f"{self.id}: the row has no model: {self.error or self.state}")
        return Model.load(self.path)


class CohortFits:
    """Outcomes of a cohort's rows, in the order in which they are finished: an iterator of `CohortFit`.

    ``len`` is the number of rows. Closing the iterator, or leaving its ``with`` block, stops the fits that are running.
    """

    def __init__(self, run: Any, progress: Any) -> None:
        self._run, self._progress, self._done = run, progress, 0

    def __len__(self) -> int:
        return len(self._run)

    def __iter__(self) -> Iterator[CohortFit]:
        return self

    def __next__(self) -> CohortFit:
        found, texts = self._run.next()
        warn(texts)
        if found is None:
            raise StopIteration
        _, row, state, path, error, report, seconds = found
        self._done += 1
        if self._progress is not None:
            self._progress("fit", self._done, len(self))
        return CohortFit(row, state, _Path(path), error, None if report is None else json.loads(report), seconds)

    def close(self) -> None:
        """Stops the fits that are running."""
        self._run.stop()

    def __enter__(self) -> CohortFits:
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"CohortFits({self._done} of {len(self)} rows)"


def fit_cohort(
    table: Any,
    output: Path | None = None,
    max_degree: int = 20,
    *,
    sphere: Path | None = None,
    mask: Path | None = None,
    on_error: Literal["raise", "collect"] = "raise",
    exists: Literal["refuse", "skip", "update", "replace"] = "refuse",
    shard: str | None = None,
    status: Path | None = None,
    fix: bool = False,
    largest_repair: float | None = None,
    wrap: int | None = None,
    cut_handles: bool = False,
    voxel_size: Iterable[float] | None = None,
    axes: str = "xyz",
    channel: int | None = None,
    time: int | None = None,
    threshold: float | None = None,
    probability: bool = False,
    label_surface: str = "smooth",
    smooth_radius: float | None = None,
    objective: str | None = None,
    weights: str = "uniform",
    smoothness: float | str | None = None,
    denoise: bool = False,
    stderr: bool = False,
    hold_out: float | None = None,
    surface_distance: bool = True,
    method: str | None = None,
    store: Path | Store | None = None,
    passes: int | None = None,
    granularity: int = 100,
    start_degree: int = 0,
    accelerate: bool = False,
    tolerance: float = 1e-10,
    max_iterations: int = 3000,
    preconditioner: str = "auto",
    strict: bool = False,
    dtype: str | None = None,
    memory: int | str | None = None,
    threads: int | None = None,
    progress: Progress = None,
) -> CohortFits:
    """Fits many surfaces from files and writes their models, as ``spharm fit --manifest`` does.

    Rows that share a sphere are fitted together, in memory that doesn't grow with the number of rows. The fits start
    immediately, on separate threads; the iterator returns their outcomes.

    Parameters
    ----------
    table : path, or iterable of mappings, or pandas.DataFrame
        A table with the columns ``id`` and ``surface``, and optionally ``sphere``, ``weights``, ``output``,
        ``label`` and, for signals, ``signal_mask`` (a mask or label within which values are read): either a file
        (tab-separated, or comma-separated if its name ends in .csv), whose paths are relative to it, or its rows.
    output : path, optional
        Folder of the models; by default the folder of the table's file, or the current folder. A model is named by the
        column ``output`` or by the id.
    max_degree : int
        Highest degree L, inclusive.
    sphere : path, optional
        Sphere of rows that have no sphere of their own. Without it, each such surface is mapped to its own sphere,
        which is written beside its model.
    mask : path, optional
        A mask of the spheres' vertices: vertices with value 0 are left out.
    on_error : {"raise", "collect"}
        Stop at the first row that fails, and raise its exception; or continue, with the reason in `CohortFit.error`.
    exists : {"refuse", "skip", "update", "replace"}
        How to treat existing models. ``"refuse"``: raise an error. ``"skip"``: keep models of the same input and
        settings, and refuse other models. ``"update"``: keep models of the same input and settings, and replace other
        models. ``"replace"``: replace all.
    shard : str, optional
        Part of the rows, such as ``"0/10"`` for the first of ten parts; or ``"slurm"``.
    status : path, optional
        A table to which the outcome of each row is appended; ``spharm status`` reads it.
    fix : bool
        Repair meshes, as `repair` does, and labels of volumes.
    largest_repair : float, optional
        With ``fix`` or ``wrap``: share of a mesh's area, from 0 to 1, that a repair may drop or add, or a wrap leave out
        or span, as for `repair`.
    wrap : int, optional
        Replace meshes by the closed surface around them, as `repair` does, instead of repairing them.
    cut_handles : bool
        Cut handles.
    voxel_size : three floats, optional
        Size of volumes' voxels along x, y and z, in mm, overriding that in their files.
    axes : {"xyz", "zyx"}
        Order of the axes of NumPy files, as for `parametrize_volume`.
    channel, time, threshold, probability, label_surface, smooth_radius
        How to read volumes and make surfaces of their labels, as for `parametrize_volume`.
    objective, weights, smoothness, denoise, stderr, hold_out, surface_distance, method, store, passes, granularity
        As for `fit`; weights are given by name, or by files in the table's column.
    start_degree, accelerate, tolerance, max_iterations, preconditioner, strict, dtype, memory, threads
        As for `fit`.
    progress : bool or callable, optional
        As for `fit`; called for each outcome that the iterator returns.

    Returns
    -------
    CohortFits

    Examples
    --------
    >>> import tempfile, pathlib, spharm_rs as sp
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> for seed in range(3):
    ...     sp.example_surface(3, seed)[0].save(folder / f"s{seed}.ply")
    >>> rows = [{"id": f"s{seed}", "surface": folder / f"s{seed}.ply"} for seed in range(3)]
    >>> [(row.id, row.state, row.model.max_degree) for row in sp.fit_cohort(rows, folder, 8)]
    [('s0', 'done', 8), ('s1', 'done', 8), ('s2', 'done', 8)]
    """
    collects = _arrays.on_error(on_error)
    if not isinstance(weights, str):
        raise ValueError("weights: expected 'uniform' or 'area'; call `fit` for arrays; name files in the table's column weights")
    settings = _settings(
        max_degree,
        0,
        objective=objective,
        weights=weights,
        smoothness=smoothness,
        denoise=denoise,
        stderr=stderr,
        hold_out=hold_out,
        surface_distance=surface_distance,
        method=method,
        store=store,
        passes=passes,
        granularity=granularity,
        start_degree=start_degree,
        accelerate=accelerate,
        tolerance=tolerance,
        max_iterations=max_iterations,
        preconditioner=preconditioner,
        strict=strict,
        dtype=dtype,
        memory=memory,
        threads=threads,
    )
    path = os.fspath(table) if isinstance(table, (str, os.PathLike)) else None
    sizes = None if voxel_size is None else [float(size) for size in voxel_size]
    if sizes is not None and (len(sizes) != 3 or not all(0 < size < float("inf") for size in sizes)):
        raise ValueError(f"voxel_size: expected three positive numbers, found {sizes}")
    run = _core.CohortRun(
        path,
        None if path is not None else _rows(table),
        output=_path(output),
        sphere=_path(sphere),
        mask=_path(mask),
        shard=None if shard is None else str(shard),
        status=_path(status),
        exists=str(exists),
        keep_going=collects,
        changes=changes_of(fix, largest_repair, wrap, cut_handles),
        voxel_size=sizes,
        axes=_axes(axes),
        image=_image(channel, time),
        **_volume_settings(threshold, probability, label_surface, smooth_radius),
        settings=settings,
    )
    return CohortFits(run, callback(progress))


def _path(path: Path | None) -> str | None:
    return None if path is None else os.fspath(path)


def _rows(table: Any) -> list[tuple[Any, ...]]:
    """Returns the cells of each row, in the order of `_COLUMNS`."""
    if hasattr(table, "to_dict") and hasattr(table, "columns"):
        table = table.to_dict("records")
    rows, ids = [], set()
    for number, row in enumerate(table):
        if not isinstance(row, Mapping):
            raise ValueError(f"table: expected mappings with the columns id and surface, found {type(row).__name__}")
        cells = [row.get(column) for column in _COLUMNS]
        # pandas represents empty cells by NaN.
        cells = [None if cell is None or cell != cell or cell == "" else cell for cell in cells]
        for column, cell in zip(("id", "surface"), cells):
            if cell is None:
                raise ValueError(f"table: row {number} has no {column}")
        name = str(cells[0])
        if name in ids:
            raise ValueError(f"table: row {number}: id {name!r} occurs twice")
        ids.add(name)
        label = cells[5]
        # pandas converts a column of integers with missing cells to floats.
        label = int(label) if isinstance(label, float) and label.is_integer() else label
        label = None if label is None else _arrays.whole("label", label, -(2**62))
        paths = [None if cell is None else os.fspath(cell) for cell in (*cells[1:5], cells[6])]
        rows.append((name, *paths[:4], label, paths[4]))
    return rows
