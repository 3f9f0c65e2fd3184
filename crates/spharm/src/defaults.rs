//! The numbers behind the defaults, each with what it was chosen by.

use crate::machine::available_memory;
use crate::params::{FitParams, Method, Smoothness};

/// Granularity of [`Method::Irf`]: the paper's.
pub const GRANULARITY: usize = 100;

/// Passes of an accelerated fit: eight iterations, which suffice on even samplings.
pub const ACCELERATED_PASSES: usize = 16;

/// Optimality at which the full least squares counts as converged.
pub const TOLERANCE: f64 = 1e-10;

/// Most iterations of the full least squares.
pub const MAX_ITERATIONS: usize = 3000;

/// Bytes of memory for a fit over a store.
pub const MEMORY_OVER_A_STORE: usize = 256 << 20;

/// Accuracy of the transforms under the full least squares. The residual's last digits are theirs.
pub(crate) const TRANSFORM_ACCURACY: f64 = 1e-12;

/// Most columns that share a transform and a factor; more share no more of the cost.
pub(crate) const MOST_COLUMNS: usize = 96;

/// Most surfaces in one sweep over a store; with more, the products take much longer than reading the basis.
pub(crate) const MOST_TOGETHER: usize = 128;

/// Most sweeps beyond the one pass of [`Method::Nlsf`]. Each reduces the error left by rounding by eps times the condition.
pub(crate) const REFINEMENTS: usize = 5;

/// On a sphere made by parametrisation: the penalty at the highest degree relative to the weight of the vertices there.
/// Large triangles leave a model undetermined between their corners. This holds it there, and adds some per cent to the
/// msd.
const RELATIVE_PENALTY: f64 = 0.01;

/// Lower degrees have wavelengths longer than any triangle.
const PENALTY_FROM_DEGREE: usize = 8;

/// Returns the default smoothness penalty of a fit over a parametrised sphere: `0.01 w / (4 pi) / (L (L + 1))^2`, with w
/// the sum of the weights, or the number of vertices where all count the same; zero for L below 8.
pub fn parametrized_smoothness(max_degree: usize, total_weight: f64) -> f64 {
    if max_degree < PENALTY_FROM_DEGREE {
        return 0.0;
    }
    let degree = max_degree as f64;
    RELATIVE_PENALTY * total_weight / (4.0 * std::f64::consts::PI) / (degree * (degree + 1.0)).powi(2)
}

/// Returns the memory that a fit keeps to, in bytes: as set, else [`MEMORY_OVER_A_STORE`] for the methods that read a
/// store and half of what is free for the others.
pub fn memory(params: &FitParams) -> usize {
    match (params.memory, params.method.blocks()) {
        (Some(bytes), _) => bytes,
        (None, Some(_)) => MEMORY_OVER_A_STORE,
        (None, None) => available_memory() / 2,
    }
}

/// Returns the smoothness penalty of a fit that doesn't choose it by cross-validation.
pub(crate) fn smoothness(params: &FitParams, parametrized: bool, weights: Option<&[f64]>, vertices: usize) -> f64 {
    match params.smoothness {
        Smoothness::Fixed(lambda) => lambda,
        Smoothness::Default if parametrized && params.method == Method::Lsq => {
            let total = weights.map_or(vertices as f64, |weights| weights.iter().sum());
            parametrized_smoothness(params.max_degree, total)
        }
        Smoothness::Default | Smoothness::Auto => 0.0,
    }
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

    #[test]
    fn memory_is_as_set_or_by_method() {
        let lsq = FitParams::lsq(10);
        assert_eq!(memory(&FitParams { memory: Some(5), ..lsq.clone() }), 5);
        assert!(memory(&lsq) > 0);
        let irf = FitParams { method: Method::Nlsf, ..lsq };
        assert_eq!(memory(&irf), MEMORY_OVER_A_STORE);
    }
}
