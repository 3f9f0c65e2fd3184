from __future__ import annotations

from typing import Any, Callable, Sequence, Union, final

import numpy as np
from numpy.typing import NDArray

_Floats = NDArray[np.float64]
_Triangles = NDArray[np.uint32]
_Progress = Callable[[str, int, int], Any]
_Seam = tuple[int, int, _Triangles]
_Ends = tuple[list[float], list[float], list[float]]
_Apart = tuple[float, float, list[float] | None, list[float], list[list[float]]]
_Mapped = tuple[_Floats, _Triangles, _Floats, str, list[str], Union[_Seam, None]]
_Metadata = Union[dict[str, Any], None]
_Given = Union[str, tuple[_Floats, _Triangles, _Metadata]]
_Flags = NDArray[np.bool_]
_Fitted = tuple[Model, Union[_Floats, None], str, list[tuple[str, str]]]

__all__ = [
    "CohortRun",
    "Group",
    "Labels",
    "Model",
    "Modes",
    "Moments",
    "Transform",
    "__version__",
    "choose_degree",
    "compare",
    "example_surface",
    "fit",
    "fit_many",
    "icosphere",
    "is_mesh_name",
    "labels",
    "main",
    "of_point_set",
    "parametrize",
    "parametrize_volume",
    "picture",
    "quality",
    "read_landmarks",
    "read_mask",
    "read_surface",
    "read_values",
    "repair",
    "resample",
    "shape_align",
    "shape_check",
    "shape_correspond",
    "shape_describe",
    "shape_even",
    "shape_geometry",
    "shape_match",
    "shape_mean",
    "shape_measure",
    "shape_measure_group",
    "shape_morph",
    "shape_pca",
    "shape_pose",
    "shape_procrustes",
    "shape_quality",
    "shape_register",
    "shape_rotate",
    "shape_smooth",
    "shape_tails",
    "shape_test",
    "solve",
    "stem",
    "store_build",
    "store_factor",
    "store_schemes",
    "store_verify",
    "surface_distance",
    "values_at",
    "write_landmarks",
    "write_surface",
    "write_values",
]

__version__: str

@final
class Group:
    @property
    def models(self) -> list[Model]: ...
    @property
    def mean(self) -> Model: ...
    @property
    def transforms(self) -> str: ...
    @property
    def places(self) -> _Floats: ...
    @property
    def reached(self) -> _Flags: ...
    @property
    def masked(self) -> _Flags: ...
    @property
    def sphere(self) -> tuple[_Floats, _Triangles]: ...
    @property
    def warnings(self) -> list[str]: ...
    @property
    def report(self) -> str: ...
    def kept_at(self, directions: _Floats) -> list[bool]: ...
    def write(self, folder: str, names: Sequence[str], overwrite: bool) -> None: ...
    @staticmethod
    def read(folder: str, names: Sequence[str] | None) -> tuple[Group, list[str]]: ...
    def carry(self, points: _Floats, source: int, target: int) -> tuple[_Floats, _Floats, _Flags]: ...
    def misplaced_landmarks(self, landmarks: Sequence[_Floats], labels: Sequence[str]) -> list[tuple[int, str]]: ...
    def add(
        self,
        surfaces: Sequence[_Given],
        names: Sequence[str],
        *,
        mirrored: bool,
        threads: int | None = None,
        progress: _Progress | None = None,
    ) -> list[tuple[Model, str, _Floats, _Flags, str, list[str]]]: ...

@final
class Labels:
    def __new__(
        cls,
        volume: tuple[str, list[float] | None, _Floats | None, str] | tuple[NDArray[np.int32] | _Floats, _Floats],
        *,
        image: tuple[int | None, int | None],
    ) -> Labels: ...
    def labels(self, fix: bool, chosen: Sequence[int] | None) -> dict[int, tuple[int, bool]]: ...
    def warnings(self) -> list[str]: ...
    def voxel(self) -> float: ...
    def degree(self, voxels: Sequence[int]) -> int: ...
    def parametrize(
        self,
        label: int,
        *,
        label_surface: str,
        smooth_radius: float | None,
        fix: bool,
        cut_handles: bool,
        memory: int | None = None,
        threads: int | None = None,
        progress: _Progress | None = None,
    ) -> _Mapped: ...

@final
class Model:
    def __new__(
        cls,
        coefficients: _Floats,
        *,
        surface: bool,
        sphere: _Floats | None = None,
        faces: _Triangles | None = None,
        parametrized: bool = False,
        seam: _Seam | None = None,
    ) -> Model: ...
    @staticmethod
    def read(path: str) -> Model: ...
    @staticmethod
    def from_bytes(bytes: bytes) -> Model: ...
    def to_bytes(self) -> bytes: ...
    def write(self, path: str, *, overwrite: bool = False) -> None: ...
    @staticmethod
    def expand(bytes: bytes, name: str) -> Model: ...
    def compress(
        self, path: str, *, tolerance: float | None, bytes: int | None, overwrite: bool, threads: int | None = None
    ) -> tuple[float, int]: ...
    @property
    def coefficients(self) -> _Floats: ...
    @property
    def max_degree(self) -> int: ...
    @property
    def is_surface(self) -> bool: ...
    @property
    def parametrized(self) -> bool: ...
    def mapped_apart(self, other: Model) -> bool: ...
    @property
    def sphere(self) -> tuple[_Floats, _Triangles] | None: ...
    @property
    def seam(self) -> _Seam | None: ...
    @property
    def provenance(self) -> str: ...
    def truncate(self, degree: int) -> Model: ...
    def with_coefficients(self, coefficients: _Floats) -> Model: ...
    def evaluate(self, directions: _Floats | None, degree: int, *, threads: int | None = None) -> _Floats: ...
    def surface(
        self, sphere: _Floats | None, faces: _Triangles | None, degree: int, *, threads: int | None = None
    ) -> tuple[_Floats, _Triangles, _Metadata]: ...

@final
class Moments:
    def __new__(
        cls,
        directions: _Floats,
        values: _Floats,
        weights: _Floats | None,
        max_degree: int,
        channels: list[str],
        *,
        whole: str | None,
        shard: tuple[int, int],
        threads: int | None = None,
        progress: _Progress | None = None,
    ) -> Moments: ...
    @staticmethod
    def read(path: str) -> Moments: ...
    @staticmethod
    def from_bytes(bytes: bytes) -> Moments: ...
    def to_bytes(self) -> bytes: ...
    def write(self, path: str, *, overwrite: bool = False) -> None: ...
    @staticmethod
    def merge(parts: Sequence[Moments], *, partial: bool = False) -> Moments: ...
    @property
    def max_degree(self) -> int: ...
    @property
    def channels(self) -> list[str]: ...
    @property
    def samples(self) -> int: ...
    @property
    def weight(self) -> float: ...
    @property
    def scheme(self) -> str | None: ...
    def fit(self, settings: dict[str, Any], progress: _Progress | None = None) -> _Fitted: ...

@final
class CohortRun:
    def __new__(
        cls,
        table: str | None,
        rows: list[tuple[Any, ...]] | None,
        *,
        output: str | None,
        sphere: str | None,
        mask: str | None,
        shard: str | None,
        status: str | None,
        exists: str,
        keep_going: bool,
        changes: tuple[bool, float | None, int | None, bool],
        voxel_size: Sequence[float] | None,
        axes: str,
        image: tuple[int | None, int | None],
        threshold: float | None,
        probability: bool,
        label_surface: str,
        smooth_radius: float | None,
        settings: dict[str, Any],
    ) -> CohortRun: ...
    def __len__(self) -> int: ...
    def next(self) -> tuple[tuple[int, str, str, str, str | None, str | None, float | None] | None, list[str]]: ...
    def stop(self) -> None: ...

@final
class Transform:
    def __new__(
        cls, directions: _Floats, max_degree: int, *, accuracy: float, channels: int, threads: int | None = None
    ) -> Transform: ...
    @property
    def max_degree(self) -> int: ...
    @property
    def directions(self) -> int: ...
    def serves(self, max_degree: int) -> bool: ...
    def synthesis(self, coefficients: _Floats) -> _Floats: ...
    def adjoint(self, samples: _Floats) -> _Floats: ...
    def normal(self, coefficients: _Floats, weights: _Floats | None = None) -> _Floats: ...

@final
class Modes:
    @staticmethod
    def read(path: str) -> Modes: ...
    def write(self, path: str, *, overwrite: bool = False) -> None: ...
    @property
    def mean(self) -> Model: ...
    @property
    def modes(self) -> _Floats: ...
    @property
    def variances(self) -> _Floats: ...
    @property
    def scores(self) -> _Floats: ...
    @property
    def total_variance(self) -> float: ...
    @property
    def shares(self) -> _Floats: ...
    @property
    def compactness(self) -> _Floats: ...
    @property
    def members(self) -> list[str]: ...
    @property
    def provenance(self) -> str: ...
    def truncate(self, count: int) -> Modes: ...
    def shape(self, deviations: _Floats) -> Model: ...
    def sample(self, count: int, *, seed: int) -> list[Model]: ...
    def project(self, model: Model) -> tuple[_Floats, float]: ...
    def quality(
        self, *, samples: int, seed: int, threads: int | None = None, progress: _Progress | None = None
    ) -> tuple[_Floats, _Floats]: ...

def main(arguments: Sequence[str]) -> int: ...
def fit(
    values: _Floats,
    faces: _Triangles | None,
    sphere: _Floats | None,
    sphere_faces: _Triangles | None,
    *,
    metadata: tuple[_Metadata, _Metadata],
    surface: bool,
    parametrized: bool,
    seam: _Seam | None,
    changes: tuple[bool, float | None, int | None, bool],
    settings: dict[str, Any],
    progress: _Progress | None = None,
) -> _Fitted: ...
def choose_degree(
    vertices: _Floats,
    faces: _Triangles,
    sphere: _Floats | None,
    sphere_faces: _Triangles | None,
    *,
    accuracy: str,
    settings: dict[str, Any],
    progress: _Progress | None = None,
) -> tuple[int, float, float]: ...
def solve(
    at: Transform | _Floats, values: _Floats, *, settings: dict[str, Any], progress: _Progress | None = None
) -> tuple[_Floats, _Floats | None, str, list[tuple[str, str]]]: ...
def fit_many(
    values: list[_Floats],
    sphere: _Floats,
    sphere_faces: _Triangles | None,
    *,
    metadata: tuple[list[_Metadata], _Metadata],
    surface: bool,
    parametrized: bool,
    seam: _Seam | None,
    settings: dict[str, Any],
    progress: _Progress | None = None,
) -> list[_Fitted]: ...
def is_mesh_name(path: str) -> bool: ...
def stem(path: str) -> str: ...
def read_surface(path: str, *, gaps: bool = ...) -> tuple[_Floats, _Triangles, _Metadata]: ...
def write_surface(
    path: str, vertices: _Floats, faces: _Triangles, metadata: _Metadata, *, overwrite: bool, double: bool
) -> str | None: ...
def of_point_set(metadata: dict[str, Any]) -> list[tuple[str, str]]: ...
def read_landmarks(path: str) -> tuple[list[str], _Floats, str | None]: ...
def write_landmarks(path: str, names: Sequence[str], points: _Floats, frame: str | None, *, overwrite: bool) -> None: ...
def read_values(path: str, *, gaps: bool = ...) -> _Floats: ...
def values_at(
    vertices: _Floats, faces: _Triangles, values: _Floats, points: _Floats, *, labels: bool
) -> tuple[_Floats, _Floats]: ...
def read_mask(path: str, vertices: int) -> NDArray[np.bool_]: ...
def write_values(path: str, values: _Floats, *, overwrite: bool, double: bool) -> None: ...
def icosphere(level: int) -> tuple[_Floats, _Triangles]: ...
def example_surface(level: int, variant: int) -> tuple[_Floats, _Triangles, _Floats]: ...
def parametrize(
    vertices: _Floats,
    faces: _Triangles,
    *,
    changes: tuple[bool, float | None, int | None, bool],
    method: str,
    degree: int | None,
    area: float,
    seed: int,
    memory: int | None = None,
    threads: int | None = None,
    progress: _Progress | None = None,
) -> _Mapped: ...
def picture(
    vertices: _Floats,
    faces: _Triangles,
    *,
    values: _Floats | None,
    limits: tuple[float, float],
    label: str,
    caption: str,
    size: int,
    view: str,
) -> bytes: ...
def repair(
    vertices: _Floats, faces: _Triangles, *, largest_repair: float | None, wrap: int | None
) -> tuple[_Floats, _Triangles, str, str]: ...
def parametrize_volume(
    volume: tuple[str, list[float] | None, _Floats | None, str] | tuple[NDArray[np.int32] | _Floats, _Floats],
    *,
    label: int | None,
    image: tuple[int | None, int | None],
    threshold: float | None,
    probability: bool,
    label_surface: str,
    smooth_radius: float | None,
    fix: bool,
    cut_handles: bool,
    method: str,
    degree: int | None,
    area: float,
    seed: int,
    memory: int | None = None,
    threads: int | None = None,
    progress: _Progress | None = None,
) -> _Mapped: ...
def labels(
    volume: tuple[str, list[float] | None, _Floats | None, str] | tuple[NDArray[np.int32] | _Floats, _Floats],
    *,
    image: tuple[int | None, int | None],
) -> dict[int, int]: ...
def resample(
    vertices: _Floats,
    faces: _Triangles,
    sphere: _Floats,
    shared: _Floats,
    shared_faces: _Triangles,
    *,
    memory: int | None = None,
    threads: int | None = None,
    progress: _Progress | None = None,
) -> _Mapped: ...
def quality(vertices: _Floats, faces: _Triangles, sphere: _Floats) -> str: ...
def compare(
    vertices: _Floats,
    faces: _Triangles,
    others: _Floats,
    other_faces: _Triangles,
    mask: NDArray[np.bool_] | None,
    check: bool,
) -> tuple[list[float], int, _Floats, str | None]: ...
def surface_distance(
    vertices: _Floats,
    faces: _Triangles,
    others: _Floats,
    other_faces: _Triangles,
    *,
    samples: int,
    mask: NDArray[np.bool_] | None = None,
    memory: int | None = None,
    threads: int | None = None,
    progress: _Progress | None = None,
) -> tuple[str, _Floats]: ...
def shape_measure(
    model: Model, degree: int, *, tolerance: float, threads: int | None = None, progress: _Progress | None = None
) -> tuple[str, list[str]]: ...
def shape_geometry(
    model: Model,
    directions: _Floats | None,
    degree: int,
    *,
    threads: int | None = None,
    progress: _Progress | None = None,
) -> tuple[_Floats, _Floats, _Floats]: ...
def shape_smooth(model: Model, *, time: float | None, width: float) -> Model: ...
def shape_describe(model: Model) -> tuple[_Floats, _Floats]: ...
def shape_match(
    query: Model,
    among: Sequence[Model],
    *,
    count: int,
    unit_size: bool,
    standardized: bool,
    threads: int | None = None,
) -> list[tuple[int, float, float]]: ...
def shape_tails(model: Model) -> _Floats: ...
def shape_even(
    model: Model,
    sphere: _Floats,
    faces: _Triangles,
    degree: int,
    *,
    steps: int,
    threads: int | None = None,
    progress: _Progress | None = None,
) -> tuple[_Floats, float, float, int]: ...
def shape_rotate(
    model: Model, asked: dict[str, Any], *, threads: int | None = None, progress: _Progress | None = None
) -> Model: ...
def shape_align(
    model: Model,
    target: Model,
    settings: dict[str, Any],
    *,
    threads: int | None = None,
    progress: _Progress | None = None,
) -> tuple[Model, str]: ...
def shape_morph(
    start: Model,
    end: Model,
    times: Sequence[float],
    *,
    fixed: bool | None,
    keep_pose: bool,
    mirror: bool,
    threads: int | None = None,
    progress: _Progress | None = None,
) -> tuple[list[Model], float, list[str]]: ...
def shape_procrustes(
    models: Sequence[Model], settings: dict[str, Any], *, threads: int | None = None, progress: _Progress | None = None
) -> tuple[list[Model], Model, str]: ...
def shape_mean(
    models: Sequence[Model], degree: int | None, *, names: Sequence[str], threads: int | None = None
) -> tuple[Model, list[float], list[str]]: ...
def shape_pca(
    models: Sequence[Model], degree: int | None, *, most: int | None, names: Sequence[str], threads: int | None = None
) -> tuple[Modes, list[str]]: ...
def shape_check(
    models: Sequence[Model],
    names: Sequence[str],
    *,
    aligned: tuple[Sequence[Model], Model] | None,
    scores: list[list[float]] | None,
    threads: int | None = None,
    progress: _Progress | None = None,
) -> tuple[
    list[tuple[list[float | None], list[float | None], tuple[int, float] | None, list[str], float]], list[str]
]: ...
def shape_quality(
    models: Sequence[Model],
    landmarks: list[_Floats] | None,
    *,
    settings: dict[str, Any],
    threads: int | None = None,
    progress: _Progress | None = None,
) -> tuple[float, list[float], list[_Ends], list[_Ends | None], _Apart | None, list[str]]: ...
def shape_correspond(
    surfaces: Sequence[_Given],
    names: Sequence[str],
    template: _Given | None,
    *,
    settings: dict[str, Any],
    signals: Sequence[Sequence[NDArray[np.float64]]],
    threads: int | None = None,
    progress: _Progress | None = None,
) -> Group: ...
def shape_pose(
    surface: _Given,
    target: _Given,
    *,
    scale: bool,
    mirror: bool,
    threads: int | None = None,
    progress: _Progress | None = None,
) -> tuple[str, float, float, list[str]]: ...
def shape_register(
    template: _Given,
    surface: _Given,
    masked: Sequence[bool] | None,
    *,
    pose: bool,
    scale: bool,
    mirror: bool,
    threads: int | None = None,
    progress: _Progress | None = None,
) -> tuple[_Floats, _Triangles, _Flags, str, str, list[str]]: ...
def shape_measure_group(
    models: Sequence[Model],
    directions: _Floats,
    degree: int | None,
    *,
    signal: str,
    pairs: bool,
    threads: int | None = None,
    progress: _Progress | None = None,
) -> tuple[_Floats, int, Model, list[str]]: ...
def shape_test(
    values: _Floats,
    components: int,
    asked: dict[str, Any],
    inference: dict[str, Any],
    *,
    welch: bool,
    permutations: int,
    seed: int,
    confidence: float,
    level: float,
    threads: int | None = None,
    progress: _Progress | None = None,
) -> dict[str, Any]: ...
def store_build(
    store: str,
    sphere: _Floats,
    faces: _Triangles | None,
    max_degree: int,
    *,
    dtype: str,
    memory: int,
    allow_large: bool,
    threads: int | None = None,
    progress: _Progress | None = None,
) -> str: ...
def store_factor(
    store: str,
    sphere: _Floats,
    faces: _Triangles | None,
    max_degree: int,
    *,
    dtype: str,
    basis_dtype: str,
    smoothness: float,
    memory: int,
    allow_large: bool,
    threads: int | None = None,
    progress: _Progress | None = None,
) -> str: ...
def store_schemes(store: str) -> str: ...
def store_verify(store: str, *, threads: int | None = None, progress: _Progress | None = None) -> list[str]: ...
