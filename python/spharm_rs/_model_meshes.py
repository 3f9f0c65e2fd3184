"""Surfaces of models as meshes of other packages."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

if TYPE_CHECKING:
    from ._surface import Surface


class Meshes:
    """Methods of `Model` that return its `surface` as a mesh of another package."""

    def surface(self, at: Any = None, *, degree: int | None = None, threads: int | None = None) -> Surface:
        raise NotImplementedError

    def to_trimesh(self, at: Any = None, *, degree: int | None = None) -> Any:
        """Returns the surface on a sphere as a ``trimesh.Trimesh``.

        Parameters
        ----------
        at : int, Surface or what `as_surface` takes, optional
            The sphere, as for `surface`: by default that of the fit.
        degree : int, optional
            Highest degree to evaluate; by default all degrees.

        Examples
        --------
        >>> import spharm_rs as sp
        >>> mesh = sp.fit(*sp.example_surface(4), 12).to_trimesh(3)
        >>> len(mesh.vertices), mesh.is_watertight
        (642, True)
        """
        return self.surface(at, degree=degree).to_trimesh()

    def to_pyvista(self, at: Any = None, *, degree: int | None = None) -> Any:
        """Returns the surface on a sphere as a ``pyvista.PolyData``; the parameters are those of `to_trimesh`."""
        return self.surface(at, degree=degree).to_pyvista()

    def to_nibabel(self, at: Any = None, *, degree: int | None = None) -> Any:
        """Returns the surface on a sphere as a ``nibabel.GiftiImage``, whose positions have 32 bits, with the metadata of the
        fitted surface's file; the parameters are those of `to_trimesh`."""
        return self.surface(at, degree=degree).to_nibabel()

    def to_nilearn(
        self, values: ArrayLike | None = None, *, at: Any = None, degree: int | None = None, hemisphere: str = "left"
    ) -> Any:
        """Returns the surface on a sphere as a mesh of nilearn, or as an image with values at its vertices.

        Parameters
        ----------
        values : array_like of float, (n,) or (n, c), optional
            Values at the vertices of the sphere, such as those of ``model.curvature()``.
        at, degree
            As for `to_trimesh`.
        hemisphere : {"left", "right"}
            The part of an image.

        Returns
        -------
        nilearn.surface.InMemoryMesh, or with values nilearn.surface.SurfaceImage
        """
        return self.surface(at, degree=degree).to_nilearn(values, hemisphere=hemisphere)
