//! Constants that determine the steps of a fit, each with its origin. A constant without a figure was chosen without a
//! recorded measurement. The model of costs is in `cost`; figures are in docs/performance.md. The table of steps in
//! docs/methods.md repeats some of the constants.

/// Minimum number of iterations before switching to a factor that must first be computed. Samplings that need more
/// iterations than this need many more: an icosphere takes 9, a sphere map by `cald` 60 (figure of
/// docs/algorithms/least-squares.md).
pub(super) const ITERATIONS_BEFORE_FACTOR: usize = 60;
/// Number of iterations over which progress is measured.
pub(super) const ITERATIONS_OF_PROGRESS: usize = 30;
/// Minimum number of iterations before switching to a stored factor, and number of iterations over which progress is
/// then measured. Three iterations suffice to predict the number of remaining iterations. With this value, a batch of
/// 32 cortices takes a third less time.
pub(super) const ITERATIONS_BESIDE_FACTOR: usize = 3;
/// Largest cost of the predicted remaining iterations, relative to the cost of a factor, for which iterations continue.
/// It is far below 1 because the prediction tends to be too low.
pub(super) const LEFT_PER_FACTOR_COST: f64 = 0.2;
/// Largest cost of moments and first iterations, relative to the cost of using a stored factor, for which iterations
/// are tried before the factor.
pub(super) const BEGUN_PER_SOLVE_COST: f64 = 0.5;
/// Reciprocal condition number above which few iterations are needed, possibly at a lower cost than using a stored
/// factor.
pub(super) const WELL_CONDITIONED_RECIPROCAL: f64 = 1e-2;
/// Number of columns up to which iterations are tried before a well-conditioned stored factor, whatever their cost: one
/// surface takes 16 ms by iterations, 17 ms with the factor.
pub(super) const FEW_COLUMNS: usize = 12;

/// Moments are computed immediately if they pay off within this share of the expected iterations. Even samplings take
/// half of the expected iterations (`Cost::expected_iterations`).
pub(super) const PAYING_PER_EXPECTED_ITERATIONS: f64 = 0.6;
/// Accuracy of moments relative to the tolerance. If the density is at most ten times its mean, the error of the
/// gradient due to moments is then small compared with the tolerance. The gradient needn't be recomputed from the
/// samples, which saves a fifth to a third of the passes over the samples.
pub(super) const MOMENT_ACCURACY_PER_TOLERANCE: f64 = 0.02;
/// Least number of iterations of a search for the smoothness: four for each of its 23 values.
pub(super) const LEAST_ITERATIONS_OF_SEARCH: f64 = 92.0;
/// Accuracy of moments for a search for the smoothness. The weakest penalties, which alone determine the coefficients
/// where the sampling has gaps, are 1e-9 of the normal matrix's diagonal at a quarter of the degree.
pub(super) const MOMENT_ACCURACY_OF_SEARCH: f64 = 1e-11;
/// Coarsest useful accuracy of moments: moments of lower accuracy aren't cheaper.
pub(super) const COARSEST_MOMENT_ACCURACY: f64 = 1e-8;
/// Number of samples per degree squared from which a common grid for operator and moments saves time: 10 to 25 % for
/// one channel.
pub(super) const SAMPLES_PER_DEGREE_SQUARED_FOR_SHARED_GRID: usize = 64;

/// Minimum number of rows with nonzero weight per basis function for which the density may precondition. With fewer
/// rows there may be many solutions, and only iterations without a preconditioner tend to the solution of minimum norm.
pub(super) const ROWS_PER_COLUMN_FOR_DENSITY: usize = 2;
/// Cost of an iteration with the density, in products by moments: the inverse of the density takes half the time of a
/// product.
pub(super) const PRODUCTS_PER_DENSITY_ITERATION: f64 = 1.5;

/// Maximum number of iterations without a halving of the optimality.
pub(super) const ITERATIONS_WITHOUT_GAIN: usize = 250;
/// Maximum number of iterations without a halving of the optimality, if the factor preconditions them. Each of these
/// iterations gains as much as many plain ones.
pub(super) const ITERATIONS_WITHOUT_GAIN_WITH_FACTOR: usize = 30;
/// Maximum number of refinements.
pub(super) const MOST_REFINEMENTS: usize = 40;
/// Optimality that is attainable despite rounding errors of targets and transforms.
pub(super) const ROUNDING_OPTIMALITY: f64 = 1e-9;
/// Reciprocal condition number below which a matrix is treated as singular: a solve loses all digits.
pub(super) const SINGULAR_RECIPROCAL: f64 = 1e-14;
