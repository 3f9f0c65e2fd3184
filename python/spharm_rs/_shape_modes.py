"""Computes modes of variation of a group: principal components."""

from __future__ import annotations

import json
import os
import pathlib
import tempfile
from dataclasses import dataclass
from typing import Any, Iterable, Sequence, overload

import numpy as np
from numpy.typing import ArrayLike

from . import _arrays, _core
from ._arrays import Floats
from ._model import Model, core
from ._progress import Progress, callback
from ._shape_newcomers import Newcomer, doubts_of
from ._shape_poses import cores, named
from ._surface import Path
from ._warnings import warn

#: Name of the file through which modes are pickled.
_FILE = "modes.shape-model.npz"


@dataclass(frozen=True, eq=False)
class Quality:
    """Generalisation and specificity of the first k modes, for k = 1 to m; smaller is better.

    Attributes
    ----------
    generalisation : ndarray of float, (m,)
        Mean distance of a member from its nearest shape in the modes of all other members.
    specificity : ndarray of float, (m,)
        Mean distance of a random shape in the modes from the nearest member.
    """

    generalisation: Floats
    specificity: Floats


class Modes:
    """Mean and m modes of variation of a group of n surfaces, from `spharm_rs.shape.pca`.

    A shape is ``mean + sum(deviations[k] * sqrt(variances[k]) * modes[k])``. Its position in space is ignored.
    """

    _inner: _core.Modes

    def __init__(self) -> None:
        raise TypeError("Modes are made by spharm_rs.shape.pca and Modes.load")

    @classmethod
    def _of(cls, inner: _core.Modes) -> Modes:
        modes = cls.__new__(cls)
        modes._inner = inner
        return modes

    def __reduce__(self) -> Any:
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder, _FILE)
            self.save(path)
            return _unpickled, (path.read_bytes(),)

    def __repr__(self) -> str:
        return f"Modes({len(self)} of {len(self.members)} members)"

    def __len__(self) -> int:
        """Number of modes, m."""
        return len(self._inner.variances)

    @property
    def mean(self) -> Model:
        """Mean of the group."""
        return Model._of(self._inner.mean)

    @property
    def modes(self) -> Floats:
        """Coefficients of the modes, (m, K, 3), by decreasing variance; each mode has norm ``sqrt(4 pi)`` and is zero
        in row 0."""
        return self._inner.modes

    @property
    def variances(self) -> Floats:
        """Variance along each mode, (m,), in the square of the surfaces' unit."""
        return self._inner.variances

    @property
    def scores(self) -> Floats:
        """Coordinates of the members along the modes, (n, m), in the surfaces' unit."""
        return self._inner.scores

    @property
    def total_variance(self) -> float:
        """Variance along all modes, including modes that were left out."""
        return self._inner.total_variance

    @property
    def shares(self) -> Floats:
        """Share of the variance along each mode, (m,)."""
        return self._inner.shares

    @property
    def compactness(self) -> Floats:
        """Cumulative share of the variance along the first k modes, (m,)."""
        return self._inner.compactness

    @property
    def members(self) -> list[str]:
        """Names of the group's members, n."""
        return self._inner.members

    @property
    def provenance(self) -> dict[str, Any]:
        """Record of how the modes were computed."""
        found: dict[str, Any] = json.loads(self._inner.provenance)
        return found

    def truncate(self, count: int) -> Modes:
        """Returns a copy with the first modes, at most ``count``."""
        return Modes._of(self._inner.truncate(_arrays.whole("count", count)))

    def shape(self, deviations: ArrayLike) -> Model:
        """Returns the shape at given numbers of standard deviations along the first modes.

        Parameters
        ----------
        deviations : array_like of float, (k,)
            Standard deviations along the first k modes, at most m; a single number is for the first mode.

        Returns
        -------
        Model
        """
        numbers = _arrays.real("deviations", deviations, "(k,)")
        if numbers.ndim > 1:
            raise ValueError(f"deviations: expected shape (k,), found {numbers.shape}")
        return Model._of(self._inner.shape(numbers.reshape(-1)))

    def sample(self, count: int, *, seed: int = 0) -> list[Model]:
        """Returns random shapes, whose deviations along the modes are normally distributed.

        Parameters
        ----------
        count : int
        seed : int
        """
        found = self._inner.sample(_arrays.whole("count", count), seed=_arrays.whole("seed", seed))
        return [Model._of(model) for model in found]

    @overload
    def project(self, model: Model) -> tuple[Floats, float]: ...
    @overload
    def project(self, model: Iterable[Model]) -> tuple[Floats, Floats]: ...
    def project(self, model: Model | Iterable[Model]) -> tuple[Floats, float | Floats]:
        """Finds the shapes of the modes that are nearest to models.

        Parameters
        ----------
        model : Model, or sequence of Model, n
            Models of the group's degree, aligned with the mean.

        Returns
        -------
        scores : ndarray of float, (m,) or (n, m)
            Coordinates along the modes, in the surfaces' unit; divide them by ``sqrt(variances)`` for `shape`.
        distance : float or ndarray of float, (n,)
            Root mean square distance of each model from its nearest shape, in the surfaces' unit.

        Raises
        ------
        ValueError
            If an item isn't a model of a surface at the group's degree; for a sequence, the message has the item's
            number.

        Warns
        -----
        SpharmWarning
            If the distance of a model from the mean is more than four times that of the farthest member of a group of
            at least five: the model may be unaligned, mirrored or in another unit.
        """
        mean = self.mean
        one = isinstance(model, Model) or not hasattr(model, "__iter__")
        given: Any = {"model": model} if one else {f"models[{number}]": item for number, item in enumerate(model)}
        found = [self._projected(what, item, mean.max_degree) for what, item in given.items()]
        warn(doubts_of(self._inner, mean, found))
        if one:
            return found[0].scores, found[0].distance
        scores, distances = [item.scores for item in found], [item.distance for item in found]
        return np.array(scores).reshape(len(found), len(self)), np.array(distances, dtype=float)

    def _projected(self, what: str, model: Any, degree: int) -> Newcomer:
        """Projects a model; errors and warnings begin with its name, `what`."""
        inner = core(what, model)
        if not model.is_surface:
            raise ValueError(f"{what}: expected a model of a surface, found {model!r}")
        if model.max_degree != degree:
            raise ValueError(f"{what}: expected degree {degree}, that of the group, found {model.max_degree}; see pca's degree=")
        return Newcomer(what, *self._inner.project(inner))

    def transform(self, models: Iterable[Model]) -> Floats:
        """Returns the scores of models along the modes, as scikit-learn's ``PCA.transform`` does; see `project`.

        Parameters
        ----------
        models : sequence of Model, n
            Models of the group's degree, aligned with the mean.

        Returns
        -------
        ndarray of float, (n, m)
            In the surfaces' unit; those of the group's members are `scores`.

        Warns
        -----
        SpharmWarning
            As for `project`.
        """
        if isinstance(models, Model) or not hasattr(models, "__iter__"):
            raise ValueError(f"models: expected a sequence of Model, found {models!r}; project takes a single model")
        return self.project(models)[0]

    def quality(
        self, *, samples: int = 2000, seed: int = 0, threads: int | None = None, progress: Progress = None
    ) -> Quality:
        """Measures generalisation and specificity; the modes must not have been truncated.

        Parameters
        ----------
        samples : int
            Number of random shapes for the specificity.
        seed : int
            Seed of the random shapes.
        threads : int, optional
        progress : bool or callable, optional

        Returns
        -------
        Quality
        """
        found = self._inner.quality(
            samples=_arrays.whole("samples", samples, 1),
            seed=_arrays.whole("seed", seed),
            threads=_arrays.threads(threads),
            progress=callback(progress),
        )
        return Quality(*found)

    def save(self, path: Path, *, overwrite: bool = False) -> None:
        """Writes a ``.shape-model.npz`` file, which ``spharm shape sample`` can read, too.

        Parameters
        ----------
        path : str or os.PathLike
        overwrite : bool
            Replace an existing file.
        """
        self._inner.write(os.fspath(path), overwrite=bool(overwrite))

    @classmethod
    def load(cls, path: Path) -> Modes:
        """Reads a ``.shape-model.npz`` file.

        Parameters
        ----------
        path : str or os.PathLike

        Returns
        -------
        Modes
        """
        return cls._of(_core.Modes.read(os.fspath(path)))


def _unpickled(data: bytes) -> Modes:
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder, _FILE)
        path.write_bytes(data)
        return Modes.load(path)


def pca(
    models: Sequence[Model],
    *,
    modes: int | None = None,
    degree: int | None = None,
    names: Sequence[str] | None = None,
    threads: int | None = None,
) -> Modes:
    """Computes the modes of variation of surfaces that correspond: principal components of their coefficients.

    Parameters
    ----------
    models : sequence of Model
        Three or more corresponding models, such as those of `procrustes`. Their position in space is ignored.
    modes : int, optional
        Maximum number of modes to keep; by default all, one fewer than models.
    degree : int, optional
        Highest degree; by default the lowest of the models'.
    names : sequence of str, optional
        Names of the members; by default their numbers from 0.
    threads : int, optional

    Returns
    -------
    Modes

    Examples
    --------
    >>> import numpy as np, spharm_rs as sp
    >>> rng = np.random.default_rng(0)
    >>> group = [sp.Model(np.eye(9)[:, 1:4] * (5 + rng.normal(size=3))) for _ in range(6)]
    >>> found = sp.shape.pca(group)
    >>> found
    Modes(5 of 6 members)
    >>> scores, distance = found.project(group[0])
    >>> bool(np.allclose(scores, found.scores[0])) and distance < 1e-12
    True
    >>> bool(np.allclose(found.transform(group), found.scores))
    True
    """
    members = cores(models)
    found, warnings = _core.shape_pca(
        members,
        None if degree is None else _arrays.whole("degree", degree),
        most=None if modes is None else _arrays.whole("modes", modes),
        names=named(names, len(members)),
        threads=_arrays.threads(threads),
    )
    warn(warnings)
    return Modes._of(found)
