//! A factor of N in single precision, and whether it serves.

use ndarray::Array2;
use spharm_monitor::{Level, Monitor, Silent};

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
/// Iterations for that, which take five at condition numbers of 1e8. Where they don't suffice, the fit's may be hundreds.
const ITERATIONS: usize = 20;
/// Below this reciprocal condition number products that are formed by fast transforms say little about N's smallest
/// eigenvalues.
const ILL_CONDITIONED: f64 = 1e-11;

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

/// Makes a factor in single precision of `G + diag(penalty)`; `None` where N is too ill-conditioned for it. `problem` has products
/// with N.
pub(super) fn make_single(
    gram: &dyn GramMatrix,
    penalty: Option<&[f64]>,
    problem: &dyn Problem,
    params: &FactorParams,
    monitor: &dyn Monitor,
) -> Result<Option<Single>, SolverError> {
    let penalty = penalty.map_or_else(|| vec![0.0; gram.size()], <[f64]>::to_vec);
    let penalised = Penalised::new(gram, penalty);
    let diagonal = diagonal(&penalised)?;
    if !diagonal.iter().all(|&value| value.is_normal() && value > 0.0) {
        return Ok(None);
    }
    let factor = match factorise_single(&penalised, &diagonal, params, monitor) {
        Ok(factor) => factor,
        Err(SolverError::NotPositiveDefinite { .. }) => return Ok(None),
        Err(error) => return Err(error),
    };
    let assessed = Single { factor, reciprocal: 0.0 }.assessed(problem, monitor)?;
    Ok(assessed.filter(|single| single.reciprocal > ILL_CONDITIONED))
}

impl Single {
    /// Estimates the condition of N, by solves with it; `None` where they take too long.
    fn assessed(self, problem: &dyn Problem, monitor: &dyn Monitor) -> Result<Option<Self>, SolverError> {
        monitor.note(Level::Status, format_args!("estimating the condition"));
        let size = self.factor.size();
        let column = |v: &[f64]| Array2::from_shape_fn((size, 1), |(k, _)| v[k]);
        let norm = condition::one_norm(size, &mut |v: &mut [f64]| {
            monitor.check()?;
            let product = problem.product(&column(v))?;
            v.iter_mut().zip(&product).for_each(|(v, value)| *v = *value);
            Ok::<(), SolverError>(())
        })?;
        let params = CgParams { tolerance: RESIDUAL, max_iterations: ITERATIONS, patience: ITERATIONS };
        let inverse = condition::one_norm(size, &mut |v: &mut [f64]| {
            monitor.check().map_err(|error| Unknown::Error(error.into()))?;
            let mut cg = Cg::from_right_sides(column(v));
            match cg.run(problem, &self, &params, &Silent).map_err(Unknown::Error)? {
                Stop::Converged => {
                    v.iter_mut().zip(&cg.x).for_each(|(v, value)| *v = *value);
                    Ok(())
                }
                _ => Err(Unknown::Slow),
            }
        });
        match inverse {
            Ok(inverse) => Ok(Some(Self { reciprocal: (1.0 / (norm * inverse)).min(1.0), ..self })),
            Err(Unknown::Slow) => Ok(None),
            Err(Unknown::Error(error)) => Err(error),
        }
    }
}
