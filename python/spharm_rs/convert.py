"""Converts coefficients from and to the conventions of other packages.

In this package a function is ``sum a[l, m] S[l, m]`` with real orthonormal harmonics without the Condon-Shortley phase;
row ``l**2 + l + m`` holds degree l and order m, and negative m stand for sin(abs(m) phi). Such coefficients are called
canonical. Degrees are inclusive; the L of s2fft and FlowShape is the number of degrees, L + 1 here.

==============  =====================================================================================================
format          array
==============  =====================================================================================================
``complex``     complex (K, c), row ``l**2 + l + m``: orthonormal, with the Condon-Shortley phase, as SciPy's
                ``sph_harm_y``
``pyshtools``   real (c, 2, L + 1, L + 1): ``SHCoeffs.from_array(.., normalization="ortho", csphase=1)`` of each channel.
                pyshtools' own default is ``"4pi"``: give ``normalization="4pi"`` for it. An ``SHCoeffs`` has its own
``healpy``      complex (c, (L + 1) (L + 2) / 2): ``alm`` of healpy and ducc0, m by m
``s2fft``       complex (c, L + 1, 2 L + 1): ``flm`` of s2fft, orders from -L
``spharm_mat``  complex (K, c): ``fvec`` of SPHARM-MAT, which is ``complex``
``spharm_pdm``  real (K, 3): rows of a SPHARM-PDM ``.coef`` file
``ktch``        real (c, K): ktch's coefficients, canonical
``flowshape``   real (K, c): FlowShape's, with the phase
==============  =====================================================================================================

Examples
--------
>>> import numpy as np, spharm_rs as sp
>>> model = sp.Model(np.arange(12.0).reshape(4, 3))
>>> model.to("pyshtools").shape
(3, 2, 2, 2)
>>> np.allclose(sp.Model.from_("pyshtools", model.to("pyshtools")).coefficients, model.coefficients)
True
>>> of_4pi = sp.convert.to("pyshtools", model.coefficients, normalization="4pi")
>>> np.allclose(sp.convert.from_("pyshtools", of_4pi, normalization="4pi"), model.coefficients)
True
"""

from __future__ import annotations

import inspect
import os
import re
from pathlib import Path
from typing import Any, Callable, Sequence, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _arrays
from ._arrays import Floats
from ._pyshtools import SHCoeffs, real_coefficients
from ._warnings import warn

Complex = NDArray[np.complex128]

__all__ = [
    "FORMATS",
    "degrees_and_orders",
    "from_",
    "from_complex",
    "from_flowshape",
    "from_healpy",
    "from_ktch",
    "from_pyshtools",
    "from_s2fft",
    "from_spharm_mat",
    "from_spharm_pdm",
    "read_spharm_pdm",
    "to",
    "to_complex",
    "to_flowshape",
    "to_healpy",
    "to_ktch",
    "to_pyshtools",
    "to_s2fft",
    "to_spharm_mat",
    "to_spharm_pdm",
    "write_spharm_pdm",
]


#: How to keep both parts of a complex function.
_BOTH = "for both parts, convert array and -1j * array, and use them as two channels"

#: Size of an imaginary part, relative to that of all coefficients, up to which it is ignored as rounding errors.
_ROUNDING = 1e-6


def degree_of(what: str, rows: int) -> int:
    degree = int(round(rows**0.5)) - 1
    if rows == 0 or (degree + 1) ** 2 != rows:
        raise ValueError(f"{what}: expected (L + 1)**2 rows, found {rows}")
    return degree


def _canonical(coefficients: ArrayLike) -> tuple[Floats, int]:
    array = _arrays.channels("coefficients", coefficients)
    return array, degree_of("coefficients", len(array))


def degrees_and_orders(max_degree: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Returns the degree and the order of each row of coefficients, (K,) with K = (L + 1)**2.

    Parameters
    ----------
    max_degree : int
        Highest degree L.

    Examples
    --------
    >>> from spharm_rs import convert
    >>> degrees, orders = convert.degrees_and_orders(1)
    >>> degrees.tolist(), orders.tolist()
    ([0, 1, 1, 1], [0, -1, 0, 1])
    """
    degree = _arrays.whole("max_degree", max_degree)
    degrees = np.repeat(np.arange(degree + 1), 2 * np.arange(degree + 1) + 1)
    return degrees, np.arange((degree + 1) ** 2) - degrees * (degrees + 1)


def _complex(what: str, array: ArrayLike, dimensions: int) -> Complex:
    found = np.asarray(array)
    if found.dtype.kind not in "fiuc" or found.ndim != dimensions:
        raise ValueError(f"{what}: expected {dimensions} dimensions of numbers, found {found.dtype} of shape {found.shape}")
    return np.asarray(found, dtype=np.complex128)


def to_complex(coefficients: ArrayLike) -> Complex:
    """Returns complex coefficients, (K, c), with the Condon-Shortley phase."""
    a, degree = _canonical(coefficients)
    degrees, orders = degrees_and_orders(degree)
    mirrored = degrees * (degrees + 1) - orders
    sign = np.where(orders % 2, -1.0, 1.0)[:, np.newaxis] / np.sqrt(2)
    order = orders[:, np.newaxis]
    positive = sign * (a - 1j * a[mirrored])
    negative = a[mirrored] + 1j * a
    found: Complex = np.where(order > 0, positive, np.where(order < 0, negative / np.sqrt(2), a))
    return found


def from_complex(array: ArrayLike) -> Floats:
    """Returns canonical coefficients, (K, c), of the real part of a complex series.

    A warning states the share of the power that is lost if the series isn't real. Such a series has two real functions:
    c is the series of its real part, and -1j * c that of its imaginary part.
    """
    return _real_part("complex", _complex("complex", array, 2), _BOTH)


def _real_part(what: str, c: Complex, advice: str) -> Floats:
    degrees, orders = degrees_and_orders(degree_of(what, len(c)))
    mirrored = c[degrees * (degrees + 1) - orders]
    sign = np.where(orders % 2, -1.0, 1.0)[:, np.newaxis]
    order = orders[:, np.newaxis]
    # For m > 0, the real part of a series has the coefficients (c_m + (-1)^m conj c_-m) / 2.
    half = (c + sign * mirrored.conj()) / 2
    cosine = np.sqrt(2) * sign * half.real
    sine = -np.sqrt(2) * sign * ((mirrored + sign * c.conj()) / 2).imag
    found: Floats = np.where(order > 0, cosine, np.where(order < 0, sine, c.real))
    # The rest of the series belongs to the imaginary part.
    lost, size = float(np.linalg.norm(c - half)), float(np.linalg.norm(c))
    if np.isfinite(size) and lost > _ROUNDING * size:
        share = f"{100 * (lost / size) ** 2:.3g} % of the power"
        warn([f"{what}: expected coefficients of a real function; dropped the imaginary part, which has {share}; {advice}"])
    return found


def to_pyshtools(coefficients: ArrayLike, *, normalization: str = "ortho", csphase: int = 1) -> Floats:
    """Converts to pyshtools' coefficients, (c, 2, L + 1, L + 1).

    Parameters
    ----------
    coefficients : array_like of float, (K, c)
    normalization : {"ortho", "orthonormal", "4pi", "schmidt", "unnorm"}
        Normalisation of the result; the first two names mean the same. pyshtools' own default is ``"4pi"``: for results
        in another normalisation, ``SHCoeffs.from_array`` needs ``normalization=``, too. The largest degree for
        ``"unnorm"`` is 150.
    csphase : {1, -1}
        -1 for coefficients of harmonics with the Condon-Shortley phase.

    Returns
    -------
    ndarray of float, (c, 2, L + 1, L + 1)
        Index ``[k, 0, l, m]`` for cosines and ``[k, 1, l, m]`` for sines. Standard errors are converted as coefficients are;
        with ``csphase=-1``, those of odd orders become negative: take ``abs`` of the result.

    Examples
    --------
    >>> import numpy as np
    >>> from spharm_rs import convert
    >>> constant = np.sqrt(4 * np.pi) * np.eye(1)
    >>> convert.to_pyshtools(constant, normalization="4pi")[0, 0].round(12).tolist()
    [[1.0]]
    """
    a, degree = _canonical(coefficients)
    a = a * _pyshtools_factors(degree, normalization, csphase)
    degrees, orders = degrees_and_orders(degree)
    found = np.zeros((a.shape[1], 2, degree + 1, degree + 1))
    found[:, (orders < 0).astype(int), degrees, abs(orders)] = a.T
    return found


def from_pyshtools(
    array: ArrayLike | SHCoeffs | Sequence[SHCoeffs], *, normalization: str | None = None, csphase: int | None = None
) -> Floats:
    """Converts pyshtools' coefficients to canonical ones, (K, c).

    Parameters
    ----------
    array : SHCoeffs, sequence of SHCoeffs, or array_like of float, (2, L + 1, L + 1) or (c, 2, L + 1, L + 1)
        Objects of pyshtools, of which each is a channel; or their arrays ``coeffs``. Objects may also be of the kind
        "complex", if they describe a real function.
    normalization : {"ortho", "orthonormal", "4pi", "schmidt", "unnorm"}, optional
        Normalisation of the array, by default ``"ortho"``. pyshtools' own default is ``"4pi"``; an array doesn't record
        its normalisation. Objects have a normalisation of their own.
    csphase : {1, -1}, optional
        Phase of the array, by default 1, as for `to_pyshtools`. Objects have a phase of their own.

    Returns
    -------
    ndarray of float, (K, c)

    Raises
    ------
    ValueError
        If the shape is wrong; if an option is given for an object; or if complex coefficients describe a function that
        isn't real, or are unnormalised.

    Examples
    --------
    >>> import numpy as np
    >>> from spharm_rs import convert
    >>> array = np.zeros((2, 3, 3))
    >>> array[0, 0, 0] = 1
    >>> convert.from_pyshtools(array, normalization="4pi")[0] ** 2 / (4 * np.pi)
    array([1.])
    """
    if isinstance(array, SHCoeffs):
        for name, value in (("normalization", normalization), ("csphase", csphase)):
            if value is not None:
                raise ValueError(f"{name}: expected none with an SHCoeffs, which has its own; found {value!r}")
        return _from_pyshtools(real_coefficients(array), array.normalization, array.csphase)
    if isinstance(array, (list, tuple)) and array and all(isinstance(one, SHCoeffs) for one in array):
        channels = [from_pyshtools(one, normalization=normalization, csphase=csphase) for one in array]
        if len({len(channel) for channel in channels}) > 1:
            degrees = ", ".join(str(degree_of("pyshtools", len(channel))) for channel in channels)
            raise ValueError(f"pyshtools: expected coefficients of one degree, found degrees {degrees}")
        return np.hstack(channels)
    if isinstance(array, np.ndarray) and np.iscomplexobj(array):
        raise ValueError(
            "pyshtools: expected real coefficients, found complex ones; give the SHCoeffs itself, or its convert(kind='real')"
        )
    phase = 1 if csphase is None else csphase
    return _from_pyshtools(array, "ortho" if normalization is None else normalization, phase)


def _from_pyshtools(array: Any, normalization: str, csphase: int) -> Floats:
    found = _arrays.real("pyshtools", array, "(c, 2, L + 1, L + 1)")
    found = found[np.newaxis] if found.ndim == 3 else found
    if found.ndim != 4 or found.shape[1] != 2 or found.shape[2] != found.shape[3] or found.shape[2] == 0:
        raise ValueError(f"pyshtools: expected shape (c, 2, L + 1, L + 1), found {found.shape}")
    degrees, orders = degrees_and_orders(found.shape[2] - 1)
    canonical = found[:, (orders < 0).astype(int), degrees, abs(orders)].T
    return np.ascontiguousarray(canonical / _pyshtools_factors(found.shape[2] - 1, normalization, csphase))


def _pyshtools_factors(degree: int, normalization: str, csphase: int) -> Floats:
    """Returns the factors from canonical coefficients to pyshtools' of a normalisation and phase, (K, 1)."""
    _arrays.choice("normalization", normalization, _NORMALIZATIONS)
    if csphase not in (1, -1):
        raise ValueError(f"csphase: expected 1 or -1, found {csphase!r}")
    factors = _norms_over_4pi(degree, "ortho") / _norms_over_4pi(degree, normalization)
    orders = degrees_and_orders(degree)[1][:, np.newaxis]
    return factors if csphase == 1 else factors * np.where(orders % 2, -1.0, 1.0)


#: pyshtools' names of normalisations, and ``"orthonormal"`` for ``"ortho"``.
_NORMALIZATIONS = ("orthonormal", "ortho", "4pi", "schmidt", "unnorm")

#: Largest degree at which the norms of unnormalised harmonics fit into a float64.
_MOST_UNNORMALISED = 150


def _norms_over_4pi(degree: int, normalization: str) -> Floats:
    """Returns the norm of each harmonic over that of a 4 pi-normalised one, (K, 1)."""
    degrees, orders = degrees_and_orders(degree)
    if normalization == "4pi":
        return np.ones((len(degrees), 1))
    if normalization in ("orthonormal", "ortho"):
        return np.full((len(degrees), 1), 1 / np.sqrt(4 * np.pi))
    if normalization == "schmidt":
        return np.asarray(1 / np.sqrt(2.0 * degrees + 1))[:, np.newaxis]
    if degree > _MOST_UNNORMALISED:
        raise ValueError(f"coefficients: expected degrees up to {_MOST_UNNORMALISED} for unnorm, found degree {degree}")
    # The mean square of P_lm cos(m phi) is (l + m)! / (l - m)! / (2 l + 1), and half of it for m > 0.
    logs = np.concatenate([[0.0], np.cumsum(np.log(np.arange(1, 2 * degree + 1)))])
    square = logs[degrees + abs(orders)] - logs[degrees - abs(orders)] - np.log(2.0 * degrees + 1)
    return np.asarray(np.exp((square - np.where(orders == 0, 0, np.log(2))) / 2))[:, np.newaxis]


def _healpy_rows(degree: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    orders = np.repeat(np.arange(degree + 1), degree + 1 - np.arange(degree + 1))
    degrees = np.concatenate([np.arange(order, degree + 1) for order in range(degree + 1)])
    return degrees, orders


def to_healpy(coefficients: ArrayLike) -> Complex:
    """Converts to ``alm`` of healpy and ducc0, (c, (L + 1) (L + 2) / 2)."""
    a, degree = _canonical(coefficients)
    degrees, orders = _healpy_rows(degree)
    return np.ascontiguousarray(to_complex(a)[degrees * (degrees + 1) + orders].T)


def from_healpy(array: ArrayLike) -> Floats:
    """Converts ``alm``, (N,) or (c, N), with all orders up to the highest degree, to canonical coefficients."""
    alm = _complex("healpy", np.atleast_2d(np.asarray(array)), 2)
    degree = int(round(((8 * alm.shape[1] + 1) ** 0.5 - 3) / 2))
    if (degree + 1) * (degree + 2) // 2 != alm.shape[1]:
        raise ValueError(f"healpy: expected (L + 1) (L + 2) / 2 values, found {alm.shape[1]}")
    degrees, orders = _healpy_rows(degree)
    found = np.zeros(((degree + 1) ** 2, len(alm)), dtype=np.complex128)
    sign = np.where(orders % 2, -1.0, 1.0)[:, np.newaxis]
    found[degrees * (degrees + 1) - orders] = sign * alm.T.conj()
    found[degrees * (degrees + 1) + orders] = alm.T
    return _real_part("healpy", found, "alm of order 0 must be real")


def to_s2fft(coefficients: ArrayLike) -> Complex:
    """Converts to ``flm`` of s2fft, (c, L + 1, 2 L + 1), with orders from -L; s2fft's own L is L + 1."""
    a, degree = _canonical(coefficients)
    degrees, orders = degrees_and_orders(degree)
    found = np.zeros((a.shape[1], degree + 1, 2 * degree + 1), dtype=np.complex128)
    found[:, degrees, degree + orders] = to_complex(a).T
    return found


def from_s2fft(array: ArrayLike) -> Floats:
    """Converts ``flm``, (L + 1, 2 L + 1) or (c, L + 1, 2 L + 1), to canonical coefficients."""
    given = np.asarray(array)
    flm = _complex("s2fft", given[np.newaxis] if given.ndim == 2 else given, 3)
    degree = flm.shape[1] - 1
    if degree < 0 or flm.shape[2] != 2 * degree + 1:
        raise ValueError(f"s2fft: expected shape (c, L + 1, 2 L + 1), found {given.shape}")
    degrees, orders = degrees_and_orders(degree)
    return _real_part("s2fft", flm[:, degrees, degree + orders].T, _BOTH)


def to_spharm_mat(coefficients: ArrayLike) -> Complex:
    """Converts to ``fvec`` of SPHARM-MAT, (K, 3). Faces in MATLAB files are numbered from 1: use ``faces + 1``."""
    _three("SPHARM-MAT", coefficients)
    return to_complex(coefficients)


def from_spharm_mat(array: ArrayLike) -> Floats:
    """Converts ``fvec``, (K, c), as read by ``scipy.io.loadmat``, to canonical coefficients."""
    return from_complex(array)


def _three(who: str, coefficients: ArrayLike) -> None:
    shape = np.shape(coefficients)
    if len(shape) != 2 or shape[1] != 3:
        raise ValueError(f"{who} files can only hold surfaces (3 channels); found shape {shape}")


def _pdm(degree: int) -> tuple[NDArray[np.intp], Floats]:
    """Returns, for each row of a ``.coef`` file, its canonical row and its factor."""
    degrees, orders = degrees_and_orders(degree)
    at = degrees**2 + np.where(orders > 0, 2 * orders - 1, -2 * orders)
    rows = np.empty_like(at)
    rows[at] = np.arange(len(at))
    factors = np.where(orders == 0, 1.0, np.sqrt(2) * np.where(orders % 2, -1.0, 1.0))
    return rows, factors[rows][:, np.newaxis]


def to_spharm_pdm(coefficients: ArrayLike) -> Floats:
    """Converts to the rows of a SPHARM-PDM ``.coef`` file, (K, 3). PDM's own evaluation fails above degree 85."""
    _three("SPHARM-PDM", coefficients)
    a, degree = _canonical(coefficients)
    rows, factors = _pdm(degree)
    return a[rows] * factors


def from_spharm_pdm(array: ArrayLike) -> Floats:
    """Converts the rows of a ``.coef`` file, (K, 3), to canonical coefficients."""
    given, degree = _canonical(array)
    rows, factors = _pdm(degree)
    found = np.empty_like(given)
    found[rows] = given / factors
    return found


def write_spharm_pdm(path: Union[str, "os.PathLike[str]"], coefficients: ArrayLike, *, overwrite: bool = False) -> None:
    """Writes a SPHARM-PDM ``.coef`` file, with 17 digits.

    Parameters
    ----------
    path : str or os.PathLike
    coefficients : array_like of float, (K, 3)
    overwrite : bool
        Replace an existing file.
    """
    rows = to_spharm_pdm(coefficients)
    lines = ",\n".join("{{{:.17g}, {:.17g}, {:.17g}}}".format(*row) for row in rows)
    with open(path, "w" if overwrite else "x", encoding="ascii") as file:
        file.write(f"{{ {len(rows)},{lines}}}\n")


def read_spharm_pdm(path: Union[str, "os.PathLike[str]"]) -> Floats:
    """Reads a SPHARM-PDM ``.coef`` file and returns canonical coefficients, (K, 3)."""
    text = Path(path).read_text(encoding="ascii", errors="replace")
    head = re.match(r"\s*\{\s*(\d+)\s*,", text)
    if head is None:
        raise ValueError(f"{os.fspath(path)}: expected a SPHARM-PDM .coef file, which begins with {{ COUNT,")
    try:
        values = [float(number) for number in re.split(r"[\s{},]+", text[head.end() :]) if number]
    except ValueError as error:
        raise ValueError(f"{os.fspath(path)}: damaged .coef file: {error}") from error
    if len(values) != 3 * int(head[1]):
        raise ValueError(f"{os.fspath(path)}: expected {head[1]} rows of 3 numbers, found {len(values)} numbers")
    return from_spharm_pdm(np.array(values).reshape(-1, 3))


def to_ktch(coefficients: ArrayLike) -> Floats:
    """Converts to ktch's coefficients, (c, K)."""
    return np.ascontiguousarray(_canonical(coefficients)[0].T)


def from_ktch(array: ArrayLike) -> Floats:
    """Converts ktch's coefficients, (c, K) or flat (3 K,), to canonical ones."""
    given = _arrays.real("ktch", array, "(c, K)")
    return _canonical(np.ascontiguousarray((given.reshape(3, -1) if given.ndim == 1 else given).T))[0]


def to_flowshape(coefficients: ArrayLike) -> Floats:
    """Converts to FlowShape's coefficients, (K, c): canonical except for the factor (-1)**m."""
    a, degree = _canonical(coefficients)
    return a * np.where(degrees_and_orders(degree)[1] % 2, -1.0, 1.0)[:, np.newaxis]


def from_flowshape(array: ArrayLike) -> Floats:
    """Converts FlowShape's coefficients, (K, c), to canonical ones."""
    return to_flowshape(array)


#: For each format, the functions that convert from and to canonical coefficients.
FORMATS: dict[str, tuple[Callable[..., Any], Callable[..., Floats]]] = {
    "complex": (to_complex, from_complex),
    "pyshtools": (to_pyshtools, from_pyshtools),
    "healpy": (to_healpy, from_healpy),
    "s2fft": (to_s2fft, from_s2fft),
    "spharm_mat": (to_spharm_mat, from_spharm_mat),
    "spharm_pdm": (to_spharm_pdm, from_spharm_pdm),
    "ktch": (to_ktch, from_ktch),
    "flowshape": (to_flowshape, from_flowshape),
}


def _format(name: str) -> tuple[Callable[..., Any], Callable[..., Floats]]:
    if name not in FORMATS:
        raise ValueError(f"format: expected one of {', '.join(FORMATS)}; found {name!r}")
    return FORMATS[name]


def _options(format: str, function: Callable[..., Any], options: dict[str, Any]) -> dict[str, Any]:
    """Returns the options of a conversion; refuses options that its function doesn't have."""
    kinds = inspect.signature(function).parameters.items()
    known = [name for name, parameter in kinds if parameter.kind is inspect.Parameter.KEYWORD_ONLY]
    for name in options:
        if name not in known:
            expected = f"the options {' and '.join(known)}" if known else "no options"
            raise ValueError(f"{name}: expected {expected} for the format {format!r}, found {name}={options[name]!r}")
    return options


def to(format: str, coefficients: ArrayLike, **options: Any) -> Any:
    """Converts canonical coefficients to another package's format.

    Parameters
    ----------
    format : str
        A format of the table above.
    coefficients : array_like of float, (K, c)
    **options
        Options of the format's function: ``normalization`` and ``csphase`` of `to_pyshtools`; other formats have none.

    Returns
    -------
    ndarray
        As in the table above.

    Raises
    ------
    ValueError
        If the format or an option is unknown, or the format can't hold the coefficients.
    """
    function = _format(format)[0]
    return function(coefficients, **_options(format, function, options))


def from_(format: str, array: Any, **options: Any) -> Floats:
    """Converts another package's coefficients to canonical ones.

    Parameters
    ----------
    format : str
        A format of the table above.
    array : array_like, or for pyshtools an SHCoeffs
    **options
        Options of the format's function: ``normalization`` and ``csphase`` of `from_pyshtools`; other formats have
        none.

    Returns
    -------
    ndarray of float, (K, c)

    Raises
    ------
    ValueError
        If the format or an option is unknown, or the array isn't of the format.
    """
    function = _format(format)[1]
    return function(array, **_options(format, function, options))
