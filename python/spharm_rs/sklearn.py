"""scikit-learn's transformers: from meshes to features, and between surfaces over one sphere and their coefficients.

`ShapeFeatures` takes bare meshes and returns scores along the modes of variation of the training group. `Descriptors`
takes bare meshes or models and returns numbers that don't depend on poses. `SpharmTransformer` takes surfaces with
corresponding vertices over one sphere and returns coefficients. X is a sequence of surfaces, one for each subject.
"""

from __future__ import annotations

from typing import Any, Iterable

import numpy as np
from numpy.typing import ArrayLike

from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted

from ._arrays import Floats
from ._fit_many import fit_many
from ._sklearn_descriptors import Descriptors
from ._sklearn_inputs import Meshes, rows
from ._sklearn_named import warned
from ._sklearn_shape import ShapeFeatures
from ._surface import Surface, as_surface, named_icosphere
from ._transform import Transform

__all__ = ["Descriptors", "ShapeFeatures", "SpharmTransformer"]


class SpharmTransformer(Meshes, TransformerMixin, BaseEstimator):  # type: ignore[misc]
    """Turns surfaces with corresponding vertices into rows of coefficients, by least squares at the vertices.

    Parameters
    ----------
    max_degree : int
        Highest degree L; a row has ``3 (L + 1)**2`` coefficients.
    sphere : Surface or what `spharm_rs.as_surface` takes, or str
        The sphere of all surfaces, with the same vertices in the same order; or ``icosphere:N``.
    smoothness : float or "auto", optional
        As for `spharm_rs.fit`.
    weights : {"uniform", "area"}
        As for `spharm_rs.fit`.
    threads : int, optional

    Examples
    --------
    >>> import numpy as np, spharm_rs as sp
    >>> from sklearn.decomposition import PCA
    >>> from sklearn.pipeline import make_pipeline
    >>> from spharm_rs.sklearn import SpharmTransformer
    >>> X = np.stack([sp.example_surface(3, seed)[0].vertices for seed in range(6)])
    >>> pipeline = make_pipeline(SpharmTransformer(10, sphere="icosphere:3"), PCA(2))
    >>> pipeline.fit_transform(X).shape
    (6, 2)
    """

    def __init__(
        self,
        max_degree: int = 20,
        sphere: Any = "icosphere:5",
        smoothness: float | str | None = None,
        weights: str = "uniform",
        threads: int | None = None,
    ) -> None:
        self.max_degree = max_degree
        self.sphere = sphere
        self.smoothness = smoothness
        self.weights = weights
        self.threads = threads

    def _sphere(self) -> Any:
        return as_surface(named_icosphere(self.sphere))

    def fit(self, X: ArrayLike | Iterable[Surface], y: Any = None) -> SpharmTransformer:
        """Stores the sphere; nothing is learned from the surfaces.

        Parameters
        ----------
        X : array_like of float, (s, n, 3), or sequence of surfaces
        y : ignored
        """
        self.sphere_ = self._sphere()
        self.n_features_out_ = 3 * (self.max_degree + 1) ** 2
        return self

    def transform(self, X: ArrayLike | Iterable[Surface]) -> Floats:
        """Returns coefficients, (s, 3 (L + 1)**2), channel by channel.

        Parameters
        ----------
        X : array_like of float, (s, n, 3), or sequence of surfaces

        Raises
        ------
        MeshError
            If a surface with triangles has other triangles than the sphere.
        """
        check_is_fitted(self, "sphere_")
        with warned():
            models = fit_many(
                X,
                self.sphere_,
                self.max_degree,
                # Fits the vertices, so that `transform` recovers the rows passed to `inverse_transform`.
                objective="vertices",
                surface_distance=False,
                smoothness=self.smoothness,
                weights=self.weights,
                threads=self.threads,
            )
        return np.stack([model.coefficients.T.ravel() for model in models])

    def inverse_transform(self, X: ArrayLike) -> Floats:
        """Returns the positions of the sphere's vertices, (s, n, 3), for rows of coefficients."""
        check_is_fitted(self, "sphere_")
        values = rows(np.atleast_2d(np.asarray(X)), self.n_features_out_, "coefficients")
        transform = Transform(self.sphere_.vertices, self.max_degree, threads=self.threads)
        coefficients = values.reshape(len(values), 3, -1)
        return np.stack([transform.synthesis(one.T) for one in coefficients])

    def get_feature_names_out(self, input_features: Any = None) -> Any:
        """Returns names such as ``x_2_-1``: channel, degree, order."""
        check_is_fitted(self, "sphere_")
        names = [
            f"{channel}_{degree}_{order}"
            for channel in "xyz"
            for degree in range(self.max_degree + 1)
            for order in range(-degree, degree + 1)
        ]
        return np.array(names, dtype=object)

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.input_tags.three_d_array = True
        return tags

    def _more_tags(self) -> dict[str, Any]:
        tags = super()._more_tags()
        return {**tags, "X_types": ["3darray", *tags["X_types"]]}
