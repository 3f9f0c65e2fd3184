//! Scales targets and weights whose products would overflow or underflow.
//!
//! The coefficients of a fit are proportional to its target, and don't change if weights and penalty are multiplied by
//! the same factor. Therefore a target whose largest magnitude is above 4e9 or below 1e-9 is divided by a power of two
//! and fitted, and the results are multiplied by that power. The scaling is exact: coefficients have the digits that
//! they would have for a target of ordinary size. If a number in a report, such as a mean squared residual, would
//! overflow, it is replaced by the largest finite f64. If it would underflow to zero, it is replaced by the smallest
//! nonzero f64. All channels of a surface have the same exponent. The channels of a signal also have the same exponent
//! unless they differ much in size. In that case, each channel has its own exponent.

use ndarray::{Array2, ArrayView2, ArrayViewMut1, ArrayViewMut2};
use spharm_harmonics::{Coefficients, Directions};
use spharm_solver::ResidualNorms;
use spharm_solver::lsq::{Gcv, LsqReport, LsqWarning, MomentFit};
use spharm_surface::range::{even_exponent, exponent, scale_all, times, times_within, unless_ordinary};
use spharm_surface::{Kind, Target};
use spharm_transform::{SampleSums, synthesis};

use crate::assess::{Distances, SurfaceDistances};
use crate::report::{BatchReport, Denoised};
use crate::{Error, Fit, FitWarning};

/// Largest binary exponent of a scaled smoothness. Products of the smoothness with degrees then stay in the range of
/// f64.
const MOST: i32 = 900;

/// Largest difference between the binary exponents of the channels' largest values with which all channels are divided
/// by the same power of two.
const SPREAD: i32 = 40;

/// Sums of weights are scaled only if the magnitude of their binary exponent is above this value. Sums of ordinary
/// weights over many samples stay below it.
const SUM: i32 = 50;

/// Exponents of the powers of two by which a target's channels were divided. Empty if the target wasn't scaled.
pub(crate) type Exponents = Vec<i32>;

/// Divides the channels of a target by powers of two. Returns the exponents of these powers.
pub(crate) fn into_range(target: &mut Target) -> Exponents {
    let channels = target.channels;
    let of = |channel: usize| even_exponent(target.values.iter().skip(channel).step_by(channels).copied());
    let sizes: Vec<Option<i32>> = (0..channels).map(of).collect();
    let exponents = exponents_of(&sizes, target.kind == Kind::Surface);
    if exponents.iter().all(|&e| e == 0) {
        return Vec::new();
    }
    for row in target.values.chunks_exact_mut(channels) {
        row.iter_mut().zip(&exponents).for_each(|(value, &e)| *value = times(*value, -e));
    }
    exponents
}

/// Returns the exponents by which to scale channels. `sizes` has the exponent of each channel's largest value, or
/// `None` for a channel of zeros. With `together`, or if the sizes are similar, all channels have the same exponent.
fn exponents_of(sizes: &[Option<i32>], together: bool) -> Exponents {
    let all = sizes.iter().flatten().copied().max().unwrap_or(0);
    if together || sizes.iter().flatten().all(|size| all - size <= SPREAD) {
        return vec![unless_ordinary(all); sizes.len()];
    }
    sizes.iter().map(|size| size.map_or(0, unless_ordinary)).collect()
}

/// Divides weights by a power of two. Returns the exponent of this power.
pub(crate) fn weights_into_range(weights: Option<&mut Vec<f64>>) -> i32 {
    let Some(weights) = weights else { return 0 };
    let exponent = exponent(weights.iter().copied());
    scale_all(weights.iter_mut(), -exponent);
    exponent
}

/// Scales a smoothness for weights that were divided by 2^exponent.
pub(crate) fn smoothness_into_range(smoothness: f64, exponent: i32) -> f64 {
    if exponent == 0 { smoothness } else { times(smoothness, -exponent).min(times(1.0, MOST)) }
}

/// Returns the largest exponent of the channels, by which sums over channels are scaled.
fn largest(exponents: &[i32]) -> i32 {
    exponents.iter().copied().max().unwrap_or(0)
}

/// Converts a target's fit back to the target's unit.
pub(crate) fn restore(fit: &mut Fit, exponents: &[i32], weights: i32) {
    for smoothness in fit.report.smoothness_by_channel.iter_mut().chain([&mut fit.report.smoothness]) {
        *smoothness = times_within(*smoothness, weights);
    }
    let all = largest(exponents);
    for denoised in fit.report.denoise.iter_mut().zip(exponents.iter().copied().chain(std::iter::repeat(0))) {
        restore_denoised(denoised, weights);
    }
    fit.report.warnings.iter_mut().for_each(|warning| restore_warning(warning, all));
    if exponents.is_empty() {
        return;
    }
    restore_columns(&mut fit.coefficients, &mut fit.standard_errors, exponents);
    let report = &mut fit.report;
    report.scale = report.scale.map(|scale| times(scale, all));
    report.passes.iter_mut().for_each(|distances| *distances = distances.times(all));
    report.between = report.between.map(|distances| distances.times(all));
    if let Some(held_out) = &mut report.held_out {
        held_out.held_out = held_out.held_out.times(all);
        held_out.seen = held_out.seen.times(all);
    }
    if let Some(SurfaceDistances { rms_raw, percentile95_raw, hausdorff_raw, .. }) = &mut report.surface_distance {
        scale_all([rms_raw, percentile95_raw, hausdorff_raw], all);
    }
}

/// Converts coefficients and their standard errors back to the unit of each channel.
fn restore_columns(coefficients: &mut Coefficients, errors: &mut Option<Array2<f64>>, exponents: &[i32]) {
    let mut values = coefficients.values().to_owned();
    scale_columns(values.view_mut(), exponents);
    if let Ok(restored) = Coefficients::new(values) {
        *coefficients = restored;
    }
    if let Some(errors) = errors {
        scale_columns(errors.view_mut(), exponents);
    }
}

fn scale_columns(mut values: ArrayViewMut2<'_, f64>, exponents: &[i32]) {
    let scale = |(mut column, &e): (ArrayViewMut1<'_, f64>, &i32)| scale_all(column.iter_mut(), e);
    values.columns_mut().into_iter().zip(exponents).for_each(scale);
}

/// Converts noise back to the target's unit. If the weights are the vertices' precisions, the noise is that of a vertex
/// with weight 1.
fn restore_denoised((denoised, exponent): (&mut Denoised, i32), weights: i32) {
    denoised.noise.sigma = times_within(denoised.noise.sigma, exponent + weights / 2);
    denoised.left_out = denoised.left_out.map(|left_out| times_within(left_out, exponent));
}

fn restore_warning(warning: &mut FitWarning, exponent: i32) {
    match warning {
        FitWarning::Singular { norm, .. } | FitWarning::Solver(LsqWarning::Underdetermined { norm, .. }) => {
            *norm = times_within(*norm, exponent);
        }
        FitWarning::Detail { left_out, sigma, .. } => {
            *left_out = times_within(*left_out, exponent);
            *sigma = times_within(*sigma, exponent);
        }
        _ => {}
    }
}

/// Returns the distances between a signal and its model at the vertices, if the signal's channels were divided by
/// different powers of two. The solver's sums over channels are meaningless for such a signal. Returns `None` for all
/// other targets.
pub(crate) fn distances_of_mixed(
    directions: &Directions,
    unread: Option<&[bool]>,
    exponents: &[i32],
    values: ArrayView2<'_, f64>,
    coefficients: ArrayView2<'_, f64>,
) -> Result<Option<Distances>, Error> {
    let all = largest(exponents);
    if exponents.iter().all(|&e| e == all) {
        return Ok(None);
    }
    let mut residual = &values - &synthesis(directions, coefficients)?;
    let relative: Vec<i32> = exponents.iter().map(|e| e - all).collect();
    scale_columns(residual.view_mut(), &relative);
    let ResidualNorms { mean_square, max_square } = ResidualNorms::without(residual.view(), unread);
    Ok(Some(Distances::new(mean_square, max_square, false, None)))
}

/// Converts a batch's report back to the unit of the targets, which all have the same exponents.
pub(crate) fn restore_batch<'a>(
    report: &mut BatchReport,
    exponents: impl Iterator<Item = &'a Exponents>,
    weights: i32,
) {
    let exponent = exponents.map(|of_target| largest(of_target)).max().unwrap_or(0);
    if exponent == 0 && weights == 0 {
        return;
    }
    let restore = |residuals: &mut Vec<ResidualNorms>| {
        for of in residuals {
            of.mean_square = times_within(of.mean_square, 2 * exponent);
            of.max_square = times_within(of.max_square, 2 * exponent);
        }
    };
    match report {
        BatchReport::Streamed(report) => report.history.iter_mut().for_each(|pass| restore(&mut pass.residuals)),
        BatchReport::Quadrature { residuals, .. } => restore(residuals),
        BatchReport::LeastSquares { report, gcv } => {
            restore(&mut report.residuals);
            restore_solution(report, exponent, weights);
            if let Some(gcv) = gcv {
                restore_search(gcv, exponent, weights);
            }
        }
    }
}

/// Converts a search for the smoothness back to the targets' unit.
pub(crate) fn restore_search(gcv: &mut Gcv, exponent: i32, weights: i32) {
    for smoothness in gcv.by_channel.iter_mut().chain([&mut gcv.smoothness]) {
        *smoothness = times_within(*smoothness, weights);
    }
    for [smoothness, score, _] in &mut gcv.tried {
        *smoothness = times_within(*smoothness, weights);
        *score = times_within(*score, 2 * exponent + weights);
    }
}

/// Converts a solver's report on several targets back to the targets' unit.
pub(crate) fn restore_solution(report: &mut LsqReport, exponent: i32, weights: i32) {
    report.norm = times_within(report.norm, exponent);
    report.smoothness = times_within(report.smoothness, weights);
    for warning in &mut report.warnings {
        if let LsqWarning::Underdetermined { norm, .. } = warning {
            *norm = times_within(*norm, exponent);
        }
    }
}

/// Divides sums over samples by powers of two. Returns the scaled sums, the exponents of the channels, and the exponent
/// of the weights. With `together`, all channels have the same exponent. Returns `None` if no sum needs scaling.
pub(crate) fn sums_into_range(sums: &SampleSums, together: bool) -> Option<(SampleSums, Exponents, i32)> {
    let total = even_exponent(sums.moments.iter().copied().chain([sums.weight])).unwrap_or(0);
    let weights = if total.abs() > SUM { total } else { 0 };
    // A sum divided by the total weight is about as large as the channel's values, whatever the number of samples.
    let of = |column: ndarray::ArrayView1<'_, f64>| even_exponent(column.iter().map(|&sum| times(sum, -total)));
    let sizes: Vec<Option<i32>> = sums.right_sides.columns().into_iter().map(of).collect();
    let exponents = exponents_of(&sizes, together);
    if weights == 0 && exponents.iter().all(|&e| e == 0) {
        return None;
    }
    let mut scaled = sums.clone();
    scale_all(scaled.moments.iter_mut().chain([&mut scaled.weight]), -weights);
    scale_columns(scaled.right_sides.view_mut(), &exponents.iter().map(|e| -weights - e).collect::<Vec<_>>());
    for (square, e) in scaled.squares.iter_mut().zip(&exponents) {
        *square = times(*square, -weights - 2 * e);
    }
    Some((scaled, exponents, weights))
}

/// Converts a fit that was computed from scaled sums back to the unit of the original sums, except for its squared
/// residuals.
pub(crate) fn restore_moments(fit: &mut MomentFit, exponents: &[i32], weights: i32) {
    restore_columns(&mut fit.coefficients, &mut fit.standard_errors, exponents);
    restore_solution(&mut fit.report, largest(exponents), weights);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_share_an_exponent_unless_their_sizes_differ_much() {
        for (sizes, together, expected) in [
            ([None, Some(-130), Some(-132)], true, [-130; 3]),
            ([None, Some(-130), Some(-132)], false, [-130; 3]),
            ([Some(30), Some(-8), None], false, [0; 3]),
            ([Some(0), Some(90), Some(-66)], false, [0, 90, -66]),
            ([Some(0), Some(90), Some(-66)], true, [90; 3]),
            ([None; 3], false, [0; 3]),
        ] {
            assert_eq!(exponents_of(&sizes, together), expected, "{sizes:?}");
        }
    }
}
