"""A scikit-learn transformer from meshes to descriptors that don't depend on poses."""

from __future__ import annotations

from typing import Any, Sequence

import numpy as np
from numpy.typing import NDArray

from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted

from . import shape
from ._arrays import Floats, whole
from ._fit import fit as fit_surface
from ._model import Model
from ._parametrize import Parametrization, parametrize
from ._sklearn_inputs import Input, Meshes
from ._sklearn_named import named

KINDS = ("singular_values", "power")
MEASURES = ("size", "volume", "area", "sphericity")


class Descriptors(Meshes, TransformerMixin, BaseEstimator):  # type: ignore[misc]
    """Turns meshes or models into numbers that are invariant to rotations, reflections and translations.

    Each mesh is mapped to the sphere, with equal areas, and fitted by itself; meshes needn't correspond. Results are
    deterministic, and the same with any number of threads.

    Parameters
    ----------
    max_degree : int
        Highest degree L, at least 1; models may have more degrees.
    kind : {"singular_values", "power"}
        The singular values of each degree's coefficients, 3 L columns in the meshes' unit; or the power of each degree,
        the sum of their squares, L columns. See `spharm_rs.shape.describe`.
    unit_size : bool
        Describe models scaled to size 1; the measures stay those of the meshes.
    measures : sequence of {"size", "volume", "area", "sphericity"}
        Measures to add as columns: the root mean square distance from the mean position over the sphere, and those of
        `spharm_rs.shape.measure`, in the meshes' unit.
    cut_handles : bool
        Cut handles of meshes, as `spharm_rs.parametrize` does.
    area : float
        Allowed area distortion of the maps, as for `spharm_rs.parametrize`. With 0, two meshes of one surface have
        nearly the same map. With more, a map also depends on the triangles, and the descriptors with it.
    threads : int, optional
        Number of threads; by default all CPUs. Give a number if several processes run at once, as with ``n_jobs``.

    Attributes
    ----------
    n_features_out_ : int
        Number of columns.

    Notes
    -----
    Meshes are mapped and fitted again in each call, so in each fold of a cross-validation. To map them once, fit models
    beforehand, and pass the models or their paths (``.npz``) as X: ``fit(parametrize(mesh, area=0), max_degree=L)`` of
    `spharm_rs`, with the highest L that is tried. Models and parametrisations are described over the maps that they
    have; ``spharm_rs.fit(mesh)`` makes other maps, which depend on the triangles.

    M. Kazhdan, T. Funkhouser and S. Rusinkiewicz, "Rotation invariant spherical harmonic representation of 3D shape
    descriptors", SGP 2003.

    Examples
    --------
    >>> import spharm_rs as sp
    >>> from spharm_rs.sklearn import Descriptors
    >>> surfaces = [sp.example_surface(3, seed)[0] for seed in range(2)]
    >>> descriptors = Descriptors(4, kind="power", measures=["volume"])
    >>> descriptors.fit_transform(surfaces).shape
    (2, 5)
    >>> descriptors.get_feature_names_out().tolist()
    ['power_1', 'power_2', 'power_3', 'power_4', 'volume']
    """

    def __init__(
        self,
        max_degree: int = 12,
        kind: str = "singular_values",
        *,
        unit_size: bool = False,
        measures: Sequence[str] = (),
        cut_handles: bool = False,
        area: float = 0.0,
        threads: int | None = None,
    ) -> None:
        self.max_degree = max_degree
        self.kind = kind
        self.unit_size = unit_size
        self.measures = measures
        self.cut_handles = cut_handles
        self.area = area
        self.threads = threads

    def fit(self, X: Any, y: Any = None) -> Descriptors:
        """Checks the parameters; nothing is learned from the surfaces.

        Parameters
        ----------
        X : sequence of surfaces, or array of them, (s,) or (s, 1)
            Paths, `spharm_rs.Surface`, `spharm_rs.Model`, `spharm_rs.Parametrization` or what `spharm_rs.as_surface`
            takes.
        y : ignored

        Raises
        ------
        ValueError
            If X isn't a sequence of surfaces, or a parameter is invalid.
        """
        whole("max_degree", self.max_degree, 1)
        if self.kind not in KINDS:
            raise ValueError(f"kind: expected {' or '.join(KINDS)}, found {self.kind!r}")
        if isinstance(self.measures, str) or not set(self.measures) <= set(MEASURES):
            known = ", ".join(MEASURES)
            raise ValueError(f"measures: expected a sequence of names among {known}; found {self.measures!r}")
        if not 0 <= float(self.area) <= 1:
            raise ValueError(f"area: expected a number from 0 to 1, found {self.area!r}")
        self._surfaces(X, reset=True)
        self.n_features_out_ = len(self._names())
        return self

    def transform(self, X: Any) -> Floats:
        """Maps, fits and describes each surface; returns a row for each, (s, m).

        Parameters
        ----------
        X : sequence of surfaces
            As for `fit`.

        Raises
        ------
        MeshError
            If a mesh can't be used; the message has its position in X and its path.
        FileNotFoundError
            If a path doesn't exist; the message has its position in X and the path.

        Warns
        -----
        SpharmWarning
            If a mesh or its model is doubtful; the message has its position in X and its path.
        """
        check_is_fitted(self, "n_features_out_")
        found = []
        for index, surface in enumerate(self._surfaces(X)):
            with named(index, surface):
                found.append(self._described(self._model(surface)))
        return np.stack(found)

    def _model(self, surface: Input) -> Model:
        if isinstance(surface, Model):
            if surface.max_degree < self.max_degree:
                found = surface.max_degree
                raise ValueError(f"expected a model of degree {self.max_degree} or more, found degree {found}")
            return surface.truncate(self.max_degree)
        if not isinstance(surface, Parametrization):
            # The maps that `fit` makes trade equal areas for accuracy, by an amount that depends on the triangles:
            # descriptors would tell meshes of different resolution apart, not shapes.
            surface = parametrize(
                surface, cut_handles=self.cut_handles, degree=self.max_degree, area=self.area, threads=self.threads
            )
        return fit_surface(surface, max_degree=self.max_degree, surface_distance=False, threads=self.threads)

    def _described(self, model: Model) -> Floats:
        power, singular_values = shape.describe(model)
        size = float(np.sqrt(power.sum()))
        measures = {"size": size}
        if not {"size"} >= set(self.measures):
            found = shape.measure(model, threads=self.threads)
            measures |= {"volume": found.volume, "area": found.area, "sphericity": found.sphericity}
        unit = size if self.unit_size and size > 0 else 1.0
        values = power / unit**2 if self.kind == "power" else singular_values.ravel() / unit
        return np.append(values, [measures[name] for name in self.measures])

    def get_feature_names_out(self, input_features: Any = None) -> NDArray[Any]:
        """Returns the columns' names, such as ``singular_value_2_1`` (degree 2, largest) or ``power_2``, and measures.

        Parameters
        ----------
        input_features : ignored
        """
        check_is_fitted(self, "n_features_out_")
        return np.array(self._names(), dtype=object)

    def _names(self) -> list[str]:
        degrees = range(1, self.max_degree + 1)
        if self.kind == "power":
            names = [f"power_{degree}" for degree in degrees]
        else:
            names = [f"singular_value_{degree}_{number}" for degree in degrees for number in (1, 2, 3)]
        return [*names, *self.measures]
