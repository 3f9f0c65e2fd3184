"""Power by degree: spectra, cross-spectra, admittance and correlation of coefficients.

With coefficients f and g of the 4 pi-normalised harmonics, whose mean square over the sphere is 1,

    S_fg(l) = sum_m f_lm g_lm,

so that by Parseval's theorem ``sum_l S_ff(l)`` is the mean square of f over the sphere.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _arrays
from ._arrays import Floats
from ._model_values import Values
from ._pyshtools import SHCoeffs
from .convert import _NORMALIZATIONS, _norms_over_4pi, degree_of, from_pyshtools

Degrees = NDArray[np.intp]

_UNITS = ("per_l", "per_lm", "per_dlogl")
_CONVENTIONS = ("power", "energy", "l2norm")


class AsArray:
    """Base of results that ``np.asarray`` converts to one of their attributes."""

    _values: ClassVar[str] = "power"

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        values: NDArray[Any] = getattr(self, self._values)
        array = values if dtype is None else values.astype(dtype, copy=False)
        if copy is False and array is not values:
            raise ValueError(f"copy: expected True or None for a conversion to {np.dtype(dtype)}, found False")
        return array.copy() if copy else array


def described(values: Floats) -> str:
    """Returns the number of channels of values by degree for a result's representation; nothing for (n,)."""
    return "" if values.ndim == 1 else f", {values.shape[1]} channel{'s'[: values.shape[1] != 1]}"


@dataclass(frozen=True, eq=False)
class Spectrum(AsArray):
    """The power of each degree. ``np.asarray`` returns `power`.

    Attributes
    ----------
    degree : ndarray of int, (L + 1,)
    power : ndarray of float, (L + 1,) or (L + 1, c)
        In the given unit and convention; for a cross-spectrum, of either sign.
    sample_error : ndarray of float, (L + 1,) or (L + 1, c)
        Standard error of `power` as an estimate of the spectrum of a process, of which the field is one realisation:
        isotropic and Gaussian. Also called cosmic variance.
    noise_error : ndarray of float, (L + 1,) or (L + 1, c), or None
        Standard error of `power` as an estimate of this field's power, from the standard errors of its coefficients;
        None without them.
    noise : ndarray of float, (L + 1,) or (L + 1, c), or None
        Expected part of the coefficients' errors in `power`, which isn't subtracted; 0 for a cross-spectrum.
    unit, convention : str
        As given to `spectrum`.
    """

    degree: Degrees
    power: Floats
    sample_error: Floats
    noise_error: Floats | None
    noise: Floats | None
    unit: str
    convention: str

    def __repr__(self) -> str:
        return f"Spectrum(degrees 0 to {len(self.degree) - 1}{described(self.power)}, {self.unit}, {self.convention})"


@dataclass(frozen=True, eq=False)
class Admittance(AsArray):
    """The admittance of each degree. ``np.asarray`` returns `admittance`.

    Attributes
    ----------
    degree : ndarray of int, (L + 1,)
    admittance : ndarray of float, (L + 1,) or (L + 1, c)
        ``S_ab / S_bb``, in a's unit divided by b's; NaN where b has no power.
    error : ndarray of float, (L + 1,) or (L + 1, c)
        Standard error; NaN at degree 0.
    """

    degree: Degrees
    admittance: Floats
    error: Floats

    _values: ClassVar[str] = "admittance"

    def __repr__(self) -> str:
        return f"Admittance(degrees 0 to {len(self.degree) - 1}{described(self.admittance)})"


@dataclass(frozen=True, eq=False)
class Correlation(AsArray):
    """The correlation of each degree. ``np.asarray`` returns `correlation`.

    Attributes
    ----------
    degree : ndarray of int, (L + 1,)
    correlation : ndarray of float, (L + 1,) or (L + 1, c)
        From -1 to 1; NaN where a field has no power.
    confidence : ndarray of float, (L + 1,) or (L + 1, c)
        Probability that the correlation of independent Gaussian fields has a smaller absolute value; NaN at degree 0.
    """

    degree: Degrees
    correlation: Floats
    confidence: Floats

    _values: ClassVar[str] = "correlation"

    def __repr__(self) -> str:
        return f"Correlation(degrees 0 to {len(self.degree) - 1}{described(self.correlation)})"


def finite(what: str, array: Floats) -> Floats:
    bad = ~np.isfinite(array)
    if bad.any():
        row = int(bad.reshape(len(array), -1).any(axis=1).argmax())
        raise ValueError(f"{what}: expected finite numbers, found NaN or infinity in row {row}")
    return array


def _of(values: ArrayLike | SHCoeffs) -> ArrayLike:
    """Returns coefficients as an array: also those of a model or, made orthonormal, of a pyshtools object, (K,)."""
    if isinstance(values, Values):
        return values.coefficients
    return from_pyshtools(values)[:, 0] if isinstance(values, SHCoeffs) else values


def _coefficients(what: str, values: ArrayLike) -> tuple[Floats, int]:
    array = _arrays.channels(what, values)
    return finite(what, array), degree_of(what, len(array))


def _fraction(f_sky: Any) -> float:
    if isinstance(f_sky, bool) or not isinstance(f_sky, (int, float, np.number)) or not 0 < f_sky <= 1:
        raise ValueError(f"f_sky: expected a fraction of the sphere above 0 and up to 1, found {f_sky!r}")
    return float(f_sky)


def sums(array: Floats) -> Floats:
    """Adds the rows of each degree, (L + 1, c)."""
    found: Floats = np.add.reduceat(array, np.arange(round(len(array) ** 0.5)) ** 2)
    return found


def _pair(a: ArrayLike, b: ArrayLike) -> tuple[Floats, Floats, tuple[int, ...]]:
    """Returns the coefficients of two fields to the lower of their degrees, and the shape of a result by degree."""
    (first, degree), (second, other) = _coefficients("a", a), _coefficients("b", b)
    if 1 not in (first.shape[1], second.shape[1]) and first.shape[1] != second.shape[1]:
        raise ValueError(f"b: expected 1 channel or {first.shape[1]}, as in a; found {second.shape[1]}")
    degree = min(degree, other)
    rows = (degree + 1) ** 2
    flat = np.ndim(a) == np.ndim(b) == 1
    shape = (degree + 1,) if flat else (degree + 1, max(first.shape[1], second.shape[1]))
    return first[:rows], second[:rows], shape


def _products(first: Floats, second: Floats) -> tuple[Floats, Floats, Floats]:
    """Returns S_aa, S_bb and S_ab of two fields, each (L + 1, c)."""
    return sums(first**2), sums(second**2), sums(first * second)


def _scaled(coefficients: Floats) -> tuple[Floats, NDArray[np.intc]]:
    """Returns coefficients with the largest of each degree between 0.5 and 1, so that squares neither overflow nor
    underflow, and the exponents of the powers of 2 by which they were divided, (L + 1, c)."""
    degrees = round(len(coefficients) ** 0.5)
    powers = np.frexp(np.maximum.reduceat(abs(coefficients), np.arange(degrees) ** 2))[1]
    return np.ldexp(coefficients, -np.repeat(powers, 2 * np.arange(degrees) + 1, axis=0)), powers


def _errors(what: str, errors: ArrayLike, given: ArrayLike, rows: int) -> Floats:
    array = finite(what, _arrays.channels(what, errors))
    if np.shape(errors) != np.shape(given):
        raise ValueError(f"{what}: expected the coefficients' shape {np.shape(given)}, found {np.shape(errors)}")
    if (array < 0).any():
        raise ValueError(f"{what}: expected standard errors of at least 0, found a negative number")
    return array[:rows]


def _scale(degree: int, unit: str, convention: str, base: float) -> Floats:
    """Returns the factor from the power of each degree to a unit and convention, (L + 1, 1)."""
    if isinstance(base, bool) or not isinstance(base, (int, float, np.number)) or not (np.isfinite(base) and base > 1):
        raise ValueError(f"base: expected a number above 1, found {base!r}")
    degrees = np.arange(degree + 1)
    scale = np.ones(degree + 1)
    if _arrays.choice("unit", unit, _UNITS) == "per_lm":
        scale = 1 / (2.0 * degrees + 1)
    elif unit == "per_dlogl":
        scale = degrees * np.log(base)
    if _arrays.choice("convention", convention, _CONVENTIONS) == "energy":
        scale = scale * (4 * np.pi)
    return np.asarray(scale)[:, np.newaxis]


def _own_normalization(normalization: str, *given: object) -> None:
    """Refuses a normalisation for an object that has its own."""
    if normalization not in ("orthonormal", "ortho") and any(isinstance(values, SHCoeffs) for values in given):
        raise ValueError(
            f"normalization: expected none with an SHCoeffs of pyshtools, which has its own; found {normalization!r}"
        )


def _scaled_norms(degree: int, normalization: str, convention: str) -> Floats:
    _arrays.choice("normalization", normalization, _NORMALIZATIONS)
    if convention != "l2norm":
        return _norms_over_4pi(degree, normalization)
    if normalization == "unnorm":
        raise ValueError("convention: expected power or energy with normalization 'unnorm', found 'l2norm'")
    return _norms_over_4pi(degree, "4pi")


def spectrum(
    coefficients: ArrayLike | SHCoeffs,
    *,
    normalization: str = "orthonormal",
    unit: str = "per_l",
    base: float = 10.0,
    convention: str = "power",
    errors: ArrayLike | None = None,
    f_sky: float = 1.0,
) -> Spectrum:
    """Returns the power spectrum of a field, with the units and conventions of pyshtools.

    Parameters
    ----------
    coefficients : array_like of float, (K,) or (K, c), Model, or SHCoeffs
        Row ``l**2 + l + m``. An ``SHCoeffs`` of pyshtools is first converted from its own normalisation and phase to this
        package's, as by `convert.from_pyshtools`.
    normalization : {"orthonormal", "4pi", "schmidt", "unnorm"}
        Normalisation of the coefficients; this package's are orthonormal (pyshtools' name ``"ortho"`` is accepted).
        ``"unnorm"`` to degree 150.
    unit : {"per_l", "per_lm", "per_dlogl"}
        Sum over the orders of a degree; mean over them; or the sum for an interval 1 of ``log_base(l)``, which is the
        sum times ``l * log(base)``.
    base : float
        Base of the logarithm for ``per_dlogl``.
    convention : {"power", "energy", "l2norm"}
        Mean square over the sphere; integral of the square, which is 4 pi times the mean; or sum of the squared
        coefficients whatever their normalisation.
    errors : array_like of float, (K,) or (K, c), optional
        Standard errors of the coefficients, assumed independent and Gaussian; by default a model's `Model.standard_errors`,
        if it has them.
    f_sky : float
        Fraction of the sphere that was observed, for ``sample_error``.

    Returns
    -------
    Spectrum

    Notes
    -----
    The C_l of cosmology is ``unit="per_lm", convention="energy"``, as healpy's ``alm2cl`` returns.

    ``sample_error`` is ``sqrt(2 / ((2 l + 1) f_sky))`` times the power (Knox 1995, without noise;
    Scott, Srednicki and White 1994 for f_sky). For a coefficient with true value a and standard error s, the square of
    its estimate has variance ``4 a**2 s**2 + 2 s**4``; ``noise_error`` adds these, with a**2 estimated by the square
    less s**2, at least 0 in sum.

    pyshtools 4.14 divides ``l2norm`` of ``"ortho"`` by 4 pi and of ``"schmidt"`` by ``2 l + 1``, unlike its
    documentation; here it is the sum of squares.

    Examples
    --------
    >>> import numpy as np
    >>> from spharm_rs import spectra
    >>> coefficients = np.zeros(9)
    >>> coefficients[6] = 3.0
    >>> spectra.spectrum(coefficients, convention="energy").power
    array([0., 0., 9.])
    """
    _own_normalization(normalization, coefficients)
    if errors is None and isinstance(coefficients, Values):
        errors = coefficients.standard_errors
    coefficients = _of(coefficients)
    array, degree = _coefficients("coefficients", coefficients)
    scale = _scale(degree, unit, convention, base)
    norms = _scaled_norms(degree, normalization, convention)
    shape = (degree + 1, *np.shape(coefficients)[1:])
    power = scale * sums((array * norms) ** 2)
    sample = np.sqrt(2 / ((2.0 * np.arange(degree + 1) + 1) * _fraction(f_sky)))[:, np.newaxis] * power
    noise = noise_error = None
    if errors is not None:
        square = (_errors("errors", errors, coefficients, len(array)) * norms) ** 2
        noise = (scale * sums(square)).reshape(shape)
        signal = np.maximum(sums(square * ((array * norms) ** 2 - square)), 0)
        noise_error = (scale * np.sqrt(4 * signal + 2 * sums(square**2))).reshape(shape)
    return Spectrum(
        np.arange(degree + 1), power.reshape(shape), sample.reshape(shape), noise_error, noise, unit, convention
    )


def cross_spectrum(
    a: ArrayLike | SHCoeffs,
    b: ArrayLike | SHCoeffs,
    *,
    normalization: str = "orthonormal",
    unit: str = "per_l",
    base: float = 10.0,
    convention: str = "power",
    errors: tuple[ArrayLike, ArrayLike] | None = None,
    f_sky: float = 1.0,
) -> Spectrum:
    """Returns the cross-power spectrum of two fields, to the lower of their degrees.

    Parameters
    ----------
    a, b : array_like of float, (K,) or (K, c), Model, or SHCoeffs
        Coefficients of the fields, as for `spectrum`. One of them may have one channel, which is paired with each of the other's.
    normalization, unit, base, convention, f_sky
        As for `spectrum`.
    errors : (array_like, array_like), optional
        Standard errors of the coefficients of a and of b, of their shapes, independent of each other. Unlike in `spectrum`,
        those of models aren't used by default, because errors of fits at the same points needn't be independent.

    Returns
    -------
    Spectrum
        Its ``sample_error`` is ``sqrt((S_ab**2 + S_aa S_bb) / ((2 l + 1) f_sky))``.
    """
    _own_normalization(normalization, a, b)
    a, b = _of(a), _of(b)
    first, second, shape = _pair(a, b)
    degree = shape[0] - 1
    scale = _scale(degree, unit, convention, base)
    norms = _scaled_norms(degree, normalization, convention)
    first, second = first * norms, second * norms
    aa, bb, cross = _products(first, second)
    counts = (2.0 * np.arange(degree + 1) + 1)[:, np.newaxis] * _fraction(f_sky)
    sample = np.sqrt((cross**2 + aa * bb) / counts)
    noise = noise_error = None
    if errors is not None:
        if not isinstance(errors, (tuple, list)) or len(errors) != 2:
            raise ValueError(f"errors: expected a pair, the errors of a and of b, found {type(errors).__name__}")
        s = (_errors("errors[0]", errors[0], a, len(first)) * norms) ** 2
        t = (_errors("errors[1]", errors[1], b, len(first)) * norms) ** 2
        # The variance of a product of estimates is a**2 t + b**2 s + s t.
        signal = np.maximum(sums(first**2 * t + second**2 * s - 2 * s * t), 0)
        noise_error = (scale * np.sqrt(signal + sums(s * t))).reshape(shape)
        noise = np.zeros(shape)
    return Spectrum(
        np.arange(degree + 1),
        (scale * cross).reshape(shape),
        (scale * sample).reshape(shape),
        noise_error,
        noise,
        unit,
        convention,
    )


def admittance(a: ArrayLike | SHCoeffs, b: ArrayLike | SHCoeffs) -> Admittance:
    """Returns the admittance of a field a, such as gravity, to a field b, such as topography.

    If ``a_lm = Z_l b_lm + n_lm`` with noise n independent of b, the admittance estimates Z.

    Parameters
    ----------
    a, b : array_like of float, (K,) or (K, c), Model, or SHCoeffs
        Coefficients of one normalisation, as for `cross_spectrum`.

    Returns
    -------
    Admittance
        ``S_ab / S_bb`` to the lower of both degrees, with standard error
        ``sqrt(S_aa / S_bb (1 - correlation**2) / (2 l))``, as pyshtools' ``SHAdmitCorr``.
    """
    first, second, shape = _pair(_of(a), _of(b))
    degree = shape[0] - 1
    (first, above), (second, below) = _scaled(first), _scaled(second)
    aa, bb, ab = _products(first, second)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.where(bb > 0, ab / bb, np.nan)
        # S_aa - Z**2 S_bb, which rounding can make negative.
        rest = np.maximum(aa - ab * ratio, 0)
        error = np.sqrt(rest / bb / (2.0 * np.arange(degree + 1))[:, np.newaxis])
    error[0] = np.nan
    with np.errstate(over="ignore", under="ignore"):
        ratio, error = (np.ldexp(values, above - below) for values in (ratio, error))
    return Admittance(np.arange(degree + 1), ratio.reshape(shape), error.reshape(shape))


def central(count: int) -> Floats:
    """Returns ``(2 k)! / (4**k k!**2)`` for k < count, by the recurrence from 1, whose factors are below 1."""
    k = np.arange(1, max(count, 1))
    return np.concatenate([[1.0], np.cumprod((2.0 * k - 1) / (2.0 * k))])


def correlation(a: ArrayLike | SHCoeffs, b: ArrayLike | SHCoeffs) -> Correlation:
    """Returns the correlation of two fields by degree.

    Parameters
    ----------
    a, b : array_like of float, (K,) or (K, c), Model, or SHCoeffs
        Coefficients of one normalisation, as for `cross_spectrum`.

    Returns
    -------
    Correlation
        ``S_ab / sqrt(S_aa S_bb)`` to the lower of both degrees. Its ``confidence`` is the distribution function of
        Student's t with 2 l degrees of freedom (Pauer, Fleming and Cadek 2006, eq. A7), as pyshtools'
        ``SHConfidence``.
    """
    first, second, shape = _pair(_of(a), _of(b))
    degree = shape[0] - 1
    aa, bb, ab = _products(_scaled(first)[0], _scaled(second)[0])
    with np.errstate(invalid="ignore", divide="ignore"):
        r = np.clip(ab / np.sqrt(aa) / np.sqrt(bb), -1, 1)
    confidence = np.full(r.shape, np.nan)
    factors = central(degree)
    for at in range(1, degree + 1):
        powers = (1 - r[at] ** 2) ** np.arange(at)[:, np.newaxis]
        confidence[at] = np.minimum(abs(r[at]) * (factors[:at] @ powers), 1)
    return Correlation(np.arange(degree + 1), r.reshape(shape), confidence.reshape(shape))
