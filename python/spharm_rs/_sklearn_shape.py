"""A scikit-learn transformer from meshes to scores along the modes of variation of the training group."""

from __future__ import annotations

from typing import Any, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted

from . import shape
from ._arrays import Floats, whole
from ._model import Model
from ._parametrize import Parametrization
from ._shape_correspond import Group, Member, _names, correspond
from ._shape_modes import Modes, pca
from ._shape_poses import SimilarityTransform
from ._sklearn_inputs import Input, Meshes, rows
from ._sklearn_named import named_among, warned
from ._surface import Surface, icosphere


class ShapeFeatures(Meshes, TransformerMixin, BaseEstimator):  # type: ignore[misc]
    """Turns meshes into scores along the modes of variation of the training group.

    `fit` makes the training meshes correspond (`spharm_rs.shape.correspond`) and finds their modes
    (`spharm_rs.shape.pca`). `transform` registers meshes to the group's mean, which doesn't change the group.
    `fit_transform` returns what `fit` and then `transform` return. Meshes need no sphere and no common vertices, and may
    be in any pose. Results are deterministic, and the same with any number of threads.

    Parameters
    ----------
    max_degree : int
        Highest degree L of the models.
    modes : int or float, optional
        Maximum number of modes; or a share of the variance, between 0 and 1, for the fewest modes that have this share
        together. By default all modes, one fewer than training meshes.
    scale : bool
        Scale meshes to one size: their models to one area.
    size : bool
        With ``scale=True``: add a column ``log_size``, the logarithm of the mesh's size relative to the group's
        (``size_``). The size of a mesh is the square root of the area of its model, in the mesh's unit.
    template : surface, optional
        As for `spharm_rs.shape.correspond`; by default the most typical training mesh.
    rounds : int
    refine : bool
    subdivisions : int, optional
    memory : int or str, optional
        As for `spharm_rs.shape.correspond`.
    threads : int, optional
        Number of threads; by default all CPUs. Give a number if several processes run at once, as with ``n_jobs``.

    Attributes
    ----------
    group_ : Group
        The training group.
    modes_ : Modes
        Its mean and modes.
    scores_ : ndarray of float, (s, m)
        The training meshes' scores in the group itself, with the columns of `transform`.
    size_ : float or None
        With ``scale=True``: the group's size, the square root of the area of all models.
    n_features_out_ : int
        Number of columns.

    Notes
    -----
    The refinement of `fit` compares training meshes with each other, and that of `transform` compares a mesh with the
    finished group. So training meshes have two kinds of scores: those of `transform` and `fit_transform`, which are
    computed as for new meshes, and those of the group, ``scores_``. They differ by the error of the registration, which
    has about the same size in all modes. It is small beside the spread of the training scores in the first modes, but as
    large or larger in modes of small variance: keep only modes of large variance (``modes``). Don't compare ``scores_``
    with scores of new meshes. `fit_transform` registers each training mesh once more than `fit`, which takes as long as
    `transform` of these meshes.

    T. F. Cootes et al., "Active shape models", Comput. Vis. Image Underst. 61 (1995).

    Examples
    --------
    >>> import spharm_rs as sp
    >>> from spharm_rs.sklearn import ShapeFeatures
    >>> ball = sp.icosphere(3)
    >>> scaled = [ball.vertices * [9 + k, 6, 4] for k in range(5)]
    >>> pears = [sp.Surface(points * (1 + 0.3 * ball.vertices), ball.faces) for points in scaled]
    >>> features = ShapeFeatures(4, modes=2, subdivisions=2).fit(pears[:4])
    >>> scores = features.transform(pears[4:])
    >>> scores.shape, features.get_feature_names_out().tolist()
    ((1, 2), ['mode_1', 'mode_2'])
    >>> features.inverse_transform(scores)[0]
    Surface(2562 vertices, 5120 faces)
    """

    def __init__(
        self,
        max_degree: int = 12,
        modes: int | float | None = None,
        *,
        scale: bool = False,
        size: bool = False,
        template: Any = None,
        rounds: int = 2,
        refine: bool = True,
        subdivisions: int | None = None,
        memory: int | str | None = None,
        threads: int | None = None,
    ) -> None:
        self.max_degree = max_degree
        self.modes = modes
        self.scale = scale
        self.size = size
        self.template = template
        self.rounds = rounds
        self.refine = refine
        self.subdivisions = subdivisions
        self.memory = memory
        self.threads = threads

    def fit(self, X: Any, y: Any = None) -> ShapeFeatures:
        """Makes the training meshes correspond, and finds their modes.

        Parameters
        ----------
        X : sequence of surfaces, or array of them, (s,) or (s, 1)
            Three or more: paths, `spharm_rs.Surface`, `spharm_rs.Model`, `spharm_rs.Parametrization` or what
            `spharm_rs.as_surface` takes.
        y : ignored

        Raises
        ------
        MeshError
            If a mesh can't be used; the message has its position in X and its path.
        ValueError
            If X isn't a sequence of surfaces, or a parameter is invalid.

        Warns
        -----
        SpharmWarning
            If a mesh is doubtful, such as one of another kind; the message has its position in X and its path.
        """
        self._fitted(X)
        return self

    def _fitted(self, X: Any) -> list[Input]:
        """Fits the transformer, and returns the surfaces of X."""
        if self.size and not self.scale:
            raise ValueError("size: expected False, because scale=False keeps the size in the modes; found True")
        most, share = _limits(self.modes)
        surfaces = self._surfaces(X, reset=True)
        if len(surfaces) < 3:
            raise ValueError(f"X: expected three or more surfaces for modes of variation, found {len(surfaces)}")
        group = self._correspond(surfaces)
        self.size_ = float(np.exp(np.log(self._sizes(group.models)).mean())) if self.scale else None
        models, sizes = self._of_one_size(group.models, group.transforms)
        with warned():
            modes = pca(models, modes=most, names=group.names, threads=self.threads)
        if share is not None:
            modes = modes.truncate(int(np.searchsorted(modes.compactness, share)) + 1)
        self.group_, self.modes_ = group, modes
        self.scores_ = self._with_size(modes.scores, sizes)
        self.n_features_out_ = len(modes) + bool(self.size)
        return surfaces

    def fit_transform(self, X: Any, y: Any = None) -> Floats:
        """Fits the transformer, and returns the training meshes' scores, (s, m), as `transform` does.

        Each mesh is registered once more, to the finished group. ``scores_`` has the scores in the group itself.

        Parameters
        ----------
        X : sequence of surfaces
            As for `fit`.
        y : ignored
        """
        surfaces = self._fitted(X)
        # `fit` has already warned of doubtful meshes.
        with warned(lambda text: None):
            return self._transformed(surfaces)

    def transform(self, X: Any) -> Floats:
        """Registers meshes to the group's mean, and returns their scores, (s, m), in the meshes' unit.

        Parameters
        ----------
        X : sequence of surfaces
            As for `fit`, but one or more.

        Raises
        ------
        MeshError
            If a mesh can't be used; the message has its position in X and its path.

        Warns
        -----
        SpharmWarning
            If a mesh is doubtful, such as one of another kind; the message has its position in X and its path.
        """
        check_is_fitted(self, "group_")
        return self._transformed(self._surfaces(X))

    def _transformed(self, surfaces: list[Input]) -> Floats:
        found = self._register(surfaces)
        models, sizes = self._of_one_size([member.model for member in found], [member.transform for member in found])
        # The registration has already warned of doubtful meshes.
        return self._with_size(np.stack([self.modes_._inner.project(model._inner)[0] for model in models]), sizes)

    def _surfaces(self, X: Any, reset: bool = False) -> list[Input]:
        return [item.surface if isinstance(item, Parametrization) else item for item in super()._surfaces(X, reset)]

    def _correspond(self, surfaces: list[Input]) -> Group:
        with named_among(surfaces, _names(surfaces)):
            return correspond(
                surfaces,
                self.max_degree,
                template=self.template,
                rounds=self.rounds,
                refine=self.refine,
                scale=self.scale,
                subdivisions=self.subdivisions,
                memory=self.memory,
                threads=self.threads,
            )

    def _register(self, surfaces: list[Input]) -> list[Member]:
        with named_among(surfaces, _names(surfaces, len(self.group_)), again=True):
            found = self.group_.add(surfaces, threads=self.threads)
        return found if isinstance(found, list) else [found]

    def _sizes(self, models: Sequence[Model]) -> Floats:
        """Returns the sizes of models, the square roots of their areas."""
        measured = [shape._measured(model, None, _AREA, self.threads, None)[0] for model in models]
        return np.array([found.area**0.5 for found in measured])

    def _of_one_size(self, models: list[Model], transforms: Sequence[SimilarityTransform]) -> tuple[list[Model], Floats]:
        """Returns models, with ``scale`` scaled about their centres to the group's size, and the logarithms of the
        surfaces' own sizes relative to it."""
        if self.size_ is None:
            return models, np.zeros(len(models))
        # Poses scale the members of the group to each other, but a new surface to the mean. Therefore the sizes of both
        # are measured on their models.
        factors = self.size_ / self._sizes(models)
        sizes = -np.log(factors * [transform.scale for transform in transforms])
        centres = [model.truncate(0) for model in models]
        return [centre + (model - centre) * factor for model, centre, factor in zip(models, centres, factors)], sizes

    def _with_size(self, scores: Floats, sizes: Floats) -> Floats:
        return np.column_stack([scores, sizes]) if self.size else scores

    def inverse_transform(self, X: ArrayLike) -> list[Surface]:
        """Returns the surfaces of rows of scores, in the group's frame.

        Their vertices correspond: they are at the directions of ``icosphere:4`` up to degree 15, ``icosphere:5`` up to degree
        40, and ``icosphere:6`` above, or of a finer icosphere if ``subdivisions`` is more. The triangles of a coarser one
        would cut corners, so that the surfaces would have less volume than their models.

        Parameters
        ----------
        X : array_like of float, (s, m)
            As returned by `transform`. With ``scale=True`` surfaces have the group's size, and with ``size=True`` their
            own.

        Returns
        -------
        list of Surface
        """
        check_is_fitted(self, "group_")
        values = rows(X, self.n_features_out_, "scores")
        sphere = self._sphere()
        spread = np.sqrt(self.modes_.variances)
        none = np.zeros((len(values), len(spread)))
        deviations = np.divide(values[:, : len(spread)], spread, out=none, where=spread > 0)
        found = []
        for row, deviation in zip(values, deviations):
            surface = self.modes_.shape(deviation).surface(sphere, threads=self.threads)
            found.append(Surface(surface.vertices * np.exp(row[-1]), surface.faces) if self.size else surface)
        return found

    def _sphere(self) -> Surface:
        degree = self.modes_.mean.max_degree
        subdivisions = 4 if degree <= 15 else 5 if degree <= 40 else 6
        while 10 * 4**subdivisions + 2 < len(self.group_.sphere.vertices):
            subdivisions += 1
        return icosphere(subdivisions)

    def get_feature_names_out(self, input_features: Any = None) -> NDArray[Any]:
        """Returns the columns' names, ``mode_1`` to ``mode_m`` and with ``size=True`` ``log_size``.

        Parameters
        ----------
        input_features : ignored
        """
        check_is_fitted(self, "group_")
        names = [f"mode_{mode + 1}" for mode in range(len(self.modes_))]
        return np.array(names + ["log_size"] * bool(self.size), dtype=object)


#: Relative change of a model's area, when the grid is refined, below which the area is accurate enough.
_AREA = 1e-5


def _limits(modes: Any) -> tuple[int | None, float | None]:
    """Returns the maximum number of modes, and the share of the variance that they must reach; None for no limit."""
    if isinstance(modes, (float, np.floating)):
        if not 0 < modes < 1:
            raise ValueError(f"modes: expected a share between 0 and 1, or a whole number of modes; found {modes!r}")
        return None, float(modes)
    return None if modes is None else whole("modes", modes, 1), None
