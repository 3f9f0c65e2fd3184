//! Removes noise within the fit, by a ridge penalty on each degree. The penalties are derived from the noise of the
//! targets.
//!
//! Targets are modelled as the sum of a smooth function and noise. The noise is independent from row to row. Its
//! variance is sigma^2, divided by the row's precision if precisions differ. An estimate of coefficients that is linear
//! in the targets, such as the plain least squares x = N^-1 A^T W f, transfers noise into each degree. The power of the
//! transferred noise, relative to sigma^2, depends only on the sampling. This power is measured by fits of noise e of
//! variance 1. In the following, x and x(e) are the plain fits of the targets f and of the noise e, an index l selects
//! the coefficients of degree l, and E is the expected value over e:
//!
//! ```text
//! B_l = E |x(e)_l|^2,   D = E |e - A x(e)|^2          of a column, from 12 columns of random signs
//! sigma^2 = |f - A x|^2 / (c D),   N_l = c sigma^2 B_l,   P_l = |x_l|^2      of the c columns of a target
//! h_l = 1 - N_l / P_l,  made non-increasing from degree 1 on (weights P_l: pooled degrees have one quotient of sums)
//! p_l = (1 - h_l) / h_l (2l + 1) / B_l,   p_0 = 0
//! min  |W^(1/2) (A x - f)|^2 + sum_l p_l |x_l|^2
//! ```
//!
//! For each degree l, P_l is the power of the plain fit, N_l the part of P_l that is expected from noise, h_l the gain
//! and p_l the penalty. In the last line, x is the penalised fit.
//!
//! The method is empirical Bayes (C. N. Morris, "Parametric empirical Bayes inference", JASA 78, 1983): coefficients of
//! degree l have the prior variance tau_l = h_l / (1 - h_l) sigma^2 B_l / (2l + 1), and `p_l = sigma^2 / tau_l`.
//! Without pooling tau_l is `(P_l - N_l) / (c (2l + 1))`. On an even sampling N is `n / 4 pi I`, and the fit's
//! coefficients of degree l are h_l times the plain fit's coefficients, which is Wiener's filter. On an uneven sampling
//! degrees mix, and the penalised fit removes less in regions whose vertices contain more information. The
//! non-increasing sequence is computed by pooling adjacent violators (R. E. Barlow et al., "Statistical inference under
//! order restrictions", 1972). The procedure isn't repeated, because a second round, with the penalised fit's own
//! powers in place of P_l, would gain only 0.02 dB.
//!
//! The prior variance is estimated, and an estimate of 0 doesn't mean that the coefficients are known to be 0. Standard
//! errors therefore include Morris's terms for the uncertainty of the estimate. Let k be the number of coefficients
//! that share the gain, `V = sigma^2 B_l / (2l + 1)`, y^2 = `V / (1 - h_l)` the mean square of these coefficients, and
//! `B = (k - 2) / k (1 - h_l)`. Then the variance `V h_l` of the posterior becomes `V (1 - B) + 2 / (k - 2) B^2 y^2`.
//! The difference is `4 (k - 1) / k^2 (1 - h_l) V`.
//!
//! Noise and detail are distinguished only by degree: detail of a surface beyond the fit's degree is treated as noise.
//!
//! The additional cost is the fit of 12 columns of noise, once per sampling, and a second fit of each target, which is
//! better conditioned than the plain fit.

use std::ops::Range;

use ndarray::{Array2, ArrayView2, Zip, s};
use serde::Serialize;
use spharm_harmonics::basis_size;
use spharm_harmonics::index::{first_column, order_count};
use spharm_monitor::{Monitor, OnlyCancel};

use super::cg::{Cg, CgParams};
use super::moments::{MomentProblem, Summed};
use super::preconditioner::Diagonal;
use super::signs::sign;
use crate::SolverError;

/// Number of columns of noise that are fitted, as many as four surfaces have. The noise power of degree l is then
/// estimated from 12 (2l + 1) values.
pub const NOISE_COLUMNS: usize = 12;

/// Gains h_l (see the [module](self)) below this value are raised to it before the penalty p_l is computed. A degree
/// with this gain is practically removed from the fit.
const LEAST_GAIN: f64 = 1e-6;

/// Generates noise (n, columns) of variance 1: random signs that depend only on row and column. With `precision` (n),
/// the variance of a row is the inverse of its precision, or zero if the precision is zero.
#[must_use]
pub fn white_noise(rows: usize, columns: Range<usize>, precision: Option<&[f64]>) -> Array2<f64> {
    let first = columns.start;
    let mut noise = Array2::zeros((rows, columns.len()));
    Zip::indexed(&mut noise).par_for_each(|(row, column), value| {
        let size = match precision.map(|precision| precision[row]) {
            None => 1.0,
            Some(precision) if precision > 0.0 => 1.0 / precision.sqrt(),
            Some(_) => 0.0,
        };
        // Each column uses its own 2^40 positions of the sequence of signs.
        *value = size * sign((((first + column) as u64) << 40) | row as u64);
    });
    noise
}

/// Computes the sum of the squares of a residual (n, c). With `precision` (n), the squares of a row are multiplied by
/// the row's precision.
#[must_use]
pub fn residual_square(residual: ArrayView2<'_, f64>, precision: Option<&[f64]>) -> f64 {
    let rows = residual.rows().into_iter().enumerate();
    rows.map(|(i, row)| precision.map_or(1.0, |precision| precision[i]) * row.dot(&row)).sum()
}

/// Power of noise of variance 1 after a fit: in the coefficients of each degree, and in the residual.
#[derive(Debug, Clone)]
pub struct NoisePower {
    /// Power in the coefficients of each degree (L + 1), summed over the fitted columns of noise.
    by_degree: Vec<f64>,
    residual: f64,
    columns: f64,
}

impl NoisePower {
    /// Creates the noise power with empty sums, to which fits of noise are then added.
    #[must_use]
    pub fn new(max_degree: usize) -> Self {
        Self { by_degree: vec![0.0; max_degree + 1], residual: 0.0, columns: 0.0 }
    }

    /// Adds a fit of columns of [`white_noise`]: the coefficients (K, columns) and the [`residual_square`] of all
    /// columns.
    ///
    /// # Panics
    ///
    /// If `coefficients` has fewer rows than the highest degree of the noise power requires.
    pub fn add(&mut self, coefficients: ArrayView2<'_, f64>, residual: f64) {
        let powers = powers(coefficients, self.by_degree.len());
        self.by_degree.iter_mut().zip(powers).for_each(|(sum, power)| *sum += power);
        self.residual += residual;
        self.columns += coefficients.ncols() as f64;
    }

    /// Estimates the noise power of fits from moments, for noise whose variance is 1 / w in a row of weight w. The
    /// noise power in a degree is the trace of the degree's part of `N^-1`, estimated by z^T N^-1 z for 12 vectors z of
    /// signs (M. F. Hutchinson, Commun. Stat. Simul. 19, 1990). The noise power in the residual is n - K. Estimates of
    /// the trace are raised to at least `(2l + 1) 4 pi / sum w`, the trace on an even sampling.
    ///
    /// # Errors
    ///
    /// [`SolverError::NoResidual`] if n isn't greater than K, and [`SolverError::Interrupted`] if the monitor cancels
    /// the computation.
    pub fn of_moments(problem: &MomentProblem, monitor: &dyn Monitor) -> Result<Self, SolverError> {
        const CG: CgParams = CgParams { tolerance: 1e-7, max_iterations: 1000, patience: 100 };
        let (max_degree, rows) = (problem.max_degree(), problem.rows());
        let columns = basis_size(max_degree);
        check_rows(rows, columns)?;
        let probes = white_noise(columns, 0..NOISE_COLUMNS, None);
        let mut cg = Cg::from_right_sides(probes.clone());
        let preconditioner = Diagonal::new(max_degree, problem.weight(), None);
        cg.run(&Summed { problem, penalty: None }, &preconditioner, &CG, &OnlyCancel(monitor))?;
        let products = &probes * &cg.x;
        let even = 4.0 * std::f64::consts::PI / problem.weight();
        let of = |l: usize| {
            products.slice(s![degree_range(l), ..]).sum().max((NOISE_COLUMNS * order_count(l)) as f64 * even)
        };
        Ok(Self {
            by_degree: (0..=max_degree).map(of).collect(),
            residual: (NOISE_COLUMNS * (rows - columns)) as f64,
            columns: NOISE_COLUMNS as f64,
        })
    }

    /// Returns the noise powers B_l (L + 1): the power in each degree of the fit of one column of noise of variance 1.
    #[must_use]
    pub fn by_degree(&self) -> Vec<f64> {
        self.by_degree.iter().map(|power| power / self.columns).collect()
    }

    /// Returns D, the power in the residual of the fit of one column of noise of variance 1: n - K for the plain least
    /// squares.
    #[must_use]
    pub fn residual(&self) -> f64 {
        self.residual / self.columns
    }

    /// Returns the noise power in degree 1 on this sampling, divided by the noise power in degree 1 on an even sampling
    /// whose precisions have the sum `weight`. The quotient is much larger than 1 if regions with few samples raise the
    /// noise of all degrees. It is 1 if the fit has no degree 1.
    #[must_use]
    pub fn relative_to_even(&self, weight: f64) -> f64 {
        let even = order_count(1) as f64 * 4.0 * std::f64::consts::PI / weight;
        self.by_degree().get(1).map_or(1.0, |power| power / even)
    }

    /// Estimates noise, gains and penalties from the coefficients (K, c) and the [`residual_square`] of a target's
    /// plain fit.
    ///
    /// # Panics
    ///
    /// If `coefficients` has fewer rows than the highest degree of the noise power requires.
    #[must_use]
    pub fn denoise(&self, coefficients: ArrayView2<'_, f64>, residual: f64) -> Denoise {
        let (base, c) = (self.by_degree(), coefficients.ncols() as f64);
        let variance = (residual / (c * self.residual())).max(0.0);
        let variance = if variance.is_finite() { variance } else { 0.0 };
        let power = powers(coefficients, base.len());
        let noise: Vec<f64> = base.iter().map(|base| c * variance * base).collect();
        let mut gain = vec![1.0];
        gain.extend(gains(&power[1..], &noise[1..]));
        let penalty = |(l, (&gain, &base)): (usize, (&f64, &f64))| {
            let gain = gain.max(LEAST_GAIN);
            if gain < 1.0 && base > 0.0 { (1.0 - gain) / gain * order_count(l) as f64 / base } else { 0.0 }
        };
        let penalty = gain.iter().zip(&base).enumerate().map(penalty).collect();
        let degrees_of_freedom = gain.iter().enumerate().map(|(l, gain)| gain * order_count(l) as f64).sum();
        let mut gain_variance = vec![0.0];
        for run in gain[1..].chunk_by(|a, b| a == b) {
            let degrees = gain_variance.len()..gain_variance.len() + run.len();
            let k = c * degrees.clone().map(order_count).sum::<usize>() as f64;
            let share = 4.0 * (k - 1.0) / (k * k) * (1.0 - run[0]);
            gain_variance.extend(degrees.map(|l| share * variance * base[l] / order_count(l) as f64));
        }
        Denoise { sigma: variance.sqrt(), degrees_of_freedom, gain, penalty, gain_variance }
    }
}

/// The estimated noise of a target, and the penalties that remove it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Denoise {
    /// Standard deviation of the noise in each channel, in the target's unit.
    pub sigma: f64,
    /// Effective number of coefficients per channel, `sum_l (2l + 1) h_l` with the gains h_l, at most K. On an even
    /// sampling this is the trace of the hat matrix.
    pub degrees_of_freedom: f64,
    /// Gain h_l of each degree l (an array of length L + 1): between 0 and 1, non-increasing.
    pub gain: Vec<f64>,
    /// Penalty p_l of each degree l (an array of length L + 1), for [`LsqParams::penalty`](crate::LsqParams::penalty).
    #[serde(skip)]
    pub penalty: Vec<f64>,
    /// For each degree (L + 1), the part of the variance of a coefficient that is due to the uncertainty of the gain
    /// h_l, in the square of the target's unit.
    #[serde(skip)]
    pub gain_variance: Vec<f64>,
}

impl Denoise {
    /// Returns the standard errors (K, c) of the penalised fit, including the uncertainty of the gains h_l. `errors`
    /// contains the standard errors for penalties that are known exactly.
    ///
    /// # Panics
    ///
    /// If `errors` has fewer rows than the highest degree of the gains requires.
    #[must_use]
    pub fn with_uncertain_gains(&self, mut errors: Array2<f64>) -> Array2<f64> {
        for (l, variance) in self.gain_variance.iter().enumerate() {
            errors.slice_mut(s![degree_range(l), ..]).mapv_inplace(|error| (error * error + variance).sqrt());
        }
        errors
    }
}

/// Checks that a fit of `columns` coefficients to `rows` samples leaves a residual.
///
/// # Errors
///
/// [`SolverError::NoResidual`] unless there are more rows than columns.
pub fn check_rows(rows: usize, columns: usize) -> Result<(), SolverError> {
    if rows > columns { Ok(()) } else { Err(SolverError::NoResidual { rows, columns }) }
}

fn degree_range(l: usize) -> Range<usize> {
    first_column(l)..first_column(l + 1)
}

/// Returns the sum of the squares of each degree's coefficients, over all columns.
fn powers(coefficients: ArrayView2<'_, f64>, degrees: usize) -> Vec<f64> {
    let of = |l: usize| coefficients.slice(s![degree_range(l), ..]).iter().map(|a| a * a).sum();
    (0..degrees).map(of).collect()
}

/// Returns the gains `1 - noise / power`, at least zero, made non-increasing by least squares with the powers as
/// weights. Degrees that violate the order get a common gain, from the sums of their noise and their power.
fn gains(power: &[f64], noise: &[f64]) -> Vec<f64> {
    struct Run {
        power: f64,
        noise: f64,
        degrees: usize,
    }
    impl Run {
        fn gain(&self) -> f64 {
            match (self.power > 0.0, self.noise > 0.0) {
                (_, false) => 1.0,
                (false, true) => f64::NEG_INFINITY,
                (true, true) => 1.0 - self.noise / self.power,
            }
        }
    }
    let mut runs: Vec<Run> = Vec::new();
    for (&power, &noise) in power.iter().zip(noise) {
        let mut run = Run { power, noise, degrees: 1 };
        while let Some(before) = runs.pop_if(|before| run.gain() > before.gain()) {
            let Run { power, noise, degrees } = before;
            run = Run { power: power + run.power, noise: noise + run.noise, degrees: degrees + run.degrees };
        }
        runs.push(run);
    }
    runs.iter().flat_map(|run| std::iter::repeat_n(run.gain().max(0.0), run.degrees)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Computes weighted least squares under an order restriction, by the min-max formula.
    fn brute_force(power: &[f64], noise: &[f64]) -> Vec<f64> {
        let mean = |from: usize, to: usize| {
            let sum = |values: &[f64]| values[from..=to].iter().sum::<f64>();
            1.0 - sum(noise) / sum(power)
        };
        let at = |i: usize| {
            let largest = |from: usize| (i..power.len()).map(|to| mean(from, to)).fold(f64::NEG_INFINITY, f64::max);
            (0..=i).map(largest).fold(f64::INFINITY, f64::min).max(0.0)
        };
        (0..power.len()).map(at).collect()
    }

    proptest::proptest! {
        #[test]
        fn gains_are_the_best_that_dont_increase(
            values in proptest::collection::vec((0.01f64..10.0, 0.01f64..3.0), 1..40),
        ) {
            let (power, noise): (Vec<f64>, Vec<f64>) = values.into_iter().unzip();
            let (found, expected) = (gains(&power, &noise), brute_force(&power, &noise));
            proptest::prop_assert_eq!(found.len(), power.len());
            proptest::prop_assert!(found.windows(2).all(|pair| pair[0] >= pair[1]));
            for (found, expected) in found.iter().zip(&expected) {
                proptest::prop_assert!((found - expected).abs() < 1e-12, "{found} {expected}");
            }
        }
    }

    #[test]
    fn degrees_without_power_or_noise_have_a_gain() {
        assert_eq!(gains(&[4.0, 0.0, 0.0], &[1.0, 1.0, 1.0]), [0.75, 0.0, 0.0]);
        assert_eq!(gains(&[0.0, 4.0], &[1.0, 1.0]), [0.5, 0.5]);
        assert_eq!(gains(&[4.0, 0.0], &[0.0, 0.0]), [1.0, 1.0]);
        assert_eq!(gains(&[], &[]), [0.0; 0]);
    }

    #[test]
    fn noise_is_the_same_in_any_columns_and_has_the_variance_of_its_precision() {
        let all = white_noise(500, 0..NOISE_COLUMNS, None);
        assert_eq!(all.slice(s![.., 3..7]), white_noise(500, 3..7, None));
        assert!(all.iter().all(|value| value.abs() == 1.0));
        // The sum of 6,000 signs is within five standard deviations of zero.
        assert!(all.sum().abs() < 5.0 * 6000f64.sqrt());
        let precision: Vec<f64> = (0..500).map(|i| (i % 3) as f64).collect();
        let noise = white_noise(500, 0..1, Some(&precision));
        assert!(precision.iter().zip(&noise).all(|(p, e)| (p * e * e - f64::from(*p > 0.0)).abs() < 1e-15));
        assert_eq!(residual_square(noise.view(), Some(&precision)).round(), 333.0);
    }
}
