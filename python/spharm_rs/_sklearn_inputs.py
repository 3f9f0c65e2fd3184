"""Lists the surfaces passed to scikit-learn's estimators."""

from __future__ import annotations

import os
from typing import Any, Union

import numpy as np
from numpy.typing import ArrayLike

from . import _arrays
from ._arrays import Floats
from ._model import Model
from ._parametrize import Parametrization
from ._sklearn_named import named
from ._surface import Surface, as_surface

#: A given surface: a path, which is read when needed, a mesh, or a model.
Input = Union[str, Surface, Model, Parametrization]


def listed(X: Any) -> list[Input]:
    """Returns surfaces as a list: from a sequence, a Series, or an array or a data frame of one column.

    Paths stay paths, except those of models, which are read.
    """
    if isinstance(X, (str, os.PathLike, Surface, Model, Parametrization)) or not hasattr(X, "__iter__"):
        raise ValueError(f"X: expected a sequence of surfaces, found {type(X).__name__}")
    if hasattr(X, "to_numpy"):
        X = X.to_numpy()
    if isinstance(X, np.ndarray):
        if X.dtype.kind not in "OU":
            raise ValueError(f"X: expected surfaces or paths, found an array of {X.dtype} of shape {X.shape}")
        if X.ndim == 2 and X.shape[1] == 1:
            X = X[:, 0]
        if X.ndim != 1:
            raise ValueError(f"X: expected a surface or a path in each row, (n,) or (n, 1); found shape {X.shape}")
    found = []
    for index, item in enumerate(X):
        with named(index, item):
            found.append(_input(item))
    if not found:
        raise ValueError("X: expected at least one surface, found none")
    return found


def _input(item: Any) -> Input:
    if isinstance(item, (str, os.PathLike)):
        path = os.fspath(item)
        return Model.load(path) if path.endswith(".npz") else path
    if isinstance(item, Model):
        if not item.is_surface:
            raise ValueError(f"expected a surface, found a {item!r}")
        return item
    return item if isinstance(item, Parametrization) else as_surface(item)


def rows(X: ArrayLike, columns: int, of: str) -> Floats:
    """Returns rows of numbers, (s, columns), for `inverse_transform`."""
    values = _arrays.real("X", X, f"(s, {columns})")
    if values.ndim != 2 or values.shape[1] != columns:
        raise ValueError(f"X: expected rows of {columns} {of}, (s, {columns}); found shape {values.shape}")
    bad = ~np.isfinite(values).all(axis=1)
    if bad.any():
        raise ValueError(f"X: expected finite numbers, found NaN or infinity in row {int(bad.argmax())}")
    return values


class Meshes:
    """Base of transformers whose X is a sequence of surfaces, not an array of numbers."""

    def _surfaces(self, X: Any, reset: bool = False) -> list[Input]:
        """Returns the surfaces of X; ``reset`` is True in `fit`."""
        return listed(X)

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()  # type: ignore[misc]
        tags.input_tags.two_d_array = False
        tags.input_tags.one_d_array = True
        tags.input_tags.string = True
        tags.transformer_tags.preserves_dtype = []
        return tags

    def _more_tags(self) -> dict[str, Any]:
        """Returns the same tags for scikit-learn before 1.6."""
        return {"X_types": ["1darray", "string"], "preserves_dtype": []}
