"""Measures groups at the vertices of a sphere, and tests them."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import Any, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from . import _arrays, _core
from ._arrays import Floats
from ._model import Model, sampling
from ._progress import Progress, callback
from ._shape_columns import Cells, categories_of, levels_of, names_of, numbers_or_levels
from ._shape_correspond import Group
from ._shape_inference import (
    Cluster,
    check_mask_file,
    check_tested,
    common_mesh,
    inference_of,
    scattered,
    stacked,
    tested_surface,
)
from ._shape_poses import cores
from ._shape_result import TestResult
from ._surface import Surface
from ._warnings import warn


@dataclass(frozen=True, eq=False)
class Field:
    """Measurements of n models at V vertices.

    Attributes
    ----------
    values : ndarray of float, (n, V) or (n, V, 3)
        Measured values, in the models' unit.
    mean : Model
        Mean of the models.
    directions : ndarray of float, (V, 3)
    warnings : tuple of str
    """

    values: Floats
    mean: Model
    directions: Floats = field(repr=False)
    warnings: tuple[str, ...] = ()


def measure_group(
    models: Sequence[Model],
    sphere: Any = 5,
    *,
    minus: Sequence[Model] | None = None,
    signal: str = "normal",
    degree: int | None = None,
    threads: int | None = None,
    progress: Progress = None,
) -> Field:
    """Measures corresponding models at the vertices of one sphere, for `spharm_rs.shape.group_test`.

    Parameters
    ----------
    models : sequence of Model
        Corresponding models, such as those of `procrustes`, or models over registered spheres.
    sphere : int, Surface or what `spharm_rs.as_surface` takes, or array_like of float, (V, 3)
        Subdivisions of an icosphere; or a sphere; or directions.
    minus : sequence of Model, optional
        A second model of each subject, such as an earlier time or the mirrored other side. Its measurements are subtracted.
    signal : {"normal", "position", "value"}
        Displacement from the mean along the mean's outward normal; position; or the value of a signal of one channel.
    degree : int, optional
        Highest degree; by default the lowest of the models'.
    threads : int, optional
    progress : bool or callable, optional

    Returns
    -------
    Field

    Examples
    --------
    >>> import numpy as np, spharm_rs as sp
    >>> unit = (4 * np.pi / 3) ** 0.5
    >>> spheres = [sp.Model(radius * unit * np.eye(4)[:, [3, 1, 2]]) for radius in (1, 2, 6)]
    >>> sp.shape.measure_group(spheres, 0).values[:, 0].round(12).tolist()
    [-2.0, -1.0, 3.0]
    """
    return _measured(models, minus, sphere, signal, degree, threads, progress)


def _measured(
    models: Sequence[Model],
    minus: Sequence[Model] | None,
    sphere: Any,
    signal: str,
    degree: int | None,
    threads: int | None,
    progress: Progress,
) -> Field:
    if minus is not None:
        if len(minus) != len(models):
            raise ValueError(f"minus: expected {len(models)} models, one for each subject; found {len(minus)}")
        models = [*models, *minus]
    members = cores(models)
    if signal != "value" and not all(model.is_surface for model in models):
        raise ValueError(f"signal: expected 'value' for models of signals, found {signal!r}")
    noted = warn([_OWN_MAPS]) if signal == "value" and _over_own_maps(models) else ()
    directions = sampling(sphere)[0]
    if directions is None:
        raise ValueError("sphere: expected a level of an icosphere, a sphere, or directions; found None")
    values, components, mean, warnings = _core.shape_measure_group(
        members,
        directions,
        None if degree is None else _arrays.whole("degree", degree),
        signal=str(signal),
        pairs=minus is not None,
        threads=_arrays.threads(threads),
        progress=callback(progress),
    )
    if components > 1:
        values = values.reshape(len(values), -1, components)
    return Field(values, Model._of(mean), directions, noted + warn(warnings))


_OWN_MAPS = (
    "the signals were fitted over maps of several surfaces, and equal directions in these maps don't correspond; fit the "
    "signals over a common sphere, or bring the surfaces into correspondence first (shape.correspond)"
)


def _over_own_maps(models: Sequence[Model]) -> bool:
    """Returns whether signals were fitted over maps that `parametrize` made from different surfaces."""
    own = [model.directions for model in models if not model.is_surface and model._inner.parametrized]
    maps = [directions for directions in own if directions is not None]
    return any(not np.array_equal(one, maps[0]) for one in maps[1:])


def _covariates(given: Any, count: int, blocks: list[str] | None) -> list[tuple[str, Cells]]:
    def cells_of(what: str, values: Any) -> Cells:
        cells = numbers_or_levels(what, values, count, blocks)
        if isinstance(cells, list) and len(set(cells)) == 1:
            raise ValueError(f"{what}: expected two levels or more, found {cells[0]!r} in all rows; omit the covariate")
        return cells

    if given is None:
        return []
    if not isinstance(given, Mapping) and hasattr(given, "columns") and hasattr(given, "__getitem__"):
        given = {name: given[name] for name in given.columns}
    if isinstance(given, Mapping):
        return [(str(name), cells_of(f"covariates, {name}", cells)) for name, cells in given.items()]
    columns: Any = [given] if categories_of(given) is not None else _arrays.channels("covariates", given).T
    names = [f"covariate {number}" for number in range(1, len(columns) + 1)]
    return [(name, cells_of(f"covariates, {name}", cells)) for name, cells in zip(names, columns)]


def _asked(
    count: int, groups: Any, effect: Any, interaction: Any, mean: bool, design: Any, contrast: Any, covariates: Any,
    interactions: Any, levels: Any, blocks: list[str] | None,
) -> dict[str, Any]:
    """Converts the tested design for the extension module."""
    if sum(given is not None for given in (groups, effect, interaction, design)) + mean != 1:
        raise ValueError("groups, effect, interaction, mean, design: expected exactly one of them")
    if levels is not None and groups is None:
        raise ValueError("levels: can only be given with groups")
    rows = contrast.tolist() if hasattr(contrast, "tolist") else contrast
    rows = [rows] if isinstance(rows, str) else rows
    named = isinstance(rows, (list, tuple)) and len(rows) > 0 and all(isinstance(row, str) for row in rows)
    asked: dict[str, Any] = {
        "effect": [], "levels": [], "covariates": [], "interactions": [], "design": None, "columns": [], "weights": None,
        "contrast": list(rows) if named else [], "relative": False,
    }  # fmt: skip
    if design is not None:
        if contrast is None:
            raise ValueError("design, contrast: expected both, or neither")
        if covariates is not None:
            raise ValueError("covariates: expected None with a design; add covariates as columns of the design")
        if interactions is not None:
            raise ValueError("interactions: expected None with a design; add products of columns to the design")
        asked["columns"] = [str(name) for name in design.columns] if hasattr(design, "columns") else []
        asked["design"] = _arrays.channels("design", design)
        if not named:
            weights = _arrays.real("contrast", contrast, "(p,) or (q, p)")
            if weights.ndim not in (1, 2):
                raise ValueError(f"contrast: expected shape (p,) or (q, p), found {weights.shape}")
            asked["weights"] = np.atleast_2d(weights)
        return asked
    if contrast is not None and (mean or not named):
        raise ValueError("contrast: expected names and weights, such as 'patient - control', for groups, effect or interaction")
    if groups is not None:
        of, order = levels_of("groups", groups, count)
        asked["effect"] = [("groups", of)]
        asked["levels"] = order if levels is None else [str(level).strip() for level in levels]
    elif effect is not None:
        cells = numbers_or_levels("effect", effect, count)
        if isinstance(cells, list):
            raise ValueError(f"effect: expected numbers, found levels such as {cells[0]!r}; give levels as groups=")
        asked["effect"] = [("effect", cells)]
    elif interaction is not None:
        if not isinstance(interaction, Mapping) or len(interaction) != 2:
            raise ValueError("interaction: expected a dict of two columns, such as {'group': groups, 'age': ages}")
        for name, given in interaction.items():
            what = f"interaction, {name}"
            cells = numbers_or_levels(what, given, count)
            # The first column that has levels gives their order.
            if isinstance(cells, list) and not asked["levels"]:
                asked["levels"] = levels_of(what, given, count)[1]
            asked["effect"].append((str(name), cells))
    asked["covariates"] = _covariates(covariates, count, blocks)
    names = [interactions] if isinstance(interactions, str) else [] if interactions is None else interactions
    asked["interactions"] = [str(name) for name in names]
    return asked


def group_test(
    subjects: Any,
    groups: Any = None,
    *,
    effect: ArrayLike | None = None,
    interaction: Mapping[str, Any] | None = None,
    mean: bool = False,
    design: Any = None,
    contrast: str | Sequence[str] | ArrayLike | None = None,
    covariates: Any = None,
    interactions: str | Sequence[str] | None = None,
    levels: Sequence[Any] | None = None,
    minus: Any = None,
    signal: str | None = None,
    sphere: Any = None,
    degree: int | None = None,
    mask: Any = None,
    welch: bool = False,
    blocks: Any = None,
    whole_blocks: bool = False,
    variance_groups: Any = None,
    errors: str | None = None,
    tfce: bool = False,
    cluster: float | None = None,
    surface: Any = None,
    permutations: int = 10_000,
    seed: int = 0,
    confidence: float = 0.95,
    level: float = 0.05,
    threads: int | None = None,
    progress: Progress = None,
) -> TestResult:
    """Tests groups, a slope, a mean, or a contrast at every vertex, with family-wise and false-discovery control.

    At each vertex a linear model is tested: by t, by F for more than two groups, by Hotelling's T-squared for
    positions. Rows have to be independent subjects, unless ``blocks`` say otherwise. Family-wise p values come from the
    largest statistic of relabelled studies; all relabellings are used if there are at most 20,000. Relabellings exchange
    subjects. For means, where exchanges change nothing, and for unequal variances, they flip the signs of residuals. If
    neither changes the statistic, `p_fwe` is None, with a warning.

    Parameters
    ----------
    subjects : Group, sequence of Model, array_like of float, (n, V) or (n, V, 3), or images
        A group of `correspond`, tested at its directions that have counterparts on members, unless a ``sphere`` is
        given; corresponding models, such as those of `procrustes`, which are first measured by `measure_group`; or
        values. Images are nibabel's ``GiftiImage`` or nilearn's ``SurfaceImage`` of one hemisphere: a sequence with an
        image of V values for each subject, or a single image of (V, n) values.
    groups : array_like, (n,), optional
        Group of each subject, a name or a number. Tests the difference of two groups, the first minus the second, or
        any difference between more than two groups. Blanks around names are ignored. As in the program's tables, empty
        text and words such as ``"NA"`` or ``"none"`` are missing values, which are refused, here and in all other columns.
    effect : array_like of float, (n,), optional
        A number for each subject, which may be text such as ``"60"``; the slope of the values over it is tested.
    interaction : dict of two array_like, (n,), optional
        Two columns by name, each of numbers or of names of levels, whose interaction is tested: for levels and numbers,
        the difference of the slopes; for levels and levels, the difference of the differences. The model also has both
        columns, except a column whose effect a covariate contains, such as the group if the subjects are a covariate.
    mean : bool
        Test whether the mean of values, of a signal, or of differences (``minus``) is zero.
    design : array_like of float, (n, p), optional
        A custom design matrix, of full column rank.
    contrast : str, sequence of str, or array_like of float, (p,) or (q, p), optional
        Combinations of the design's columns; the test's null hypothesis is that they are zero. Weights are for a
        ``design``; text, such as ``"mild - control"`` or ``"severe - 1/2 mild - 1/2 control"``, names columns of any
        design. ``groups`` has a column for each group, ``effect`` the columns ``mean`` and ``effect``, an interaction
        ``level:name`` or ``level:level``; a covariate's column has its name or, for levels, its name and each level but
        the first. `TestResult.columns` lists them. A name that is also a combination of other columns, such as ``a - b``,
        needs double quotes.
    covariates : dict of array_like, (n,), or array_like of float, (n, k), optional
        Nuisance variables: numbers, or names of levels; for ``groups``, ``effect``, ``interaction`` and ``mean``. Text
        such as ``"60"`` is a number, as in the program's tables; a ``pandas.Categorical`` has levels, even of numbers.
        Numbers that are equal to ``blocks``, such as numbers of subjects, are levels, too.
    interactions : str or sequence of str, optional
        Interactions to account for, as names of two columns such as ``"age:sex"``: of covariates, ``groups``, ``effect``, or
        the columns of ``interaction``.
    levels : sequence, optional
        Order of the groups; by default that of a ``pandas.Categorical``'s categories, else sorted.
    minus : sequence of Model, array_like of float, of the shape of subjects, or images, optional
        A second measurement of each subject, which is subtracted from the first; the differences are tested.
    signal : {"normal", "position", "value"}, optional
        Measurement of models, as in `measure_group`; by default normal. Not for values, which are measured already.
    sphere : int, Surface or what `spharm_rs.as_surface` takes, or array_like of float, (V, 3), optional
        Vertices at which models are measured: by default the sphere of a `Group`, and an icosphere of 5 subdivisions for
        models. For values, the sphere at whose vertices they were measured.
    degree : int, optional
        Highest degree of models; by default the lowest degree among them.
    mask : array_like of bool, (V,), path, or image, optional
        Vertices to test; a file or an image as for `spharm_rs.fit`. For models, FreeSurfer's labels and annotations
        need their ``sphere``. Values outside are never read, and may be NaN. All results are NaN there, and
        ``cluster_of`` is 0. Vertices outside don't count in family-wise p values, false-discovery rates, TFCE and
        clusters. In these, vertices inside keep their areas and the edges between them. By default all vertices, whose
        values must be finite.
    welch : bool
        Use Welch's test, for two groups of unequal variance without covariates; ``variance_groups`` is for other designs.
    blocks : array_like, (n,), optional
        Exchangeability block of each row, a name or a number: rows of the same block depend on each other, such as visits
        of a subject. Relabellings stay within blocks. With an effect within blocks, and the blocks as a covariate
        too, this is the paired test. It assumes that the effect is equal in all blocks. If it may differ, such as the rate
        of growth, compute one slope or difference for each block, and test these as values.
    whole_blocks : bool
        Instead, exchange whole blocks of the same size, and flip the signs of whole blocks. Rows of two blocks
        correspond by the columns of the design that vary within blocks, such as the visit; if the blocks' values
        differ, by the rank of the one column that varies, such as the age; for several such columns by their order,
        with a warning.
    variance_groups : array_like, (n,), optional
        Group of each row, a name or a number, whose variances may differ: the statistic is Aspin and Welch's v, or G for
        several contrasts (Winkler et al. 2014). For values of one component.
    errors : {"exchangeable", "symmetric", "both"}, optional
        Assumption about the errors, on which the relabellings rest: exchange rows, flip signs, or both. By default
        exchangeable; symmetric for means, for ``welch`` and for ``variance_groups``.
    tfce : bool
        Compute threshold-free cluster enhancement, of extent to the power of 1 and height to the power of 2.
    cluster : float, optional
        Uncorrected p value below which vertices form clusters; 0.001 is usual. Their family-wise p values are those of
        their areas.
    surface : Surface or what `spharm_rs.as_surface` takes, optional
        The surface at whose vertices values were measured, for ``tfce``, ``cluster`` and pictures. By default the mean of the
        models; for a signal and for values, the sphere; for images of nilearn with the same mesh, this mesh. It has V vertices.
    permutations : int
        Number of random relabellings, at most 100,000,000; 0 for none.
    seed : int
        Seed of the relabellings.
    confidence : float
        Coverage of the effect's confidence interval.
    level : float
        Level of significance, used for warnings only.
    threads : int, optional
        Number of threads; the result doesn't depend on it.
    progress : bool or callable, optional

    Returns
    -------
    TestResult

    Raises
    ------
    ValueError
        If shapes don't match, if the design doesn't determine what is tested, or if a value that is tested is NaN or infinite.

    Examples
    --------
    >>> import numpy as np, spharm_rs as sp
    >>> values = np.random.default_rng(0).normal(size=(10, 2))
    >>> values[:5, 1] += 9
    >>> found = sp.shape.group_test(values, groups=["a"] * 5 + ["b"] * 5)
    >>> found.meaning, found.relabellings, bool(np.isclose(found.p_fwe[1], 2 / 252))
    ('a - b', 252, True)
    >>> later = values + np.random.default_rng(1).normal(0.5, 0.1, size=(10, 2))
    >>> change = sp.shape.group_test(later, minus=values, mean=True, covariates={"age": np.arange(30, 80, 5.0)})
    >>> change.resampling, bool((change.p_fwe < 0.01).all())
    ('sign flips', True)

    The difference of two slopes, and three groups of which two are compared:

    >>> ages, group = np.arange(30, 80, 5.0), np.array(["a", "b"] * 5)
    >>> sp.shape.group_test(values, interaction={"group": group, "age": ages}, permutations=0).meaning
    'slope of age in a minus slope of age in b'
    >>> stages = ["healthy", "mild", "severe", "mild", "healthy"] * 2
    >>> sp.shape.group_test(values, stages, contrast="mild - healthy", permutations=0).freedom
    (7.0,)

    Two visits of ten subjects, as rows that are exchanged within each subject:

    >>> visits, subject = np.concatenate([values, later]), np.tile(np.arange(10), 2)
    >>> time = np.repeat([0.0, 1.0], 10)
    >>> paired = sp.shape.group_test(visits, effect=time, covariates={"subject": subject}, blocks=subject)
    >>> paired.relabellings, bool((paired.p_fwe < 0.01).all())
    (1024, True)

    A vertex without values:

    >>> values[:, 0] = np.nan
    >>> found = sp.shape.group_test(values, ["a"] * 5 + ["b"] * 5, mask=~np.isnan(values).any(axis=0))
    >>> found
    TestResult(t, a - b, 1 of 2 vertices, least p_fwe 0.00794)
    """
    average: Model | None = None
    noted: tuple[str, ...] = ()
    if isinstance(subjects, Group) or _are_models(subjects):
        check_mask_file(mask, sphere)
    if isinstance(subjects, Group):
        if sphere is None:
            sphere, lids = subjects.sphere, subjects.masked
            if lids.any():
                given = _arrays.mask(mask, len(lids))
                mask = ~lids if given is None else ~lids & given
        subjects = subjects.models
    minus = minus.models if isinstance(minus, Group) else minus
    if _are_models(groups):
        raise ValueError("groups: expected a name for each subject, found models; give all subjects in one sequence")
    for what, given in (("subjects", subjects), ("minus", minus)):
        if _are_paths(given):
            raise ValueError(f"{what}: expected models or values, found text; load files of models with spharm_rs.Model.load")
    if _are_models(subjects):
        sphere = 5 if sphere is None else sphere
        signal = "normal" if signal is None else signal
        measured = _measured(subjects, minus, sphere, signal, degree, threads, progress)
        values, average, noted = measured.values, measured.mean, measured.warnings
        if mean and minus is None and signal != "value":
            raise ValueError("mean: the mean of displacements from the mean is always zero; give minus, or signal='value'")
    else:
        values = _arrays.real("subjects", stacked("subjects", subjects), "(n, V) or (n, V, 3)")
        surface = common_mesh("subjects", subjects) if surface is None and sphere is None else surface
        if values.ndim not in (2, 3):
            raise ValueError(f"subjects: expected models, or values of shape (n, V) or (n, V, 3), found {values.shape}")
        if signal not in (None, "value", "position" if values.ndim == 3 else "value"):
            raise ValueError(
                f"signal: expected models as subjects with signal={signal!r}, found values of shape {values.shape}, which are "
                "measured already; leave out signal, or give the models"
            )
        if minus is not None:
            others = _arrays.real("minus", stacked("minus", minus), "(n, V) or (n, V, 3), as for subjects")
            if others.shape != values.shape:
                raise ValueError(f"minus: expected shape {values.shape}, found {others.shape}")
            values = values - others
    kept = _arrays.mask(mask, values.shape[1])
    check_tested("subjects" if minus is None else "subjects, minus", values, kept)
    components = values.shape[2] if values.ndim == 3 else 1
    blocks = None if blocks is None else names_of("blocks", blocks, len(values))
    asked = _asked(
        len(values), groups, effect, interaction, bool(mean), design, contrast, covariates, interactions, levels, blocks,
    )  # fmt: skip
    asked["relative"] = average is not None and minus is None and signal != "value" and design is None
    place = tested_surface(surface, sphere, average, signal, values.shape[1])
    values = values if kept is None else values[:, kept]
    inference = inference_of(
        len(values), bool(permutations), errors, blocks, whole_blocks, variance_groups, tfce, cluster, place, kept
    )
    found = _core.shape_test(
        values.reshape(len(values), values.shape[1] * components),
        components,
        asked,
        inference,
        welch=bool(welch),
        permutations=_arrays.whole("permutations", permutations),
        seed=_arrays.whole("seed", seed),
        confidence=float(confidence),
        level=float(level),
        threads=_arrays.threads(threads),
        progress=callback(progress),
    )
    warnings = warn(found.pop("warnings"))
    if kept is not None:
        found = scattered(found, kept)
    by_component = {name: found.pop(name, None) for name in ("effect", "margin", "standard_error")}
    if values.ndim == 2:
        by_component = {name: None if array is None else array[:, 0] for name, array in by_component.items()}
    return TestResult(
        **by_component,
        p_fwe=found.pop("p_fwe", None),
        p_permutation=found.pop("p_permutation", None),
        size=found.pop("size", None),
        freedom=tuple(found.pop("freedom")),
        levels=dict(found.pop("levels")),
        codes=dict(found.pop("codes")),
        resampling=found.pop("resampling", None),
        assumption=found.pop("assumption", None),
        relabellings=found.pop("relabellings", 0),
        exact=found.pop("exact", False),
        smallest_p=found.pop("smallest_p", None),
        tfce=found.pop("tfce", None),
        p_tfce=found.pop("p_tfce", None),
        clusters=None if "clusters" not in found else [Cluster(*cluster) for cluster in found.pop("clusters")],
        cluster_of=found.pop("cluster_of", None),
        cluster_threshold=found.pop("cluster_threshold", None),
        warnings=noted + warnings,
        mean=average,
        surface=None if place is None or place[1] is None else Surface(*place),
        mask=kept,
        **found,
    )


def _are_paths(subjects: Any) -> bool:
    some = subjects.ravel().tolist() if isinstance(subjects, np.ndarray) and subjects.dtype.kind in "OU" else subjects
    return isinstance(some, (str, os.PathLike)) or (
        isinstance(some, (list, tuple)) and any(isinstance(one, (str, os.PathLike)) for one in some)
    )


def _are_models(subjects: Any) -> bool:
    return isinstance(subjects, Model) or isinstance(subjects, Sequence) and any(isinstance(one, Model) for one in subjects)
