//! The numbers that decide about the steps of a fit, each with what it comes from; those without a figure were chosen,
//! and no measurement of them is recorded. The model of costs is in `cost`, figures are in docs/performance.md.

/// Iterations that are made before they may be left for a factor that has yet to be made. Samplings that need more
/// need many more: an icosphere takes 9, a map by cald 60 (figure of docs/algorithms/least-squares.md).
pub(super) const ITERATIONS_BEFORE_FACTOR: usize = 60;
/// Iterations over which their progress is measured.
pub(super) const ITERATIONS_OF_PROGRESS: usize = 30;
/// Both, beside a stored factor: three show how many are left. A batch of 32 cortices takes a third less time.
pub(super) const ITERATIONS_BESIDE_FACTOR: usize = 3;
/// Share of a factor's cost that the iterations which seem to be left may take: they tend to be more than it seems.
pub(super) const LEFT_PER_FACTOR_COST: f64 = 0.2;
/// Share of the cost of using a stored factor that moments and the first iterations beside it may take.
pub(super) const BEGUN_PER_SOLVE_COST: f64 = 0.5;
/// Reciprocal condition number above which few iterations are needed, perhaps fewer than a stored factor is worth.
pub(super) const WELL_CONDITIONED_RECIPROCAL: f64 = 1e-2;
/// Columns up to which they are tried whatever they cost: one surface takes 16 ms by them, 17 ms with the factor.
pub(super) const FEW_COLUMNS: usize = 12;

/// Share of the expected iterations within which moments have to pay to be made at once: even samplings take half of
/// these (`Cost::expected_iterations`).
pub(super) const PAYING_PER_EXPECTED_ITERATIONS: f64 = 0.6;
/// Accuracy of moments relative to the tolerance. If the density is at most ten times its mean, their error in the
/// gradient is small beside it, which spares a fifth to a third of the passes over the samples.
pub(super) const MOMENT_ACCURACY_PER_TOLERANCE: f64 = 0.02;
/// Accuracy of the coarsest moments that are any cheaper.
pub(super) const COARSEST_MOMENT_ACCURACY: f64 = 1e-8;
/// Samples per degree squared from which one grid for operator and moments saves time: 10 to 25 % of one channel.
pub(super) const SAMPLES_PER_DEGREE_SQUARED_FOR_SHARED_GRID: usize = 64;

/// Rows with weight to a column from which the density may precondition: with fewer there may be many solutions, and
/// that of least norm is what iterations without a preconditioner tend to.
pub(super) const ROWS_PER_COLUMN_FOR_DENSITY: usize = 2;
/// Products that an iteration with the density costs: its inverse takes half the time of a product.
pub(super) const PRODUCTS_PER_DENSITY_ITERATION: f64 = 1.5;

/// Iterations without the optimality halving after which to give up.
pub(super) const ITERATIONS_WITHOUT_GAIN: usize = 250;
/// The same where each is preconditioned with the factor and worth many.
pub(super) const ITERATIONS_WITHOUT_GAIN_WITH_FACTOR: usize = 30;
/// Most refinements.
pub(super) const MOST_REFINEMENTS: usize = 40;
/// Optimality that rounding errors of targets and transforms leave.
pub(super) const ROUNDING_OPTIMALITY: f64 = 1e-9;
/// Reciprocal condition number below which a matrix counts as singular: nothing is left of a solve's digits.
pub(super) const SINGULAR_RECIPROCAL: f64 = 1e-14;
