//! Constants that determine the steps of a fit, with their origins. A constant without a figure was chosen without a
//! recorded measurement. The formulas of the costs are in `cost`; measured figures are in docs/performance.md. The
//! table of steps in docs/methods.md repeats some of the constants.

/// Minimum number of iterations before switching to a factor that must first be computed. A sampling that needs more
/// iterations than this usually needs far more. An icosphere takes 9 iterations, and a sphere map computed by `cald`
/// takes 60 (figures from docs/algorithms/least-squares.md).
pub(super) const ITERATIONS_BEFORE_FACTOR: usize = 60;
/// Number of iterations over which progress is measured.
pub(super) const ITERATIONS_OF_PROGRESS: usize = 30;
/// Minimum number of iterations before switching to a stored factor. With a stored factor, this number replaces
/// [`ITERATIONS_BEFORE_FACTOR`] and [`ITERATIONS_OF_PROGRESS`] for iterations by moments. Three iterations suffice to
/// predict the number of remaining iterations. This early switch reduces the time for a batch of 32 cortices by a
/// third.
pub(super) const ITERATIONS_BESIDE_FACTOR: usize = 3;
/// Iterations continue if the predicted remaining iterations cost at most this share of the cost of a factor. The share
/// is far below 1 because the prediction tends to be too low.
pub(super) const LEFT_PER_FACTOR_COST: f64 = 0.2;
/// Iterations are tried before a well-conditioned stored factor is used, if the first [`ITERATIONS_BESIDE_FACTOR`]
/// iterations cost less than this share of the cost of using the factor. If the moments must first be computed, their
/// cost is added to the cost of the iterations.
pub(super) const BEGUN_PER_SOLVE_COST: f64 = 0.5;
/// A stored factor is well conditioned if its reciprocal condition number is above this value. A fit then needs few
/// iterations, which may cost less than using the factor.
pub(super) const WELL_CONDITIONED_RECIPROCAL: f64 = 1e-2;
/// If the targets have at most this number of columns, iterations are tried before a well-conditioned stored factor is
/// used, regardless of the iterations' cost. One surface takes 16 ms by iterations, and 17 ms with the factor.
pub(super) const FEW_COLUMNS: usize = 12;

// Rates of the cost model on one thread of a Xeon of 2023. The times in ns are fitted to measurements by
// `examples/rates.rs` of `spharm-transform`, at degree L, for n samples and c channels. The two rates of dense matrices
// were chosen without a recorded measurement.

/// Product computed from the samples: time for computing the kernel values of one sample.
pub(super) const SAMPLE_NS: f64 = 50.0;
/// Product computed from the samples: time for one sample's sums over the kernel values, per channel.
pub(super) const SAMPLE_CHANNEL_NS: f64 = 50.0;
/// Product computed from the samples: time for the Fourier transforms of a grid, divided by c L^2 log2 L.
pub(super) const GRID_NS: f64 = 25.0;
/// Product computed from the samples: time for the Legendre sums, divided by c L^3.
pub(super) const ORDER_NS: f64 = 0.1;
/// Product computed from moments: time for the Fourier transforms, divided by c L^2 log2 L.
pub(super) const MOMENT_GRID_NS: f64 = 13.0;
/// Product computed from moments: time for the Legendre sums, divided by c L^3.
pub(super) const MOMENT_ORDER_NS: f64 = 0.2;
/// Computation of moments: time per sample.
pub(super) const MAKING_SAMPLE_NS: f64 = 350.0;
/// Computation of moments: time for the Fourier transforms, divided by L^2 log2 2L.
pub(super) const MAKING_GRID_NS: f64 = 100.0;
/// Computation of moments: time for the Legendre sums, divided by L^3.
pub(super) const MAKING_ORDER_NS: f64 = 1.2;
/// Rate of dense products and factorisations, in flops per ns.
pub(super) const DENSE_FLOPS_PER_NS: f64 = 40.0;
/// Rate at which a Cholesky factor is read from memory, in bytes per ns.
pub(super) const FACTOR_BYTES_PER_NS: f64 = 5.0;

/// Moments are computed before the first iteration if the time for computing them is saved within this share of the
/// iterations that `Cost::expected_iterations` predicts. The share is below 1, because even samplings take only half of
/// the predicted iterations.
pub(super) const PAYING_PER_EXPECTED_ITERATIONS: f64 = 0.6;
/// Accuracy required of the moments, as a fraction of the tolerance. With it, the error that the moments cause in the
/// gradient is small compared with the tolerance, if the sampling density is nowhere more than ten times its mean.
/// Therefore the gradient needn't be recomputed from the samples, which saves a fifth to a third of the passes over the
/// samples.
pub(super) const MOMENT_ACCURACY_PER_TOLERANCE: f64 = 0.02;
/// Smallest number of iterations that a search for the smoothness takes: four iterations for each of the 23 values of
/// lambda.
pub(super) const LEAST_ITERATIONS_OF_SEARCH: f64 = 92.0;
/// Relative accuracy required of the moments in a search for the smoothness. The search also tries very weak penalties:
/// at a quarter of the highest degree, they are 1e-9 of the normal matrix's diagonal. In gaps of the sampling only the
/// penalty determines the fit, so the error of the moments must be far below the penalty.
pub(super) const MOMENT_ACCURACY_OF_SEARCH: f64 = 1e-11;
/// Coarsest useful accuracy of moments: moments of lower accuracy aren't cheaper.
pub(super) const COARSEST_MOMENT_ACCURACY: f64 = 1e-8;
/// If there are at least this number of samples per degree squared, a grid shared by the operator and the moments saves
/// time: 10 to 25 % for one channel.
pub(super) const SAMPLES_PER_DEGREE_SQUARED_FOR_SHARED_GRID: usize = 64;

/// The inverse of the sampling density is used as a preconditioner only if there are at least this many rows with
/// nonzero weight per basis function. With fewer rows there may be many solutions, and only iterations without a
/// preconditioner tend to the solution of minimum norm.
pub(super) const ROWS_PER_COLUMN_FOR_DENSITY: usize = 2;
/// Time of an iteration that is preconditioned with the density, divided by the time of a product by moments. The
/// inverse of the density takes half the time of a product.
pub(super) const PRODUCTS_PER_DENSITY_ITERATION: f64 = 1.5;

/// Conjugate gradients end if the optimality isn't halved within this number of iterations.
pub(super) const ITERATIONS_WITHOUT_GAIN: usize = 250;
/// The same limit as [`ITERATIONS_WITHOUT_GAIN`], for conjugate gradients that are preconditioned with the factor. The
/// limit is lower, because an iteration with the factor reduces the error as much as many iterations without it.
pub(super) const ITERATIONS_WITHOUT_GAIN_WITH_FACTOR: usize = 30;
/// Maximum number of refinements.
pub(super) const MOST_REFINEMENTS: usize = 40;
/// Optimality (relative gradient) that can be attained despite rounding errors in the targets and transforms.
pub(super) const ROUNDING_OPTIMALITY: f64 = 1e-9;
/// Reciprocal condition number below which a matrix is treated as singular, because a solve loses all digits.
pub(super) const SINGULAR_RECIPROCAL: f64 = 1e-14;
