"""Numbers that describe models in any pose, and the models that are nearest to a given one by these numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Sequence

from . import _arrays, _core
from ._arrays import Floats
from ._model import Model
from ._model import core as _model
from ._warnings import warn


@dataclass(frozen=True)
class Match:
    """A model found by `nearest`.

    Attributes
    ----------
    index : int
        Index in the searched models.
    distance : float
        Distance between the singular values of the two models, in the models' unit; see `nearest` for what it bounds.
    score : float
        The value by which models are ordered.
    """

    index: int
    distance: float
    score: float


class Description(NamedTuple):
    """Numbers that describe a model and are invariant to rotations, reflections and translations.

    Attributes
    ----------
    power : ndarray of float, (L,)
        Mean square over the sphere of each degree's part of the model, from degree 1.
    singular_values : ndarray of float, (L, c)
        Singular values of each degree's coefficients divided by ``sqrt(4 pi)``, largest first; their squares sum to the power.
    """

    power: Floats
    singular_values: Floats


def describe(model: Model) -> Description:
    """Describes a model by numbers that are invariant to rotations, reflections and translations.

    They depend on the map to the sphere; for comparisons, use maps with equal areas (`nearest`).

    Parameters
    ----------
    model : Model

    Returns
    -------
    Description
    """
    return Description(*_core.shape_describe(_model("model", model)))


def nearest(
    query: Model,
    among: Sequence[Model],
    count: int = 5,
    *,
    unit_size: bool = False,
    standardized: bool = False,
    threads: int | None = None,
) -> list[Match]:
    """Finds the models whose singular values are nearest to those of the query, regardless of pose.

    Singular values depend on the maps to the sphere. The maps that `spharm_rs.fit` makes by default depend on the
    triangles, too, so that models of meshes of equal resolution may be nearer than models of equal shape. Fit over maps
    with equal areas instead: ``spharm_rs.fit(spharm_rs.parametrize(mesh, area=0))``.

    Parameters
    ----------
    query : Model
    among : sequence of Model
        Models to search; compared at the lowest degree of all models, with a warning if others have more.
    count : int
        Number of models to return.
    unit_size : bool
        Compare models scaled to size 1.
    standardized : bool
        Divide each number by its standard deviation over ``among``. High degrees then count as much as low ones, and
        with them the small differences between the maps of meshes of different resolution.
    threads : int, optional

    Returns
    -------
    list of Match
        Nearest first. The distance is at most the root mean square distance between points of the two surfaces at equal
        directions, in any pose and however the sphere is rotated. It isn't a bound of the distance between the surfaces
        themselves: two models of one surface over different maps may be far apart.
    """
    one, others = _model("query", query), [_model("among", model) for model in among]
    found = _core.shape_match(
        one,
        others,
        count=_arrays.whole("count", count),
        unit_size=bool(unit_size),
        standardized=bool(standardized),
        threads=_arrays.threads(threads),
    )
    degrees = sorted({model.max_degree for model in (one, *others)})
    if len(degrees) > 1:
        least, most = degrees[0], degrees[-1]
        warn([f"the models have degrees from {least} to {most}; they are compared up to degree {least}"])
    return [Match(*match) for match in found]
