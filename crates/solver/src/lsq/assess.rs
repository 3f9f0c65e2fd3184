//! Creates the report on a least-squares solution.

use std::ops::Range;
use std::time::Instant;

use ndarray::{Array2, s};

use super::cg::{Cg, Stop};
use super::columns::norms;
use super::report::{LsqReport, LsqSeconds, LsqWarning, StepReport};
use super::solver::{LsqSolver, Solution, Source};
use crate::cholesky::CholeskyFactor;
use crate::residual::ResidualNorms;

impl LsqSolver<'_> {
    /// Creates the report on a solution. `groups` gives the columns of each target, for its optimality and the
    /// norms of its residual.
    pub(super) fn report(
        &mut self,
        cg: &Cg,
        solution: &Solution,
        steps: Vec<StepReport>,
        groups: &[Range<usize>],
        started: Instant,
    ) -> LsqReport {
        let optimality = cg.optimality();
        let converged = solution.stop == Stop::Converged && optimality <= 2.0 * self.params.tolerance;
        let stop = match solution.stop {
            Stop::Converged if !converged => Stop::Stalled,
            stop => stop,
        };
        let norm = norms(&cg.x).into_iter().fold(0.0, f64::max);
        let made = self.made.as_ref().filter(|_| solution.refinements.is_some());
        let shift = made.map_or(0.0, |made| made.shift);
        let breaks_at = made.and_then(|made| made.breaks_at);
        let (rows, columns) = (self.rows_with_weight(), cg.x.nrows());
        if rows < columns && self.penalty.is_none() && shift == 0.0 {
            self.warnings.push(LsqWarning::Underdetermined { rows, columns, norm });
        }
        let of_groups = |residual: &Array2<f64>| {
            let unread = self.params.unread.as_deref();
            groups.iter().map(|group| ResidualNorms::without(residual.slice(s![.., group.clone()]), unread)).collect()
        };
        LsqReport {
            max_degree: self.source.max_degree(),
            rows: self.source.rows(),
            channels: cg.x.ncols(),
            preconditioner: solution.preconditioner,
            iterations: cg.iterations,
            products: match self.source {
                Source::Samples(_) if self.moments.is_none() => "samples",
                _ => "moments",
            },
            refinements: solution.refinements.unwrap_or(0),
            steps,
            optimality,
            optimalities: cg.optimalities(groups),
            stop,
            condition: self.condition(cg),
            shift,
            breaks_at,
            norm,
            smoothness: self.params.smoothness,
            warnings: self.warnings.clone(),
            residuals: solution.residual.as_ref().map_or_else(Vec::new, of_groups),
            seconds: LsqSeconds {
                factor: self.factor_seconds,
                moments: self.moment_seconds,
                iterations: cg.seconds,
                total: started.elapsed().as_secs_f64(),
            },
        }
    }

    /// Returns the condition number of the matrix that consists of `W^(1/2) A` stacked on `P^(1/2)`.
    fn condition(&self, cg: &Cg) -> f64 {
        let of = |reciprocal: f64| if reciprocal > 0.0 { (1.0 / reciprocal).sqrt() } else { f64::INFINITY };
        match (self.stored, &self.made) {
            (Some(factor), _) => of(factor.condition().reciprocal),
            (None, Some(made)) if made.shift > 0.0 => f64::INFINITY,
            (None, Some(made)) => of(made.factor.condition().reciprocal),
            (None, None) if self.penalty.is_some() => f64::NAN,
            (None, None) => cg.condition.sqrt(),
        }
    }
}
