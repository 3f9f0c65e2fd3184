//! Changes targets before a fit: values are scaled (see [`super::range`]). If values are close together and far from
//! zero, the middle between the smallest and the largest value is subtracted.
//!
//! The solver's tolerance is relative to the values. If the values of a channel lie close together far from zero, such
//! as coordinates in a national grid, the tolerance would allow errors that are large compared with the differences of
//! the values. A least-squares fit of a constant is exact, and smoothness penalties don't apply to it. Therefore the
//! middle of the values is subtracted before the fit, and added to the coefficient of degree 0 afterwards. All values
//! are within a factor of 2 of the middle, so the subtraction is exact. For other methods, and with denoising, the
//! middle isn't subtracted.

use std::f64::consts::PI;

use ndarray::Array2;
use spharm_harmonics::basis_size;
use spharm_surface::Target;

use super::job::Job;
use super::range::{Exponents, into_range};
use super::zeros;
use crate::{FitWarning, Method};

/// The middle of a channel's values is subtracted if its magnitude exceeds this multiple of the difference between the
/// largest and the smallest value.
const FAR: f64 = 1000.0;

/// The changes made to a target.
pub(crate) struct Change {
    /// Exponents of the powers of two by which the channels were divided.
    pub(crate) exponents: Exponents,
    /// The values subtracted from the channels after the division by powers of two; empty if nothing was subtracted.
    middles: Vec<f64>,
    /// A warning about the values before the changes.
    pub(crate) warning: Option<FitWarning>,
}

impl Change {
    /// Changes a target, and returns the changes. The caller must already have replaced the values that the fit doesn't
    /// read.
    pub(crate) fn of(target: &mut Target, job: &Job<'_>) -> Self {
        let warning = zeros::warning(target, job.unread.as_deref());
        let exponents = into_range(target);
        let least_squares = job.params.method == Method::Lsq && !job.params.denoise;
        // Subtract the middles only if the vertices determine the coefficients. Otherwise the fit is the solution of
        // smallest norm, which subtracting a constant would change.
        let enough = || job.vertices_with_weight() >= basis_size(job.params.max_degree);
        let mut middles = if least_squares { far_middles(target) } else { Vec::new() };
        if !middles.is_empty() {
            if job.fits_surface(target.kind) || enough() {
                subtract(target, &middles);
            } else {
                middles.clear();
            }
        }
        Self { exponents, middles, warning }
    }

    /// Adds the values that were subtracted from the target's channels to the coefficients of its fit, one column per
    /// channel.
    pub(crate) fn add_middles(&self, coefficients: &mut Array2<f64>) {
        for (channel, middle) in self.middles.iter().enumerate() {
            coefficients[[0, channel]] += middle * (4.0 * PI).sqrt();
        }
    }
}

/// Returns, for each channel, the middle of its values if they are close together and far from zero, and 0 otherwise.
/// Returns an empty vector if all results are 0.
fn far_middles(target: &Target) -> Vec<f64> {
    let channels = target.channels;
    let middle = |channel: usize| {
        let values = target.values.iter().skip(channel).step_by(channels);
        let (low, high) =
            values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &value| (low.min(value), high.max(value)));
        let (middle, difference) = (0.5 * low + 0.5 * high, high - low);
        if difference > 0.0 && middle.abs() > FAR * difference { middle } else { 0.0 }
    };
    let middles: Vec<f64> = (0..channels).map(middle).collect();
    if middles.iter().all(|&middle| middle == 0.0) { Vec::new() } else { middles }
}

/// Subtracts a value from each channel.
fn subtract(target: &mut Target, middles: &[f64]) {
    for row in target.values.chunks_exact_mut(target.channels) {
        row.iter_mut().zip(middles).for_each(|(value, middle)| *value -= middle);
    }
}
