"""Issues warnings at the line of the user's program that called the package."""

from __future__ import annotations

import os
import sys
import warnings
from typing import Iterable

from .errors import SpharmWarning

#: The category and the text of a warning that isn't issued yet.
Problem = tuple[type[Warning], str]

_PACKAGE = os.path.dirname(__file__) + os.sep


def warn(found: Iterable[str], category: type[Warning] = SpharmWarning) -> tuple[str, ...]:
    """Issues warnings, and returns their texts."""
    for text in (texts := tuple(found)):
        warnings.warn(text, category, stacklevel=_outside())
    return texts


def issue(problems: Iterable[Problem]) -> None:
    """Issues warnings of several categories."""
    for category, text in problems:
        warn([text], category)


def _outside() -> int:
    """Returns the level of the nearest caller outside the package, relative to the caller of this function."""
    frame, level = sys._getframe(1), 1
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_PACKAGE):
        frame, level = frame.f_back, level + 1
    return level
