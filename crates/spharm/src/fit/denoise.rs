//! Estimates the noise of targets by comparing their fits with fits of pure noise over the same sphere.

use std::ops::Range;

use ndarray::{Array2, ArrayView2, Axis, s};
use spharm_harmonics::basis_size;
use spharm_monitor::{Level, Monitor};
use spharm_solver::lsq::denoise::{NOISE_COLUMNS, check_rows, residual_square, white_noise};
use spharm_solver::lsq::{Denoise, LsqReport, NoisePower, Stop};
use spharm_surface::Kind;

use super::detail::left_out;
use super::job::Job;
use crate::report::Denoised;
use crate::{Error, FitParams, Method, Smoothness, Weights};

/// How plain fits (fits without a penalty) over one sphere respond to noise.
pub(crate) struct Denoiser {
    power: NoisePower,
    /// Precisions of the n vertices; `None` if all precisions are equal.
    precision: Option<Vec<f64>>,
    /// Power of the noise in degree 1, divided by its power on an even sampling.
    relative_noise: f64,
}

impl Denoiser {
    /// Measures the response of plain fits to noise, by fitting columns of noise, `at_a_time` at a time. `fit` makes a
    /// plain fit. It returns the fit's coefficients and its residual at the vertices, both with one column per column
    /// of noise.
    pub(crate) fn new(
        job: &Job<'_>,
        at_a_time: usize,
        monitor: &dyn Monitor,
        mut fit: impl FnMut(&Array2<f64>) -> Result<(Array2<f64>, Array2<f64>), Error>,
    ) -> Result<Self, Error> {
        let (vertices, max_degree) = (job.sphere.directions.len(), job.params.max_degree);
        let precision = precision(job);
        let rows = precision.as_ref().map_or(vertices, |of| of.iter().filter(|precision| **precision > 0.0).count());
        check_rows(rows, basis_size(max_degree))?;
        monitor.note(
            Level::Info,
            format_args!("fitting {NOISE_COLUMNS} columns of random noise, to measure how a fit responds to noise"),
        );
        let mut power = NoisePower::new(max_degree);
        for start in (0..NOISE_COLUMNS).step_by(at_a_time.max(1)) {
            monitor.check()?;
            let columns = start..NOISE_COLUMNS.min(start + at_a_time.max(1));
            monitor.note(Level::Status, format_args!("fitting noise, column {} of {NOISE_COLUMNS}", columns.start + 1));
            let noise = white_noise(vertices, columns, precision.as_deref());
            let (coefficients, residual) = fit(&noise)?;
            // Add column by column, so that the sums don't depend on the number of columns fitted together.
            for (coefficients, residual) in coefficients.axis_iter(Axis(1)).zip(residual.axis_iter(Axis(1))) {
                let [coefficients, residual] = [coefficients, residual].map(|column| column.insert_axis(Axis(1)));
                power.add(coefficients, residual_square(residual, precision.as_deref()));
            }
        }
        let total = precision.as_ref().map_or(vertices as f64, |precision| precision.iter().sum());
        let relative_noise = power.relative_to_even(total);
        Ok(Self { power, precision, relative_noise })
    }

    /// Estimates the noise of a target, or of one of its channels, from the coefficients and the residual of its plain
    /// fit. Both have one column per channel.
    pub(crate) fn denoise(&self, coefficients: ArrayView2<'_, f64>, residual: ArrayView2<'_, f64>) -> Denoise {
        self.power.denoise(coefficients, residual_square(residual, self.precision.as_deref()))
    }

    /// Estimates how much of the noise found in `target` (vertices x channels) is detail beyond the degree of the fit.
    pub(crate) fn assess(
        &self,
        job: &Job<'_>,
        target: ArrayView2<'_, f64>,
        noise: Denoise,
        monitor: &dyn Monitor,
    ) -> Result<Denoised, Error> {
        let left_out = left_out(job, self.precision.as_deref(), target, &noise, monitor)?;
        Ok(Denoised { noise, left_out, relative_noise: self.relative_noise })
    }
}

/// Returns the precision of each vertex, or `None` if all precisions are equal. Precisions are the given weights, and 0
/// at held-out vertices. Area weights aren't used, since a vertex's share of the sphere is unrelated to its noise.
fn precision(job: &Job<'_>) -> Option<Vec<f64>> {
    let weights = job.weights.as_ref()?;
    match (&job.params.weights, &job.hold_out) {
        (Weights::Values { .. }, _) => Some(weights.clone()),
        (_, Some(_)) => Some(weights.iter().map(|&weight| f64::from(weight > 0.0)).collect()),
        (_, None) => None,
    }
}

/// Returns the groups of a target's columns for which noise is estimated together: all columns of a surface, but each
/// channel of a signal separately, since channels may have different units.
pub(crate) fn parts(group: &Range<usize>, kind: Kind) -> Vec<Range<usize>> {
    match kind {
        Kind::Surface => vec![group.clone()],
        Kind::Signal => group.clone().map(|column| column..column + 1).collect(),
    }
}

/// Copies values to columns of an array.
pub(crate) fn set_columns(all: &mut Array2<f64>, columns: &Range<usize>, values: ArrayView2<'_, f64>) {
    all.slice_mut(s![.., columns.clone()]).assign(&values);
}

/// Merges a penalised fit's report into the report of the plain fit.
pub(crate) fn merge(report: &mut LsqReport, penalised: LsqReport) {
    report.iterations += penalised.iterations;
    report.add_steps(penalised.steps);
    report.refinements += penalised.refinements;
    report.optimality = report.optimality.max(penalised.optimality);
    if penalised.stop != Stop::Converged {
        report.stop = penalised.stop;
    }
    let (seconds, more) = (&mut report.seconds, penalised.seconds);
    seconds.factor += more.factor;
    seconds.moments += more.moments;
    seconds.iterations += more.iterations;
    for warning in penalised.warnings {
        if !report.warnings.contains(&warning) {
            report.warnings.push(warning);
        }
    }
}

impl FitParams {
    /// Checks that all requirements of denoising are met, and that no setting conflicts with it.
    pub(crate) fn check_denoise(&self) -> Result<(), Error> {
        let refuse = |expected, found: String| Err(Error::Setting { what: "denoise", expected, found });
        if !self.denoise {
            return Ok(());
        }
        if self.method != Method::Lsq {
            return refuse("the method lsq", self.method.name().to_owned());
        }
        if self.smoothness != Smoothness::Default {
            let found = format!("smoothness {}", self.smoothness.name());
            return refuse("a fit without a smoothness penalty (denoising has its own penalty)", found);
        }
        Ok(())
    }

    /// Returns the name of the penalty that is recorded in models: `denoise`, or the name of the smoothness.
    #[must_use]
    pub fn penalty_name(&self) -> &'static str {
        if self.denoise { "denoise" } else { self.smoothness.name() }
    }
}
