"""Types of the reports of maps and fits.

Reports are dictionaries: these types name their keys for editors and type checkers. Distances with the suffix ``_raw``
are in the unit of the surface or signal; the others are relative to the cube root of the bounding box's volume. Keys
that don't apply are absent. To type checkers all keys are present, so that each can be read without a check.
"""

from __future__ import annotations

from typing import Any, List, Optional, TypedDict, Union

__all__ = [
    "CutLoop",
    "Denoised",
    "Distances",
    "FitReport",
    "HandlesReport",
    "HeldOut",
    "MapQuality",
    "MapReport",
    "RepairReport",
    "ResidualNorms",
    "Seconds",
    "SolverReport",
    "SolverSeconds",
    "SolverStep",
    "SurfaceDistance",
    "WrapReport",
]


class Distances(TypedDict):
    """Squared distances between model and target. Relative ones are None for a target without volume."""

    #: Whether the pass is an additional one, which removes rounding errors.
    refinement: bool
    #: Mean and largest squared distance, relative.
    msd: Optional[float]
    xsd: Optional[float]
    #: Mean and largest squared distance in the target's unit, squared.
    msd_raw: float
    xsd_raw: float


class SurfaceDistance(TypedDict):
    """Distances from the model to the surface and from the surface to the model, not only at vertices."""

    #: Root mean square, 95th percentile over the area, and largest distance, relative.
    rms: float
    percentile95: float
    hausdorff: float
    #: These distances in the surface's unit.
    rms_raw: float
    percentile95_raw: float
    hausdorff_raw: float
    #: Number of points that distances were measured from, excluding vertices.
    points: int
    #: Number of vertices of the icosphere at which the model was evaluated.
    model_vertices: int


class HeldOut(TypedDict):
    """Distances at held-out vertices and at the others."""

    #: Number of vertices held out.
    vertices: int
    held_out: Distances
    seen: Distances


class Denoised(TypedDict):
    """Noise that was estimated and removed, of a surface or of a channel of a signal."""

    #: Standard deviation of the noise in each channel, in the target's unit.
    sigma: float
    #: Effective number of coefficients per channel, at most (L + 1)**2.
    degrees_of_freedom: float
    #: Gain of each degree, between 0 and 1, (L + 1).
    gain: List[float]
    #: Root mean square of the detail beyond the fit's degree, in the target's unit; None if unknown.
    left_out: Optional[float]


class ResidualNorms(TypedDict):
    """Squared residual of a target, in its unit, squared."""

    mean_square: float
    max_square: float


class SolverSeconds(TypedDict):
    """Wall times of the solver, seconds."""

    factor: float
    moments: float
    iterations: float
    total: float


class SolverStep(TypedDict):
    """A step of the solver."""

    #: ``moments``, ``iterations by samples``, ``iterations by moments``, ``factor``, ``refinement``, ``confirmation``, ...
    name: str
    #: ``none``, ``density``, ``factor`` or ``stored-factor``.
    preconditioner: str
    #: Why this step was chosen.
    why: str
    #: Number of fits that took the step.
    fits: int
    iterations: int
    seconds: float
    #: Largest relative gradient of all columns after the step.
    optimality: float
    #: Why the step ended early.
    left: str


class SolverReport(TypedDict):
    """The solver of the full least squares."""

    max_degree: int
    #: Number of samples and of columns.
    rows: int
    channels: int
    #: Preconditioner of the last steps.
    preconditioner: str
    #: Source of the last iterations' products: ``samples`` or ``moments``.
    products: str
    iterations: int
    #: Number of refinements with a Cholesky factor.
    refinements: int
    steps: List[SolverStep]
    #: Largest relative gradient of all columns: 0 at the exact solution, 1 at zero coefficients.
    optimality: float
    #: ``converged``, ``stalled`` or ``iteration-limit``.
    stop: str
    #: Estimated condition number of the basis matrix, or a bound if ``density`` is the preconditioner; None if the
    #: matrix is singular or the number unknown.
    condition: Optional[float]
    #: Shift of the diagonal of a singular normal matrix, relative to its largest entry; otherwise 0.
    shift: float
    #: Column and degree at which the factorisation of a singular matrix broke down.
    breaks_at: Optional[List[int]]
    #: Largest norm of a column of the coefficients.
    norm: float
    #: Smoothness penalty, lambda.
    smoothness: float
    warnings: List[Any]
    #: One per target, at the vertices; empty if surfaces were fitted.
    residuals: List[ResidualNorms]
    seconds: SolverSeconds


class Seconds(TypedDict):
    """Wall times of a fit, seconds."""

    read: float
    plan: float
    solve: float
    write: float


class MapQuality(TypedDict):
    """Distortion of a map to the sphere. The area ratio of a triangle is its share of the sphere over its share of the
    surface."""

    triangles: int
    #: Numbers of reversed triangles and of triangles without area, by exact predicates; both 0 for a one-to-one map.
    flipped: int
    degenerate: int
    #: Number of times the sphere is covered: 1, or -1 if triangles are clockwise seen from outside.
    winding_number: int
    #: Root mean square of the log area ratio over triangles, and the same with triangles weighted by area.
    area_rms: float
    area_rms_weighted: float
    #: 1st and 99th percentile of the log area ratio.
    area_p01: float
    area_p99: float
    #: Root mean square of the angles' distortion, degrees.
    angle_rms_degrees: float
    #: L2 stretch: 1 for an isometry.
    stretch: float
    #: Largest length distortion of a triangle, and its 99th percentile.
    length_worst: float
    length_p99: float


class CutLoop(TypedDict):
    """A loop of edges along which a surface was cut."""

    #: ``handle`` or ``tunnel``.
    kind: str
    #: Length in the surface's unit, and number of vertices.
    length: float
    vertices: int
    #: Area of the two fillings, in the surface's unit, squared.
    area_added: float
    #: Mean of the positions of its vertices.
    centre: List[float]


class HandlesReport(TypedDict):
    """Handles that were cut."""

    genus_before: int
    genus_after: int
    #: Areas in the surface's unit, squared.
    area_added: float
    area: float
    vertices_added: int
    loops: List[CutLoop]


class WrapReport(TypedDict):
    """A closed surface around a mesh, found on a grid of voxels."""

    #: Voxels along the longest side of the mesh.
    voxels: int
    #: Length of a voxel's edges, in the coordinates' unit.
    voxel: float
    #: Share of the mesh's area farther than a voxel from the wrap: inner walls and parts thinner than a voxel.
    hidden_area: float
    #: Share of the mesh's area outside of the wrap and farther than two voxels from it: parts that were left out.
    lost_area: float
    #: Share of the wrap's area farther than a voxel from the mesh: the wrap spans holes there.
    bridged_area: float
    #: Root mean square distance of the wrap from the mesh, in the coordinates' unit.
    rms_distance: float
    #: Pieces of the body left out, which are all except the largest.
    pieces: int
    #: Share of the body's voxels in the pieces left out.
    left_out: float
    #: Cavities filled.
    cavities: int
    #: Handles removed.
    handles: int
    #: Whether handles were removed by cutting them; otherwise their holes were filled.
    handles_cut: bool


class RepairReport(TypedDict):
    """A repair of a mesh."""

    #: Vertices merged with another at the same position or, on rims, at nearly the same position.
    vertices_welded: int
    degenerate_triangles_dropped: int
    repeated_triangles_dropped: int
    #: Triangles of fins and of walls between chambers.
    triangles_of_fins_dropped: int
    triangles_turned: int
    #: Vertices added where parts touched.
    vertices_split: int
    pieces_dropped: int
    #: Dropped pieces that shared edges with the kept piece, such as a body behind a common wall.
    attached_pieces_dropped: int
    holes_filled: int
    #: Triangles that fill the holes; they are the last of the repaired surface.
    triangles_added: int
    unused_vertices_dropped: int
    #: Share of the area, from 0 to 1, lost by welding rims.
    lost_area: float
    #: Share of the area, from 0 to 1, in the dropped fins and walls between chambers.
    fins_area: float
    #: Share of the area of all pieces, from 0 to 1, in the dropped pieces.
    dropped_area: float
    #: Share of the area of the repaired surface in the filled holes.
    filled_area: float
    #: The closed surface that took the mesh's place, if it was wrapped.
    wrap: WrapReport
    #: `repair` only: reasons why the repaired surface can't be mapped to the sphere; empty if it can be.
    problems: List[str]


class MapReport(TypedDict):
    """A map to the sphere."""

    #: ``cald``, ``conformal``, ``stretch``, ``equal-area``, ``deform``, ``resample`` or ``given``.
    method: str
    vertices: int
    quality: MapQuality
    iterations: int
    #: Whether the optimisation met its tolerance.
    converged: bool
    #: Wall time from the mesh to the map.
    seconds: float
    notes: List[str]
    warnings: List[str]
    #: ``equal-area`` only: largest relative deviation of a quadrangle's area from its target.
    quad_area_deviation: float
    handles: HandlesReport
    #: `spharm_rs.fit_cohort` only: file of the sphere.
    sphere: str
    #: For a label: number of its voxels before a repair, and whether they touch the border of the volume, which may
    #: have cut off a part.
    voxels: int
    at_border: bool
    #: Repairs of a label: counts by name.
    repair: Any
    #: Repair of a mesh.
    mesh_repair: RepairReport
    #: `resample` only: root mean square and largest distance from the given surface, in its unit.
    distance_rms: float
    distance_max: float
    #: `resample` only: pairs of triangles that intersect; None if this wasn't checked.
    self_intersections: Optional[int]


class FitReport(TypedDict):
    """The report of a fit: `spharm_rs.Model.report`, or the report of `spharm_rs.solve`. It is empty for a model from a
    file."""

    #: Number of channels; for a fit of moments, their names.
    channels: Union[int, List[str]]
    #: Cube root of the bounding box's volume, in the target's unit; None for a target without volume.
    scale: Optional[float]
    #: Mean and largest squared distance at the vertices, relative; None for a target without volume.
    msd: Optional[float]
    xsd: Optional[float]
    #: Distances at the vertices after each pass; the last are those of the model.
    passes: List[Distances]
    #: Distances between the surface and its model, if the surface was fitted.
    surface_distance: SurfaceDistance
    #: Distances at the centres of triangles.
    between: Distances
    held_out: HeldOut
    #: One per surface, or one per channel of a signal.
    denoise: List[Denoised]
    #: Smoothness penalty, lambda; 0 without one. If each channel of a signal has its own, the largest one.
    smoothness: float
    #: Smoothness penalty of each channel, if cross-validation chose it for each channel of a signal.
    smoothness_by_channel: List[float]
    #: Key of the sampling scheme, 64 hexadecimal digits; None for moments of samples elsewhere.
    scheme_key: Optional[str]
    seconds: Seconds
    #: Map of a surface that was given without a sphere; None over a given sphere.
    parametrization: Optional[MapReport]
    #: Report of the full least squares.
    solver: SolverReport
    warnings: List[str]
    #: Fits of moments only: number of samples with weight, and sum of the weights.
    samples: int
    weight: float
    #: Fits of moments only: root of the weighted mean of the squared residual of each channel, in its unit; None if
    #: the mean of the values is so large that rounding errors hide the residual.
    rms: List[Optional[float]]
    #: Fits of moments only: share of the sum of squares that the model explains, for each channel; None as for
    #: ``rms``.
    explained: List[Optional[float]]
    #: Fits of moments only: diameter of the largest cap without samples, and resolution at the highest degree (None at
    #: degree 0), degrees.
    largest_gap: float
    resolved: Optional[float]
    #: Fits of moments only: search for the smoothness by cross-validation.
    gcv: Any
    #: `spharm_rs.solve` with ``stderr`` only: standard errors of the coefficients, an array of their shape.
    standard_errors: Any
    #: `spharm_rs.shape.mean` only: root mean square distance of each model from the mean, (s,), and that of all models,
    #: in the models' unit.
    distances: Any
    spread: float
