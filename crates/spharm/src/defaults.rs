//! Numeric defaults of fits, with the reason for each.

/// Default granularity of [`Method::Irf`](crate::Method::Irf), as in the paper.
pub const GRANULARITY: usize = 100;

/// Default number of passes of an accelerated iterative residual fit: eight iterations of two passes, which suffice on
/// even samplings.
pub const ACCELERATED_PASSES: usize = 16;

/// Default optimality (gradient, relative to the gradient at zero coefficients) at which the full least squares is
/// treated as converged.
pub const TOLERANCE: f64 = 1e-10;

/// Default maximum number of iterations of the full least squares.
pub const MAX_ITERATIONS: usize = 3000;

/// Default memory budget of a fit over a store, in bytes.
pub const MEMORY_OVER_A_STORE: usize = 256 << 20;

/// Accuracy of the transforms in the full least squares, which limits the accuracy of the residual.
pub(crate) const TRANSFORM_ACCURACY: f64 = 1e-12;

/// Maximum number of columns that are fitted together with one transform and one factor. A larger number doesn't reduce
/// the cost per column further.
pub(crate) const MOST_COLUMNS: usize = 96;

/// Maximum number of surfaces that are fitted in one sweep over a store. With more surfaces, the products take much
/// longer than reading the basis.
pub(crate) const MOST_TOGETHER: usize = 128;

/// Maximum number of additional sweeps after the single pass of [`Method::Nlsf`](crate::Method::Nlsf). Each sweep
/// multiplies the remaining rounding error by the machine epsilon times the condition number.
pub(crate) const REFINEMENTS: usize = 5;

/// Default smoothness penalty over a sphere made by parametrisation: the penalty at the highest degree, relative to the
/// weight of the vertices. Without a penalty, a model is undetermined between the corners of large triangles. The
/// penalty increases the msd by a few per cent.
const RELATIVE_PENALTY: f64 = 0.01;

/// Lowest degree of a fit with a default penalty. Fits of lower degree need no penalty, because their wavelengths are
/// longer than any triangle.
const PENALTY_FROM_DEGREE: usize = 8;

/// Returns the default smoothness penalty of a fit over a parametrised sphere: `0.01 w / (4 pi) / (L (L + 1))^2` for
/// degree L, and zero for L below 8. The weight w is the sum of the weights, or the number of vertices if all weights
/// are equal.
pub fn parametrized_smoothness(max_degree: usize, total_weight: f64) -> f64 {
    if max_degree < PENALTY_FROM_DEGREE {
        return 0.0;
    }
    let degree = max_degree as f64;
    RELATIVE_PENALTY * total_weight / (4.0 * std::f64::consts::PI) / (degree * (degree + 1.0)).powi(2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_penalty_begins_at_degree_eight() {
        assert_eq!(parametrized_smoothness(7, 1000.0), 0.0);
        let expected = 0.01 * 1000.0 / (4.0 * std::f64::consts::PI) / (72.0f64 * 72.0);
        assert!((parametrized_smoothness(8, 1000.0) / expected - 1.0).abs() < 1e-15);
    }
}
