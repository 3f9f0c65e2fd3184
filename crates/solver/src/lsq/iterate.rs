//! Conjugate gradients by samples or by moments, and when to leave them for a factor.

use std::time::Instant;

use ndarray::Array2;
use spharm_harmonics::basis_size;
use spharm_monitor::{Level, Monitor};
use spharm_transform::FINEST;

use super::cg::{Cg, CgParams, Stop};
use super::columns::dots;
use super::cost::Cost;
use super::params::Strategy;
use super::problem::{Moments, Problem};
use super::progress::{BEFORE_FACTOR, Progress, STRETCH_BESIDE};
use super::report::LsqWarning;
use super::solver::{Given, LsqSolver, Solution};
use crate::SolverError;

/// Share of a factor's cost that the iterations which seem to be left may take: they tend to be more than it seems.
const SHARE: f64 = 0.2;
/// Accuracy of moments relative to the tolerance: where the density is up to ten times its mean what it leaves of the
/// gradient is little beside it, and the last gradient needn't be formed from the samples.
const MOMENT_ACCURACY: f64 = 0.02;
/// The coarsest moments that are any cheaper.
const COARSEST: f64 = 1e-8;

impl LsqSolver<'_> {
    /// Runs conjugate gradients with the selected preconditioner until they end, or until a factor has been made
    /// because they are slow: then there is no solution yet.
    pub(super) fn iterate(
        &mut self,
        cg: &mut Cg,
        given: Given<'_>,
        monitor: &dyn Monitor,
    ) -> Result<Option<Solution>, SolverError> {
        let params = self.cg_params();
        let cost = Cost { rows: self.source.rows(), max_degree: self.source.max_degree(), channels: cg.x.ncols() };
        let factor_possible = self.params.strategy == Strategy::Auto
            && (self.make_gram.is_some() || self.stored.is_some() || self.made.is_some())
            && basis_size(self.source.max_degree()) <= self.source.rows();
        let mut stop = Stop::IterationLimit;
        if let Given::Targets(..) = given
            && let Some(first) = self.before_moments(&cost)
        {
            let first = CgParams { max_iterations: first.min(params.max_iterations), ..params };
            if first.max_iterations > 0 {
                stop = cg.run(&*self.problem(given), &*self.preconditioner(), &first, monitor)?;
            }
            if stop == Stop::IterationLimit && cg.iterations < params.max_iterations {
                self.take_moments(None, monitor)?;
            }
        }
        let left = |cg: &Cg| CgParams { max_iterations: params.max_iterations - cg.iterations, ..params };
        if stop == Stop::IterationLimit {
            let by_moments = self.moments.is_some() || matches!(given, Given::Sums(_));
            let product = self.cost_by_moments(&cost);
            let progress = match (self.stored, by_moments) {
                _ if !factor_possible => None,
                (Some(_), true) => {
                    Some(Progress::beside_factor(params.tolerance, cost.with_factor() / product, cg.optimality()))
                }
                (None, true) => Some(Progress::new(params.tolerance, SHARE * cost.factor() / product)),
                (_, false) => Some(Progress::new(params.tolerance, 0.0)),
            };
            stop = cg.run_while(&*self.problem(given), &*self.preconditioner(), &left(cg), progress, monitor)?;
        }
        // The user's limit is a limit on all the work: no factor then.
        if stop == Stop::IterationLimit && factor_possible && cg.iterations < params.max_iterations {
            if self.make_factor(false, monitor)? {
                return Ok(None);
            }
            stop = cg.run(&*self.problem(given), &*self.preconditioner(), &left(cg), monitor)?;
        }
        let preconditioner = self.preconditioner();
        let (mut stop, mut residual) = cg.confirm(stop, &*self.problem(given), &*preconditioner, &params, monitor)?;
        let mut name = preconditioner.name();
        if stop != Stop::Converged && further_than_zero(cg, &*self.problem(given))? {
            // Rounding has carried it there: up to where it was best, it hadn't.
            let before = cg.iterations;
            let first = CgParams { max_iterations: cg.best_at, ..params };
            *cg = Cg::new(&*self.problem(given))?;
            cg.run(&*self.problem(given), &*preconditioner, &first, monitor)?;
            (_, residual) = cg.confirm(Stop::Stalled, &*self.problem(given), &*preconditioner, &params, monitor)?;
            if further_than_zero(cg, &*self.problem(given))? {
                *cg = Cg::new(&*self.problem(given))?;
                (_, residual) = cg.confirm(Stop::Stalled, &*self.problem(given), &*preconditioner, &params, monitor)?;
            }
            cg.iterations += before;
        }
        drop(preconditioner);
        if stop == Stop::Converged && cg.optimality() > 1.5 * params.tolerance && self.moments.is_some() {
            self.warnings.push(LsqWarning::MomentsLoseDigits { optimality: cg.optimality() });
            (self.moments, self.make_moments) = (None, None);
            let preconditioner = self.preconditioner();
            stop = cg.run(&*self.problem(given), &*preconditioner, &left(cg), monitor)?;
            (stop, residual) = cg.confirm(stop, &*self.problem(given), &*preconditioner, &params, monitor)?;
            name = preconditioner.name();
        }
        Ok(Some(Solution { stop, preconditioner: name, refinements: None, residual }))
    }

    /// How many iterations to make by the samples before moments are made; `None` where they are not to be made, or are
    /// there. Where as many iterations are expected as moments take to pay they are made at once, else when iterations
    /// have taken as long as moments would have.
    fn before_moments(&self, cost: &Cost) -> Option<usize> {
        if self.make_moments.is_none() || self.moments.is_some() || self.params.moment_bytes > self.room() {
            return None;
        }
        if self.params.strategy == Strategy::DensityCg {
            return Some(0);
        }
        let paid_after = cost.paid_after();
        if paid_after > BEFORE_FACTOR as f64 {
            return None;
        }
        Some(if cost.at_once(self.params.tolerance) { 0 } else { paid_after.ceil() as usize })
    }

    /// Whether iterations by moments are worth beginning for so many columns where there is a factor of a matrix of
    /// moderate condition: whether the few that show how many it takes are less than half the work of using the factor.
    pub(super) fn moments_beside_factor(&self, columns: usize) -> bool {
        let cost = Cost { rows: self.source.rows(), max_degree: self.source.max_degree(), channels: columns };
        let making = match (self.moments.is_some(), self.before_moments(&cost)) {
            (true, _) => 0.0,
            (false, Some(0)) => cost.making(),
            _ => return false,
        };
        making + STRETCH_BESIDE as f64 * self.cost_by_moments(&cost) < 0.5 * cost.with_factor()
    }

    /// What an iteration by moments takes, with its preconditioner.
    fn cost_by_moments(&self, cost: &Cost) -> f64 {
        if self.inverse_density().is_some() { cost.preconditioned() } else { cost.by_moments() }
    }

    /// Makes moments where they are needed from the first iteration on; returns right-hand sides, (K, c), that came
    /// with them.
    pub(super) fn moments_at_once(
        &mut self,
        given: Given<'_>,
        monitor: &dyn Monitor,
    ) -> Result<Option<Array2<f64>>, SolverError> {
        let Given::Targets(_, targets) = given else { return Ok(None) };
        let channels = targets.ncols();
        let cost = Cost { rows: self.source.rows(), max_degree: self.source.max_degree(), channels };
        if self.starts_with_factor(channels) || self.before_moments(&cost) != Some(0) {
            return Ok(None);
        }
        self.take_moments(Some(targets), monitor)
    }

    fn take_moments(
        &mut self,
        targets: Option<&Array2<f64>>,
        monitor: &dyn Monitor,
    ) -> Result<Option<Array2<f64>>, SolverError> {
        let Some(make) = self.make_moments else { return Ok(None) };
        monitor.note(Level::Status, format_args!("moments"));
        let accuracy = (MOMENT_ACCURACY * self.params.tolerance).clamp(FINEST, COARSEST);
        let started = Instant::now();
        let (normal, right_sides) = make(accuracy, targets)?;
        self.moments = Some(Moments { normal, accuracy });
        // Made now if it is to be.
        let _ = self.inverse_density();
        self.moment_seconds = started.elapsed().as_secs_f64();
        Ok(right_sides)
    }
}

/// Whether a column of x is further from its target than zero is, penalty included:
/// `|W^(1/2) (f - A x)|^2 + x^T P x - |W^(1/2) f|^2 = -x^T (b + r)`, with b the right-hand side and r = b - N x the
/// gradient.
fn further_than_zero(cg: &Cg, problem: &dyn Problem) -> Result<bool, SolverError> {
    let sum = problem.right_sides()? + &cg.gradient;
    Ok(dots(&cg.x, &sum).iter().any(|gain| *gain < 0.0))
}
