"""Fits surfaces and signals: computes their coefficients."""

from __future__ import annotations

import json
import os
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from . import _arrays, _core, errors
from ._arrays import Floats
from ._fit_kind import warn_of_signal
from ._model import Model, seam_of, sphere_arrays
from ._parametrize import Parametrization
from ._progress import Progress, callback
from ._repair import changes_of, named_change
from ._store import Store
from ._surface import Metadata, Path, Surface, as_surface, meta_of, meta_of_path, named_icosphere, opened
from ._transform import Transform
from ._warnings import Problem, issue, warn
from .reports import FitReport


def _degree(max_degree: Any) -> int:
    if max_degree is None or isinstance(max_degree, str):
        raise ValueError(f"max_degree: expected a whole number, found {max_degree!r}; choose_degree chooses one for a surface")
    return _arrays.whole("max_degree", max_degree)


def _settings(
    max_degree: int,
    vertices: int,
    *,
    objective: str | None = None,
    weights: str | ArrayLike = "uniform",
    mask: Any = None,
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
) -> dict[str, Any]:
    """Checks the types of `fit`'s keyword arguments; the library checks their values."""
    if isinstance(smoothness, bool) or not (smoothness is None or isinstance(smoothness, (str, int, float, np.number))):
        raise ValueError(f"smoothness: expected a number of at least 0, or 'auto', found {smoothness!r}")
    method = str(method or ("irf" if store is not None else "lsq"))
    if passes is None:
        passes = 16 if accelerate else 4 if method == "mirf" else 1
    return {
        "max_degree": _degree(max_degree),
        "method": method,
        "passes": _arrays.whole("passes", passes, 1),
        "granularity": _arrays.whole("granularity", granularity, 1),
        "objective": None if objective is None else str(objective),
        "surface_distance": bool(surface_distance),
        "start_degree": _arrays.whole("start_degree", start_degree),
        "accelerate": bool(accelerate),
        "smoothness": None if smoothness is None else str(smoothness),
        "denoise": bool(denoise),
        "weights": weights if isinstance(weights, str) else _arrays.weights(weights, vertices),
        "mask": _arrays.mask(mask, vertices),
        "mask_path": os.fspath(mask) if isinstance(mask, (str, os.PathLike)) else None,
        "hold_out": None if hold_out is None else float(hold_out),
        "standard_errors": bool(stderr),
        "tolerance": float(tolerance),
        "max_iterations": _arrays.whole("max_iterations", max_iterations, 1),
        "preconditioner": str(preconditioner),
        "strict": bool(strict),
        "store": None if store is None else os.fspath(store.path if isinstance(store, Store) else store),
        "dtype": None if dtype is None else str(dtype),
        "memory": _arrays.size(memory),
        "threads": _arrays.threads(threads),
    }


def _sphere_of(vertices: int, triangles: Any, sphere: Any) -> tuple[Any, Any, bool]:
    """Returns the directions of a surface's sphere, its triangles, which by default are the surface's, and whether
    `parametrize` made the sphere."""
    directions, faces, parametrized = sphere_arrays(named_icosphere(sphere))
    if directions is not None and len(directions) != vertices:
        raise errors.MeshError(
            f"surface: found {vertices} vertices, but the sphere has {len(directions)}; both must have the same vertices"
        )
    if directions is not None and faces is None:
        faces = triangles
    return directions, faces, parametrized


def _read(target: Any, sphere: Any, gaps: bool) -> tuple[Floats, Any, Metadata]:
    """Returns the positions, triangles and metadata of a mesh; or, given a sphere and a file that has no mesh, its signal,
    None and the file's path as metadata. With `gaps`, positions and values of files may be NaN, because a mask or weights
    may leave them out."""
    is_file = isinstance(target, (str, os.PathLike))
    try:
        mesh = Surface._of(*_core.read_surface(os.fspath(target), gaps=True)) if is_file and gaps else as_surface(target)
    except errors.MeshError as error:
        if not is_file:
            raise
        try:
            signal = _core.read_values(os.fspath(target), gaps=gaps)
        except (errors.SpharmError, OSError, ValueError):
            raise error from None
        if sphere is None:
            raise errors.MeshError(f"{os.fspath(target)}: a signal needs a sphere; give the sphere as sphere=") from error
        return signal, None, meta_of_path(target)
    return mesh.vertices, mesh.faces, mesh._meta


def refuse_both(what: str, surface: Any) -> None:
    """Refuses an image with a mesh and values, of which either could be fitted over a sphere."""
    if _arrays.is_image(surface) and hasattr(surface, "mesh"):
        raise ValueError(
            f"{what}: expected a mesh or values, found a {type(surface).__name__}, which has both; "
            "give image.mesh to fit the shape, or image.data to fit the map of its values"
        )


def _check_values(
    what: str, values: Floats, settings: dict[str, Any], *, scattered: bool = False, flat: bool | None = None
) -> None:
    """Refuses values, (n, c), that are NaN or infinite at vertices that are read, or in rows of scattered samples. `flat` says
    whether they were given without an axis of channels."""
    finite = np.isfinite(values)
    if finite.all():  # takes a sixth of the time of a row-by-row check
        return
    bad = ~finite.all(axis=1)
    masked = settings["mask"] is not None
    if masked:
        bad &= settings["mask"]
    if not isinstance(settings["weights"], str):
        bad &= settings["weights"] != 0
    if not bad.any():
        return
    vertex = int(bad.argmax())
    missing = bool(np.isnan(values[vertex]).any())
    flat = values.shape[1] == 1 if flat is None else flat
    kept = f"~np.isnan(values){'' if flat else '.any(axis=-1)'}"
    if not missing:
        kept = f"np.isfinite(values){'' if flat else '.all(axis=-1)'}"
    at = f"{'NaN' if missing else 'infinity'} {'in row' if scattered else 'at vertex'} {vertex} (counted from 0)"
    rows, drop = ("rows", ", or drop these rows from the directions and values") if scattered else ("vertices", "")
    if masked:
        text = f"{at}, which is inside the mask; leave out {rows} without values with mask=mask & {kept}{drop}"
    else:
        text = f"{at}; leave out {rows} without values, for example with mask={kept}{drop}"
    raise errors.MeshError(f"{what}: expected finite numbers, found {text}")


def _model(fitted: Any) -> Model:
    """Returns the model of a fit, and issues its warnings."""
    model, problems = _with_problems(fitted)
    issue(problems)
    return model


def _with_problems(fitted: Any) -> tuple[Model, list[Problem]]:
    """Returns the model of a fit, and its warnings, which aren't issued."""
    core, standard_errors, report, problems = fitted
    found: FitReport = json.loads(report)
    found["warnings"] = [text for _, text in problems]
    return Model._of(core, found, standard_errors), [(getattr(errors, kind), text) for kind, text in problems]


def fit_mapped(mapped: Parametrization, progress: Progress, **settings: Any) -> tuple[Model, list[Problem]]:
    """Fits a mapped surface as `fit` does. Returns the model and its warnings, which aren't issued."""
    mesh = mapped.surface
    directions, faces, parametrized = _sphere_of(len(mesh.vertices), mesh.faces, mapped)
    return _with_problems(
        _core.fit(
            mesh.vertices,
            mesh.faces,
            directions,
            faces,
            metadata=(mesh._meta, None),
            surface=True,
            parametrized=parametrized,
            seam=seam_of(mapped),
            changes=changes_of(False, None, None, False),
            settings=_settings(vertices=len(mesh.vertices), **settings),
            progress=callback(progress),
        )
    )


def fit(
    surface: Any,
    sphere: Any = None,
    max_degree: int = 20,
    *,
    fix: bool = False,
    largest_repair: float | None = None,
    wrap: int | None = None,
    cut_handles: bool = False,
    objective: str | None = None,
    weights: str | ArrayLike = "uniform",
    mask: Any = None,
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
) -> Model:
    """Fits a surface, or a signal on the vertices of a sphere, by spherical harmonics.

    Parameters
    ----------
    surface : Surface or what `as_surface` takes, or ndarray of float, (n,) or (n, c), or image
        A surface; an array of positions (n, 3) at a sphere's vertices; or a signal on the sphere's vertices, as an array
        (n,) or (n, c), as an image (nibabel's ``GiftiImage`` without a mesh, or nilearn's ``PolyData`` of one hemisphere)
        or, given the sphere, as a file that `read_signal` reads. nilearn's ``SurfaceImage`` has a mesh and values: without a
        sphere, its mesh is fitted; with a sphere, give ``image.mesh`` or ``image.data``.

        An array with three columns is always read as positions x, y, z, and over a sphere with triangles the surface
        between them is fitted, not the values. For a signal of three channels, give ``objective="vertices"``, or use
        `solve`. A warning is given if the positions enclose hardly any volume. A file of values, such as ``.func.gii``, is a
        signal, whatever its number of channels.
    sphere : Surface or what `as_surface` takes, Parametrization, Model, or ndarray of float, (n, 3), optional
        A sphere with the same vertices in the same order, of any radius, centred at the origin. Without it the surface
        is first mapped to a sphere, as by `parametrize`; that sphere becomes the model's.
    max_degree : int
        Highest degree L, inclusive.
    fix : bool
        Without a sphere: repair the surface before it is mapped, as `repair` does; a warning states the changes.
    largest_repair : float, optional
        With ``fix`` or ``wrap``: share of the area, from 0 to 1, that the repair may drop or add, or the wrap leave
        out or span, as for `repair`.
    wrap : int, optional
        Without a sphere: replace the surface by the closed surface around it, as `repair` does, instead of repairing it.
    cut_handles : bool
        Without a sphere: cut the handles of a surface, as `parametrize` does; a warning states the cuts.
    objective : {"surface", "vertices"}, optional
        What is fitted: ``"surface"``, all triangles, each part weighted by its share of the sphere; or ``"vertices"``,
        the vertices alone, as in the paper. By default the surface if triangles are given; the vertices for signals and
        with a store.
    weights : {"uniform", "area"} or array_like of float, (n,)
        Weight of each vertex: 1, its share of the sphere, or the given number. Values at vertices of weight 0 are never
        read, and may be NaN; a fit of the surface leaves out the triangles at these vertices. With ``stderr``, weights
        must be proportional to the inverse variances of the values, as described there.
    mask : array_like of bool, (n,), path, or image, optional
        Vertices to read; the others have weight 0, and may be NaN over a sphere. A file or an image (of nibabel or
        nilearn) has a value for each vertex, and 0 leaves it out, or is a label of FreeSurfer or GIfTI. An array has
        true and false, or 1 and 0; masked elements of a masked array are left out. Outside of the mask the model is an
        extrapolation, not data; the model doesn't record its mask.
    smoothness : float or "auto", optional
        Penalty ``lambda * sum (l (l + 1))**2 * a**2``, added to the sum of squared distances, each multiplied by its
        weight. Weights are used as given: if all are a tenth as large, a tenth of lambda has the same effect.
        ``"auto"`` chooses lambda for each surface, or for each channel of a signal, by generalised cross-validation. By
        default no penalty, but a small one if vertices are fitted over a sphere made by `parametrize`. A penalty
        shrinks focal effects of single subjects: for group tests (`shape.group_test`), fit without it.
    denoise : bool
        Remove independent noise of the vertices within the fit, by a penalty for each degree that is estimated from the
        surface, or from each channel of a signal. Replaces ``smoothness``; for ``lsq`` only. ``report["denoise"]`` has
        the noise found, ``sigma``, the ``gain`` of each degree, and ``degrees_of_freedom``. It shrinks focal effects of
        single subjects, too: for group tests, fit without it.
    stderr : bool
        Compute the standard error of each coefficient, for independent noise of the vertices whose variance is
        inversely proportional to the weight: `Model.standard_errors`. With weights that only even out the density of
        the vertices, such as areas, ``Grid.weights``, cos(latitude) or lower weights of dense tracks, standard errors
        are too small, up to three times. Compute them by a fit with uniform weights, or with weights that are
        proportional to inverse variances.
    hold_out : float, optional
        Fraction of the vertices to leave out of the fit and to assess separately; a fit of the surface also leaves out
        their triangles.
    surface_distance : bool
        If the surface is fitted, measure the distance between model and surface, which takes about a second.
    method : {"lsq", "irf", "sirf", "mirf", "nlsf", "quadrature"}, optional
        ``lsq``, the default, is the full least squares by fast transforms; ``irf``, ``sirf``, ``mirf`` and ``nlsf`` are
        the methods of Shen and Chung (2006) over a store. With a store the default is ``irf``.
    store : str, os.PathLike or Store, optional
        Basis store.
    passes : int, optional
        Passes over the store, of ``irf`` and ``mirf``; by default 1 for ``irf`` and 4 for ``mirf``, and at most 16 with
        ``accelerate``.
    granularity : int
        Largest number of basis functions that ``irf`` solves for together.
    start_degree : int
        Last degree of the first block of ``sirf`` and ``mirf``.
    accelerate : bool
        Use conjugate gradients over pairs of passes, for ``irf`` and ``mirf``.
    tolerance : float
        Optimality that ``lsq`` must reach: the gradient relative to the gradient at zero coefficients.
    max_iterations : int
        Maximum number of iterations of ``lsq``.
    preconditioner : {"auto", "none", "density", "factor"}
        ``density`` computes moments of uneven samples and divides by the samples' density; ``factor`` factorises the
        normal equations; ``auto`` uses ``density`` if that pays off, and ``factor`` if iterations are slow. With fewer
        vertices than coefficients and no penalty, no preconditioner is used, for the solution of minimum norm.
    strict : bool
        Raise an error if the tolerance isn't met, if the sphere is doubtful, or if the sphere or the mask doesn't seem to
        belong to the surface.
    dtype : {"f64", "f32"}, optional
        Scalar type of the store's basis.
    memory : int or str, optional
        Memory budget in bytes, or text such as ``"512MiB"``; by default half of the free memory, or 256 MiB with a
        store.
    threads : int, optional
        Number of threads; by default all CPUs.
    progress : bool or callable, optional
        ``progress(stage, done, total)``, or True for a tqdm bar. An exception raised in it stops the fit and is raised
        again.

    Returns
    -------
    Model
        Its ``report`` has ``surface_distance`` (``rms``, ``percentile95`` and ``hausdorff`` between model and surface,
        both ways), ``msd`` and ``xsd`` (mean and maximal squared distance at the vertices), and ``warnings``. Distances
        are for a bounding box scaled to volume 1.

    Raises
    ------
    ValueError
        If an argument has an invalid shape or value, or if an image with a mesh and values is given with a sphere.
    MeshError
        If the surface can't be mapped, or doesn't belong to the sphere; or if a value that is read is NaN or infinite. It is
        a ``ValueError``, too.
    MemoryBudgetError
        If the budget is too small; the exception has ``budget`` and ``needed``.
    StoreError
        If the store lacks the basis, or is damaged.

    Warns
    -----
    NotDetermined, NotConverged, Oscillation
        Doubts about the fit.
    SpharmWarning
        If the sphere isn't centred or closed; if it reverses the orientation of the surface; if the triangles of a surface
        without a sphere wind inwards; if its map to the sphere is doubtful; if an array of three columns encloses hardly any
        volume, as a signal does; or if, according to the metadata or names of the files, the sphere or the mask belongs to
        the other hemisphere.

    Examples
    --------
    >>> import spharm_rs as sp
    >>> surface, sphere = sp.example_surface(4)
    >>> model = sp.fit(surface, sphere, 20)
    >>> model.coefficients.shape
    (441, 3)
    >>> model.report["msd"] < 1e-3
    True
    """
    if isinstance(surface, Parametrization):
        surface, sphere = surface.surface, surface if sphere is None else sphere
    # An array or an image holds values; a mesh is given as an object, a path or a pair of arrays.
    triangles, meta = None, None
    image = _arrays.is_image(surface)
    if sphere is not None:
        refuse_both("surface", surface)
    is_file = isinstance(surface, (str, os.PathLike))
    if image and not _arrays.has_mesh(surface):
        values, is_surface = _arrays.channels("surface", surface), False
    elif isinstance(surface, np.ndarray):
        values, is_surface = _arrays.channels("surface", surface), surface.ndim == 2 and surface.shape[1] == 3
    else:
        # Over a sphere, missing values are refused below.
        gaps = sphere is not None or mask is not None or not isinstance(weights, str)
        values, triangles, meta = _read(surface, sphere, gaps)
        is_surface = triangles is not None
    if isinstance(sphere, (int, float, np.number)):
        raise ValueError(f"sphere: expected a sphere, found {sphere!r}; give the degree as max_degree={sphere!r}")
    sphere = opened(sphere)
    directions, faces, parametrized = _sphere_of(len(values), triangles, sphere)
    changes = changes_of(fix, largest_repair, wrap, cut_handles)
    if directions is not None and (name := named_change(fix, wrap, cut_handles)) is not None:
        raise ValueError(
            f"{name}: expected no sphere, because this option changes the surface; map the surface with parametrize first"
        )
    if (fix or wrap is not None) and (mask is not None or not isinstance(weights, str)):
        name, change = "weights" if mask is None else "mask", "fix=True" if fix else f"wrap={wrap}"
        raise ValueError(f"{name}: expected no array with {change}, which renumbers the vertices; repair the surface first")
    settings = _settings(
        max_degree,
        len(values),
        objective=objective,
        weights=weights,
        mask=mask,
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
    if directions is not None:
        _check_values(os.fspath(surface) if is_file else "surface" if is_surface else "values", values, settings)
        whole = mask is None and isinstance(weights, str)
        of_surface = objective != "vertices" and store is None and method in (None, "lsq")
        if is_surface and triangles is None and faces is not None and of_surface and whole:
            warn_of_signal(values, faces)
    return _model(
        _core.fit(
            values,
            triangles,
            directions,
            faces,
            metadata=(meta, meta_of(sphere)),
            surface=is_surface,
            parametrized=parametrized,
            seam=seam_of(sphere),
            changes=changes,
            settings=settings,
            progress=callback(progress),
        )
    )


def choose_degree(
    surface: Any,
    sphere: Any = None,
    accuracy: float | str = "0.2%",
    *,
    memory: int | str | None = None,
    threads: int | None = None,
    progress: Progress = None,
) -> int:
    """Finds the lowest degree at which the model of a surface is accurate enough, by a few trial fits.

    Models of a group should have the same degree: the highest that any of its surfaces needs.

    Parameters
    ----------
    surface : Surface or what `as_surface` takes
    sphere : Surface or what `as_surface` takes, Parametrization, Model, or ndarray of float, (n, 3), optional
        As for `fit`.
    accuracy : float or str
        The root mean square distance between model and surface: a length in the unit of the surface, or a percentage of
        its size, such as ``"0.2%"``; the size is the cube root of the volume of the bounding box.
    memory, threads, progress
        As for `fit`.

    Returns
    -------
    int
        The degree, at most 256, and with no more basis functions than the surface has vertices.

    Warns
    -----
    NotDetermined
        If no such degree is accurate enough. The degree is then at most the one that resolves one and a half edges.

    Examples
    --------
    >>> import spharm_rs as sp
    >>> surface, _ = sp.example_surface(3)
    >>> sp.choose_degree(surface, accuracy="2%") < sp.choose_degree(surface, accuracy="1%")
    True
    """
    if isinstance(surface, Parametrization):
        surface, sphere = surface.surface, surface if sphere is None else sphere
    mesh = as_surface(surface)
    directions, faces, _ = _sphere_of(len(mesh.vertices), mesh.faces, sphere)
    degree, rms, wanted = _core.choose_degree(
        mesh.vertices,
        mesh.faces,
        directions,
        faces,
        accuracy=str(accuracy),
        settings=_settings(1, len(mesh.vertices), memory=memory, threads=threads),
        progress=callback(progress),
    )
    if rms > wanted:
        text = f"no degree has an rms error of at most {wanted:.4g}; degree {degree} has an error of {rms:.4g}"
        warn([text], errors.NotDetermined)
    return degree


def solve(
    transform: Transform | ArrayLike,
    values: Any,
    max_degree: int | None = None,
    *,
    weights: str | ArrayLike = "uniform",
    mask: Any = None,
    smoothness: float | str | None = None,
    stderr: bool = False,
    tolerance: float = 1e-10,
    max_iterations: int = 3000,
    preconditioner: str = "auto",
    memory: int | str | None = None,
    threads: int | None = None,
    progress: Progress = None,
) -> tuple[Floats, FitReport]:
    """Computes least-squares coefficients of samples at scattered directions, such as topography or a masked sky.

    Parameters
    ----------
    transform : Transform or ndarray of float, (n, 3)
        The directions with a degree; or only the directions.
    values : array_like of float, (n,) or (n, c), or (n_latitude, n_longitude) or (n_latitude, n_longitude, c), or image
        A value for each direction. Values on a grid are read in C order, the order of the points in
        `spectra.directions` and `spectra.Grid.directions`. Values with a mask or weight of 0 are never read, and may be
        NaN.
    max_degree : int, optional
        Required with directions; by default the transform's.
    weights, mask
        As for `fit`; arrays may also have the shape of the values' grid.
    stderr : bool
        Compute standard errors of the coefficients, which assume that the weights are proportional to the inverse
        variances of the values. With weights that only even out the density of the samples, such as areas,
        ``Grid.weights``, cos(latitude) or lower weights of dense tracks, they are too small, up to three times.
    smoothness, tolerance, max_iterations, preconditioner, memory, threads, progress
        As for `fit`.

    Returns
    -------
    coefficients : ndarray of float, (K,) or (K, c)
        With the channels of the values, as from `Transform.adjoint`; (K,) for values (n_latitude, n_longitude).
    report : dict
        ``report["solver"]`` contains iterations, optimality and condition; with ``stderr``, ``report["standard_errors"]``
        the standard errors of the coefficients, an array of their shape, which `spectra.spectrum` takes as ``errors``.

    Raises
    ------
    ValueError
        If the number of values isn't that of the directions, or if a value that is read is NaN or infinite.

    Warns
    -----
    NotDetermined, NotConverged
        Doubts about the coefficients.

    Examples
    --------
    >>> import numpy as np, spharm_rs as sp
    >>> directions = sp.icosphere(4).vertices
    >>> height = directions[:, 2] ** 2
    >>> coefficients, report = sp.solve(directions, height, 4)
    >>> bool(abs(coefficients[6] - 2 / 3 * np.sqrt(4 * np.pi / 5)) < 1e-9)
    True
    """
    if isinstance(transform, Transform):
        directions, degree = transform.directions, transform.max_degree
    else:
        directions, degree = _arrays.positions("directions", transform), -1
    if max_degree is not None:
        degree = _arrays.whole("max_degree", max_degree)
    if degree == -1:
        raise ValueError("max_degree: expected a degree, which is required with directions; found None")
    values, grid = _arrays.of_grid("values", values, directions)
    weights, mask = (_arrays.raveled(given, grid) for given in (weights, mask))
    flat = values.ndim == 1
    array = _arrays.channels("values", values)
    if len(array) != len(directions):
        raise ValueError(f"values: expected a row for each of {len(directions)} directions, found shape {np.shape(values)}")
    settings = _settings(
        degree,
        len(directions),
        weights=weights,
        mask=mask,
        smoothness=smoothness,
        stderr=stderr,
        tolerance=tolerance,
        max_iterations=max_iterations,
        preconditioner=preconditioner,
        memory=memory,
        threads=threads,
    )
    _check_values("values", array, settings, scattered=True, flat=flat)
    # The given transform may be planned for another degree, or with too low an accuracy.
    planned = isinstance(transform, Transform) and transform._inner.serves(degree)
    at = transform._inner if isinstance(transform, Transform) and planned else directions
    coefficients, deviations, text, problems = _core.solve(at, array, settings=settings, progress=callback(progress))
    issue((getattr(errors, kind), problem) for kind, problem in problems)
    report: FitReport = json.loads(text)
    report["warnings"] = [problem for _, problem in problems]
    if deviations is not None:
        report["standard_errors"] = deviations[:, 0] if flat else deviations
    return coefficients[:, 0] if flat else coefficients, report
