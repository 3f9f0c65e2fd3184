"""Reads columns of tables of subjects, which have numbers or names of levels, for the extension module."""

from __future__ import annotations

import math
from typing import Any, Union

import numpy as np

from ._arrays import Floats

#: A column of the table of subjects: numbers, or names of levels.
Cells = Union[Floats, "list[str]"]

#: Words for missing values, the same as in the program's tables.
_MISSING = frozenset(("", "na", "n/a", "#n/a", "<na>", ".", "-", "?", "none", "null"))
#: Types of pandas' missing values.
_NOTHING = ("NAType", "NaTType")
_NUMBERS = (bool, int, float, np.bool_, np.integer, np.floating)


def column(what: str, values: Any, count: int) -> Any:
    """Returns the cells of a column, one for each subject: numbers, flags, or names without blanks around them.

    Refuses missing values, and cells that are neither all names nor all numbers.
    """
    cells = np.asarray(values)
    if cells.shape != (count,):
        raise ValueError(f"{what}: expected shape ({count},), one for each subject; found {cells.shape}")
    found = [cell.strip() if isinstance(cell, str) else cell for cell in cells.tolist()]
    if isinstance(values, np.ma.MaskedArray):
        found = [None if masked else cell for cell, masked in zip(found, np.ma.getmaskarray(values))]
    for row, cell in enumerate(found):
        if _is_missing(cell):
            shown = "NaN" if isinstance(cell, float) and math.isnan(cell) else repr(cell)
            raise ValueError(
                f"{what}: expected a name or a finite number for each subject, found {shown} in row {row} (counted from 0), "
                "which is a missing value; leave out the subject"
            )
    if cells.dtype.kind in "biuf":
        return cells
    expected: Any = str if found and isinstance(found[0], str) else _NUMBERS
    for row, cell in enumerate(found):
        if cells.dtype.kind not in ("O", "T", "U") or not isinstance(cell, expected):
            other = f", and {found[0]!r} in row 0" if row else ""
            raise ValueError(
                f"{what}: expected a level for each subject, either all names or all numbers; found {cell!r} in row "
                f"{row}{other} (counted from 0)"
            )
    array = np.array(found)
    return array.astype(float) if array.dtype == object else array


def _is_missing(cell: Any) -> bool:
    if isinstance(cell, str):
        number = _number(cell)
        return cell.lower() in _MISSING or number is not None and not math.isfinite(number)
    is_infinite = isinstance(cell, (float, np.floating)) and not math.isfinite(cell)
    return cell is None or type(cell).__name__ in _NOTHING or is_infinite


def _number(text: str) -> float | None:
    """Returns the number in a text, written as in the program's tables; None for other text."""
    text = text.replace("\u2212", "-")
    try:
        return float(text) if text.isascii() and "_" not in text else None
    except ValueError:
        return None


def categories_of(values: Any) -> list[str] | None:
    """Returns the names of the categories of pandas' categorical values, in order; None for other values."""
    named = getattr(getattr(values, "dtype", None), "name", None) == "category"
    holder = getattr(values, "cat", values) if named else values
    if not (hasattr(holder, "categories") and hasattr(holder, "codes")):
        return None
    return [str(category).strip() for category in holder.categories]


def names_of(what: str, values: Any, count: int) -> list[str]:
    """Returns the name of each subject's level."""
    return [str(cell) for cell in column(what, values, count).tolist()]


def levels_of(what: str, values: Any, count: int) -> tuple[list[str], list[str]]:
    """Returns the level of each subject, and the distinct levels: in the order of the categories, or else sorted."""
    names, categories = names_of(what, values, count), categories_of(values)
    if categories is None:
        return names, [str(level) for level in np.unique(column(what, values, count)).tolist()]
    found = set(names)
    return names, [level for level in dict.fromkeys(categories) if level in found]


def numbers_or_levels(what: str, values: Any, count: int, blocks: list[str] | None = None) -> Cells:
    """Returns a column as numbers or as names of levels.

    Text is read as in the program's tables: as numbers if all of it is numbers. Flags and categorical values are
    levels, and so are numbers that are equal to the names of the blocks.
    """
    cells, names = column(what, values, count), names_of(what, values, count)
    if cells.dtype.kind == "b" or categories_of(values) is not None:
        return names
    numbers = cells.astype(np.float64) if cells.dtype.kind in "iuf" else _read(what, names)
    if numbers is None or blocks is not None and _are_blocks(names, numbers, blocks):
        return names
    return numbers


def _read(what: str, names: list[str]) -> Floats | None:
    """Returns the numbers in texts; None if they are levels. If most are numbers, text that isn't a number is refused,
    because it would turn the whole column into levels."""
    numbers = [_number(name) for name in names]
    if None not in numbers:
        return np.array(numbers, np.float64)
    # Numbers with a decimal comma, such as 30,5, are meant as numbers.
    meant = sum(_number(name.replace(",", ".")) is not None for name in names)
    if 2 * meant <= len(names):
        return None
    row = numbers.index(None)
    raise ValueError(
        f"{what}: expected a number, as in most rows, found {names[row]!r} in row {row} (counted from 0); write a number "
        "such as 30.5, or leave out the subject; for levels, give words such as site1, or a pandas.Categorical"
    )


def _are_blocks(names: list[str], numbers: Floats, blocks: list[str]) -> bool:
    """Returns whether a column of numbers is equal to the names of the blocks."""
    return names == blocks or numbers.tolist() == [_number(block) for block in blocks]
