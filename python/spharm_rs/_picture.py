"""Pictures of surfaces, without a window or a graphics card."""

from __future__ import annotations

import os
from typing import Any, Literal

import numpy as np

from . import _arrays, _core
from ._arrays import Floats
from ._surface import Path, as_surface


class Picture:
    """A picture as PNG, which notebooks show.

    Attributes
    ----------
    png : bytes
        The file's contents.
    """

    def __init__(self, png: bytes) -> None:
        self.png = png

    def __repr__(self) -> str:
        return f"Picture({len(self.png)} bytes)"

    def _repr_png_(self) -> bytes:
        return self.png

    def save(self, path: Path, *, overwrite: bool = False) -> None:
        """Writes the picture as a PNG file.

        Parameters
        ----------
        path : str or os.PathLike
            Ends in ``.png``.
        overwrite : bool
            Replace an existing file.

        Raises
        ------
        ValueError
            If the name has another extension.
        """
        name = os.fsdecode(path)
        if not name.lower().endswith(".png"):
            raise ValueError(f"path: expected a name that ends in .png, found {name}")
        with open(name, "wb" if overwrite else "xb") as file:
            file.write(self.png)


def picture(
    surface: Any,
    values: Any = None,
    *,
    limits: tuple[float, float] | None = None,
    label: str = "",
    caption: str = "",
    size: int = 480,
    view: Literal["left", "right", "front", "back", "top", "bottom", "corner"] = "corner",
) -> Picture:
    """Draws a surface, with values at its vertices as colours.

    Parameters
    ----------
    surface : Surface or what `as_surface` takes
        Models are drawn by `Model.picture`.
    values : array_like of float, (n,) or (n, 1), or image, optional
        A value for each vertex, also as an image of nibabel or nilearn; NaN is grey.
    limits : pair of float, optional
        Values of the first and the last colour; by default the range of the values, symmetric if they have both signs.
        Colours are blue to red if the limits are symmetric.
    label : str
        Name of the values, beneath the bar of colours.
    caption : str
    size : int
        Width and height in pixels.
    view : {"left", "right", "front", "back", "top", "bottom", "corner"}
        Side from which the surface is seen, in coordinates whose x, y and z point right, forwards and up.

    Returns
    -------
    Picture

    Examples
    --------
    >>> import spharm_rs as sp
    >>> surface, sphere = sp.example_surface(4)
    >>> picture = sp.picture(surface, surface.vertices[:, 2], label="height", size=240)
    >>> picture.png[:4]
    b'\\x89PNG'
    """
    mesh = as_surface(surface)
    colours = None
    if values is not None:
        colours = _arrays.at_each("values", values, len(mesh.vertices))
    return Picture(
        _core.picture(
            mesh.vertices,
            mesh.faces,
            values=colours,
            limits=_limits(colours, limits),
            label=str(label),
            caption=str(caption),
            size=_arrays.whole("size", size),
            view=str(view),
        )
    )


def _limits(values: Floats | None, limits: tuple[float, float] | None) -> tuple[float, float]:
    if limits is not None:
        low, high = (float(limits[0]), float(limits[1])) if len(limits) == 2 else (0.0, 0.0)
        if not (np.isfinite(low) and np.isfinite(high) and low < high):
            raise ValueError(f"limits: expected two increasing numbers, found {limits}")
        return low, high
    finite = np.empty(0) if values is None else values[np.isfinite(values)]
    if len(finite) == 0:
        return 0.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    if low < 0 < high:
        high = max(-low, high)
        low = -high
    return (low, high) if low < high else (low, low + 1.0)
