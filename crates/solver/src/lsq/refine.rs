//! Refines the solution x with a Cholesky factor of the normal matrix N, shifted by mu if N is singular: `x += M g`,
//! with `M = (N + mu I)^-1` and the gradient g computed by the operator.

use spharm_monitor::{Level, Monitor};

use super::cg::{Cg, CgParams, Stop, relative};
use super::columns::norms;
use super::limits::{ITERATIONS_WITHOUT_GAIN_WITH_FACTOR, MOST_REFINEMENTS, ROUNDING_OPTIMALITY};
use super::preconditioner::ByFactor;
use super::problem::Problem;
use super::run::{Done, Taken};
use super::solver::{LsqSolver, Solution};
use super::why::Why;
use crate::SolverError;

impl LsqSolver<'_> {
    /// Refines x until its optimality meets the tolerance or stops improving.
    pub(super) fn refine(
        &self,
        cg: &mut Cg,
        problem: &dyn Problem,
        taken: &mut Taken,
        monitor: &dyn Monitor,
    ) -> Result<Solution, SolverError> {
        let factor = self.factor()?;
        let preconditioner = if self.stored.is_some() { "stored-factor" } else { "factor" };
        let tolerance = self.params.tolerance;
        let shifted = self.made.as_ref().is_some_and(|made| made.shift > 0.0);
        if shifted && cg.iterations > 0 {
            // Start from zero, to obtain a solution of small norm.
            *cg = Cg::new(problem)?;
        }
        let (mut stop, mut refinements, mut residual) = (Stop::IterationLimit, 0, None);
        let mut optimality = cg.optimality();
        while refinements < MOST_REFINEMENTS {
            monitor.check()?;
            let mut step = cg.gradient.clone();
            factor.solve(&mut step)?;
            let x = &cg.x + &step;
            let (gradient, new_residual) = problem.gradient(&x)?;
            let improved = relative(&norms(&gradient), &cg.scale);
            // Reject a step that makes the optimality worse.
            if improved >= optimality && improved > tolerance {
                stop = Stop::Stalled;
                break;
            }
            refinements += 1;
            (cg.x, cg.gradient) = (x, gradient);
            residual = new_residual;
            monitor.step(1);
            monitor.note(Level::Status, format_args!("refinement {refinements}, optimality {improved:.1e}"));
            if improved <= tolerance {
                stop = Stop::Converged;
                break;
            }
            if improved > 0.5 * optimality {
                stop = Stop::Stalled;
                break;
            }
            optimality = improved;
        }
        if refinements == 0 {
            (cg.gradient, residual) = problem.gradient(&cg.x)?;
        }
        let left = (stop == Stop::Stalled).then(|| "the optimality stopped improving".to_owned());
        taken.add_of(Done::new("refinement", preconditioner, &Why::AfterFactor), refinements, cg, left);
        // A factor with too few digits for the condition number is still a good preconditioner.
        let rest = self.params.max_iterations.saturating_sub(cg.iterations);
        if stop != Stop::Converged && !shifted && cg.optimality() > ROUNDING_OPTIMALITY && rest > 0 {
            let before = (cg.x.clone(), cg.gradient.clone());
            let optimality = cg.optimality();
            let params = CgParams { tolerance, max_iterations: rest, patience: ITERATIONS_WITHOUT_GAIN_WITH_FACTOR };
            stop = cg.run(problem, &ByFactor(factor), &params, monitor)?;
            let (gradient, formed) = problem.gradient(&cg.x)?;
            cg.gradient = gradient;
            if cg.optimality() < optimality {
                residual = formed;
            } else {
                (cg.x, cg.gradient) = before;
                stop = Stop::Stalled;
            }
            let why = "refinement alone didn't reach the tolerance";
            taken.add(Done::new("iterations with the factor", preconditioner, &why), cg, None);
        }
        // Treat the solution as converged: only rounding limits its optimality, and the factor of N can't improve it
        // further.
        if stop == Stop::Stalled && cg.optimality() <= ROUNDING_OPTIMALITY {
            stop = Stop::Converged;
        }
        Ok(Solution { stop, preconditioner, refinements: Some(refinements), residual })
    }
}
