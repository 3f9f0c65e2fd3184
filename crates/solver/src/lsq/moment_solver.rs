//! [`LsqSolver`] on moments alone.

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

/// A fit from moments alone.
#[derive(Debug, Clone)]
pub struct MomentFit {
    /// Canonical coefficients, (K, c).
    pub coefficients: Coefficients,
    /// `sum w (f - A x)^2` of each column, (c).
    pub residual_squares: Vec<f64>,
    /// How it was solved, and how close it is. It has no residuals, which need the samples.
    pub report: LsqReport,
    /// Standard errors of the coefficients, (K, c), where they were asked for.
    pub standard_errors: Option<Array2<f64>>,
}

/// One group's part of a fit of several from the same moments.
#[derive(Debug, Clone)]
pub struct GroupFit {
    /// Canonical coefficients, (K, c).
    pub coefficients: Coefficients,
    /// How it was solved, and how close it is.
    pub report: LsqReport,
}

/// Solves a problem that is known by its moments, as [`LsqSolver::fit`] would with the samples. With `standard_errors`
/// also those, which take a factor: `K^3 / 3` flops and `4 K^2` bytes.
///
/// Weights of `params` don't count: the moments have the weights.
///
/// # Errors
///
/// [`SolverError::Smoothness`], [`SolverError::Interrupted`]; where a factor is asked for, too small a budget for it;
/// with standard errors [`SolverError::Underdetermined`]. Not converging is none.
///
/// ```
/// use ndarray::Array2;
/// use spharm_harmonics::{Directions, synthesis};
/// use spharm_monitor::Silent;
/// use spharm_solver::LsqParams;
/// use spharm_solver::lsq::{MomentProblem, solve_moments};
/// use spharm_transform::{FINEST, SampleSums};
///
/// // Two functions of degree 10, sampled at 600 directions, are found again from sums over the samples.
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

/// Solves for some of the columns after others, each group to its own optimality: as [`solve_moments`] of the group
/// alone, bit for bit, unless a factor is made, which serves the groups after it, too.
///
/// # Errors
///
/// Those of [`solve_moments`].
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
    // Groups share it: it is made before them, by all threads.
    let _ = solver.inverse_density();
    if let Some(group) = groups.first() {
        solver.plan(Given::Sums(problem), group.len()).note(monitor);
    }
    solver.notes_plans = false;
    // A product of a group takes one thread. A factor takes all of them, and the memory for one.
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
