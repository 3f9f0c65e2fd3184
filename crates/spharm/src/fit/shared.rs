//! Functions shared by the three variants of the full least squares: at vertices, over surfaces and from moments.

use std::fmt;
use std::sync::Once;

use spharm_monitor::{Level, Monitor, Stage};
use spharm_solver::lsq::{LsqReport, LsqSeconds, Stop};
use spharm_solver::{SolverError, StoredFactor, Strategy};

use crate::machine::{Exceeded, exceeded};
use crate::{Error, FitParams, FitWarning, Preconditioner};

/// A monitor for the fit of one of several targets. Stages of this fit are shown as status notes of the enclosing
/// stage, which counts targets.
pub(crate) struct NestedMonitor<'a>(pub(crate) &'a dyn Monitor);

impl Monitor for NestedMonitor<'_> {
    fn begin(&self, stage: Stage, _: u64) {
        self.0.note(Level::Status, format_args!("{}", stage.name));
    }

    fn note(&self, level: Level, text: fmt::Arguments<'_>) {
        self.0.note(level, text);
    }

    fn cancelled(&self) -> bool {
        self.0.cancelled()
    }
}

/// Checks that this process's limits allow a Cholesky factor of `data` bytes.
pub(crate) fn allowed(data: usize) -> Result<(), SolverError> {
    exceeded(data, 0).map_or(Ok(()), |Exceeded { what, limit, needed }| Err(SolverError::Limit { what, limit, needed }))
}

pub(crate) fn strategy(preconditioner: Preconditioner) -> Strategy {
    match preconditioner {
        Preconditioner::Auto => Strategy::Auto,
        Preconditioner::None => Strategy::Cg,
        Preconditioner::Density => Strategy::DensityCg,
        Preconditioner::Factor => Strategy::Cholesky,
    }
}

/// Largest number of coefficients per vertex or sample for which cross-validation has enough data.
const MOST_FOR_AUTO: usize = 100;

/// Returns an error if there are far more coefficients than vertices or samples. Choosing a smoothness would take some
/// 25 fits of a high degree, and the choice would be based on only a few residuals.
pub(crate) fn check_auto(rows: usize, max_degree: usize) -> Result<(), Error> {
    let functions = spharm_harmonics::basis_size(max_degree);
    if functions <= MOST_FOR_AUTO * rows {
        return Ok(());
    }
    Err(Error::Setting {
        what: "choosing the smoothness by cross-validation",
        expected: "at least one vertex or sample per 100 coefficients",
        found: format!("{rows} for {functions} coefficients; lower the degree, or give the smoothness"),
    })
}

/// Returns a count followed by its noun, in the singular or plural.
pub(crate) fn counted(count: usize, one: &str, many: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { many })
}

/// Returns the part of a note that states how many targets are fitted at a time. The text is empty if all targets are
/// fitted together.
pub(crate) fn in_batches(count: usize, together: usize) -> String {
    if together >= count { String::new() } else { format!(", {together} at a time") }
}

/// Returns whether the tolerance was met, according to a fit's warnings. With strict settings, returns an error if the
/// tolerance wasn't met.
pub(crate) fn converged(params: &FitParams, warnings: &[FitWarning]) -> Result<bool, Error> {
    let missed = warnings.iter().find(|warning| matches!(warning, FitWarning::NotConverged { .. }));
    match missed.filter(|_| params.strict) {
        Some(missed) => Err(Error::NotConverged(missed.clone())),
        None => Ok(missed.is_none()),
    }
}

/// Merges two reports: `some` covers the targets solved so far, and `other` the next target.
pub(crate) fn merge_reports(some: LsqReport, other: LsqReport) -> LsqReport {
    let mut warnings = some.warnings;
    for warning in &other.warnings {
        if !warnings.contains(warning) {
            warnings.push(warning.clone());
        }
    }
    let seconds = LsqSeconds {
        factor: some.seconds.factor + other.seconds.factor,
        moments: some.seconds.moments + other.seconds.moments,
        iterations: some.seconds.iterations + other.seconds.iterations,
        total: some.seconds.total + other.seconds.total,
    };
    let stop = if some.stop == Stop::Converged { other.stop } else { some.stop };
    let (mut report, mut residuals) = (other, some.residuals);
    residuals.append(&mut report.residuals);
    report.channels += some.channels;
    let steps = std::mem::replace(&mut report.steps, some.steps);
    report.add_steps(steps);
    report.iterations = report.iterations.max(some.iterations);
    report.refinements = report.refinements.max(some.refinements);
    report.optimality = report.optimality.max(some.optimality);
    report.condition = report.condition.max(some.condition);
    report.shift = report.shift.max(some.shift);
    report.breaks_at = report.breaks_at.or(some.breaks_at);
    report.norm = report.norm.max(some.norm);
    (report.stop, report.warnings, report.seconds, report.residuals) = (stop, warnings, seconds, residuals);
    report
}

/// Notes, once for all batches, that a fit was solved with the factor in the store.
pub(crate) fn note_factor(report: &LsqReport, stored: Option<&StoredFactor>, noted: &Once, monitor: &dyn Monitor) {
    let Some(stored) = stored else { return };
    if report.steps.iter().any(|step| step.preconditioner == "stored-factor") {
        let path = stored.file().path().display();
        noted.call_once(|| monitor.note(Level::Info, format_args!("using the Cholesky factor {path}")));
    }
}

pub(crate) fn note_solution(report: &LsqReport, monitor: &dyn Monitor) {
    let text = format_args!(
        "{} iterations by {}, {} refinements, preconditioner {}, optimality {:.1e}, condition number {:.1e}, {:.3} s",
        report.iterations,
        report.products,
        report.refinements,
        report.preconditioner,
        report.optimality,
        report.condition,
        report.seconds.total
    );
    monitor.note(Level::Detail, text);
}
