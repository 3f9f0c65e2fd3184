//! Detects fits from moments whose coefficients the samples don't determine.

use spharm_harmonics::basis_size;
use spharm_moments::Moments;
use spharm_monitor::{Level, Monitor, OnlyCancel};
use spharm_solver::LsqParams;
use spharm_solver::lsq::{LsqReport, LsqWarning, MomentProblem, determined};

use crate::{Error, FitWarning};

/// Condition number of the basis at the samples above which some functions up to the fit's degree are treated as
/// undetermined.
const UNDETERMINED: f64 = 1e6;

/// Returns a warning if the samples don't determine a fit without a penalty. `report` is the report on this fit,
/// `has_factor` states whether the fit computed a factor, and `largest_gap` is the diameter of the largest cap without
/// samples, in degrees.
///
/// Samples at few places, or with wide gaps, may not determine some functions, and iterations don't reveal these
/// functions. The condition number of a factor reveals them without a further fit.
pub(super) fn warning(
    moments: &Moments,
    problem: &MomentProblem,
    solver: &LsqParams,
    (report, has_factor): (&LsqReport, bool),
    largest_gap: f64,
    monitor: &dyn Monitor,
) -> Result<Option<FitWarning>, Error> {
    let (max_degree, samples) = (problem.max_degree(), moments.sums.count);
    if solver.smoothness > 0.0 || max_degree == 0 {
        return Ok(None);
    }
    let (functions, resolved) = (basis_size(max_degree), 180.0 / max_degree as f64);
    let few = report.warnings.iter().any(|warning| matches!(warning, LsqWarning::Underdetermined { .. }));
    let poor = report.shift > 0.0 || few || report.condition > UNDETERMINED;
    let sparse = largest_gap > resolved || moments.occupied.count() < functions;
    let unsure = (sparse || is_concentrated(&moments.sums.moments, max_degree)) && !has_factor;
    let gap = FitWarning::Gap { max_degree, samples, functions, largest_gap, resolved };
    Ok((poor || (unsure && !recovers(problem, solver, monitor)?)).then_some(gap))
}

/// Returns whether the samples' weight may be concentrated at fewer places than there are basis functions. The number
/// of places follows from the moments above the fit's degree: for p places of equal weight, the mean square of these
/// moments is about 1 / p of the square of the first moment.
fn is_concentrated(moments: &[f64], max_degree: usize) -> bool {
    let high = moments.get(basis_size(max_degree)..basis_size(2 * max_degree)).unwrap_or_default();
    // The quotients don't overflow, because no moment is larger than a small multiple of the first one.
    let power = high.iter().map(|moment| (moment / moments[0]).powi(2)).sum::<f64>();
    power * basis_size(max_degree) as f64 > high.len() as f64
}

/// Returns whether a fit recovers known coefficients from the same samples.
fn recovers(problem: &MomentProblem, solver: &LsqParams, monitor: &dyn Monitor) -> Result<bool, Error> {
    monitor.note(Level::Info, format_args!("checking whether the samples determine the fit"));
    determined(problem, solver, &OnlyCancel(monitor)).map_err(Error::from)
}
