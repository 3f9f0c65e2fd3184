//! Refinement with a factor of the normal equations: `x += M g`, `M = (N + mu I)^-1`, with the gradient g formed by the
//! operator. With a factor in single precision conjugate gradients go on instead, preconditioned with it.

use std::time::Instant;

use spharm_harmonics::basis_size;
use spharm_monitor::{Level, Monitor};

use super::cg::{Cg, CgParams, Stop, relative};
use super::columns::norms;
use super::preconditioner::{ByFactor, Preconditioner};
use super::problem::Problem;
use super::single::{Single, single_factor};
use super::solver::{FEW, FIT, Given, LsqSolver, Solution};
use crate::SolverError;
use crate::cholesky::plan_single;

/// Most refinements.
const REFINEMENTS: usize = 40;
/// Iterations without the optimality halving after which to give up, where each is preconditioned with the factor and
/// worth many.
const PATIENCE: usize = 30;
/// Optimality that rounding errors of targets and transforms leave.
const ROUNDING: f64 = 1e-9;

/// Columns from which a factor is made in single precision: one in double precision of fewer takes less than a quarter
/// of a second.
const SINGLE_FROM: usize = 4096;
/// Iterations that have to be left for one: it takes five to ten of them, on matrices that it barely serves for some
/// more.
const SINGLE_ITERATIONS: usize = 40;
/// How much further than the tolerance iterations with it go, a digit each: what the optimality says little of,
/// coefficients in directions of small eigenvalues, converges with the rest.
const FURTHER: f64 = 1e-2;
/// Rounds of these, each from the gradient that is formed from the samples.
const ROUNDS: usize = 2;

impl LsqSolver<'_> {
    /// Makes a factor in single precision unless there is one. False where it isn't worth it, where memory doesn't
    /// suffice, or where N is too ill-conditioned for it.
    pub(super) fn make_single(
        &mut self,
        cg: &Cg,
        given: Given<'_>,
        monitor: &dyn Monitor,
    ) -> Result<bool, SolverError> {
        if self.single.is_some() || self.single_refused {
            return Ok(self.single.is_some());
        }
        let (Some(make_gram), None, None) = (self.make_gram, self.stored, &self.made) else { return Ok(false) };
        let (size, params) = (basis_size(self.source.max_degree()), self.factor_params());
        let left = self.params.max_iterations.saturating_sub(cg.iterations);
        if size < SINGLE_FROM || left < SINGLE_ITERATIONS || cg.x.ncols() > FEW {
            return Ok(false);
        }
        if plan_single(size, &params).and_then(|plan| self.check_plan(&plan)).is_err() {
            return Ok(false);
        }
        let started = Instant::now();
        let factor = single_factor(&*make_gram()?, self.penalty.as_deref(), &params, monitor)?;
        monitor.begin(FIT, 0);
        let single = match factor {
            Some(factor) => Single::new(factor, &*self.problem(given), monitor)?,
            None => None,
        };
        self.single_refused = single.is_none();
        self.single = single;
        self.factor_seconds += started.elapsed().as_secs_f64();
        Ok(self.single.is_some())
    }

    /// Goes on with the factor that there is: with one in single precision as far as that goes.
    pub(super) fn solve_with_factor(
        &mut self,
        cg: &mut Cg,
        given: Given<'_>,
        monitor: &dyn Monitor,
    ) -> Result<Solution, SolverError> {
        if let Some(single) = &self.single {
            let solution = self.iterate_with_single(single, cg, &*self.problem(given), monitor)?;
            if solution.stop != Stop::Stalled {
                return Ok(solution);
            }
            (self.single, self.single_refused) = (None, true);
            if !self.make_factor(false, monitor)? {
                return Ok(solution);
            }
        }
        self.refine(cg, &*self.problem(given), monitor)
    }

    fn iterate_with_single(
        &self,
        single: &Single,
        cg: &mut Cg,
        problem: &dyn Problem,
        monitor: &dyn Monitor,
    ) -> Result<Solution, SolverError> {
        let tolerance = self.params.tolerance;
        let further = (FURTHER * tolerance).max(f64::EPSILON).min(tolerance);
        let (mut stop, mut residual) = (Stop::Stalled, None);
        for _ in 0..ROUNDS {
            let max_iterations = self.params.max_iterations.saturating_sub(cg.iterations);
            let params = CgParams { tolerance: further, max_iterations, patience: PATIENCE / ROUNDS };
            stop = cg.run(problem, single, &params, monitor)?;
            (cg.gradient, residual) = problem.gradient(&cg.x)?;
        }
        let stop = match stop {
            _ if cg.optimality() <= 1.5 * tolerance => Stop::Converged,
            Stop::IterationLimit => Stop::IterationLimit,
            _ => Stop::Stalled,
        };
        Ok(Solution { stop, preconditioner: single.name(), refinements: None, residual })
    }

    /// Refines x until its optimality is met or stops improving.
    pub(super) fn refine(
        &self,
        cg: &mut Cg,
        problem: &dyn Problem,
        monitor: &dyn Monitor,
    ) -> Result<Solution, SolverError> {
        let factor = self.factor()?;
        let preconditioner = if self.stored.is_some() { "stored-factor" } else { "factor" };
        let tolerance = self.params.tolerance;
        let shifted = self.made.as_ref().is_some_and(|made| made.shift > 0.0);
        if shifted && cg.iterations > 0 {
            // From zero, for the sake of the minimum norm.
            *cg = Cg::new(problem)?;
        }
        let (mut stop, mut refinements, mut residual) = (Stop::IterationLimit, 0, None);
        let mut optimality = cg.optimality();
        while refinements < REFINEMENTS {
            monitor.check()?;
            let mut step = cg.gradient.clone();
            factor.solve(&mut step)?;
            let x = &cg.x + &step;
            let (gradient, new_residual) = problem.gradient(&x)?;
            let improved = relative(&norms(&gradient), &cg.scale);
            // A step that makes it worse isn't taken.
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
        // A factor with fewer digits than the condition takes is a good preconditioner yet.
        let rest = self.params.max_iterations.saturating_sub(cg.iterations);
        if stop != Stop::Converged && !shifted && cg.optimality() > ROUNDING && rest > 0 {
            let before = (cg.x.clone(), cg.gradient.clone());
            let optimality = cg.optimality();
            let params = CgParams { tolerance, max_iterations: rest, patience: PATIENCE };
            stop = cg.run(problem, &ByFactor(factor), &params, monitor)?;
            let (gradient, formed) = problem.gradient(&cg.x)?;
            cg.gradient = gradient;
            if cg.optimality() < optimality {
                residual = formed;
            } else {
                (cg.x, cg.gradient) = before;
                stop = Stop::Stalled;
            }
        }
        // As far as rounding goes is as far as it can go: the factor is that of N.
        if stop == Stop::Stalled && cg.optimality() <= ROUNDING {
            stop = Stop::Converged;
        }
        Ok(Solution { stop, preconditioner, refinements: Some(refinements), residual })
    }
}
