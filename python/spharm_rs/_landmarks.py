"""Landmarks, named points placed by a person, and their files."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Sequence

import numpy as np
from numpy.typing import ArrayLike

from . import _arrays, _core
from ._arrays import Floats
from ._surface import Path


@dataclass(frozen=True, eq=False)
class Landmarks:
    """The named points of one subject.

    Attributes
    ----------
    names : tuple of str, n
        Distinct names.
    points : ndarray of float, (n, 3)
        In the file's unit.
    frame : str, optional
        ``"LPS"`` or ``"RAS"``, if the file states it.
    """

    names: tuple[str, ...]
    points: Floats
    frame: str | None = None

    def __post_init__(self) -> None:
        points = _arrays.positions("points", self.points)
        object.__setattr__(self, "names", tuple(self.names))
        object.__setattr__(self, "points", points)
        if len(self.names) != len(points) or len(set(self.names)) != len(points):
            found = f"{len(self.names)} names, {len(set(self.names))} of them different"
            raise ValueError(f"names: expected {len(points)} different names, found {found}")
        if self.frame not in (None, "LPS", "RAS"):
            raise ValueError(f"frame: expected LPS or RAS, found {self.frame!r}")

    def __len__(self) -> int:
        """Number of landmarks, n."""
        return len(self.names)

    def in_frame(self, frame: str) -> Landmarks:
        """Returns the landmarks along the axes of ``"LPS"`` or ``"RAS"``; unchanged if their own frame is unknown.

        Parameters
        ----------
        frame : str
        """
        if frame not in ("LPS", "RAS"):
            raise ValueError(f"frame: expected LPS or RAS, found {frame!r}")
        if self.frame in (None, frame):
            return self
        return Landmarks(self.names, self.points * [-1.0, -1.0, 1.0], frame)


def read_landmarks(path: Path) -> Landmarks:
    """Reads landmarks: 3D Slicer's ``.mrk.json`` and ``.fcsv``, lists in JSON, tables ``name,x,y,z`` (``.csv``, ``.tsv``).

    Parameters
    ----------
    path : str or os.PathLike

    Returns
    -------
    Landmarks
        Positions as in the file; `Landmarks.in_frame` converts them.
    """
    names, points, frame = _core.read_landmarks(os.fspath(path))
    return Landmarks(tuple(names), points, frame)


def write_landmarks(path: Path, landmarks: Landmarks, *, overwrite: bool = False) -> None:
    """Writes landmarks in the format given by the file's name; the formats are those of `read_landmarks`.

    Parameters
    ----------
    path : str or os.PathLike
    landmarks : Landmarks
        Landmarks without a frame are marked as LPS in Slicer's files, since Slicer reads meshes as LPS.
    overwrite : bool
        Replace an existing file.
    """
    if not isinstance(landmarks, Landmarks):
        raise TypeError(f"landmarks: expected Landmarks, found {type(landmarks).__name__}")
    _core.write_landmarks(os.fspath(path), landmarks.names, landmarks.points, landmarks.frame, overwrite=bool(overwrite))


def matched(
    landmarks: Sequence[Landmarks | ArrayLike | Path], members: int
) -> tuple[tuple[str, ...] | None, list[Floats]]:
    """Returns the names that all members share, in the first member's order, and the positions; arrays have no
    names."""
    found = [read_landmarks(item) if isinstance(item, (str, os.PathLike)) else item for item in landmarks]
    if len(found) != members:
        raise ValueError(f"landmarks: expected landmarks of {members} members, found {len(found)}")
    named = [item for item in found if isinstance(item, Landmarks)]
    if not named:
        arrays = [_arrays.positions(f"landmarks[{index}]", item) for index, item in enumerate(found)]  # type: ignore[arg-type]
        for index, item in enumerate(arrays):
            if len(item) != len(arrays[0]):
                raise ValueError(
                    f"landmarks[{index}]: expected {len(arrays[0])} positions, as in landmarks[0], found {len(item)}"
                )
            if not np.isfinite(item).all():
                raise ValueError(f"landmarks[{index}]: expected finite positions, found NaN or infinity")
        return None, arrays
    if len(named) != members:
        raise ValueError("landmarks: expected named landmarks for all members, or arrays for all members; found both")
    names = tuple(name for name in named[0].names if all(name in item.names for item in named))
    if not names:
        raise ValueError("landmarks: no name is common to all members")
    return names, [np.array([item.points[item.names.index(name)] for name in names]) for item in named]
