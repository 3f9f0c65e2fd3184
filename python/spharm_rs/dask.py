"""Fits chunked samples, which may exceed the memory or one machine, with Dask.

Each chunk is reduced to its `spharm_rs.Moments`, and the moments are added in a tree. Workers exchange only these sums,
of ``8 ((2 L + 1)**2 + c (L + 1)**2)`` bytes. The order of the additions depends on the chunks alone, so results don't
depend on the workers.
"""

from __future__ import annotations

import os
from typing import Any, Iterable, Sequence

try:
    import dask
    from dask.base import tokenize
    from dask.delayed import Delayed
except ImportError:
    raise ImportError("spharm_rs.dask needs Dask: pip install 'spharm-rs[dask]'")

from . import _arrays
from ._cohort import CohortFit
from ._cohort import fit_cohort as fit_cohort_here
from ._model import Model
from ._moments import Moments
from ._surface import Path


def moments(
    samples: Any,
    values: Any = None,
    *,
    max_degree: int,
    weights: Any = None,
    channels: Sequence[str] | None = None,
    split_every: int = 8,
    threads: int = 1,
) -> Any:
    """Plans the sums over chunked samples; any Dask scheduler can compute them.

    Parameters
    ----------
    samples : dask.array.Array of float, (n, 3), or iterable of dask.delayed.Delayed
        Directions, as vectors of any nonzero length, in chunks of rows; or delayed chunks, each of which gives a tuple
        of directions, values and, optionally, weights.
    values : dask.array.Array of float, (n,) or (n, c), optional
        Required with an array of directions; rechunked to its chunks.
    max_degree : int
        Highest degree L of fits, inclusive.
    weights : dask.array.Array of float, (n,), optional
    channels : sequence of str, optional
        As for `spharm_rs.Moments`.
    split_every : int
        Number of parts added at a time.
    threads : int
        Threads per chunk. Dask runs several chunks in parallel.

    Returns
    -------
    dask.delayed.Delayed
        Its result is a `spharm_rs.Moments`.

    Notes
    -----
    A chunk of any size takes the memory of ``spharm moments`` at this degree, 0.8 GB at degree 1,000. The final step of
    a chunk takes as long as some ten million samples at that degree, so smaller chunks are inefficient.

    Examples
    --------
    >>> import dask, numpy as np, spharm_rs as sp, spharm_rs.dask
    >>> chunks = [dask.delayed(lambda v: (v, v[:, 2]))(v) for v in np.split(sp.icosphere(2).vertices, 3)]
    >>> sp.dask.moments(chunks, max_degree=4).compute(scheduler="synchronous")
    Moments(162 samples, degree 4, 1 channel)
    """
    degree, every = _arrays.whole("max_degree", max_degree), _arrays.whole("split_every", split_every, 2)
    _arrays.threads(threads)
    chunks = _chunks(samples, values, weights)
    if not chunks:
        raise ValueError("samples: expected at least one chunk, found none")
    whole = tokenize(*chunks)
    part, add = dask.delayed(_part, pure=True), dask.delayed(_add, pure=True)
    names = None if channels is None else list(channels)
    parts = [part(chunk, degree, names, whole, (i, len(chunks)), threads) for i, chunk in enumerate(chunks)]
    while len(parts) > every:
        parts = [add(parts[i : i + every], True) for i in range(0, len(parts), every)]
    return add(parts, False)


def fit(
    samples: Any,
    values: Any = None,
    max_degree: int = 20,
    *,
    weights: Any = None,
    channels: Sequence[str] | None = None,
    split_every: int = 8,
    threads: int = 1,
    **settings: Any,
) -> Model:
    """Fits chunked samples by least squares.

    Computes `moments` with the current Dask scheduler, such as a client's cluster, and fits them in this process.

    Parameters
    ----------
    samples, values, weights, channels, split_every, threads
        As for `moments`.
    max_degree : int
        Highest degree L, inclusive.
    **settings
        The other arguments of `spharm_rs.Moments.fit`, such as ``smoothness`` and ``stderr``.

    Returns
    -------
    Model

    Examples
    --------
    >>> import dask.array as da, numpy as np, spharm_rs as sp, spharm_rs.dask
    >>> directions = da.from_array(sp.icosphere(4).vertices, chunks=(1000, 3))
    >>> model = sp.dask.fit(directions, directions[:, 2] ** 2, 4)
    >>> bool(abs(model.coefficients[6, 0] - 2 / 3 * np.sqrt(4 * np.pi / 5)) < 1e-9)
    True
    """
    planned = moments(
        samples,
        values,
        max_degree=max_degree,
        weights=weights,
        channels=channels,
        split_every=split_every,
        threads=threads,
    )
    found: Moments = planned.compute()
    return found.fit(max_degree, **settings)


def fit_cohort(
    table: Any,
    output: Path | None = None,
    max_degree: int = 20,
    *,
    shards: int | None = None,
    threads: int = 1,
    **settings: Any,
) -> Any:
    """Plans the fits of many surfaces from files, in shards that any Dask scheduler computes.

    Each shard is a call of `spharm_rs.fit_cohort` on a worker, which reads surfaces from and writes models to files that all
    workers share.

    Parameters
    ----------
    table, output, max_degree
        As for `spharm_rs.fit_cohort`.
    shards : int, optional
        Number of parts of the table; by default one per eight rows, so that few rows are repeated if a worker is lost.
    threads : int
        Threads per shard. Dask runs several shards in parallel.
    **settings
        The other arguments of `spharm_rs.fit_cohort`. By default ``on_error`` is ``"collect"``: one bad surface doesn't
        stop the others.

    Returns
    -------
    dask.delayed.Delayed
        Yields a list of `spharm_rs.CohortFit`, in the order of the table's shards.

    Examples
    --------
    >>> import tempfile, pathlib, spharm_rs as sp, spharm_rs.dask
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> for seed in range(3):
    ...     sp.example_surface(3, seed)[0].save(folder / f"s{seed}.ply")
    >>> rows = [{"id": f"s{seed}", "surface": folder / f"s{seed}.ply"} for seed in range(3)]
    >>> fits = sp.dask.fit_cohort(rows, folder, 8, shards=2).compute(scheduler="synchronous")
    >>> sorted((fit.id, fit.state) for fit in fits)
    [('s0', 'done'), ('s1', 'done'), ('s2', 'done')]
    """
    _arrays.threads(threads)
    if "shard" in settings or "progress" in settings:
        raise ValueError("shard, progress: these settings are only for `spharm_rs.fit_cohort`; give shards=N")
    rows = _table(table)
    count = _arrays.whole("shards", -(-_rows(rows) // 8) if shards is None else shards, 1)
    settings = {"on_error": "collect", **settings, "threads": threads}
    part, join = dask.delayed(_shard), dask.delayed(_joined)
    return join([part(rows, output, max_degree, f"{shard}/{count}", settings) for shard in range(count)])


def _table(table: Any) -> Any:
    """Returns a table that can be sent to workers and read more than once."""
    if isinstance(table, (str, os.PathLike)) or hasattr(table, "to_dict"):
        return table
    return [dict(row) for row in table]


def _rows(table: Any) -> int:
    if not isinstance(table, (str, os.PathLike)):
        return len(table)
    with open(table, encoding="utf-8", errors="replace") as file:
        return max(1, sum(1 for line in file if line.strip()) - 1)


def _shard(table: Any, output: Path | None, max_degree: int, shard: str, settings: dict[str, Any]) -> list[CohortFit]:
    return list(fit_cohort_here(table, output, max_degree, shard=shard, **settings))


def _joined(parts: list[list[CohortFit]]) -> list[CohortFit]:
    return [fit for part in parts for fit in part]


def _chunks(samples: Any, values: Any, weights: Any) -> list[Any]:
    """Returns a delayed tuple of arrays for each chunk of rows."""
    if not hasattr(samples, "to_delayed"):
        if values is not None or weights is not None:
            raise ValueError("values, weights: expected None, because delayed chunks are tuples that contain values and weights")
        chunks = list(samples) if isinstance(samples, Iterable) and not isinstance(samples, Delayed) else [samples]
        for chunk in chunks:
            if not isinstance(chunk, Delayed):
                raise ValueError(f"samples: expected a Dask array or delayed chunks, found {type(chunk).__name__}")
        return chunks
    if values is None:
        raise ValueError("values: expected the values at the directions, found None")
    arrays = {"samples": samples, "values": values} | ({} if weights is None else {"weights": weights})
    for name, array in arrays.items():
        if not hasattr(array, "to_delayed"):
            raise ValueError(f"{name}: expected a Dask array, found {type(array).__name__}")
    if samples.ndim != 2 or samples.shape[1] != 3:
        raise ValueError(f"samples: expected shape (n, 3), found {samples.shape}")
    if values.ndim not in (1, 2):
        raise ValueError(f"values: expected shape (n,) or (n, c), found {values.shape}")
    if weights is not None and weights.ndim != 1:
        raise ValueError(f"weights: expected shape (n,), found {weights.shape}")
    rows, columns = samples.chunks[0], []
    # NaN stands for an unknown length, such as of an array made from a table.
    known = all(size == size for array in arrays.values() for size in array.chunks[0])
    for name, array in arrays.items():
        if known and array.shape[0] != samples.shape[0]:
            raise ValueError(f"{name}: expected {samples.shape[0]} rows, found {array.shape[0]}")
        if not known and array.numblocks[0] != samples.numblocks[0]:
            raise ValueError(f"{name}: expected {samples.numblocks[0]} chunks, found {array.numblocks[0]}")
        sizes = ({0: rows} if known else {}) | ({1: -1} if array.ndim == 2 else {})
        columns.append(array.rechunk(sizes).to_delayed().ravel())
    return [dask.delayed(tuple, pure=True)(list(chunk)) for chunk in zip(*columns)]


def _part(
    chunk: Any, max_degree: int, channels: list[str] | None, whole: str, shard: tuple[int, int], threads: int
) -> Moments:
    """Computes the moments of a chunk; runs on a worker."""
    return Moments(*chunk, max_degree=max_degree, channels=channels, whole=whole, shard=shard, threads=threads)


def _add(parts: list[Moments], partial: bool) -> Moments:
    """Adds moments at a node of the tree; runs on a worker."""
    return Moments.merge(parts, partial=partial)
