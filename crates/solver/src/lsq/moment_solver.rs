//! Solves least-squares problems that are given by moments, without samples, with [`LsqSolver`].

use std::ops::Range;

use ndarray::Array2;
use rayon::prelude::*;
use spharm_harmonics::{Coefficients, basis_size};
use spharm_monitor::Monitor;

use super::moments::MomentProblem;
use super::params::LsqParams;
use super::report::LsqReport;
use super::signs::sign;
use super::solver::{Given, LsqSolver, Source};
use crate::SolverError;
use crate::gram::GramMatrix;

/// The result of a fit from moments.
#[derive(Debug, Clone)]
pub struct MomentFit {
    /// Canonical coefficients (K, c).
    pub coefficients: Coefficients,
    /// Weighted sum of squares (c) of each column's residual, `sum w (f - A x)^2`.
    pub residual_squares: Vec<f64>,
    /// Whether rounding errors hide each column's residual (c), because the mean of the values is large: see
    /// [`MomentProblem::lost`].
    pub lost: Vec<bool>,
    /// Report on the fit, without norms of residuals by target, because these would need the samples.
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
/// [`SolverError::Underdetermined`] or [`SolverError::UnderdeterminedWithPenalty`] if standard errors are requested and
/// the samples, with the penalty, don't determine the coefficients;
/// [`SolverError::LostResidual`] if they are requested and rounding errors hide a residual. A fit that doesn't converge
/// isn't an error.
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
    let lost = problem.lost(&residual_squares);
    if let Some(column) = lost.iter().position(|&lost| lost).filter(|_| standard_errors) {
        return Err(SolverError::LostResidual { column });
    }
    let standard_errors = match standard_errors {
        true => Some(solver.standard_errors_of(&residual_squares, monitor)?),
        false => None,
    };
    Ok(MomentFit { coefficients, residual_squares, lost, report, standard_errors })
}

/// If the error of the recovered coefficients has at most this norm, [`determined`] treats all functions as recovered.
/// A single function that isn't recovered causes an error of about 1.2.
const MOST_LOST: f64 = 0.03;
/// Tolerance of the fit by which [`determined`] recovers known coefficients, unless the tolerance of the settings is
/// smaller. It is small enough for bases with condition numbers of several thousand.
const RECOVERED: f64 = 1e-11;

/// Returns whether the samples determine the coefficients without a penalty. This is tested by a fit that should
/// recover known coefficients from the values of their function at the samples.
///
/// Conjugate gradients from zero converge even if some functions are zero at all samples, and the condition number that
/// they estimate doesn't reveal these functions. This test detects the functions for any arrangement of the samples.
/// The test takes about as long as the fit of one column. The strategy and the memory budget are taken from `params`.
///
/// # Errors
///
/// The errors of [`solve_moments`].
pub fn determined(problem: &MomentProblem, params: &LsqParams, monitor: &dyn Monitor) -> Result<bool, SolverError> {
    let functions = basis_size(problem.max_degree());
    // Each known coefficient consists of sixteen random bits, so that their magnitudes differ. Suppose that they
    // differed only in sign, and that the sum of two functions were zero at all samples. If the two coefficients had
    // opposite signs, the fit would recover both by chance, and the test would pass.
    let digits = |k: usize| (0..16).map(move |bit| sign((16 * k + bit) as u64) * 0.5f64.powi(bit as i32));
    let known = Array2::from_shape_fn((functions, 1), |(k, _)| digits(k).sum::<f64>());
    let tolerance = params.tolerance.min(RECOVERED);
    let max_iterations = params.max_iterations.max(LsqParams::default().max_iterations);
    let params = LsqParams { smoothness: 0.0, penalty: None, tolerance, max_iterations, ..params.clone() };
    let found = solve_moments(&problem.of_known(&known)?, &params, false, monitor)?;
    let square: f64 = (found.coefficients.values() - &known).iter().map(|error| error * error).sum();
    Ok(found.report.shift == 0.0 && square.sqrt() <= MOST_LOST)
}

/// Solves a problem for groups of its columns in parallel. The stopping rules are applied to each group separately.
/// Groups that need a factor are solved afterwards, one after another. The result for a group is bit-identical to the
/// result of [`solve_moments`] for this group only, unless a factor is computed. A computed factor is also used for the
/// following groups.
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
    // Fit the groups in parallel, each on one thread. Groups that need a factor are fitted afterwards, one after
    // another: a factor uses all threads, and the memory suffices for only one factor.
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
