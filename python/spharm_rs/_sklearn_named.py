"""Names the surfaces of X in errors and warnings of scikit-learn's estimators."""

from __future__ import annotations

import os
import sys
import warnings
from contextlib import contextmanager
from typing import Any, Callable, Iterator, Sequence

from .errors import SpharmError, SpharmWarning

#: First words of the warning about a surface that equals a member of a group, whose name follows.
_IDENTICAL_TO = "the surface is identical to "

#: Packages between the user's program and this module: scikit-learn wraps methods, and its pipelines use joblib.
_BETWEEN = (__name__.partition(".")[0], "sklearn", "joblib", "contextlib")


def _at(index: int, item: Any, text: str) -> str:
    """Returns a text with the position of the surface, and its path if the text doesn't begin with it."""
    path = f"{os.fspath(item)}: " if isinstance(item, (str, os.PathLike)) else ""
    return f"X[{index}]: {'' if text.startswith(path) else path}{text}"


def _renamed(text: str, items: Sequence[Any], names: Sequence[str]) -> str:
    """Replaces the name of a member at the beginning of a text by the member's position and path."""
    found = text.removeprefix("the ")
    for index, (item, name) in enumerate(zip(items, names)):
        if found.startswith(f"{name}: "):
            found = found.removeprefix(f"{name}: ")
            other = found.removeprefix(_IDENTICAL_TO)
            if other != found and other in names:
                found = f"{_IDENTICAL_TO}X[{list(names).index(other)}]"
            return _at(index, item, found)
    return text


def _outside() -> int:
    """Returns the level of the nearest caller outside this package, scikit-learn and joblib, relative to the caller of
    this function."""
    frame, level = sys._getframe(1), 1
    while frame.f_back is not None and str(frame.f_globals.get("__name__")).partition(".")[0] in _BETWEEN:
        frame, level = frame.f_back, level + 1
    return level


@contextmanager
def warned(renamed: Callable[[str], str | None] = str) -> Iterator[None]:
    """Issues this package's warnings at the line of the user's program, with the texts that `renamed` returns; drops a
    warning if it returns None."""
    # As `catch_warnings` isn't thread-safe, threads may issue each other's warnings.
    found: list[warnings.WarningMessage] = []
    try:
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always", SpharmWarning)
            yield
    finally:
        for one in found:
            if not issubclass(one.category, SpharmWarning):
                warnings.warn_explicit(one.message, one.category, one.filename, one.lineno, source=one.source)
            elif (text := renamed(str(one.message))) is not None:
                warnings.warn(text, one.category, stacklevel=_outside())


def _missing(error: OSError, index: int) -> None:
    """Adds the position of a surface to an error of the operating system, which has a text and a path of its own."""
    error.strerror = f"X[{index}]: {error.strerror}"
    error.args = (error.errno, error.strerror)


@contextmanager
def named(index: int, item: Any) -> Iterator[None]:
    """Adds the position of a surface, and its path, to errors and warnings."""
    try:
        with warned(lambda text: _at(index, item, text)):
            yield
    except (SpharmError, ValueError, OSError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            _missing(error, index)
        else:
            error.args = (_at(index, item, str(error)), *error.args[1:])
        raise


@contextmanager
def named_among(items: Sequence[Any], names: Sequence[str], *, again: bool = False) -> Iterator[None]:
    """Replaces the name of a member, with which errors and warnings of groups begin, by its position and its path.

    With ``again``, the surfaces may be members of the group, so warnings that they equal a member are dropped.
    """

    def renamed(text: str) -> str | None:
        return None if again and f": {_IDENTICAL_TO}" in text else _renamed(text, items, names)

    try:
        with warned(renamed):
            yield
    except (SpharmError, ValueError, OSError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            paths = [os.fspath(item) if isinstance(item, (str, os.PathLike)) else None for item in items]
            if error.filename in paths:
                _missing(error, paths.index(error.filename))
        elif (text := _renamed(str(error), items, names)) != str(error):
            error.args = (text, *error.args[1:])
        raise
