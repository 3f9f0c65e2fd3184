//! A factor of N in single precision, and whether it serves.

use ndarray::Array2;
use spharm_monitor::{Level, Monitor, OnlyCancel};

use super::cg::{Cg, CgParams, Stop};
use super::factor::diagonal;
use super::preconditioner::Preconditioner;
use super::problem::Problem;
use crate::cholesky::{FactorParams, SingleFactor, factorise_single};
use crate::gram::{GramMatrix, Penalised};
use crate::{SolverError, condition};

/// What is left of a right-hand side, of its norm, when the condition is estimated with its solution. The share in a
/// direction of N's smallest eigenvalue is some `K^-1/2`.
const RESIDUAL: f64 = 1e-3;
/// Iterations for that, which take five at condition numbers of 1e8. Where they don't suffice, the fit's may be
/// hundreds.
const ITERATIONS: usize = 20;
/// The least error of products that are formed by fast transforms, relative to the norm of N.
const PRODUCT_ERROR: f64 = 1e-12;
/// How far above that N's smallest eigenvalue has to be for products to say anything about it.
const ABOVE_ERROR: f64 = 10.0;

/// A factor of N in single precision.
pub(super) struct Single {
    factor: SingleFactor,
    /// Estimated reciprocal condition number of N, in the 1-norm.
    pub(super) reciprocal: f64,
}

impl Preconditioner for Single {
    fn name(&self) -> &'static str {
        "factor-f32"
    }

    fn apply(&self, r: &Array2<f64>) -> Result<Array2<f64>, SolverError> {
        self.factor.apply(r)
    }
}

/// Why a condition number isn't known.
enum Unknown {
    Slow,
    Error(SolverError),
}

/// Makes a factor in single precision of `G + diag(penalty)`; `None` where rounding makes that indefinite.
pub(super) fn single_factor(
    gram: &dyn GramMatrix,
    penalty: Option<&[f64]>,
    params: &FactorParams,
    monitor: &dyn Monitor,
) -> Result<Option<SingleFactor>, SolverError> {
    let penalty = penalty.map_or_else(|| vec![0.0; gram.size()], <[f64]>::to_vec);
    let penalised = Penalised::new(gram, penalty);
    let diagonal = diagonal(&penalised)?;
    if !diagonal.iter().all(|&value| value.is_normal() && value > 0.0) {
        return Ok(None);
    }
    match factorise_single(&penalised, &diagonal, params, monitor) {
        Ok(factor) => Ok(Some(factor)),
        Err(SolverError::NotPositiveDefinite { .. }) => Ok(None),
        Err(error) => Err(error),
    }
}

impl Single {
    /// Estimates the condition of N by solves with the factor and products of the problem; `None` where these take too
    /// long, or N is too ill-conditioned for such products.
    pub(super) fn new(
        factor: SingleFactor,
        problem: &dyn Problem,
        monitor: &dyn Monitor,
    ) -> Result<Option<Self>, SolverError> {
        monitor.note(Level::Status, format_args!("estimating the condition"));
        let size = factor.size();
        let single = Self { factor, reciprocal: 0.0 };
        let column = |v: &[f64]| Array2::from_shape_fn((size, 1), |(k, _)| v[k]);
        let norm = condition::one_norm(size, &mut |v: &mut [f64]| {
            monitor.check()?;
            let product = problem.product(&column(v))?;
            v.iter_mut().zip(&product).for_each(|(v, value)| *v = *value);
            Ok::<(), SolverError>(())
        })?;
        let params = CgParams { tolerance: RESIDUAL, max_iterations: ITERATIONS, patience: ITERATIONS };
        let inverse = condition::one_norm(size, &mut |v: &mut [f64]| {
            let mut cg = Cg::from_right_sides(column(v));
            match cg.run(problem, &single, &params, &OnlyCancel(monitor)).map_err(Unknown::Error)? {
                Stop::Converged => {
                    v.iter_mut().zip(&cg.x).for_each(|(v, value)| *v = *value);
                    Ok(())
                }
                _ => Err(Unknown::Slow),
            }
        });
        let reciprocal = match inverse {
            Ok(inverse) => 1.0 / (norm * inverse),
            Err(Unknown::Slow) => return Ok(None),
            Err(Unknown::Error(error)) => return Err(error),
        };
        let error = problem.product_error().map_or(0.0, |error| error.relative).max(PRODUCT_ERROR);
        // Not where it is NaN either.
        let serves = reciprocal > ABOVE_ERROR * error;
        Ok(serves.then(|| Self { reciprocal: reciprocal.min(1.0), ..single }))
    }
}
