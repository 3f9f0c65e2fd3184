"""Results of tests at vertices: their maps as pictures, images and files."""

from __future__ import annotations

import json
import os
import pathlib
import tempfile
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np

from . import _arrays
from ._arrays import Floats
from ._model import Model
from ._picture import Picture
from ._picture import picture as draw
from ._shape_inference import Cluster
from ._surface import Path, Surface, write_signal, write_surface

#: Maps of p values and of false-discovery rates, which are small where there is evidence.
_P_MAPS = ("p", "q", "p_fwe", "p_permutation", "p_tfce")
#: Maps that `TestResult.save` writes, (V,) or (V, 3).
_MAPS = (
    "statistic", *_P_MAPS, "effect", "margin", "standard_error", "size", "tfce", "cluster_of",
)  # fmt: skip
#: Other attributes, which `TestResult.save` writes to the file `_FIGURES_FILE`.
_FIGURES = (
    "kind", "meaning", "freedom", "levels", "columns", "codes", "resampling", "assumption", "relabellings", "exact",
    "smallest_p", "cluster_threshold", "warnings",
)  # fmt: skip
_SURFACE_FILE, _FIGURES_FILE = "surface.surf.gii", "test.json"


def _minus_log10(p: Floats) -> Floats:
    """Returns -log10 of p values, taking 0 as the smallest number above 0."""
    return np.asarray(0.0 - np.log10(np.maximum(p, np.finfo(float).tiny)))


@dataclass(frozen=True, eq=False)
class TestResult:
    """Result of a test at each of V vertices. Arrays are NaN at vertices outside of the test's mask; `cluster_of` is 0 there.

    Attributes
    ----------
    statistic : ndarray of float, (V,)
        t, F, Hotelling's T-squared or, with variance groups, v or G; 0 at vertices without variance.
    p : ndarray of float, (V,)
        Two-sided, uncorrected p value from the distribution of t, F or T-squared; with variance groups, from
        the distribution of the estimates divided by their standard errors.
    q : ndarray of float, (V,)
        False-discovery rate of Benjamini and Hochberg.
    p_fwe, p_permutation : ndarray of float, (V,), or None
        p values from relabellings: family-wise, by the largest statistic, and uncorrected. None without relabellings.
    effect, margin, standard_error : ndarray of float, (V,) or (V, 3), or None
        The contrast's estimate, half the width of its confidence interval, and its standard error, in the values' unit. None
        if several contrasts are tested at once.
    size : ndarray of float, (V,), or None
        The estimate divided by the standard deviation of the errors: Cohen's d for two groups
        without covariates, Mahalanobis' distance for positions; 0 at vertices without variance.
    kind : {"t", "F", "T2", "v", "G"}
        With variance groups, Aspin and Welch's v and G instead of t and F.
    freedom : tuple of float
        For t and v: the degrees of freedom, for Welch's t and v the smallest over all vertices. For F and G: degrees of
        freedom between and within. For T-squared: number of components, and degrees of freedom of the errors.
    meaning : str
        The tested difference in words, such as ``"control - patient"``.
    levels : dict
        Number of subjects in each group.
    columns : list of str
        Names of the design's columns.
    codes : dict
        Covariates with three to six different whole numbers, and columns of an interaction with two to six, and these
        numbers. They are treated as amounts, with one slope each; if they are codes of levels, such as sites, give words such
        as ``"site1"``, or a ``pandas.Categorical``, instead.
    resampling : str or None
        Kind of relabelling: "permutations" of subjects, "sign flips", or both.
    assumption : str or None
        The assumption about the errors on which `p_fwe` and `p_permutation` rest.
    relabellings : int
        Number of relabellings used; 0 without relabellings.
    exact : bool
        Whether all possible relabellings were used.
    smallest_p : float or None
        The smallest p value that these relabellings can give.
    tfce, p_tfce : ndarray of float, (V,), or None
        Threshold-free cluster enhancement, with the sign of the statistic, and its family-wise p values.
    clusters : list of Cluster, or None
        Clusters by decreasing area.
    cluster_of : ndarray of int, (V,), or None
        Number of each vertex's cluster, from 1 for the first of ``clusters``; 0 for none.
    cluster_threshold : float or None
        Statistic from which vertices form clusters.
    warnings : tuple of str
    mean : Model or None
        Mean of the models, if models were given.
    surface : Surface or None
        The surface on which `picture` draws: the given one, else the mean at the vertices of the sphere, or the
        sphere for signals; None if it isn't known.
    mask : ndarray of bool, (V,), or None
        The tested vertices, if a mask was given.
    """

    statistic: Floats
    p: Floats
    q: Floats
    p_fwe: Floats | None
    p_permutation: Floats | None
    effect: Floats | None
    margin: Floats | None
    standard_error: Floats | None
    size: Floats | None
    kind: str
    freedom: tuple[float, ...]
    meaning: str
    levels: dict[str, int]
    columns: list[str]
    codes: dict[str, list[float]]
    resampling: str | None
    assumption: str | None
    relabellings: int
    exact: bool
    smallest_p: float | None
    tfce: Floats | None
    p_tfce: Floats | None
    clusters: list[Cluster] | None
    cluster_of: np.ndarray[Any, np.dtype[np.int64]] | None
    cluster_threshold: float | None
    warnings: tuple[str, ...]
    mean: Model | None
    surface: Surface | None = field(repr=False)
    mask: np.ndarray[Any, np.dtype[np.bool_]] | None = field(default=None, repr=False)

    # Tells pytest not to collect this class as a test.
    __test__ = False

    def __repr__(self) -> str:
        least = self.p if self.p_fwe is None else self.p_fwe
        name = "p" if self.p_fwe is None else "p_fwe"
        count = f"{len(self.p)}" if self.mask is None else f"{int(self.mask.sum())} of {len(self.p)}"
        return f"TestResult({self.kind}, {self.meaning}, {count} vertices, least {name} {np.nanmin(least):.3g})"

    @property
    def t(self) -> Floats:
        """The statistic of a t test, (V,)."""
        if self.kind != "t":
            raise AttributeError(f"t: this result has the statistic {self.kind}, not t; use the attribute statistic")
        return self.statistic

    def to_nilearn(self, values: str = "statistic", *, hemisphere: str = "left", log10: bool = False) -> Any:
        """Returns a map of the result on `surface` as nilearn's ``SurfaceImage``.

        Parameters
        ----------
        values : str
            Attribute with a number for each vertex, as for `picture`; NaN outside of the mask.
        hemisphere : {"left", "right"}
        log10 : bool
            Return ``-log10`` of p values (`p`, `q`, `p_fwe`, `p_permutation`, `p_tfce`), so that small p are high, as for
            thresholds of nilearn's plots; by default the values themselves.

        Returns
        -------
        nilearn.surface.SurfaceImage
        """
        return self._surface().to_nilearn(self._values(values, log10), hemisphere=hemisphere)

    def to_nibabel(self, values: str = "statistic", *, log10: bool = False) -> Any:
        """Returns a map of the result as a ``nibabel.GiftiImage`` with one array of 32 bits, as `save` writes it.

        The triangles belong in a separate file, which ``result.surface.to_nibabel()`` makes. The parameters are those
        of `to_nilearn`.
        """
        from nibabel.gifti import GiftiDataArray, GiftiImage

        found = self._values(values, log10).astype(np.float32)
        name = f"-log10 {values}" if log10 else values
        array = GiftiDataArray(
            found, intent="NIFTI_INTENT_SHAPE", datatype="NIFTI_TYPE_FLOAT32", meta={"Name": f"{name}, {self.meaning}"}
        )
        return GiftiImage(darrays=[array])

    def _surface(self) -> Surface:
        if self.surface is None:
            raise ValueError("surface: expected a surface for the values, found None; give surface= to group_test")
        return self.surface

    def _values(self, values: str, log10: bool = False) -> Floats:
        """Returns a map, or with `log10` -log10 of a map of p values, (V,)."""
        if log10:
            _arrays.choice("values, with log10=True", values, _P_MAPS)
        found = getattr(self, values, None) if values in ("t", *self.__dataclass_fields__) else None
        if not isinstance(found, np.ndarray) or found.shape != self.p.shape or values == "mask":
            names = [name for name in _MAPS if np.shape(getattr(self, name)) == self.p.shape]
            raise ValueError(f"values: expected one of {', '.join(names)}; found {values!r}")
        # Numbers of clusters are 0 outside of the mask, where there is no value to draw.
        found = found if self.mask is None else np.where(self.mask, found, np.nan)
        return _minus_log10(found) if log10 else found

    def picture(
        self,
        values: str = "statistic",
        *,
        level: float | None = None,
        limits: tuple[float, float] | None = None,
        size: int = 480,
        view: Literal["left", "right", "front", "back", "top", "bottom", "corner"] = "corner",
    ) -> Picture:
        """Draws a map of the result on `surface`.

        Parameters
        ----------
        values : str
            Attribute with a number for each vertex, such as ``"effect"``, ``"statistic"``, ``"p_fwe"`` or ``"size"``. Of p
            values (`p`, `q`, `p_fwe`, `p_permutation`, `p_tfce`), ``-log10`` is drawn, so that small p are high: 1.3 is p =
            0.05, 3 is p = 0.001.
        level : float, optional
            Leave vertices grey whose `p_fwe` is above this level. Vertices outside of the mask are always grey.
        limits, size, view
            As for `spharm_rs.picture`; limits of p values are those of ``-log10``.

        Returns
        -------
        Picture
        """
        surface, found = self._surface(), self._values(values, log10=values in _P_MAPS)
        label = f"-log10 {values}, {self.meaning}" if values in _P_MAPS else f"{values}, {self.meaning}"
        if level is not None:
            if self.p_fwe is None:
                raise ValueError("level: expected a result with p_fwe, found a result of a test with permutations=0")
            found = np.where(self.p_fwe <= level, found, np.nan)
        return draw(surface, found, limits=limits, label=label, size=size, view=view)

    def save(self, folder: Path, *, overwrite: bool = False) -> None:
        """Writes the result into a folder: maps as GIfTI, which Workbench, nibabel and nilearn read, and figures as JSON.

        Each map with a value for each vertex is ``NAME.shape.gii``, such as ``p_fwe.shape.gii``, with 32 bits; effect,
        margin and standard error of positions have three channels. ``surface.surf.gii`` is `surface`, if it is known.
        ``test.json``, written last, has the other attributes except `mean` and `mask`, and the names of the files. With
        ``overwrite``, files of an earlier result that this one doesn't have are removed.

        Parameters
        ----------
        folder : str or os.PathLike
            Created if it doesn't exist.
        overwrite : bool
            Replace existing files.

        Raises
        ------
        FileExistsError
            If one of these files exists and ``overwrite`` is False; nothing is written then.

        Examples
        --------
        >>> import pathlib, tempfile
        >>> import numpy as np, spharm_rs as sp
        >>> values = np.random.default_rng(0).normal(size=(10, 42))
        >>> found = sp.shape.group_test(values, ["a", "b"] * 5, surface=sp.icosphere(1), permutations=0)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     found.save(folder)
        ...     names = sorted(path.name for path in pathlib.Path(folder).iterdir())
        >>> names[:3]
        ['effect.shape.gii', 'margin.shape.gii', 'p.shape.gii']
        """
        into = pathlib.Path(os.fspath(folder))
        files = {name: into / f"{name}.shape.gii" for name in _MAPS}
        surface, figures = into / _SURFACE_FILE, into / _FIGURES_FILE
        existing = [path for path in (*files.values(), surface, figures) if path.exists()]
        if existing and not overwrite:
            raise FileExistsError(f"{existing[0]}: exists already; choose another folder, or give overwrite=True")
        into.mkdir(parents=True, exist_ok=True)
        written = [name for name in _MAPS if getattr(self, name) is not None]
        # While this file is missing, the result in the folder counts as incomplete.
        figures.unlink(missing_ok=True)
        for name in written:
            write_signal(files[name], getattr(self, name).astype(float), overwrite=overwrite)
        if self.surface is not None:
            write_surface(surface, self.surface, overwrite=overwrite)
        for path in (*(files[name] for name in _MAPS if name not in written), *([] if self.surface is not None else [surface])):
            path.unlink(missing_ok=True)
        about = {name: getattr(self, name) for name in _FIGURES}
        about["clusters"] = None if self.clusters is None else [asdict(cluster) for cluster in self.clusters]
        about["vertices"], about["tested_vertices"] = len(self.p), len(self.p) if self.mask is None else int(self.mask.sum())
        about["maps"] = {name: files[name].name for name in written}
        about["surface"] = None if self.surface is None else surface.name
        with tempfile.TemporaryDirectory(dir=into, prefix=".test") as own:
            draft = pathlib.Path(own, figures.name)
            draft.write_text(json.dumps(about, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
            os.replace(draft, figures)
