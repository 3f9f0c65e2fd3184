//! Chooses a smoothness for each channel of a signal, since channels may have different units and different noise.

use std::ops::Range;

use ndarray::Array2;
use spharm_harmonics::{Coefficients, basis_size};
use spharm_monitor::Monitor;
use spharm_solver::lsq::{Gcv, LsqReport, MomentFit, MomentProblem, choose_smoothness_by_moments, solve_moments};
use spharm_solver::{LsqParams, SolverError};

use super::denoise::set_columns;
use super::shared::merge_reports;

/// Merges the searches of the channels: the result is the search with the largest smoothness, and lists the smoothness
/// of each channel. Returns `None` without channels.
pub(super) fn merge_searches(found: Vec<Gcv>) -> Option<Gcv> {
    let by_channel: Vec<f64> = found.iter().map(|of_channel| of_channel.smoothness).collect();
    let largest = found.into_iter().max_by(|a, b| a.smoothness.total_cmp(&b.smoothness))?;
    Some(Gcv { by_channel, ..largest })
}

/// Merges the report on another channel's fit into the report on a target. The report of a target has the largest
/// smoothness of its channels.
pub(super) fn merge_channels(some: Option<LsqReport>, other: LsqReport) -> LsqReport {
    let Some(some) = some else { return other };
    let smoothness = some.smoothness.max(other.smoothness);
    let both = some.optimalities.iter().zip(&other.optimalities);
    let optimalities = both.map(|(a, b)| a.max(*b)).collect();
    let mut report = merge_reports(some, other);
    (report.smoothness, report.optimalities) = (smoothness, optimalities);
    report
}

/// Chooses a smoothness for each of the ranges `parts` of a problem's columns.
pub(super) fn choose(
    problem: &MomentProblem,
    parts: &[Range<usize>],
    monitor: &dyn Monitor,
) -> Result<Gcv, SolverError> {
    let of_part = |part: &Range<usize>| {
        let found = choose_smoothness_by_moments(&problem.of_columns(part.clone()), monitor);
        found.map_err(|error| of_column(error, part.start))
    };
    if parts.len() > 1
        && let Some(found) = merge_searches(parts.iter().map(of_part).collect::<Result<Vec<Gcv>, SolverError>>()?)
    {
        return Ok(found);
    }
    choose_smoothness_by_moments(problem, monitor)
}

/// Solves a problem as [`solve_moments`] does. Each channel has its own smoothness unless `by_channel` is empty.
pub(super) fn solve(
    problem: &MomentProblem,
    solver: &LsqParams,
    by_channel: &[f64],
    standard_errors: bool,
    monitor: &dyn Monitor,
) -> Result<MomentFit, SolverError> {
    let mut coefficients = Array2::<f64>::zeros((basis_size(problem.max_degree()), problem.channels()));
    let mut errors = standard_errors.then(|| Array2::zeros(coefficients.dim()));
    let (mut residual_squares, mut lost, mut merged) = (Vec::new(), Vec::new(), None);
    for (channel, &smoothness) in by_channel.iter().enumerate() {
        let (column, params) = (channel..channel + 1, LsqParams { smoothness, ..solver.clone() });
        let fit = solve_moments(&problem.of_columns(column.clone()), &params, standard_errors, monitor)
            .map_err(|error| of_column(error, channel))?;
        set_columns(&mut coefficients, &column, fit.coefficients.values().view());
        if let (Some(errors), Some(of_channel)) = (&mut errors, &fit.standard_errors) {
            set_columns(errors, &column, of_channel.view());
        }
        residual_squares.extend(fit.residual_squares);
        lost.extend(fit.lost);
        merged = Some(merge_channels(merged, fit.report));
    }
    let Some(report) = merged else { return solve_moments(problem, solver, standard_errors, monitor) };
    let coefficients = Coefficients::new(coefficients)?;
    Ok(MomentFit { coefficients, residual_squares, lost, report, standard_errors: errors })
}

/// Converts an error about some of a problem's columns, which begin at column `first`, to an error about the whole
/// problem.
fn of_column(error: SolverError, first: usize) -> SolverError {
    match error {
        SolverError::LostResidual { column } => SolverError::LostResidual { column: first + column },
        other => other,
    }
}
