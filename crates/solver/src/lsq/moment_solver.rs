//! Runs [`LsqSolver`] on moments, without samples.

use std::ops::Range;

use ndarray::Array2;
use rayon::prelude::*;
use spharm_harmonics::Coefficients;
use spharm_monitor::Monitor;

use super::moments::MomentProblem;
use super::params::LsqParams;
use super::report::LsqReport;
use super::solver::{Given, LsqSolver, Source};
use crate::SolverError;
use crate::gram::GramMatrix;

/// A fit from moments.
#[derive(Debug, Clone)]
pub struct MomentFit {
    /// Canonical coefficients (K, c).
    pub coefficients: Coefficients,
    /// Weighted sum of squares (c) of each column's residual, `sum w (f - A x)^2`.
    pub residual_squares: Vec<f64>,
    /// Report on the fit, without norms of residuals by target, since these would need the samples.
    pub report: LsqReport,
    /// Standard errors (K, c) of the coefficients, if requested.
    pub standard_errors: Option<Array2<f64>>,
}

/// The fit of one of several groups of columns that share their moments.
#[derive(Debug, Clone)]
pub struct GroupFit {
    /// Canonical coefficients (K, c).
    pub coefficients: Coefficients,
    /// Report on the fit.
    pub report: LsqReport,
}

/// Solves a problem given by its moments, in the same way as [`LsqSolver::fit`] with the samples. With
/// `standard_errors` it also computes standard errors, which require a factor: `K^3 / 3` flops and `4 K^2` bytes.
///
/// The weights of `params` are ignored: the moments include the weights.
///
/// # Errors
///
/// [`SolverError::Smoothness`] if the smoothness is negative or not finite; [`SolverError::Interrupted`] if the monitor
/// cancels the fit; an error if a factor is requested and the budget is too small for it;
/// [`SolverError::Underdetermined`] if standard errors are requested and the samples don't determine the coefficients.
/// A fit that doesn't converge isn't an error.
///
/// ```
/// use ndarray::Array2;
/// use spharm_harmonics::{Directions, synthesis};
/// use spharm_monitor::Silent;
/// use spharm_solver::LsqParams;
/// use spharm_solver::lsq::{MomentProblem, solve_moments};
/// use spharm_transform::{FINEST, SampleSums};
///
/// // The fit recovers two functions of degree 10 from sums over samples at 600 directions.
/// let directions = Directions::fibonacci(600)?;
/// let known = Array2::from_shape_fn((121, 2), |(k, c)| ((7 * k + c) as f64).sin());
/// let samples = synthesis(&directions, known.view())?;
/// let sums = SampleSums::new(&directions, None, samples.view(), 10, FINEST)?;
///
/// let fit = solve_moments(&MomentProblem::new(&sums, 10)?, &LsqParams::default(), false, &Silent)?;
/// assert!((fit.coefficients.values() - &known).iter().all(|d| d.abs() < 1e-8));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn solve_moments(
    problem: &MomentProblem,
    params: &LsqParams,
    standard_errors: bool,
    monitor: &dyn Monitor,
) -> Result<MomentFit, SolverError> {
    let make_gram = || Ok(Box::new(problem.gram()?) as Box<dyn GramMatrix>);
    let params = LsqParams { weights: None, ..params.clone() };
    let mut solver = LsqSolver::of(Source::Moments(problem), Some(&make_gram), params)?;
    let (coefficients, _, report) = solver.solve(Given::Sums(problem), &[], monitor)?;
    let residual_squares = problem.residual_squares(coefficients.values())?;
    let standard_errors = match standard_errors {
        true => Some(solver.standard_errors_of(&residual_squares, monitor)?),
        false => None,
    };
    Ok(MomentFit { coefficients, residual_squares, report, standard_errors })
}

/// Solves for groups of columns in parallel, each to its own optimality. Groups that need a factor follow one after
/// another. The result for a group is bit-identical to the result of [`solve_moments`] for the group alone, unless a
/// factor is computed, which is also used for the following groups.
///
/// # Errors
///
/// The errors of [`solve_moments`].
pub fn solve_moments_of_groups(
    problem: &MomentProblem,
    groups: &[Range<usize>],
    params: &LsqParams,
    monitor: &dyn Monitor,
) -> Result<Vec<GroupFit>, SolverError> {
    let make_gram = || Ok(Box::new(problem.gram()?) as Box<dyn GramMatrix>);
    let params = LsqParams { weights: None, ..params.clone() };
    let fit = |solver: &mut LsqSolver<'_>, group: &Range<usize>| {
        let own = problem.of_columns(group.clone());
        let (coefficients, _, report) = solver.solve(Given::Sums(&own), &[], monitor)?;
        Ok(GroupFit { coefficients, report })
    };
    let mut solver = LsqSolver::of(Source::Moments(problem), Some(&make_gram), params.clone())?;
    // Compute the inverse of the density first, on all threads, because the groups share it.
    let _ = solver.inverse_density();
    if let Some(group) = groups.first() {
        solver.plan(Given::Sums(problem), group.len()).note(monitor);
    }
    solver.notes_plans = false;
    // Fit the groups in parallel, each on one thread. Groups that need a factor follow one after another: a factor uses
    // all threads, and there is memory for only one.
    let without_factor = |group: &Range<usize>| {
        let refuse = || Err(SolverError::NoGram);
        let mut solver = LsqSolver::of(Source::Moments(problem), Some(&refuse), params.clone())?;
        solver.notes_plans = false;
        match fit(&mut solver, group) {
            Err(SolverError::NoGram) => Ok(None),
            found => found.map(Some),
        }
    };
    let found: Vec<Option<GroupFit>> =
        groups.par_iter().with_max_len(1).map(without_factor).collect::<Result<_, SolverError>>()?;
    let with_factor = |(group, found): (&Range<usize>, Option<GroupFit>)| match found {
        Some(found) => Ok(found),
        None => fit(&mut solver, group),
    };
    groups.iter().zip(found).map(with_factor).collect()
}
