"""Values of functions on grids of latitudes and longitudes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Sequence

import numpy as np
from numpy.typing import ArrayLike

from . import _arrays
from ._arrays import Floats
from ._model import Model
from ._model_tables import channel_names
from ._spectra_angles import angles, unit_vectors, warn_if_radians
from ._spectra_degree import finite
from ._spectra_quadrature import gauss_legendre, latitude_weights, longitude_weights
from ._transform import Transform


@dataclass(frozen=True, eq=False)
class Grid:
    """Values on a grid of latitudes and longitudes, returned by `grid` or made from an array of your own.

    Parameters
    ----------
    latitude : array_like of float, (n,)
        In degrees, from -90 to 90, in any order; the default latitudes of `grid` begin in the north.
    longitude : array_like of float, (m,)
        In degrees, from -360 to 360.
    values : array_like of float, (n, m) or (n, m, c)
        Values at the grid's points, NaN where there is none.
    channel : list of str, optional
        Names of the channels: x, y and z of a surface, otherwise, and by default, numbers from 0; empty for values (n, m).

    Raises
    ------
    ValueError
        If the values don't have a row for each latitude and a column for each longitude.

    Warns
    -----
    SpharmWarning
        If the angles of a grid of 10 points or more are so small that they may be in radians.

    Examples
    --------
    >>> import numpy as np
    >>> from spharm_rs import spectra
    >>> latitude, longitude = np.arange(90, -90, -10), np.arange(0, 360, 10)
    >>> height = np.sin(np.radians(latitude))[:, np.newaxis] * np.ones(36)
    >>> model = spectra.Grid(latitude, longitude, height).expand()
    >>> model.max_degree, bool(np.isclose(model[1, 0][0], np.sqrt(4 * np.pi / 3)))
    (8, True)
    """

    latitude: Floats
    longitude: Floats
    values: Floats
    channel: list[str]

    def __init__(
        self, latitude: ArrayLike, longitude: ArrayLike, values: ArrayLike, channel: Sequence[str] = ()
    ) -> None:
        north, east = _axis("latitude", latitude), _axis("longitude", longitude)
        angles("latitude", north, -90, 90, degrees=True, axis=True)
        angles("longitude", east, -360, 360, degrees=True, axis=True)
        array, shape = _arrays.real("values", values, "(n, m) or (n, m, c)").copy(), (len(north), len(east))
        if array.ndim not in (2, 3) or array.shape[:2] != shape or array.shape[2:] == (0,):
            raise ValueError(
                f"values: expected a row for each of {shape[0]} latitudes and a column for each of {shape[1]} longitudes, "
                f"found shape {array.shape}"
            )
        warn_if_radians("latitude", 90, north, east, len(north) * len(east), "convert radians with numpy.degrees")
        if isinstance(channel, str):
            raise ValueError(f"channel: expected a list of names, found the text {channel!r}")
        names, count = list(channel), array.shape[2] if array.ndim == 3 else 0
        if not names:
            names = channel_names(count, False)
        if len(names) != count or not all(isinstance(name, str) for name in names):
            raise ValueError(f"channel: expected {count} names for values of shape {array.shape}, found {channel!r}")
        for name, value in (("latitude", north), ("longitude", east), ("values", array), ("channel", names)):
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        return f"Grid({len(self.latitude)} latitudes, {len(self.longitude)} longitudes)"

    @property
    def directions(self) -> Floats:
        """Unit vectors of the grid's points, (n m, 3), latitude by latitude, as in ``values.reshape(n * m, -1)``."""
        return _points(self.latitude, self.longitude)

    @property
    def weights(self) -> Floats:
        """Weights of the grid's points, (n m,), in the order of `directions`: shares of the unit sphere, with the sum 4 pi.

        Weighted sums over the points are integrals over the sphere. They are exact up to a degree for Gauss-Legendre
        latitudes and for evenly spaced ones, from pole to pole or half a step from the poles (Driscoll and Healy 1994; Fejer),
        with evenly spaced longitudes. For other axes, the weights are areas of the cells around the points. Where a grid
        leaves out a part of the sphere, so do the cells, and the sum is less than 4 pi. Points at a pole may have the
        weight 0.
        """
        return np.outer(latitude_weights(self.latitude)[0], longitude_weights(self.longitude)[0]).ravel()

    def _largest_degree(self) -> int | None:
        """Returns the highest degree of an exact quadrature; None if the weights are areas of cells."""
        exact = latitude_weights(self.latitude)[1], longitude_weights(self.longitude)[1]
        return None if min(exact) < 0 else min(exact) // 2

    def expand(self, max_degree: int | None = None, *, threads: int | None = None) -> Model:
        """Computes the coefficients of the values by quadrature, as pyshtools' ``SHGrid.expand`` does.

        Parameters
        ----------
        max_degree : int, optional
            Highest degree L, inclusive; at most, and by default, the largest for which the quadrature is exact: ``n / 2 - 1``
            for n latitudes in steps of ``180 / n`` degrees from a pole, or ``n - 1`` for n Gauss-Legendre latitudes; and
            at most ``(m - 1) / 2`` for m longitudes.
        threads : int, optional

        Returns
        -------
        Model
            A surface if the channels are x, y and z. For a field without power above degree L, its coefficients are
            exact. For other fields, power above L can alias into them.

        Raises
        ------
        ValueError
            If the quadrature isn't exact for functions of this degree on this grid, or if a value is NaN:
            ``spharm_rs.solve(grid.directions, grid.values, max_degree)`` fits the values of any grid, also with a mask.

        Examples
        --------
        >>> import numpy as np
        >>> from spharm_rs import spectra
        >>> coefficients = np.arange(16.0)
        >>> model = spectra.grid(coefficients, kind="GLQ").expand()
        >>> bool(abs(model.coefficients[:, 0] - coefficients).max() < 1e-12)
        True
        """
        largest, solve = self._largest_degree(), "spharm_rs.solve(grid.directions, grid.values, max_degree)"
        if largest is None:
            raise ValueError(
                "latitude, longitude: expected a grid with an exact quadrature, which has Gauss-Legendre or evenly spaced "
                "latitudes between the poles, and evenly spaced longitudes around the sphere; found other angles. "
                f"{solve} fits any grid"
            )
        degree = largest if max_degree is None else _arrays.whole("max_degree", max_degree)
        if degree > largest:
            raise ValueError(
                f"max_degree: expected at most {largest}, the largest degree for which quadrature is exact on this grid, "
                f"found {degree}. {solve} fits other degrees"
            )
        values = self.values.reshape(len(self.latitude) * len(self.longitude), -1)
        bad = ~np.isfinite(values).all(axis=1)
        if bad.any():
            row, column = divmod(int(bad.argmax()), len(self.longitude))
            raise ValueError(
                f"values: expected finite numbers, found NaN or infinity in row {row}, column {column}. "
                "spharm_rs.solve leaves out values with mask="
            )
        transform = Transform(self.directions, degree, accuracy=1e-13, channels=min(values.shape[1], 8), threads=threads)
        found = transform.adjoint(self.weights[:, np.newaxis] * values)
        return Model(found, surface=self.channel == list("xyz"))

    def to_xarray(self) -> Any:
        """Returns an xarray ``DataArray`` with the coordinates latitude, longitude and, for values (n, m, c), channel."""
        import xarray

        coordinates: dict[str, Any] = {"latitude": self.latitude, "longitude": self.longitude}
        if self.values.ndim == 3:
            coordinates["channel"] = self.channel
        return xarray.DataArray(self.values, coordinates, list(coordinates))


def grid(
    coefficients: Model | ArrayLike,
    latitude: ArrayLike | None = None,
    longitude: ArrayLike | None = None,
    *,
    kind: str = "DH2",
    threads: int | None = None,
) -> Grid:
    """Evaluates functions on a grid of latitudes and longitudes, such as for a map.

    Parameters
    ----------
    coefficients : Model, or array_like of float, (K,) or (K, c)
        Such as those of `spharm_rs.solve`.
    latitude : array_like of float, (n,), optional
        In degrees, from -90 to 90; by default those of `kind`.
    longitude : array_like of float, (m,), optional
        In degrees, from -360 to 360; by default those of `kind`.
    kind : {"DH2", "DH", "GLQ"}
        The default axes. ``"DH2"``: 2 L + 2 latitudes from 90 in steps of 180 / (2 L + 2), and 4 L + 4 longitudes from 0 in
        the same steps. ``"DH"``: the same latitudes, and 2 L + 2 longitudes from 0. ``"GLQ"``: L + 1 Gauss-Legendre
        latitudes from the north, and 2 L + 1 longitudes from 0.
    threads : int, optional

    Returns
    -------
    Grid

    Notes
    -----
    The default grid is that of pyshtools' ``expand(grid=kind, extend=False)``, from which `Grid.expand` recovers
    the coefficients to degree L.

    Examples
    --------
    >>> import numpy as np
    >>> from spharm_rs import spectra
    >>> dipole = [0, 0, np.sqrt(4 * np.pi / 3), 0]
    >>> spectra.grid(dipole, latitude=[90, 0, -30], longitude=[0, 180]).values.round(12).tolist()
    [[1.0, 1.0], [0.0, 0.0], [-0.5, -0.5]]
    >>> spectra.grid(dipole)
    Grid(4 latitudes, 8 longitudes)
    """
    if isinstance(coefficients, Model):
        model, flat = coefficients, False
    else:
        array = finite("coefficients", _arrays.channels("coefficients", coefficients))
        model, flat = Model(array, surface=False), np.ndim(coefficients) == 1
    default = _default_axes(model.max_degree, _arrays.choice("kind", kind, ("DH2", "DH", "GLQ")))
    north = _axis("latitude", default[0] if latitude is None else latitude)
    east = _axis("longitude", default[1] if longitude is None else longitude)
    values = model.evaluate(_points(north, east), threads=threads)
    if flat:
        return Grid(north, east, values.reshape(len(north), len(east)), [])
    names = channel_names(values.shape[1], model.is_surface)
    return Grid(north, east, values.reshape(len(north), len(east), -1), names)


def _default_axes(degree: int, kind: str) -> tuple[Floats, Floats]:
    """Returns the latitudes and longitudes of a kind of grid, in degrees."""
    if kind == "GLQ":
        columns = 2 * degree + 1
        return gauss_legendre(degree + 1), 360.0 / columns * np.arange(columns, dtype=np.float64)
    rows = 2 * degree + 2
    step = 180.0 / rows
    south = step * np.arange(rows, dtype=np.float64)
    return 90 - south, step * np.arange(2 * rows, dtype=np.float64) if kind == "DH2" else 2 * south


def _points(latitude: Floats, longitude: Floats) -> Floats:
    """Returns the unit vectors of a grid's points, (n m, 3)."""
    elevation = angles("latitude", latitude, -90, 90, degrees=True, axis=True)
    azimuth = angles("longitude", longitude, -360, 360, degrees=True, axis=True)
    return unit_vectors(np.sin(elevation)[:, np.newaxis], np.cos(elevation)[:, np.newaxis], azimuth).reshape(-1, 3)


def _axis(what: str, values: ArrayLike) -> Floats:
    axis = _arrays.real(what, values, "(n,)").copy()
    if axis.size == 0:
        raise ValueError(f"{what}: expected at least one angle, found none")
    return axis
