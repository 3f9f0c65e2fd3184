"""Converts users' values to arrays of the types that the extension module accepts. Arguments are never modified."""

from __future__ import annotations

import os
import pathlib
import tempfile
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _core

Floats = NDArray[np.float64]
Triangles = NDArray[np.uint32]


#: GIfTI's intent codes of arrays of positions, triangles, numbers of vertices with values, and labels.
_POINTS, _TRIANGLES, _VERTEX_NUMBERS, _LABELS = 1008, 1009, 2002, 1002


def _parts(values: Any) -> dict[str, Any] | None:
    """Returns the values of an image of nilearn for each hemisphere, and None for anything else."""
    if isinstance(values, np.ndarray):
        return None
    for holder in (values, getattr(values, "data", None)):
        parts = getattr(holder, "parts", None)
        if isinstance(parts, dict) and all(isinstance(part, np.ndarray) for part in parts.values()):
            return parts
    return None


def is_image(values: Any) -> bool:
    """Returns whether an object is an image on vertices: a GIfTI image of nibabel, or an image or its data of nilearn."""
    return hasattr(values, "agg_data") or _parts(values) is not None


def has_mesh(image: Any) -> bool:
    """Returns whether an image on vertices has a mesh, too."""
    return hasattr(image, "mesh") or any(one.intent in (_POINTS, _TRIANGLES) for one in getattr(image, "darrays", ()))


def unwrapped(what: str, values: Any) -> Any:
    """Returns the values of an image on vertices as an array, (n,) or (n, c), and anything else unchanged."""
    parts = _parts(values)
    if parts is not None:
        if len(parts) != 1:
            found = " and ".join(map(str, parts)) or "none"
            raise ValueError(f"{what}: expected one hemisphere, found {found}; give one, such as image.data.parts['left']")
        return next(iter(parts.values()))
    if not hasattr(values, "agg_data"):
        return values
    intents = [one.intent for one in values.darrays]
    if _VERTEX_NUMBERS in intents:
        raise ValueError(f"{what}: expected a value for each vertex, found a GIfTI image with values for listed vertices only")
    arrays = [one.data for one in values.darrays if one.intent not in (_POINTS, _TRIANGLES)]
    if not arrays:
        found = "a mesh" if intents else "an empty image"
        raise ValueError(f"{what}: expected a GIfTI image with values on vertices, found {found}")
    lengths = sorted({len(array) for array in arrays})
    if len(lengths) > 1:
        raise ValueError(f"{what}: expected a GIfTI image with arrays of equal lengths, found {', '.join(map(str, lengths))}")
    return arrays[0] if len(arrays) == 1 else np.column_stack(arrays)


def real(what: str, values: ArrayLike, shape: str, *, flags: bool = False) -> Floats:
    """Returns real numbers as aligned float64, without a copy if they are already; with ``flags``, true is 1.
    Masked numbers are NaN."""
    values = unwrapped(what, values)
    if isinstance(values, (list, tuple)) and any(isinstance(one, np.ma.MaskedArray) for one in values):
        values = _joined(what, values, shape)
    if isinstance(values, np.ma.MaskedArray) and values.dtype.kind in ("fiub" if flags else "fiu"):
        values = np.ma.filled(values.astype(np.float64), np.nan)
    try:
        array = np.asarray(values)
    except ValueError as error:
        raise ValueError(f"{what}: expected an array of shape {shape}, found rows of different lengths") from error
    if array.dtype.kind not in ("fiub" if flags else "fiu"):
        advice = ""
        if array.dtype.kind == "c" and "c)" in shape:
            advice = "; pass the real and imaginary parts as two channels"
            if what == "coefficients":
                advice = "; convert.from_complex converts coefficients of complex harmonics"
        raise ValueError(f"{what}: expected real numbers of shape {shape}, found {_described(array)}{advice}")
    return np.require(array, np.float64, "A")


def _joined(what: str, rows: list[Any] | tuple[Any, ...], shape: str) -> Any:
    """Stacks rows, some of them masked arrays, into one masked array; NumPy's ``asarray`` would drop their masks."""
    try:
        masks = [np.ma.getmaskarray(row) for row in rows]
        return np.ma.array(np.stack([np.ma.getdata(row) for row in rows]), mask=masks)
    except ValueError as error:
        raise ValueError(f"{what}: expected an array of shape {shape}, found rows of different lengths") from error


def _described(array: NDArray[Any]) -> str:
    return "None" if array.dtype == object and array.ndim == 0 and array.item() is None else f"{array.dtype} of shape {array.shape}"


def positions(what: str, values: ArrayLike) -> Floats:
    """Returns positions or directions, (n, 3)."""
    if hasattr(type(values), "max_degree"):
        raise ValueError(f"{what}: expected an array of shape (n, 3), found a model or a transform")
    array = real(what, values, "(n, 3)")
    if array.ndim != 2 or array.shape[1] != 3:
        angles = what == "directions" and 2 in array.shape
        advice = "; spectra.directions(latitudes, longitudes) converts angles" if angles else ""
        raise ValueError(f"{what}: expected shape (n, 3), found {array.shape}{advice}")
    return array


def triangles(what: str, values: ArrayLike) -> Triangles:
    """Returns triangles, (f, 3), counted from 0."""
    if np.ma.is_masked(values):
        raise ValueError(f"{what}: expected vertex numbers, found masked ones; leave out the triangles that have them")
    try:
        array = np.asarray(values)
    except ValueError as error:
        raise ValueError(f"{what}: expected shape (f, 3), found rows of different lengths") from error
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{what}: expected shape (f, 3), found {array.shape}")
    if array.dtype.kind not in "iu":
        raise ValueError(f"{what}: expected integers, found {array.dtype}")
    if array.size and (array.min() < 0 or array.max() > np.iinfo(np.uint32).max):
        raise ValueError(f"{what}: expected vertex numbers from 0, found {array.min()} to {array.max()}")
    return np.require(array, np.uint32, "A")


def channels(what: str, values: ArrayLike) -> Floats:
    """Returns values on vertices, (n, c), of an array or an image; a vector is one channel, and true is 1."""
    array = real(what, values, "(n,) or (n, c)", flags=True)
    if array.ndim == 1:
        array = array[:, np.newaxis]
    if array.ndim != 2:
        raise ValueError(f"{what}: expected shape (n,) or (n, c), found {array.shape}")
    return array


def at_vertices(what: str, values: ArrayLike) -> Floats:
    """Returns values on vertices as `channels` does, and refuses models, which NumPy would read as their
    coefficients."""
    if hasattr(type(values), "max_degree"):
        raise ValueError(f"{what}: expected a value for each vertex, found a {type(values).__name__}; call its evaluate()")
    return channels(what, values)


def at_each(what: str, values: ArrayLike, count: int) -> Floats:
    """Returns one value for each of ``count`` vertices, (count,), from an array (count,) or (count, 1), or an image."""
    array = at_vertices(what, values)
    if array.shape != (count, 1):
        shape = np.shape(unwrapped(what, values))
        raise ValueError(f"{what}: expected shape ({count},), found {shape}")
    return array[:, 0]


def of_grid(what: str, values: Any, at: Floats) -> tuple[Floats, tuple[int, ...] | None]:
    """Flattens values on a grid of n directions, (n_latitude, n_longitude) or (n_latitude, n_longitude, c), to (n,) or
    (n, c), and also returns the grid's shape. Returns other values unchanged, with None. Refuses values whose axes are
    exchanged."""
    array = real(what, values, "(n,) or (n, c), or that of a grid", flags=True)
    shape = array.shape
    if array.ndim not in (2, 3) or shape[0] == len(at) or shape[0] * shape[1] != len(at):
        return array, None
    rows, columns = shape[:2]
    if not _of_rings(at, rows, columns) and _of_rings(at, columns, rows):
        raise ValueError(f"{what}: expected the shape of the directions' grid, {(columns, rows)}, found {shape}; exchange the axes")
    return np.reshape(array, (-1, *shape[2:])), (rows, columns)


def _of_rings(at: Floats, rows: int, columns: int) -> bool:
    """Returns whether directions, arranged as (rows, columns), have one latitude in each row, or in each column, and
    different ones in neighbouring rows or columns."""
    with np.errstate(all="ignore"):
        sines = (at[:, 2] / np.linalg.norm(at, axis=1)).reshape(rows, columns)
    return any(np.ptp(of, axis=1).max() < 1e-6 and abs(np.diff(of[:, 0])).min(initial=1) > 1e-6 for of in (sines, sines.T))


def raveled(given: Any, grid: tuple[int, ...] | None) -> Any:
    """Returns a mask, weights or noise on a grid in the order of its directions, and anything else unchanged."""
    if grid is None or given is None or isinstance(given, (str, os.PathLike)) or np.shape(given) != grid:
        return given
    if isinstance(given, (list, tuple)):
        given = _joined("mask", given, str(grid))
    return np.ma.ravel(given)


def weights(values: ArrayLike, vertices: int) -> Floats:
    """Returns a weight for each vertex, (n,)."""
    array = real("weights", values, f"({vertices},)")
    if array.shape != (vertices,):
        raise ValueError(f"weights: expected shape ({vertices},), found {array.shape}")
    return array


def flags(what: str, values: Any, count: int | None = None, *, masked: bool = False) -> NDArray[np.bool_]:
    """Returns flags, (count,) if a count is given, from true and false, or 1 and 0. Masked elements become ``masked``."""
    array = np.asarray(_filled(values, masked))
    if count is not None and array.shape != (count,):
        raise ValueError(f"{what}: expected shape ({count},), found {array.shape}")
    if array.dtype != bool:
        numbers = real(what, array, "(n,)" if count is None else f"({count},)")
        bad = ((numbers != 0) & (numbers != 1)).ravel()
        if bad.any():
            vertex = int(bad.argmax())
            number = numbers.ravel()[vertex]
            found = "NaN" if np.isnan(number) else f"{number:g}"
            graded = ", or the numbers as weights= of a fit" if what == "mask" else ""
            raise ValueError(
                f"{what}: expected true or false, or 1 or 0, at each vertex, found {found} at vertex {vertex} (counted from "
                f"0); give a comparison such as {what} > 0.5{graded}"
            )
        array = numbers != 0
    return np.ascontiguousarray(array)


def _filled(values: Any, missing: bool) -> Any:
    """Returns a masked array with its masked elements replaced, and anything else unchanged."""
    return values.filled(missing) if isinstance(values, np.ma.MaskedArray) else values


def mask(values: Any, vertices: int) -> NDArray[np.bool_] | None:
    """Returns a flag for each vertex, true if it is used, (n,), from a mask given as an array, an image or a file; None
    for all vertices. Masked elements of an array are false."""
    if values is None:
        return None
    if isinstance(values, (str, os.PathLike)):
        return _core.read_mask(os.fspath(values), vertices)
    return _mask_of_image(values, vertices) if is_image(values) else flags("mask", values, vertices)


def graded_mask(values: ArrayLike, count: int) -> Floats:
    """Returns a mask's numbers from 0 to 1, (count,). Masked elements of an array are 0."""
    kept = real("mask", _filled(values, False), f"({count},)", flags=True)
    if kept.shape != (count,):
        raise ValueError(f"mask: expected shape ({count},), found {kept.shape}")
    if not ((kept >= 0) & (kept <= 1)).all():
        raise ValueError("mask: expected true or false, or numbers from 0 to 1; found other numbers")
    return kept


def _mask_of_image(image: Any, vertices: int) -> NDArray[np.bool_]:
    """Returns the mask in an image, in which 0 leaves a vertex out, as in a mask's file."""
    array = np.asarray(unwrapped("mask", image))
    if array.shape == (vertices, 1):
        array = array[:, 0]
    labels = any(one.intent == _LABELS for one in getattr(image, "darrays", ()))
    if labels and array.shape == (vertices,) and array.any():
        return _mask_of_labels(image, vertices)
    if array.dtype != bool:
        numbers = real("mask", array, f"({vertices},)")
        if np.isnan(numbers).any():
            raise ValueError(f"mask: expected true or false at each vertex, found NaN at vertex {int(np.isnan(numbers).argmax())}")
        array = numbers != 0
    if array.shape != (vertices,):
        raise ValueError(f"mask: expected shape ({vertices},), found {array.shape}")
    return np.ascontiguousarray(array)


def _mask_of_labels(image: Any, vertices: int) -> NDArray[np.bool_]:
    """Returns the mask in a nibabel image of labels: all regions except unknown and the medial wall, as for a file."""
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder, "mask.label.gii")
        path.write_bytes(image.to_bytes())
        return _core.read_mask(os.fspath(path), vertices)


def choice(what: str, value: Any, known: tuple[str, ...]) -> str:
    """Returns one of the known names."""
    if value not in known:
        raise ValueError(f"{what}: expected one of {', '.join(known)}; found {value!r}")
    return str(value)


def on_error(value: Any) -> bool:
    """Returns whether errors are collected rather than raised."""
    if value not in ("raise", "collect"):
        raise ValueError(f"on_error: expected 'raise' or 'collect', found {value!r}")
    return bool(value == "collect")


def whole(what: str, value: Any, least: int = 0) -> int:
    """Returns a whole number of any integer type, at least ``least``."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)):
        raise ValueError(f"{what}: expected a whole number, found {value!r}")
    if not least <= value < 2**63:
        raise ValueError(f"{what}: expected at least {least}, found {value}")
    return int(value)


def threads(value: Any) -> int | None:
    """Returns a number of threads, 1 to 64, or None for the default."""
    if value is None:
        return None
    count = whole("threads", value, 1)
    if count > 64:
        raise ValueError(f"threads: expected a number from 1 to 64, found {count}")
    return count


#: The units of sizes, the same as in the program's options.
_UNITS = {"KiB": 1 << 10, "MiB": 1 << 20, "GiB": 1 << 30, "KB": 10**3, "MB": 10**6, "GB": 10**9, "B": 1}


def size(memory: int | str | None) -> int | None:
    """Returns a size in bytes, given as a number or as text such as ``"512MiB"``."""
    if memory is None:
        return None
    if not isinstance(memory, str):
        return whole("memory", memory, 1)
    for unit, scale in _UNITS.items():
        number = memory.removesuffix(unit).strip()
        if memory.endswith(unit) and number.replace(".", "", 1).isdecimal():
            return int(float(number) * scale)
    raise ValueError(f"memory: expected bytes, or a size such as '512MiB', found {memory!r}")
