"""Models: coefficients of a surface or a signal on the sphere."""

from __future__ import annotations

import base64
import json
import os
import pathlib
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from . import _arrays, _core, _model_tables, convert
from ._arrays import Floats
from ._model_meshes import Meshes
from ._model_values import Values
from ._parametrize import Parametrization, Seam
from ._picture import Picture, picture
from ._progress import Progress
from ._spectra_degree import sums
from ._surface import Path, Surface, as_surface, icosphere, named_icosphere
from ._warnings import warn
from .reports import FitReport


#: Subdivisions of the icosphere on which a surface is checked for triangles that face inwards.
_TO_SEE_SIDES = 4

_MIRRORED = (
    "the parameterisation is mirrored, so that its normals point inwards, and the surface's curvatures have the opposite "
    "sign, except for the Gaussian curvature; reverse the signs for outward normals"
)

#: The extension of compressed models.
_COMPRESSED = ".sphz"


class Model(Values, Meshes):
    """A model: functions on the sphere, each a sum of real spherical harmonics.

    Parameters
    ----------
    coefficients : array_like of float, (K, c)
        Row ``l**2 + l + m`` is degree l and order m, orthonormal and without the Condon-Shortley phase; sin(abs(m) phi) for
        negative m.
    sphere : Surface or what `as_surface` takes, or array_like of float, (n, 3), optional
        The sphere or directions at which the model was fitted.
    surface : bool, optional
        Whether the channels are x, y and z; by default True for three channels: give False for a signal of three channels.

    Examples
    --------
    An ellipsoid:

    >>> import numpy as np, spharm_rs as sp
    >>> coefficients = np.zeros((4, 3))
    >>> coefficients[3, 0], coefficients[1, 1], coefficients[2, 2] = 9, 4, 4
    >>> model = sp.Model(coefficients)
    >>> model.surface(3)
    Surface(642 vertices, 1280 faces)

    Models can be added, subtracted, and multiplied by numbers. The result has the sums, differences or multiples of the
    coefficients, with 0 for missing degrees, and the sphere of the first model. Multiples and `truncate` keep the
    standard errors. ``model[l]`` has the coefficients of a degree, (2 l + 1, c), ``model[l, m]`` those of an order,
    (c,), and ``len(model)`` is the number of degrees, L + 1.

    >>> half = (model + model.truncate(0)) / 2
    >>> half == 0.5 * model, half[1, 1].tolist()
    (True, [4.5, 0.0, 0.0])

    ``sum(models) / len(models)`` is the mean of models, also of different degrees; NumPy's functions, such as ``np.mean``,
    take models as arrays of coefficients, and need equal degrees.
    """

    _inner: _core.Model
    #: Report of the fit: distances, iterations, warnings; empty if the model wasn't fitted in this process.
    report: FitReport
    #: Standard error of each coefficient, (K, c), if requested, else None. Multiples and `truncate` keep them; sums of two
    #: models, other operations and files don't.
    standard_errors: Floats | None

    def __init__(self, coefficients: ArrayLike, *, sphere: Any = None, surface: bool | None = None) -> None:
        values = _arrays.channels("coefficients", coefficients)
        vertices, faces, parametrized = sphere_arrays(sphere)
        seam = seam_of(sphere)
        surface = values.shape[1] == 3 if surface is None else bool(surface)
        inner = _core.Model(
            values, surface=surface, sphere=vertices, faces=faces, parametrized=parametrized, seam=seam
        )
        self._set(inner, cast(FitReport, {}), None)

    def _set(self, core: _core.Model, report: FitReport, errors: Floats | None) -> None:
        self._inner, self.report, self.standard_errors = core, report, errors
        self._coefficients: Floats | None = None
        self._measures: Any = None

    @classmethod
    def _of(cls, core: _core.Model, report: FitReport | None = None, errors: Floats | None = None) -> Model:
        model = cls.__new__(cls)
        model._set(core, cast(FitReport, {}) if report is None else report, errors)
        return model

    def __repr__(self) -> str:
        kind = "surface" if self.is_surface else f"{self.coefficients.shape[1]} channels"
        return f"Model(degree {self.max_degree}, {kind})"

    def __reduce__(self) -> Any:
        return _unpickled, (self._inner.to_bytes(), self.report, self.standard_errors)

    def _with(self, coefficients: Floats, errors: Floats | None = None) -> Model:
        return Model._of(self._inner.with_coefficients(np.ascontiguousarray(coefficients)), errors=errors)

    def _repr_html_(self) -> str:
        rows = {"degree": str(self.max_degree), "channels": "x, y, z" if self.is_surface else str(self.coefficients.shape[1])}
        if self.rms is not None:
            rows["rms"] = f"{self.rms:.4g}"
        drawing = ""
        if self.is_surface:
            png = base64.b64encode(self.picture(at=4, size=200).png).decode()
            drawing = f'<img alt="the surface" src="data:image/png;base64,{png}"/>'
        cells = "".join(f"<tr><th>{name}</th><td>{value}</td></tr>" for name, value in rows.items())
        return f"<div>{drawing}<table>{cells}</table></div>"

    @property
    def coefficients(self) -> Floats:
        """Coefficients, (K, c), read-only."""
        if self._coefficients is None:
            self._coefficients = self._inner.coefficients
            self._coefficients.flags.writeable = False
        return self._coefficients

    @property
    def max_degree(self) -> int:
        """Highest degree L, inclusive; each channel has (L + 1)**2 coefficients."""
        return self._inner.max_degree

    @property
    def is_surface(self) -> bool:
        """Whether the channels are x, y and z."""
        return self._inner.is_surface

    @property
    def rms(self) -> float | None:
        """Root mean square error of the fit, in the unit of the surface or signal; None if it wasn't fitted in this process.

        For a surface, the distance between it and the model, both ways; for a fit of vertices, the residual at those of
        nonzero weight, which count equally; for a fit of moments, the residual at the samples, which count by their weights.
        Also None if moments don't determine it.
        """
        report = self.report
        if "surface_distance" in report:
            return report["surface_distance"]["rms_raw"]
        if "passes" in report:
            return float(np.sqrt(report["passes"][-1]["msd_raw"]))
        rms = report.get("rms", [None])
        return None if None in rms else float(np.sqrt(np.square(rms).sum()))

    @property
    def sphere(self) -> Surface | None:
        """The sphere over which the model was fitted; None if it has no triangles."""
        found = self._inner.sphere
        return None if found is None or len(found[1]) == 0 else Surface(*found)

    @property
    def directions(self) -> Floats | None:
        """Unit vectors at which the model was fitted, (n, 3): for a surface, those to which the map sends its vertices,
        in the same order."""
        found = self._inner.sphere
        return None if found is None else found[0]

    @property
    def provenance(self) -> dict[str, Any]:
        """Record of how the model was made."""
        found: dict[str, Any] = json.loads(self._inner.provenance)
        return found

    def _degree(self, degree: int | None) -> int:
        return self.max_degree if degree is None else _arrays.whole("degree", degree)

    def evaluate(self, at: Any = None, *, degree: int | None = None, threads: int | None = None) -> Floats:
        """Evaluates the model at directions.

        Directions are on the sphere to which the surface was mapped. The map determines which point of the surface belongs
        to a direction; the point isn't in that direction as seen from the centre of the surface. `directions` has the
        directions of the fitted vertices. For a mesh in space, ``compare(model, mesh, surface_distance=True).per_vertex`` has
        the distance of each vertex from the surface (`spharm_rs.compare`).

        Parameters
        ----------
        at : array_like of float, (n, 3), int, Surface or what `as_surface` takes, optional
            Vectors of any nonzero length; or subdivisions of an icosphere; or a sphere. By default the directions at
            which the model was fitted.
        degree : int, optional
            Highest degree to evaluate; by default all degrees.
        threads : int, optional

        Returns
        -------
        ndarray of float, (n, c)

        Examples
        --------
        >>> import spharm_rs as sp
        >>> surface, sphere = sp.example_surface(3)
        >>> model = sp.fit(surface, sphere, 10)
        >>> model.evaluate([[0, 0, 1]]).shape
        (1, 3)
        """
        return self._inner.evaluate(directions_at(at), self._degree(degree), threads=threads)

    def at(self, points: ArrayLike, *, degree: int | None = None, threads: int | None = None) -> Floats:
        """Evaluates the model at directions, (n, 3), or at one direction, (3,): returns values, (n, c) or (c,).

        Directions are on the sphere of the map, not as seen from the centre of the surface; see `evaluate`.
        """
        values = _arrays.real("points", points, "(3,) or (n, 3)")
        if values.ndim not in (1, 2) or values.shape[-1] != 3:
            raise ValueError(f"points: expected shape (3,) or (n, 3), found {values.shape}")
        found = self.evaluate(values.reshape(-1, 3), degree=degree, threads=threads)
        return found[0] if values.ndim == 1 else found

    def normals(self, at: Any = None, *, degree: int | None = None, threads: int | None = None) -> Floats:
        """Returns unit normals of the surface at directions, (n, 3), by default those of the fit; see `shape.geometry`.

        Normals are computed from first derivatives, whose error falls more slowly with the degree than that of
        positions. If the parameterisation is mirrored, they point inwards, and there is a warning.
        """
        from . import shape

        return shape.geometry(self, at, degree=degree, threads=threads).normals

    def curvature(self, at: Any = None, *, degree: int | None = None, threads: int | None = None) -> Floats:
        """Returns the mean curvature of the surface at directions, (n,), by default those of the fit; see `shape.geometry`.

        In the inverse of the surface's unit. The curvature is computed from second derivatives, so it needs a higher
        degree than positions do: compare the curvatures of two degrees. It is positive where the surface is convex; if
        the parameterisation is mirrored, it is negative there, and there is a warning.
        """
        from . import shape

        return shape.geometry(self, at, degree=degree, threads=threads).mean_curvature

    def _warn_if_mirrored(self, degree: int | None) -> None:
        mesh = self.surface(_TO_SEE_SIDES, degree=degree)
        # The volume of a flat surface is a rounding error.
        if mesh.volume < -1e-9 * mesh.area**1.5:
            warn([_MIRRORED])

    @property
    def area(self) -> float:
        """Area of the surface, in the square of its unit; see `shape.measure`. If handles were cut, that of the cut surface
        with the lids over its cuts."""
        return self._measured.area

    @property
    def volume(self) -> float:
        """Volume within the surface, in the cube of its unit, positive also if the surface is mirrored; see `shape.measure`.
        If handles were cut, that of the cut surface with the lids over its cuts."""
        return self._measured.volume

    @property
    def _measured(self) -> Any:
        from . import shape

        if not self.is_surface:
            raise AttributeError("area, volume: expected a model of a surface, found a signal")
        if self._measures is None:
            self._measures = shape.measure(self)
        return self._measures

    def picture(self, values: ArrayLike | None = None, *, at: Any = 5, degree: int | None = None, **settings: Any) -> Picture:
        """Draws the surface on a sphere, with values at its vertices as colours.

        Parameters
        ----------
        values : array_like of float, (n,) or (n, 1), optional
            A value for each vertex of the sphere, such as those of ``model.curvature(5)``. Values at the directions of the
            fit, such as those of ``model.curvature()``, need ``at=model.sphere``.
        at : int, Surface or what `as_surface` takes, or None
            The sphere, as for `surface`.
        degree : int, optional
        **settings
            As for `spharm_rs.picture`: ``limits``, ``label``, ``caption``, ``size``, ``view``.

        Raises
        ------
        ValueError
            If there isn't one value for each vertex of the sphere.
        """
        return picture(self._coloured(values, at, degree), values, **settings)

    def plot(self, values: ArrayLike | None = None, *, at: Any = 5, degree: int | None = None, **settings: Any) -> Any:
        """Shows the surface on a sphere; see `Surface.plot` for the settings, and `picture` for the others."""
        return self._coloured(values, at, degree).plot(values, **settings)

    def _coloured(self, values: ArrayLike | None, at: Any, degree: int | None) -> Surface:
        """Returns the surface on a sphere, and refuses values of another number of vertices."""
        mesh = self.surface(at, degree=degree)
        if values is None:
            return mesh
        count = len(mesh.vertices)
        shape = _arrays.at_vertices("values", values).shape
        if shape[0] != count:
            given = f"at={at}" if at is None or isinstance(at, (int, str)) else f"at, a {type(at).__name__}"
            of_fit = self.sphere is not None and shape[0] == len(self.sphere.vertices)
            advice = "give at=model.sphere for values at the vertices of the fit" if of_fit else "give the values' sphere as at="
            raise ValueError(
                f"values: expected shape ({count},), a value for each vertex of the sphere {given}; "
                f"found {np.shape(_arrays.unwrapped('values', values))}; {advice}"
            )
        return mesh

    def surface(self, at: Any = None, *, degree: int | None = None, threads: int | None = None) -> Surface:
        """Evaluates the surface on a sphere.

        Parameters
        ----------
        at : int, Surface or what `as_surface` takes, optional
            Subdivisions of an icosphere, as a number or as ``icosphere:N``; or a sphere. By default the sphere over
            which the model was fitted. If the surface's handles were cut, the default returns the surface with its
            handles, and ``model.sphere`` returns the cut surface.
        degree : int, optional
            Highest degree to evaluate; by default all degrees.
        threads : int, optional

        Returns
        -------
        Surface
            With the metadata of the fitted surface's file, such as the geometry of FreeSurfer's volume.
        """
        vertices, faces = sampling(at)
        return Surface._of(*self._inner.surface(vertices, faces, self._degree(degree), threads=threads))

    def truncate(self, degree: int) -> Model:
        """Returns a model that has only the degrees 0 to ``degree``, with the standard errors of their coefficients."""
        inner = self._inner.truncate(_arrays.whole("degree", degree))
        errors = self.standard_errors
        return Model._of(inner, errors=None if errors is None else errors[: (inner.max_degree + 1) ** 2].copy())

    def rotate(
        self,
        *,
        parameters: Any = None,
        object: Any = None,
        scale: float = 1.0,
        translation: ArrayLike = (0.0, 0.0, 0.0),
        threads: int | None = None,
        progress: Progress = None,
    ) -> Model:
        """Returns the model rotated in its parameters, or moved in space; see `shape.rotate` for the settings.

        The result has no standard errors: a rotation mixes coefficients, and their covariances aren't known.
        """
        from . import shape

        return shape.rotate(
            self,
            parameters=parameters,
            object=object,
            scale=scale,
            translation=translation,
            threads=threads,
            progress=progress,
        )

    def spectrum(self) -> Floats:
        """Returns the power of each degree, (L + 1,): the sum of the squares of its coefficients, over all channels.

        In the square of the model's unit, as an integral over the sphere: 4 pi times the mean square that
        `spharm_rs.spectra.spectrum` returns for each channel by default, which is pyshtools' power.
        """
        return sums((self.coefficients**2).sum(axis=1))

    def save(self, path: Path, *, overwrite: bool = False) -> None:
        """Writes the model as a NumPy archive, atomically; ``spharm reconstruct`` reads it, too.

        The file has the coefficients, the provenance, and the sphere, which is usually the largest part. Standard errors and
        the report aren't written; pickles have them. `compress` makes much smaller files.

        Parameters
        ----------
        path : str or os.PathLike
            By convention ``NAME.spharm.npz``; an extension has to be ``.npz``.
        overwrite : bool
            Replace an existing file.

        Raises
        ------
        ValueError
            If the name has the extension of another format.
        """
        name = os.fspath(path)
        if (ending := pathlib.PurePath(name).suffix.lower()) not in ("", ".npz"):
            advice = "; model.surface(5).save writes meshes" if _core.is_mesh_name(name) else ""
            advice = "; model.compress writes compressed models" if ending == _COMPRESSED else advice
            raise ValueError(f"path: expected a model's name such as NAME.spharm.npz, found {name}{advice}")
        self._inner.write(name, overwrite=bool(overwrite))

    def compress(
        self,
        path: Path,
        *,
        tolerance: float | None = None,
        bytes: int | None = None,
        overwrite: bool = False,
        threads: int | None = None,
    ) -> float:
        """Writes the model to a small file, with rounded coefficients and without its sphere.

        As ``spharm shape compress`` does, which has more settings.

        Parameters
        ----------
        path : str or os.PathLike
            ``NAME.sphz``.
        tolerance : float, optional
            Largest root mean square distance between the surfaces, measured both ways, with the bounding box scaled to
            volume 1; from 1e-8 to 1. For signals, a fraction of each channel's standard deviation over the sphere.
        bytes : int, optional
            Largest size of the file. Either this or ``tolerance`` is required.
        overwrite : bool
            Replace an existing file.
        threads : int, optional

        Returns
        -------
        float
            The distance reached, in the unit of ``tolerance``.

        Raises
        ------
        ValueError
            If no file meets the tolerance or the size.

        Warns
        -----
        SpharmWarning
            If the highest degrees, whose coefficients were all rounded to zero, are omitted: small files can't list many zeros.

        Examples
        --------
        >>> import pathlib, tempfile, spharm_rs as sp
        >>> model = sp.fit(*sp.example_surface(3), 6)
        >>> file = pathlib.Path(tempfile.mkdtemp(), "m.sphz")
        >>> model.compress(file, tolerance=1e-3) <= 1e-3, file.stat().st_size < 1500
        (True, True)
        >>> sp.Model.load(file)
        Model(degree 6, surface)
        """
        name = os.fspath(path)
        if pathlib.PurePath(name).suffix.lower() != _COMPRESSED:
            raise ValueError(f"path: expected a name that ends in {_COMPRESSED}, found {name}")
        distance, degree = self._inner.compress(
            name,
            tolerance=None if tolerance is None else float(tolerance),
            bytes=None if bytes is None else _arrays.whole("bytes", bytes, 1),
            overwrite=bool(overwrite),
            threads=_arrays.threads(threads),
        )
        if degree < self.max_degree:
            reason = "because all their coefficients were rounded to zero, and a file of this size can't list so many zeros"
            warn([f"{name}: the degrees above {degree} are omitted, {reason}"])
        return distance

    @classmethod
    def load(cls, path: Path) -> Model:
        """Reads a model: any NumPy archive with an array ``coefficients``, (K, c), or a compressed model ``NAME.sphz``.

        Parameters
        ----------
        path : str or os.PathLike

        Returns
        -------
        Model
        """
        name = os.fspath(path)
        if pathlib.PurePath(name).suffix.lower() == _COMPRESSED:
            return cls._of(_core.Model.expand(pathlib.Path(name).read_bytes(), name))
        return cls._of(_core.Model.read(name))

    def to_frame(self) -> Any:
        """Returns the coefficients as a pandas ``DataFrame``: index degree and order, and a column for each channel.

        Examples
        --------
        >>> import spharm_rs as sp
        >>> table = sp.Model([[1.0, 0, 0], [0, 2, 0], [0, 0, 2], [2, 0, 0]]).to_frame()
        >>> float(table.loc[(1, -1), "y"]), (table**2).sum(axis=1).groupby("degree").sum().tolist()
        (2.0, [1.0, 12.0])
        """
        return _model_tables.to_frame(self.coefficients, self.is_surface)

    def to_xarray(self) -> Any:
        """Returns the coefficients as an xarray ``DataArray`` of harmonics and channels, with the coordinates degree, order
        and channel."""
        return _model_tables.to_xarray(self.coefficients, self.is_surface)

    def to(self, format: str, **options: Any) -> Any:
        """Returns the coefficients in another package's convention; see `spharm_rs.convert`.

        Parameters
        ----------
        format : {"complex", "pyshtools", "healpy", "s2fft", "spharm_pdm", "spharm_mat", "ktch", "flowshape"}
        **options
            As for `spharm_rs.convert.to`, such as ``normalization`` and ``csphase`` for ``"pyshtools"``.
        """
        return convert.to(format, self.coefficients, **options)

    @classmethod
    def from_(cls, format: str, array: Any, *, sphere: Any = None, **options: Any) -> Model:
        """Makes a model from another package's coefficients; see `spharm_rs.convert`.

        Parameters
        ----------
        format : str
            A format of `to`, or ``"frame"`` and ``"xarray"`` for what `to_frame` and `to_xarray` return: rows in any order,
            absent ones being zero. Channels x, y and z are found by name, and other channels are taken in their order. A
            frame may have degree and order as columns, as after ``reset_index``.
        array : Any
        sphere : Surface or what `as_surface` takes, or array_like of float, (n, 3), optional
            As for `Model`.
        **options
            As for `spharm_rs.convert.from_`, such as ``normalization`` and ``csphase`` for ``"pyshtools"``.
        """
        if format in ("frame", "xarray"):
            if options:
                raise ValueError(f"{', '.join(options)}: expected no options for the format {format}")
            coefficients, surface = _model_tables.of_table(array)
            return cls(coefficients, sphere=sphere, surface=surface)
        return cls(convert.from_(format, array, **options), sphere=sphere)


def _unpickled(data: bytes, report: FitReport, errors: Floats | None) -> Model:
    return Model._of(_core.Model.from_bytes(data), report, errors)


def core(what: str, model: Any, advice: str = "") -> _core.Model:
    """Returns the extension module's object for a model; ``advice`` says what to do with a mesh instead."""
    if not isinstance(model, Model):
        found = type(model).__name__
        makes = "spharm_rs.fit makes a Model of a surface"
        if isinstance(model, np.ndarray):
            makes = "spharm_rs.Model(coefficients) makes a Model of coefficients, and spharm_rs.fit one of a surface"
        raise ValueError(f"{what}: expected a Model, found {found}; {makes}{advice}")
    return model._inner


def mapped_apart(first: Model, second: Model) -> bool:
    """Returns whether two models were fitted over different maps that `parametrize` made, so that equal directions don't
    correspond. Spheres given by the user may be registered, and models without directions have no map of their own."""
    return first._inner.mapped_apart(second._inner)


#: Largest distance between a vertex's unit vectors in two maps up to which the maps are taken as the same.
_SAME_MAP = 1e-3


def maps_differ(first: Model, second: Model) -> bool:
    """Returns whether two models were fitted over different maps, as `mapped_apart` does, but takes maps that differ
    only by a rotation or reflection of the sphere as the same."""
    if not mapped_apart(first, second):
        return False
    own, other = first.directions, second.directions
    if own is None or other is None or own.shape != other.shape:
        return True
    left, _, right = np.linalg.svd(own.T @ other)
    return not bool(np.abs(own @ (left @ right) - other).max() < _SAME_MAP)


def seam_of(sphere: Any) -> Seam:
    """Returns the seam of a sphere whose surface was cut, otherwise None."""
    if isinstance(sphere, Parametrization):
        return sphere._seam
    return sphere._inner.seam if isinstance(sphere, Model) else None


def sampling(sphere: Any) -> tuple[Any, Any]:
    """Returns the directions and triangles (None if absent) of an icosphere, given by its level, a sphere, or
    directions."""
    whole = isinstance(sphere, (int, np.integer)) and not isinstance(sphere, bool)
    if whole:
        sphere = icosphere(int(sphere))
        return sphere.vertices, sphere.faces
    sphere = named_icosphere(sphere)
    directions, faces, _ = sphere_arrays(sphere)
    if faces is not None and not isinstance(sphere, (Model, Parametrization)):
        _warn_of_radii(directions)
    return directions, faces


#: The spread of a sphere's radii, relative to the largest, above which there is a warning, as for `fit`.
_RADIUS_SPREAD = 0.01


def _warn_of_radii(vertices: Floats) -> None:
    radii = np.linalg.norm(vertices, axis=1)
    low, high = (float(radii.min()), float(radii.max())) if len(radii) else (0.0, 0.0)
    if high - low > _RADIUS_SPREAD * high:
        percent = 100 * (high - low) / high
        warn(
            [
                f"the sphere: the radii range from {low:.4f} to {high:.4f} ({percent:.1f} % apart); "
                "check that this is a sphere centred at the origin"
            ]
        )


def directions_at(at: Any) -> Floats | None:
    """Returns directions, (n, 3), given as such or as what `sampling` takes; None for None."""
    # Rows of numbers are directions; everything else is a sphere of some kind.
    if not (isinstance(at, (np.ndarray, list, tuple)) or hasattr(at, "__array__")) or isinstance(at, (np.integer, Model)):
        found: Floats | None = sampling(at)[0]
        return found
    return _arrays.positions("at", at)


def sphere_arrays(sphere: Any) -> tuple[Any, Any, bool]:
    """Returns the directions, the triangles (None if absent), and whether `parametrize` made the sphere from a
    surface."""
    if sphere is None:
        return None, None, True
    if isinstance(sphere, Parametrization):
        return sphere.sphere.vertices, sphere.sphere.faces, sphere.report["method"] != "resample"
    if isinstance(sphere, np.ndarray):
        return _arrays.positions("sphere", sphere), None, False
    if isinstance(sphere, Model):
        own = sphere._inner.sphere
        if own is None:
            raise ValueError("sphere: expected a sphere, because the model has no sphere of its own")
        return own[0], own[1] if len(own[1]) else None, sphere._inner.parametrized
    mesh = as_surface(sphere)
    return mesh.vertices, mesh.faces, False
