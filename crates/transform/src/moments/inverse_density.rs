//! An approximate inverse of the normal operator: division by the density of the samples.
//!
//! `A^T diag(w) A` multiplies by the density S of the weights and projects to degrees up to L. If S varies on a larger
//! scale than functions of degree L, the inverse divides by S. On irregular samplings S itself is rough at the scale of
//! degree L, but the operator effectively sees S smoothed at that scale, `S~ = sum exp(-(c l / L)^2 / 2) s_{lm}
//! S_{lm}`. Here c is the constant `SMOOTHING`. With a lower bound on S~, the basis `A_g` on a quadrature grid and the
//! grid's weights q, the matrix
//!
//! ```text
//! M = A_g^T diag(q_g / S~(g)) A_g
//! ```
//!
//! is symmetric and positive definite. A preconditioner needn't be exact, so M has a grid of 5/4 L rings instead of 2L,
//! and takes about half the time of a product with the operator. Numbers of iterations of conjugate gradients to a
//! tolerance of 1e-10, without and with M:
//!
//! | samples | without | with |
//! |---|--:|--:|
//! | random, 4 per coefficient | 84 | 32 |
//! | random, 10 per coefficient | 32 | 17 |
//! | 10 per coefficient, half of them in a clump | 136 | 25 |
//! | 10 per coefficient and a gap of radius 10 / L | 265 | 132 |
//!
//! With 40 random samples per coefficient, M reduces the iterations from 17 to 11, which doesn't pay off. On even
//! samplings, M saves no time.

#[cfg(test)]
mod tests;

use ndarray::{Array2, ArrayView2};
use rustfft::num_complex::Complex64;
use spharm_harmonics::index::{basis_size, degree_order};

use super::MomentOperator;
use super::on_grid::OnGrid;
use super::ring_grid::{RingGrid, Size};
use crate::TransformError;

/// The factor c in the exponent of the density's smoothing, `exp(-(c l / L)^2 / 2)`. The iterations are fewest with c
/// from 1.1 to 1.3.
const SMOOTHING: f64 = 1.2;
/// Densities below this share of the mean density are replaced by this share of the mean density.
const FLOOR: f64 = 0.05;
/// The iterations that the inverse saves outweigh the cost of applying it if the standard deviation of the smoothed
/// density, relative to its mean, is above this value. Random samples have this deviation at 11 samples per
/// coefficient.
const UNEVEN: f64 = 0.25;
/// The sampling is treated as even if the standard deviation of the smoothed density, relative to its mean, is below
/// this value. Random samples have this deviation at 70 samples per coefficient.
const EVEN: f64 = 0.1;
/// If the standard deviation is from `EVEN` to `UNEVEN`, the inverse pays off only if the smoothed density is somewhere
/// below this fraction of its mean.
const SPARSE: f64 = 0.3;
/// The inverse isn't used if the smoothed density is below [`FLOOR`] times its mean on more than this fraction of the
/// sphere.
const GAPS: f64 = 0.02;
/// The scale c of the smoothing that reveals large gaps, whose radius is about 15 / L or more. A sampling with such a
/// gap gets no inverse, because functions within the gap are undetermined, and their values after some iterations would
/// depend on the preconditioner.
const GAP_SMOOTHING: f64 = 6.0;

/// An approximate inverse of the normal operator of an uneven sampling, from the moments of its weights.
#[derive(Debug)]
pub struct InverseDensity {
    /// The operator `A_g^T D A_g` on a grid, where D is the diagonal matrix of the quotients `q_g / S~(g)` (see the
    /// [module](self)).
    on_grid: OnGrid,
    condition: f64,
}

impl InverseDensity {
    /// Builds the inverse to degree L = `max_degree` from the moments to degree 2L that
    /// [`MomentOperator`](super::MomentOperator) takes. Returns `None` if the inverse doesn't pay off because the
    /// sampling is even, or if the sampling has large gaps.
    ///
    /// # Errors
    ///
    /// The errors of [`MomentOperator::new`](super::MomentOperator::new).
    pub fn new(max_degree: usize, moments: &[f64]) -> Result<Option<Self>, TransformError> {
        super::check(max_degree, moments)?;
        let factors = smoothing(max_degree, SMOOTHING);
        // S~ has the same mean as S.
        let mean = moments[0] / (4.0 * std::f64::consts::PI).sqrt();
        let deviation = if mean > 0.0 { deviation(moments, &factors) } else { 0.0 };
        if deviation < EVEN {
            return Ok(None);
        }
        let floor = FLOOR * mean;
        // Smoothing with `GAP_SMOOTHING` makes the degrees above L negligible, so the moments up to degree L suffice
        // for this check.
        let low = max_degree.div_ceil(2);
        let of_low = &moments[..basis_size(2 * low)];
        if Smoothed::new(low, of_low, &smoothing(max_degree, GAP_SMOOTHING))?.below(floor) > 0.0 {
            return Ok(None);
        }
        let smoothed = Smoothed::new(max_degree, moments, &factors)?;
        if (deviation < UNEVEN && smoothed.below(SPARSE * mean) == 0.0) || smoothed.below(floor) > GAPS {
            return Ok(None);
        }
        let Smoothed { grid, mut density } = smoothed;
        let values = || density.iter().flat_map(|point| [point.re, point.im]).map(|value| value.max(floor));
        let condition = values().fold(floor, f64::max) / values().fold(f64::INFINITY, f64::min);
        grid.weigh(&mut density, |[weight, mirror], point| {
            (point.re, point.im) = (weight / point.re.max(floor), mirror / point.im.max(floor));
        });
        Ok(Some(Self { on_grid: OnGrid::new(grid, density), condition }))
    }

    /// Returns the peak memory in bytes of an operator and its inverse together, either during construction of one of
    /// them or during calls with `channels` channels on `threads` threads.
    pub const fn bytes_with_operator(max_degree: usize, channels: usize, threads: usize) -> usize {
        let operator = MomentOperator::sizes(max_degree, channels, threads);
        let rings = (Size::Coarse.last_pair(max_degree) + 1).next_multiple_of(8);
        let inverse = OnGrid::sizes(max_degree, rings, 5 * (max_degree + 1) / 2 + 64, channels, threads);
        let called = operator.called + inverse.called;
        let beside = inverse.held + if inverse.made > called { inverse.made } else { called };
        operator.held + if operator.made > beside { operator.made } else { beside }
    }

    /// Returns a bound on the condition number: the ratio of the largest to the smallest density, where densities below
    /// the floor are replaced by the floor.
    pub fn condition(&self) -> f64 {
        self.condition
    }

    /// Applies the approximate inverse M to coefficients r. Both r and the result `M r` have shape (K, c).
    ///
    /// # Errors
    ///
    /// [`TransformError::Shape`] if r doesn't have `K = (L + 1)^2` rows.
    pub fn apply(&self, r: ArrayView2<'_, f64>) -> Result<Array2<f64>, TransformError> {
        self.on_grid.apply(r)
    }
}

/// A smoothed density on a coarse grid.
struct Smoothed {
    grid: RingGrid,
    density: Vec<Complex64>,
}

impl Smoothed {
    /// Evaluates the density on the grid for degree L. Each moment, to degree 2L, is multiplied by the factor of its
    /// degree. `factors` must extend to degree 2L at least.
    fn new(max_degree: usize, moments: &[f64], factors: &[f64]) -> Result<Self, TransformError> {
        let (grid, twice) = RingGrid::new(max_degree, Size::Coarse)?;
        let density = grid.function(&twice, moments, Some(&factors[..=2 * max_degree]));
        Ok(Self { grid, density })
    }

    /// Returns the fraction of the sphere on which the density is below a bound.
    fn below(&self, bound: f64) -> f64 {
        let mut below = self.density.clone();
        self.grid.weigh(&mut below, |[weight, mirror], point| {
            let share = |value: f64, weight: f64| if value < bound { weight } else { 0.0 };
            (point.re, point.im) = (share(point.re, weight), share(point.im, mirror));
        });
        below.iter().map(|point| point.re + point.im).sum::<f64>() / (4.0 * std::f64::consts::PI)
    }
}

/// Returns, for each degree l up to 2L, the factor `exp(-(scale l / L)^2 / 2)` by which smoothing multiplies it.
fn smoothing(max_degree: usize, scale: f64) -> Vec<f64> {
    let scale = scale / max_degree.max(1) as f64;
    (0..=2 * max_degree).map(|l| (-0.5 * (scale * l as f64).powi(2)).exp()).collect()
}

/// Returns the standard deviation of the smoothed density, relative to its mean. Uses Parseval's identity, without
/// evaluating the density.
fn deviation(moments: &[f64], factors: &[f64]) -> f64 {
    let squares = moments.iter().enumerate().skip(1).map(|(column, s)| (factors[degree_order(column).0] * s).powi(2));
    (squares.sum::<f64>()).sqrt() / moments[0].abs()
}
