//! Reports on least-squares fits.

use serde::{Serialize, Serializer};

use super::cg::Stop;
use crate::residual::ResidualNorms;

/// Report on a least-squares fit.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct LsqReport {
    /// Highest degree, L.
    pub max_degree: usize,
    /// Number of rows, n.
    pub rows: usize,
    /// Number of columns of the targets, c.
    pub channels: usize,
    /// Preconditioner of the last steps: `none`, `density` (computed from moments), `factor` or `stored-factor`.
    pub preconditioner: &'static str,
    /// Number of iterations of conjugate gradients.
    pub iterations: usize,
    /// Source of the last iterations' products with the normal matrix: `samples` or `moments`.
    pub products: &'static str,
    /// Number of steps of iterative refinement with the Cholesky factor.
    pub refinements: usize,
    /// The steps taken, in order.
    pub steps: Vec<StepReport>,
    /// Largest relative gradient of all columns, computed from the samples if there are any. If iterations by moments
    /// have an estimated error that is small compared with the tolerance, the optimality is the relative gradient of
    /// these iterations plus the estimated error.
    pub optimality: f64,
    /// Optimality of each target, over the columns of the target; empty without samples.
    #[serde(skip)]
    pub optimalities: Vec<f64>,
    /// Reason why the fit ended.
    pub stop: Stop,
    /// Estimated condition number of the basis matrix, including weights and penalty. If the density from moments is
    /// the preconditioner, the value is an upper bound. The value is infinite (null in JSON) if the matrix is
    /// numerically singular, and NaN (null) if it is unknown.
    pub condition: f64,
    /// Shift of the diagonal of a singular normal matrix, relative to the largest diagonal entry; zero otherwise.
    pub shift: f64,
    /// Column, counted from 0, at which the factorisation of a singular normal matrix broke down, and the column's
    /// degree.
    pub breaks_at: Option<[usize; 2]>,
    /// Largest norm of a column of coefficients.
    pub norm: f64,
    /// Smoothness penalty, lambda.
    pub smoothness: f64,
    /// Possible problems with the result.
    pub warnings: Vec<LsqWarning>,
    /// Norms of the residual of each target; empty without samples.
    pub residuals: Vec<ResidualNorms>,
    /// Wall time by kind of work.
    pub seconds: LsqSeconds,
}

/// Report on a step of a fit.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct StepReport {
    /// Name of the step: `moments`, `iterations by samples`, `iterations by moments`, `factor`, `refinement`,
    /// `iterations with the factor`, `confirmation` or `iterations from zero`. A confirmation recomputes the gradient
    /// if necessary, and resumes the iterations if the tolerance isn't met. Iterations from zero repeat iterations that
    /// were dominated by rounding errors.
    pub name: &'static str,
    /// Preconditioner of the step, as in [`LsqReport::preconditioner`].
    pub preconditioner: &'static str,
    /// Reason why this step was chosen.
    pub why: String,
    /// Number of fits that took this step, in a report on several fits.
    pub fits: usize,
    /// Number of iterations of conjugate gradients, or of refinements.
    pub iterations: usize,
    /// Wall time in seconds.
    pub seconds: f64,
    /// The largest relative gradient of all columns after the step.
    pub optimality: f64,
    /// Reason why the step ended early; `None` if it didn't.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub left: Option<String>,
}

impl LsqReport {
    /// Adds the steps of another fit: steps that are already listed are merged, other steps are appended.
    pub fn add_steps(&mut self, others: Vec<StepReport>) {
        for other in others {
            let same = |step: &&mut StepReport| {
                (step.name, step.preconditioner) == (other.name, other.preconditioner)
                    && (&step.why, &step.left) == (&other.why, &other.left)
            };
            match self.steps.iter_mut().find(same) {
                Some(step) => {
                    step.fits += other.fits;
                    step.iterations = step.iterations.max(other.iterations);
                    step.seconds += other.seconds;
                    step.optimality = step.optimality.max(other.optimality);
                }
                None => self.steps.push(other),
            }
        }
    }
}

/// Wall time by kind of work, in seconds.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct LsqSeconds {
    /// Seconds for computing the Gram matrix and factorising it.
    pub factor: f64,
    /// Seconds for computing the moments of the sampling, the normal operator from these moments, and the approximate
    /// inverse of this operator.
    pub moments: f64,
    /// Seconds for conjugate gradients.
    pub iterations: f64,
    /// Total time of the fit in seconds.
    pub total: f64,
}

/// A possible problem with the result of a fit.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum LsqWarning {
    /// No factor was computed, because the memory doesn't suffice or because the solution isn't unique.
    #[error("no Cholesky factor was computed: {reason}")]
    NoFactor {
        /// Reason why no factor was computed.
        reason: String,
    },
    /// Iterations should have been preconditioned with the density of the samples, but weren't.
    #[error("iterations weren't preconditioned with the density of the samples: {reason}")]
    NoDensity {
        /// Reason why the density wasn't used.
        reason: String,
    },
    /// Moments weren't accurate enough for the requested optimality.
    #[error(
        "rounding errors in the moments limit the accuracy: iterations with moments ended at an optimality of \
         {optimality:.1e}, so the fit continued with the samples"
    )]
    MomentsLoseDigits {
        /// Optimality at which iterations by moments ended.
        optimality: f64,
    },
    /// There are fewer vertices with nonzero weight than coefficients, and no penalty.
    #[error(
        "{rows} vertices don't determine {columns} coefficients; the solution of minimum norm was used (norm {norm:.3e})"
    )]
    Underdetermined {
        /// Number of vertices with nonzero weight.
        rows: usize,
        /// Number of coefficients, K.
        columns: usize,
        /// The largest norm of a column of the solution.
        norm: f64,
    },
}

impl Serialize for LsqWarning {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}
