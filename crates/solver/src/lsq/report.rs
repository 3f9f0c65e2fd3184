//! What a least-squares fit reports.

use serde::{Serialize, Serializer};

use super::cg::Stop;
use crate::residual::ResidualNorms;

/// Report of a least-squares fit.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct LsqReport {
    /// Highest degree, L.
    pub max_degree: usize,
    /// Rows, n.
    pub rows: usize,
    /// Columns of the targets, c.
    pub channels: usize,
    /// The preconditioner of the last steps: `none`, `density` (by moments), `factor`, `stored-factor`.
    pub preconditioner: &'static str,
    /// Iterations of conjugate gradients.
    pub iterations: usize,
    /// What the last iterations' products with the normal matrix were formed from: `samples` or `moments`.
    pub products: &'static str,
    /// Refinements with a factor.
    pub refinements: usize,
    /// The steps that were taken, in order.
    pub steps: Vec<StepReport>,
    /// The largest relative gradient of all columns: formed from the samples where there are some, or that of
    /// iterations by moments, with an estimate of what these leave it off by, where that is little beside the
    /// tolerance.
    pub optimality: f64,
    /// How it ended.
    pub stop: Stop,
    /// Estimated condition number of the basis matrix, with its weights and penalty, or of a bound on it where the
    /// density of moments preconditions; infinite (null in JSON) where it is numerically singular, NaN (null) where it
    /// isn't known.
    pub condition: f64,
    /// What was added to the diagonal of a singular normal matrix, relative to its largest entry; zero otherwise.
    pub shift: f64,
    /// The column, from 0, and its degree at which the factorisation of a singular normal matrix broke down.
    pub breaks_at: Option<[usize; 2]>,
    /// The largest norm of a column of the coefficients.
    pub norm: f64,
    /// Smoothness penalty, lambda.
    pub smoothness: f64,
    /// What a user should know about the result.
    pub warnings: Vec<LsqWarning>,
    /// The residual of each target; empty where the samples aren't at hand.
    pub residuals: Vec<ResidualNorms>,
    /// Wall times.
    pub seconds: LsqSeconds,
}

/// A step of a fit.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct StepReport {
    /// `moments`, `iterations by samples`, `iterations by moments`, `factor`, `refinement`, `iterations with the
    /// factor`; `confirmation` of the gradient, with the iterations that it shows to be lacking; `iterations from zero`
    /// if rounding errors had taken over.
    pub name: &'static str,
    /// Its preconditioner, as in [`LsqReport::preconditioner`].
    pub preconditioner: &'static str,
    /// Number of fits that took it, in a report of several.
    pub fits: usize,
    /// Iterations of conjugate gradients, or refinements.
    pub iterations: usize,
    /// Wall time.
    pub seconds: f64,
    /// The largest relative gradient of all columns after it.
    pub optimality: f64,
    /// Why it was left before its end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub left: Option<String>,
}

impl LsqReport {
    /// Adds the steps of another fit: to the same ones, else at the end.
    pub fn add_steps(&mut self, others: Vec<StepReport>) {
        for other in others {
            let same = |step: &&mut StepReport| {
                (step.name, step.preconditioner, &step.left) == (other.name, other.preconditioner, &other.left)
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

/// Seconds by kind of work.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct LsqSeconds {
    /// Gram matrix and its factorisation.
    pub factor: f64,
    /// Moments of the sampling, the operator from them and its approximate inverse.
    pub moments: f64,
    /// Iterations of conjugate gradients.
    pub iterations: f64,
    /// All of it.
    pub total: f64,
}

/// What a user should know about a result, in plain words.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum LsqWarning {
    /// A factor would have helped, and there is no memory for one.
    #[error("no factor was made: {reason}")]
    NoFactor {
        /// What stood in the way.
        reason: String,
    },
    /// Iterations were to be preconditioned with the density of the samples, and went without.
    #[error("iterations weren't preconditioned with the density of the samples: {reason}")]
    NoDensity {
        /// What stood in the way.
        reason: String,
    },
    /// Moments didn't have the digits that the optimality asks for.
    #[error(
        "moments of the sampling lose digits: iterations with them ended at an optimality of {optimality:.1e}; went on with the samples"
    )]
    MomentsLoseDigits {
        /// Where they ended.
        optimality: f64,
    },
    /// Fewer vertices with weight than coefficients, without a penalty.
    #[error("{rows} vertices don't determine {columns} coefficients; took the solution of least norm, {norm:.3e}")]
    Underdetermined {
        /// Vertices with weight.
        rows: usize,
        /// Coefficients, K.
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
