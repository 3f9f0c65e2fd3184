//! Estimates the detail beyond the degree of a denoised fit, at held-out vertices.
//!
//! The part of a target beyond the degree of the fit is in the residual, and is treated as noise. If this part is
//! larger than the noise, denoising removes detail. Held-out vertices distinguish detail from noise, because a fit
//! predicts detail at vertices that it hasn't used, but not noise. Therefore a second fit to 1.5 times the degree is
//! made, with the penalties extrapolated by a power law. If denoising removes detail, the second fit has a smaller
//! error at the held-out vertices than the first fit:
//!
//! ```text
//! detail^2 = e_L^2 - e_L'^2,    L' = 3 L / 2, with at most 4/5 as many functions as vertices
//! ```
//!
//! with e_L and e_L' the rms errors of the two fits at a held-out tenth of the vertices. The estimate is only the part
//! of the detail that the vertices reveal, and the true detail may be larger. If the highest degree is almost entirely
//! noise, higher degrees reveal no detail, and no fits are made. No fits are made either if the noise is as small as
//! the rounding errors of the fit. The mean of the target is subtracted, since errors of the fits are relative to their
//! targets.
//!
//! Cost: two fits by conjugate gradients to a tolerance of 1e-4, or lower if the noise is small.

use ndarray::{Array2, ArrayView2};
use spharm_harmonics::basis_size;
use spharm_monitor::{Level, Monitor};
use spharm_solver::lsq::Denoise;
use spharm_solver::{LsqParams, LsqSolver, MatrixFreeOperator, Strategy};
use spharm_transform::Transform;

use super::job::Job;
use super::lsq_plan::transform;
use crate::Error;
use crate::assess::HoldOut;

/// If denoising multiplies the coefficients of the highest degree by less than this gain, noise is assumed to dominate
/// all higher degrees as well.
const COVERED: f64 = 0.05;
/// Fraction of the vertices that are held out.
const HELD_OUT: f64 = 0.1;
/// Noise below this fraction of the largest value is attributed to rounding errors of the solver. The fit of an exact
/// model leaves residuals of up to 1e-10 of the values.
const ROUNDING: f64 = 1e-9;
/// Largest tolerance of the two fits (see the [module](self)), and the largest error of these fits as a fraction of the
/// noise. If the first value would give a larger error, a lower tolerance is used.
const TOLERANCE: (f64, f64) = (1e-4, 0.1);

/// Returns the rms of the detail beyond the fit's degree that the vertices reveal, per channel, in the target's unit.
/// Returns `None` if there are too few vertices for a higher degree, or too little memory.
pub(crate) fn left_out(
    job: &Job<'_>,
    precision: Option<&[f64]>,
    target: ArrayView2<'_, f64>,
    removed: &Denoise,
    monitor: &dyn Monitor,
) -> Result<Option<f64>, Error> {
    let (degree, directions) = (job.params.max_degree, &job.sphere.directions);
    let (n, c) = target.dim();
    if degree == 0 || removed.sigma == 0.0 || removed.gain[degree] < COVERED {
        return Ok(Some(0.0));
    }
    let Ok(hold_out) = HoldOut::new(n, HELD_OUT) else { return Ok(None) };
    let weights = hold_out.apply(precision.map(<[f64]>::to_vec));
    let seen = weights.iter().filter(|weight| **weight > 0.0).count();
    if removed.sigma <= ROUNDING * largest(target, &weights) {
        return Ok(Some(0.0));
    }
    let (centred, size) = centred(target, &weights);
    let most = ((0.8 * seen as f64).sqrt() as usize).saturating_sub(1);
    let higher = (degree + degree / 2).min(most);
    let Some(penalty) = continued(&removed.penalty, higher).filter(|_| higher >= degree + degree.div_ceil(10)) else {
        return Ok(None);
    };
    let needed = Transform::bytes(&transform(higher, c), n, c)? + 8 * c * (6 * n + 8 * basis_size(higher));
    if needed > job.memory / 2 {
        return Ok(None);
    }
    monitor.note(Level::Status, format_args!("fitting without the held-out vertices, degree {higher}"));
    // With area weights, the penalties were chosen for weights with a different sum, so scale the penalties.
    let all = precision.map_or(n as f64, |precision| precision.iter().sum());
    let scale = all / job.weights.as_ref().map_or(n as f64, |weights| weights.iter().sum());
    let error = |max_degree: usize, penalty: &[f64]| -> Result<f64, Error> {
        let operator = MatrixFreeOperator::new(directions, &transform(max_degree, c))?;
        let params = LsqParams {
            weights: Some(weights.clone()),
            penalty: Some(penalty.iter().map(|p| scale * p).collect()),
            strategy: Strategy::Cg,
            tolerance: (TOLERANCE.1 * removed.sigma / size).clamp(LsqParams::default().tolerance, TOLERANCE.0),
            max_iterations: 100,
            ..LsqParams::default()
        };
        let columns = 0..c;
        let mut solver = LsqSolver::new(&operator, None, params)?;
        let fit = solver.fit(&centred, std::slice::from_ref(&columns), monitor)?;
        Ok(at_held_out(&fit.residual, &weights, precision))
    };
    let (lower, higher) = (error(degree, &removed.penalty)?, error(higher, &penalty)?);
    Ok(Some((lower - higher).max(0.0).sqrt()))
}

/// Returns the largest absolute value of `target` (vertices x channels) at vertices of nonzero weight.
fn largest(target: ArrayView2<'_, f64>, weights: &[f64]) -> f64 {
    let rows = target.rows().into_iter().zip(weights).filter(|(_, weight)| **weight > 0.0);
    rows.fold(0.0, |largest: f64, (row, _)| row.iter().fold(largest, |largest: f64, value| largest.max(value.abs())))
}

/// Returns `target` (vertices x channels) minus the mean of each column over the vertices of nonzero weight. Also
/// returns the rms of the result over these vertices.
fn centred(target: ArrayView2<'_, f64>, weights: &[f64]) -> (Array2<f64>, f64) {
    let mut centred = target.to_owned();
    let count = weights.iter().filter(|weight| **weight > 0.0).count().max(1) as f64;
    let mut square = 0.0;
    for mut column in centred.columns_mut() {
        let seen = |(value, weight): (&f64, &f64)| (*weight > 0.0).then_some(*value);
        let mean = column.iter().zip(weights).filter_map(seen).sum::<f64>() / count;
        column -= mean;
        square += column.iter().zip(weights).filter_map(seen).map(|value| value * value).sum::<f64>();
    }
    let size = (square / (count * centred.ncols().max(1) as f64)).sqrt();
    (centred, size)
}

/// Returns the mean square of `residual` (vertices x channels) over the held-out vertices and all channels.
fn at_held_out(residual: &Array2<f64>, weights: &[f64], precision: Option<&[f64]>) -> f64 {
    let held_out = |i: usize| weights[i] == 0.0 && precision.is_none_or(|precision| precision[i] > 0.0);
    let rows = residual.rows().into_iter().enumerate().filter(|(i, _)| held_out(*i));
    let (sum, count) = rows.fold((0.0, 0usize), |(sum, count), (_, row)| (sum + row.dot(&row), count + row.len()));
    sum / count.max(1) as f64
}

/// Extrapolates penalties to higher degrees by a power law in the degree. The power is fitted to the penalties of the
/// upper half of the degrees, by least squares of the logarithms. Returns `None` if fewer than three of these penalties
/// are positive.
fn continued(penalty: &[f64], degree: usize) -> Option<Vec<f64>> {
    let last = penalty.len() - 1;
    let upper = penalty.iter().enumerate().skip((last / 2).max(1));
    let points: Vec<[f64; 2]> = upper.filter(|(_, p)| **p > 0.0).map(|(l, p)| [(l as f64).ln(), p.ln()]).collect();
    if points.len() < 3 {
        return None;
    }
    let count = points.len() as f64;
    let mean = [0, 1].map(|k| points.iter().map(|point| point[k]).sum::<f64>() / count);
    let sum = |k: usize| points.iter().map(|point| (point[0] - mean[0]) * (point[k] - mean[k])).sum::<f64>();
    let power = (sum(1) / sum(0)).clamp(1.0, 20.0);
    let at = |l: usize| (mean[1] + power * ((l as f64).ln() - mean[0])).exp();
    Some((0..=degree).map(|l| penalty.get(l).copied().unwrap_or_else(|| at(l))).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn penalties_are_continued_by_their_power() {
        let penalty: Vec<f64> = (0..=10).map(|l| 3.0 * f64::from(l).powi(4)).collect();
        let more = continued(&penalty, 15).expect("ten of them");
        assert_eq!(more.len(), 16);
        assert_eq!(more[..11], penalty[..]);
        assert!((more[15] / (3.0 * 15f64.powi(4)) - 1.0).abs() < 1e-12);
        assert!(continued(&[0.0; 11], 15).is_none());
    }
}
