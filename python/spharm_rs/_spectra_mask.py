"""Spectra of fields that were observed on a part of the sphere: MASTER (Hivon et al. 2002, ApJ 567, 2).

Samples f_i at directions u_i have weights w_i. Their pseudo-spectrum and that of the weights are

    P_l = sum_m (sum_i w_i f_i S_lm(u_i))**2 / (2 l + 1),    W_l = sum_m (sum_i w_i S_lm(u_i))**2 / (2 l + 1).

For an isotropic field with spectrum C_l, and independent noise of standard deviation s_i at each sample,

    <P_l> = sum_l' M_ll' C_l' + N,    N = sum_i (w_i s_i)**2 / (4 pi),
    M_ll' = (2 l' + 1) / (4 pi) sum_l'' (2 l'' + 1) W_l'' (l l' l''; 0 0 0)**2    (Hivon, eq. A31),

which is exact for samples at points: no quadrature is involved, and the weights needn't be areas. Without the pairs of
a sample with itself, which add ``sum_i (w_i f_i)**2 / (4 pi)`` to P_l and ``sum_i w_i**2 / (4 pi)`` to W_l, the
equation holds with N = 0 (Wolz, Alonso and Nicola 2025, JCAP 01, 028). For the cross-spectrum of two fields, the square of
the sum over f is the product of the sums over f and g.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray

from . import _arrays
from ._arrays import Floats
from ._spectra_degree import AsArray, Degrees, central, described, finite, sums
from ._transform import Transform
from ._warnings import warn

#: Condition number of the binned coupling matrix above which a solution has no correct digits.
_MOST_CONDITION = 1e12

#: Largest relative excess of a sum of weights over 4 pi that rounding or approximate areas can explain.
_EXCESS = 0.01

#: Fraction of 4 pi below which a sum of weights gives a warning.
_SMALL = 0.5

#: Norm above which directions count as uneven: of the means, over the directions, of the 4 pi-normalised harmonics of
#: one degree, from 1 to 4.
_UNEVEN = 0.1

#: Norms times n**0.5 that n independent directions of uniform density exceed with a probability of about 1e-5: of a
#: degree, and of the zonal harmonics of degrees 2 and 4, whose norm is 0.7 on grids of latitudes and longitudes.
_BY_CHANCE = 6.0, 5.0


@dataclass(frozen=True, eq=False)
class PseudoSpectrum(AsArray):
    """The spectrum of a field times a mask. ``np.asarray`` returns `power`.

    Attributes
    ----------
    degree : ndarray of int, (L + 1,)
    power : ndarray of float, (L + 1,) or (L + 1, c)
        Mean over the orders of the squared coefficients of the field times the mask; noise isn't subtracted.
    noise : ndarray of float, () or (c,)
        What noise adds to each degree of `power`, on average.
    window : ndarray of float, (2 L + 1,)
        Spectrum of the mask, for `coupling_matrix`.
    f_sky : float
        ``(sum q m**2)**2 / (4 pi sum q m**4)`` with weights q and mask m: of a binary mask, the observed fraction of
        the sphere, if the weights are areas.
    """

    degree: Degrees
    power: Floats
    noise: Floats
    window: Floats
    f_sky: float

    def __repr__(self) -> str:
        return f"PseudoSpectrum(degrees 0 to {len(self.degree) - 1}{described(self.power)}, f_sky {self.f_sky:.4g})"


@dataclass(frozen=True, eq=False)
class BandPowers(AsArray):
    """The spectrum of a field in bins of degrees. ``np.asarray`` returns `power`.

    Attributes
    ----------
    first, last : ndarray of int, (b,)
        First and last degree of each bin.
    degree : ndarray of float, (b,)
        Midpoints of the bins.
    power : ndarray of float, (b,) or (b, c)
        Mean of C_l over the coefficients of a bin: of the squared orthonormal coefficients of each degree, as
        ``spectrum(c, unit="per_lm", convention="energy")`` and healpy's ``alm2cl`` have it; 4 pi times pyshtools'
        ``per_lm`` power.
    error : ndarray of float, (b,) or (b, c)
        Standard errors, including cosmic variance: the roots of the covariance's diagonal.
    covariance : ndarray of float, (b, b) or (b, b, c)
    windows : ndarray of float, (b, L + 1)
        ``windows @ C`` is the expectation of `power` for a spectrum C, (L + 1,).
    """

    first: Degrees
    last: Degrees
    degree: Floats
    power: Floats
    error: Floats
    covariance: Floats
    windows: Floats

    def __repr__(self) -> str:
        bins = "1 bin" if len(self.first) == 1 else f"{len(self.first)} bins"
        return f"BandPowers({bins}, degrees {self.first[0]} to {self.last[-1]}{described(self.power)})"


def coupling_matrix(window: ArrayLike, max_degree: int) -> Floats:
    """Returns the matrix from the spectrum of an isotropic field to the expected spectrum of the field times a mask.

    Both spectra are means over the orders of a degree, ``unit="per_lm"`` of `spectrum`.

    Parameters
    ----------
    window : array_like of float, (n,)
        Spectrum W_l of the mask from degree 0, the mean over the orders of its squared orthonormal coefficients, such
        as `PseudoSpectrum.window`. Degrees to 2 L are read; those beyond its end are taken as 0.
    max_degree : int
        L.

    Returns
    -------
    ndarray of float, (L + 1, L + 1)
        ``M[l, k] = (2 k + 1) / (4 pi) sum_j (2 j + 1) W_j (l k j; 0 0 0)**2`` (Hivon et al. 2002, eq. A31). It is the
        identity for the mask 1.

    Notes
    -----
    For sums over the orders, ``unit="per_l"``, the matrix is the transpose, since ``M[l, k] (2 l + 1) / (2 k + 1)`` is
    ``M[k, l]``. The transpose is pyshtools' ``SHMTCouplingMatrix(L, power)[: L + 1]``, where ``power``, (n, 1), is the window
    by degree, ``(2 l + 1) W_l / (4 pi)``.

    With ``p(n) = (2 n)! / (4**n n!**2)`` and ``2 g = l + k + j``, the square of the Wigner 3j symbol is
    ``p(g - l) p(g - k) p(g - j) / ((2 g + 1) p(g))`` for even ``l + k + j`` and 0 otherwise. p follows from a
    recurrence of positive terms; the relative error of the squares grows as the degree times epsilon. Time grows as
    L**3: about a second at degree 1,000.

    Examples
    --------
    >>> import numpy as np
    >>> from spharm_rs import spectra
    >>> np.allclose(spectra.coupling_matrix([4 * np.pi], 8), np.eye(9))
    True
    """
    degree = _arrays.whole("max_degree", max_degree)
    given = finite("window", np.atleast_1d(_arrays.real("window", window, "(n,)")))
    if given.ndim != 1 or not len(given):
        raise ValueError(f"window: expected shape (n,), found {np.shape(window)}")
    kept = np.zeros(2 * degree + 1)
    kept[: len(given)] = given[: 2 * degree + 1]
    kept *= 2.0 * np.arange(2 * degree + 1) + 1
    p = central(2 * degree + 1)
    inverse = 1 / ((2.0 * np.arange(2 * degree + 1) + 1) * p)

    # For k = l + d and j = d + 2 n, with n from 0 to l: g - k = n, g - l = d + n, g - j = l - n, g = l + d + n.
    symmetric = np.empty((degree + 1, degree + 1))
    for at in range(degree + 1):
        rows = degree + 1 - at
        terms = sliding_window_view(p, at + 1)[:rows] * sliding_window_view(kept, 2 * at + 1)[:rows, ::2]
        terms *= sliding_window_view(inverse[at:], at + 1)[:rows]
        symmetric[at, at:] = terms @ (p[: at + 1] * p[at::-1])
        symmetric[at:, at] = symmetric[at, at:]
    matrix: Floats = symmetric * (2.0 * np.arange(degree + 1) + 1) / (4 * np.pi)
    return matrix


def _weights(weights: ArrayLike | None, mask: ArrayLike | None, count: int) -> tuple[Floats, Floats]:
    """Returns the weight and the mask of each direction, (n,)."""
    areas = np.full(count, 4 * np.pi / max(count, 1))
    if weights is not None:
        areas = finite("weights", _arrays.weights(weights, count))
    kept = np.ones(count)
    if mask is not None:
        kept = _arrays.graded_mask(mask, count)
    if not (areas * kept).any():
        raise ValueError("mask: expected directions with a weight other than 0, found none")
    return areas, kept


def _noise(noise: Any, values: Floats, weights: Floats) -> Floats:
    """Returns what noise adds to each degree of a pseudo-spectrum, (c,)."""
    if isinstance(noise, str):
        if noise != "auto":
            raise ValueError(f"noise: expected standard deviations or 'auto', found {noise!r}")
        return np.asarray(((weights[:, np.newaxis] * values) ** 2).sum(axis=0) / (4 * np.pi))
    deviations = _arrays.real("noise", noise, f"() or ({len(weights)},)")
    if deviations.shape not in ((), weights.shape):
        raise ValueError(f"noise: expected a number or shape {weights.shape}, found {deviations.shape}")
    deviations = np.where(weights != 0, deviations, 0)
    if not (np.isfinite(deviations) & (deviations >= 0)).all():
        raise ValueError("noise: expected finite standard deviations of at least 0, found other values")
    return np.full(values.shape[1], ((weights * deviations) ** 2).sum() / (4 * np.pi))


def _products(first: Floats, second: Floats) -> Floats:
    """Returns the mean product of the coefficients of each degree, (degree + 1, c), given coefficients, (K, c)."""
    totals = sums(first * second)
    return np.asarray(totals / (2.0 * np.arange(len(totals)) + 1)[:, np.newaxis])


def _powers(transform: Transform, values: Floats) -> Floats:
    """Returns the mean squared coefficient of each degree of weighted samples, (degree + 1, c)."""
    found = transform.adjoint(values)
    return _products(found, found)


def _unevenness(at: Floats, shares: Floats) -> tuple[float, float]:
    """Returns the norms of the means of 4 pi-normalised harmonics, given each direction's share: the largest one of the
    degrees 1 to 4, and that of the zonal harmonics of degrees 2 and 4."""
    square = 4 * np.pi * Transform(at, 4, accuracy=1e-6, channels=1).adjoint(shares[:, np.newaxis]) ** 2
    return float(np.sqrt(sums(square)[1:].max())), float(np.sqrt(square[6, 0] + square[20, 0]))


def _warn_if_not_areas(at: Floats, areas: Floats) -> None:
    """Warns of given weights that cover the whole sphere evenly, but whose sum is far below its area, or is 1."""
    total = float(areas.sum())
    if not 0 < total < _SMALL * 4 * np.pi:
        return
    if abs(total - 1) < 1e-6 or max(_unevenness(at, areas / total)) < _UNEVEN:
        warn(
            [
                f"the weights have a sum of {total:.4g}, but areas on the unit sphere have a sum of 4 pi = 12.57 if the "
                "directions cover the sphere, so that powers can be much too small; scale the weights to the area that the "
                "directions cover, such as weights * (4 * np.pi / weights.sum()) for the whole sphere"
            ]
        )


def _warn_if_uneven(at: Floats) -> None:
    """Warns if the default weights, which are equal, aren't areas of the directions."""
    norm, zonal = _unevenness(at, np.full(len(at), 1 / len(at)))
    worst, (by_degree, by_latitude) = max(norm, zonal), _BY_CHANCE
    if worst > _UNEVEN and max(norm / by_degree, zonal / by_latitude) > len(at) ** -0.5:
        warn(
            [
                f"the directions aren't spread evenly over the sphere (unevenness {worst:.2g}; 0 is even), so that the equal "
                "default weights are wrong and powers can be much too large or small; give the areas of the "
                "samples as weights=, such as weights=grid.weights of a spectra.Grid"
            ]
        )


def _samples(
    at: Floats, values: ArrayLike, weights: ArrayLike | None, mask: ArrayLike | None, what: str = "values"
) -> tuple[Floats, Floats, Floats]:
    """Returns values, weights and mask at directions (n, 3), with 0 for values that have no weight."""
    array = _arrays.channels(what, values)
    if len(array) != len(at):
        raise ValueError(f"{what}: expected a row for each of {len(at)} directions, found shape {np.shape(values)}")
    areas, kept = _weights(weights, mask, len(at))
    return finite(what, np.where((areas * kept != 0)[:, np.newaxis], array, 0)), areas, kept


def _of_grid(at: Floats, values: Any, *others: Any) -> tuple[Any, ...]:
    """Returns values of a grid, and other arrays of its shape, in the order of its directions."""
    array, grid = _arrays.of_grid("values", values, at)
    return array, *(_arrays.raveled(given, grid) for given in others)


def pseudo_spectrum(
    directions: ArrayLike,
    values: ArrayLike,
    max_degree: int,
    *,
    mask: ArrayLike | None = None,
    weights: ArrayLike | None = None,
    noise: ArrayLike | str = 0.0,
) -> PseudoSpectrum:
    """Returns the spectrum of a field times a mask, from samples at any directions.

    Parameters
    ----------
    directions : array_like of float, (n, 3)
        Scattered, or of a quadrature or an icosphere. Vectors of any nonzero length.
    values : array_like of float, (n,) or (n, c), or of a grid, (n_latitude, n_longitude) or (n_latitude, n_longitude, c)
        With values of a grid, weights, mask and noise may have its shape. Values where the mask or the weight is 0 are never
        read, and may be NaN.
    max_degree : int
        Highest degree L, inclusive.
    mask : array_like of bool or float, (n,), optional
        Observed directions; or numbers from 0 to 1, such as an apodised mask. Masked elements of a masked array aren't
        observed. By default all.
    weights : array_like of float, (n,), optional
        Areas on the unit sphere or weights of a quadrature, such as `Grid.weights`. Their sum is 4 pi for directions over the
        whole sphere, and less if the directions cover a part of it. By default ``4 pi / n``, which is right only for
        directions that are spread evenly over the sphere: not for grids of latitudes and longitudes, and not if directions
        without a value are left out instead of masked. For n even directions over a fraction f of the sphere, give
        ``4 pi f / n`` for each.
    noise : float, array_like of float, (n,), or "auto"
        Standard deviation of the samples' noise, independent of each other and of the field. ``"auto"`` needs no
        estimate: it leaves out the pairs of a sample with itself, in the field and in the window. For scattered
        directions, it also keeps power above degree 2 L from leaking in.

    Returns
    -------
    PseudoSpectrum

    Raises
    ------
    ValueError
        If the sum of the weights is more than 4 pi, by more than 1 %.

    Warns
    -----
    SpharmWarning
        If the directions aren't spread evenly, without weights; or if the sum of weights that cover the sphere is far
        below 4 pi, such as 1.

    Notes
    -----
    If samples cover the sphere and have little noise, `spharm_rs.solve` and `spectrum` return the power of this field
    itself; here, power of other degrees leaks in from every gap and from the scatter of the directions.

    Examples
    --------
    A field of degree 8 on a grid of latitudes and longitudes:

    >>> import numpy as np
    >>> from spharm_rs import spectra
    >>> coefficients = np.random.default_rng(0).normal(size=81)
    >>> grid = spectra.grid(coefficients)
    >>> found = spectra.pseudo_spectrum(grid.directions, grid.values, 8, weights=grid.weights)
    >>> exact = spectra.spectrum(coefficients, unit="per_lm", convention="energy")
    >>> bool(np.allclose(found.power, exact.power)), found
    (True, PseudoSpectrum(degrees 0 to 8, f_sky 1))
    """
    degree = _arrays.whole("max_degree", max_degree)
    at = _arrays.positions("directions", directions)
    values, weights, mask, noise = _of_grid(at, values, weights, mask, noise)
    array, areas, kept = _samples(at, values, weights, mask)
    if (total := float(areas[kept != 0].sum())) > 4 * np.pi * (1 + _EXCESS):
        raise ValueError(
            "weights: expected areas on the unit sphere or weights of a quadrature, with a sum of at most 4 pi = 12.57, "
            f"found a sum of {total:.4g}"
        )
    double = Transform(at, 2 * degree, channels=1)
    if weights is None:
        _warn_if_uneven(at)
    else:
        _warn_if_not_areas(at, areas)
    power, added, window = _pseudo(double, array, areas * kept, noise)
    flat = np.ndim(values) == 1
    f_sky = (areas * kept**2).sum() ** 2 / (4 * np.pi * (areas * kept**4).sum())
    return PseudoSpectrum(
        np.arange(degree + 1), power[:, 0] if flat else power, added[0] if flat else added, window, float(f_sky)
    )


def _pseudo(double: Transform, values: Floats, weights: Floats, noise: ArrayLike | str) -> tuple[Floats, Floats, Floats]:
    """Returns power, (L + 1, c), noise, (c,), and window, (2 L + 1,), with a transform to degree 2 L."""
    window, added = _window(double, weights, noise), _noise(noise, values, weights)
    return _powers(_single(double, values.shape[1]), weights[:, np.newaxis] * values), added, window


def _window(double: Transform, weights: Floats, noise: ArrayLike | str) -> Floats:
    """Returns the spectrum of the weights, (2 L + 1,), without the pairs of a sample with itself if noise is "auto"."""
    window = _powers(double, weights[:, np.newaxis])[:, 0]
    return window - (weights**2).sum() / (4 * np.pi) if isinstance(noise, str) else window


def _single(double: Transform, channels: int) -> Transform:
    """Returns a transform to degree L, given one to degree 2 L."""
    return Transform(double.directions, double.max_degree // 2, channels=min(channels, 8))


def _edges(bins: Any, degree: int) -> NDArray[np.intp]:
    """Returns the first degree of each bin, and the degree after the last."""
    if isinstance(bins, (int, np.integer)) or np.ndim(bins) == 0:
        width = _arrays.whole("bins", bins, 1)
        return np.concatenate([[0], np.arange(1, degree + 1, width), [degree + 1]]).astype(np.intp)
    edges = np.asarray(bins)
    if edges.ndim != 1 or edges.dtype.kind not in "iu" or len(edges) < 2:
        raise ValueError(f"bins: expected a width, or at least 2 degrees l as edges, found {edges.dtype} of shape {edges.shape}")
    edges = edges.astype(np.intp)
    if edges[0] < 0 or edges[-1] > degree + 1 or (np.diff(edges) < 1).any():
        raise ValueError(f"bins: expected increasing degrees from 0 to {degree + 1}, found other values")
    return edges


def decoupled_spectrum(
    directions: ArrayLike,
    values: ArrayLike,
    max_degree: int,
    *,
    mask: ArrayLike | None = None,
    weights: ArrayLike | None = None,
    noise: ArrayLike | str = 0.0,
    bins: int | ArrayLike = 1,
    shape: ArrayLike | None = None,
) -> BandPowers:
    """Estimates the spectrum of an isotropic field from samples on a part of the sphere, by MASTER.

    Parameters
    ----------
    directions, values, max_degree, mask, weights, noise
        As for `pseudo_spectrum`; but a common factor of the weights cancels, so their sum doesn't matter.
    bins : int or array_like of int, (b + 1,)
        Width of the bins, from degree 1; degree 0 is a bin of its own. Or the first degree of each bin, and the degree
        after the last. Narrow bins are strongly correlated if they are narrower than 180 degrees over the mask's width
        in degrees.
    shape : array_like of float, (L + 1,), optional
        Expected spectrum, up to a factor for each bin, above 0; by default constant. If the spectrum varies much within a
        bin, give its expected form, such as ``1 / (1 + np.arange(L + 1)) ** 2``: otherwise this bin and its neighbours are
        biased.

    Returns
    -------
    BandPowers

    Raises
    ------
    ValueError
        If the mask doesn't determine the bins. The message has the narrowest width of bins that it does determine.

    Warns
    -----
    SpharmWarning
        If the directions aren't spread evenly, without weights.

    Notes
    -----
    Which function to use: for samples over the sphere with little noise, also scattered ones, `spharm_rs.solve` and
    `spectrum` return the power of this field without a statistical error. This function is for gaps wider than about
    180 / L degrees, over which single coefficients aren't determined; and for noise of an unknown size, by
    ``noise="auto"``. It estimates the spectrum of the process, with cosmic variance.

    Assumptions: the field is isotropic; mask, directions and noise are independent of it; and it has no power outside
    the bins. If it has power above L, choose L larger than needed, and leave out the last bins: leakage decreases with
    the distance in degrees as the mask's spectrum does. For scattered directions that tends to a constant, unless
    ``noise="auto"``. Subtract a large mean of the samples first.

    The bins are those of Hivon et al. (2002, eq. 20 to 25), with the mean over a bin's coefficients and `shape` in
    place of their l (l + 1). `covariance` assumes a Gaussian field whose spectrum varies slowly compared with the
    coupling matrix (Efstathiou 2004, MNRAS 349, 603): ``cov(P_l, P_k) = 2 T_l T_k X_lk / (2 k + 1)``, where X is the
    coupling matrix of the squared mask, and T is P over the mean squared mask. Noise is treated as if it were spread
    over the sphere as the field is.

    Examples
    --------
    >>> import numpy as np, spharm_rs as sp
    >>> from spharm_rs import spectra
    >>> directions = sp.icosphere(4).vertices
    >>> rng = np.random.default_rng(0)
    >>> values = sp.Transform(directions, 12).synthesis(rng.normal(size=169))
    >>> found = spectra.decoupled_spectrum(directions, values, 12, mask=abs(directions[:, 2]) > 0.2, bins=4)
    >>> bool((abs(found.power - 1) < 4 * found.error).all())
    True
    """
    degree = _arrays.whole("max_degree", max_degree)
    edges, expected = _edges(bins, degree), _shape(shape, degree)
    at = _arrays.positions("directions", directions)
    values, weights, mask, noise = _of_grid(at, values, weights, mask, noise)
    array, areas, kept = _samples(at, values, weights, mask)
    double = Transform(at, 2 * degree, channels=1)
    if weights is None:
        _warn_if_uneven(at)
    pseudo, added, window = _pseudo(double, array, areas * kept, noise)
    return _decoupled(double, (areas, kept), window, (edges, expected), (pseudo, pseudo, pseudo), added, np.ndim(values) == 1)


def decoupled_cross_spectrum(
    directions: ArrayLike,
    a: ArrayLike,
    b: ArrayLike,
    max_degree: int,
    *,
    mask: ArrayLike | None = None,
    weights: ArrayLike | None = None,
    noise: float | str = 0.0,
    bins: int | ArrayLike = 1,
    shape: ArrayLike | None = None,
) -> BandPowers:
    """Estimates the cross-spectrum of two isotropic fields from samples of both at the same directions.

    Parameters
    ----------
    directions, max_degree, mask, weights, bins, shape
        As for `decoupled_spectrum`; ``shape`` is that of the cross-spectrum.
    a, b : array_like of float, (n,) or (n, c), or of a grid
        Samples of the two fields, with the same number of channels, or one. With values of a grid, weights and mask may have
        its shape.
    noise : 0 or "auto"
        0 for samples whose noise isn't correlated between a and b. ``"auto"`` also allows correlated noise that is
        independent from sample to sample: it leaves out the pairs of a sample with itself.

    Returns
    -------
    BandPowers
        Powers of either sign.

    Notes
    -----
    As for `decoupled_spectrum`, with ``cov(P_l, P_k) = (sqrt(A_l A_k B_l B_k) + T_l T_k) X_lk / (2 k + 1)``, where A, B
    and T are the spectra of a and b and their cross-spectrum, over the mean squared mask.

    Examples
    --------
    The correlation of two fields by degree, from two thirds of the sphere:

    >>> import numpy as np, spharm_rs as sp
    >>> from spharm_rs import spectra
    >>> directions = sp.icosphere(4).vertices
    >>> fields = np.random.default_rng(0).normal(size=(169, 2)) @ [[1.0, 0.6], [0.0, 0.8]]
    >>> a, b = sp.Transform(directions, 12).synthesis(fields).T
    >>> seen = {"mask": abs(directions[:, 2]) > 1 / 3, "bins": 4}
    >>> cross = spectra.decoupled_cross_spectrum(directions, a, b, 12, **seen)
    >>> own = [spectra.decoupled_spectrum(directions, field, 12, **seen) for field in (a, b)]
    >>> (cross.power / np.sqrt(own[0].power * own[1].power)).round(1)[1:]
    array([0.8, 0.5, 0.6])
    """
    degree = _arrays.whole("max_degree", max_degree)
    edges, expected = _edges(bins, degree), _shape(shape, degree)
    if not (isinstance(noise, str) and noise == "auto") and not (np.ndim(noise) == 0 and noise == 0):
        raise ValueError(f"noise: expected 0 or 'auto', found {noise!r}")
    at = _arrays.positions("directions", directions)
    a, of_a = _arrays.of_grid("a", a, at)
    b, of_b = _arrays.of_grid("b", b, at)
    weights, mask = (_arrays.raveled(given, of_a or of_b) for given in (weights, mask))
    first, areas, kept = _samples(at, a, weights, mask, "a")
    second, _, _ = _samples(at, b, weights, mask, "b")
    if 1 not in (first.shape[1], second.shape[1]) and first.shape[1] != second.shape[1]:
        raise ValueError(f"b: expected 1 channel or {first.shape[1]}, as in a; found {second.shape[1]}")
    double, w = Transform(at, 2 * degree, channels=1), areas * kept
    if weights is None:
        _warn_if_uneven(at)
    window = _window(double, w, noise)
    added = (w[:, np.newaxis] ** 2 * first * second).sum(axis=0) / (4 * np.pi) if noise == "auto" else np.zeros(1)
    single = _single(double, max(first.shape[1], second.shape[1]))
    x, y = (single.adjoint(w[:, np.newaxis] * field) for field in (first, second))
    powers = _products(x, y), _products(x, x), _products(y, y)
    flat = np.ndim(a) == np.ndim(b) == 1
    return _decoupled(double, (areas, kept), window, (edges, expected), powers, added, flat)


def _shape(shape: ArrayLike | None, degree: int) -> Floats:
    """Returns the expected spectrum, (L + 1,)."""
    if shape is None:
        return np.ones(degree + 1)
    expected = finite("shape", np.atleast_1d(_arrays.real("shape", shape, f"({degree + 1},)")))
    if expected.shape != (degree + 1,) or (expected <= 0).any():
        raise ValueError(f"shape: expected {degree + 1} numbers above 0, found shape {expected.shape}, or numbers of 0 or less")
    return expected


def _binned(coupling: Floats, edges: NDArray[np.intp], expected: Floats) -> tuple[Floats, Floats, Floats]:
    """Returns each degree's share of the coefficients of a bin, the shares over the expected spectrum, both (b, L + 1), and the
    coupling matrix of the bins, (b, b)."""
    degrees = np.arange(len(expected))
    inside = (degrees >= edges[:-1, np.newaxis]) & (degrees < edges[1:, np.newaxis])
    share = np.where(inside, 2.0 * degrees + 1, 0)
    share /= share.sum(axis=1, keepdims=True)
    average = share / expected
    return share, average, average @ coupling @ (inside * expected).T


def _narrowest(coupling: Floats, expected: Floats) -> int | None:
    """Returns the least width of the bins that a mask determines."""
    degree = len(expected) - 1
    for width in range(1, degree + 1):
        if np.linalg.cond(_binned(coupling, _edges(width, degree), expected)[2]) < _MOST_CONDITION:
            return width
    return None


def _decoupled(
    double: Transform,
    weights: tuple[Floats, Floats],
    window: Floats,
    bins: tuple[NDArray[np.intp], Floats],
    powers: tuple[Floats, Floats, Floats],
    added: Floats,
    flat: bool,
) -> BandPowers:
    """Returns the powers of bins, given the pseudo-spectra of the products of two fields and of each field, (L + 1, c)."""
    (areas, kept), (edges, expected) = weights, bins
    degree = len(expected) - 1
    coupling = coupling_matrix(window, degree)
    degrees = np.arange(degree + 1)
    share, average, binned = _binned(coupling, edges, expected)
    condition = np.linalg.cond(binned)
    if not condition < _MOST_CONDITION:
        width = _narrowest(coupling, expected)
        wider = "no width of bins suffices" if width is None else f"the narrowest width that suffices is bins={width}"
        raise ValueError(
            f"bins: expected bins wide enough for the mask, found a condition number of {condition:.0e}; {wider}. Errors are "
            "small if bins are about as wide as 180 divided by the mask's width in degrees"
        )
    # From the pseudo-spectrum to the mean power of each bin.
    solve = (share @ expected)[:, np.newaxis] * np.linalg.solve(binned, average)
    power = solve @ (powers[0] - added)

    squared = _powers(double, (areas * kept**2)[:, np.newaxis])[:, 0]
    spread = coupling_matrix(squared, degree) / (2.0 * degrees + 1)
    product, first, second = (total / ((areas * kept**2).sum() / (4 * np.pi)) for total in powers)
    terms = [np.stack([(solve * t) @ spread @ (solve * t).T for t in total.T], axis=-1) for total in (product, np.sqrt(first * second))]
    covariance = terms[0] + terms[1]
    error = np.sqrt(np.maximum(np.einsum("bbc->bc", covariance), 0))
    return BandPowers(
        edges[:-1],
        edges[1:] - 1,
        (edges[:-1] + edges[1:] - 1) / 2,
        power[:, 0] if flat else power,
        error[:, 0] if flat else error,
        covariance[..., 0] if flat else covariance,
        solve @ coupling,
    )
