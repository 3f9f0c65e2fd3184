//! An approximate inverse of the normal operator: division by the density of the samples.
//!
//! `A^T diag(w) A` multiplies by the density S of the weights and projects to degrees up to L. Where S varies on a larger scale
//! than functions of degree L do, the inverse divides by it. S itself is rough at the scale of degree L on any sampling without
//! order; what the operator sees of it is S smoothed at that scale, `S~ = sum exp(-(c l / L)^2 / 2) s_{lm} S_{lm}`. With a
//! floor under S~ and quadrature weights q,
//!
//! ```text
//! M = A_g^T diag(q_g / S~(g)) A_g
//! ```
//!
//! is symmetric and positive definite, and a preconditioner needn't be exact: M has a grid of 5/4 L rings in place of 2L, which
//! takes some half of the time of a product with the operator. Iterations of conjugate gradients to 1e-10, without and with M:
//!
//! | samples | without | with |
//! |---|--:|--:|
//! | random, 4 to a coefficient | 84 | 32 |
//! | random, 10 to a coefficient | 32 | 17 |
//! | 10 to a coefficient, half of them in a clump | 136 | 25 |
//! | 10 to a coefficient and a gap of a radius of 10 / L | 265 | 132 |
//!
//! With 40 random ones to a coefficient, 17 become 11, which is not worth it, and on even samplings nothing is gained.

#[cfg(test)]
mod tests;

use ndarray::{Array2, ArrayView2};
use rustfft::num_complex::Complex64;
use spharm_harmonics::index::{basis_size, degree_order};

use super::MomentOperator;
use super::on_grid::OnGrid;
use super::ring_grid::{RingGrid, Size};
use crate::TransformError;

/// The scale at which the density is smoothed, c: from 1.1 to 1.3 iterations are fewest.
const SMOOTHING: f64 = 1.2;
/// Least density, relative to the mean.
const FLOOR: f64 = 0.05;
/// Standard deviation of the smoothed density, relative to its mean, from which on fewer iterations pay for what an application of the
/// inverse takes: random samples have it at 11 to a coefficient.
const UNEVEN: f64 = 0.25;
/// Standard deviation below which the sampling is even: random samples have it at 70 to a coefficient.
const EVEN: f64 = 0.1;
/// Between the two it pays where the density is anywhere below this, relative to its mean.
const SPARSE: f64 = 0.3;
/// The largest share of the sphere whose density may be below the floor.
const GAPS: f64 = 0.02;
/// The same scale, c, where the density is smoothed to find large gaps: those of a radius of some 15 / L. Functions within such
/// a gap aren't determined in the end, and what iterations make of them depends on the preconditioner.
const GAP_SMOOTHING: f64 = 6.0;

/// An approximate inverse of the normal operator of an uneven sampling, from the moments of its weights.
#[derive(Debug)]
pub struct InverseDensity {
    /// With `q_g / S~(g)`.
    on_grid: OnGrid,
    condition: f64,
}

impl InverseDensity {
    /// Makes the inverse to degree L = `max_degree` from moments to degree 2L, as [`MomentOperator`](super::MomentOperator) takes them;
    /// `None` where it isn't worth it, as the sampling is even, or where the sampling has large gaps.
    ///
    /// # Errors
    ///
    /// Those of [`MomentOperator::new`](super::MomentOperator::new).
    pub fn new(max_degree: usize, moments: &[f64]) -> Result<Option<Self>, TransformError> {
        super::check(max_degree, moments)?;
        let factors = smoothing(max_degree, SMOOTHING);
        // S~ has the mean that S has.
        let mean = moments[0] / (4.0 * std::f64::consts::PI).sqrt();
        let deviation = if mean > 0.0 { deviation(moments, &factors) } else { 0.0 };
        if deviation < EVEN {
            return Ok(None);
        }
        let floor = FLOOR * mean;
        // Smoothed so widely it has no digits beyond the degree L.
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

    /// Returns the most bytes that an operator and its inverse take together, while either is made or with the working memory of calls
    /// with so many channels on `threads` threads.
    pub const fn bytes_with_operator(max_degree: usize, channels: usize, threads: usize) -> usize {
        let operator = MomentOperator::sizes(max_degree, channels, threads);
        let rings = (Size::Coarse.last_pair(max_degree) + 1).next_multiple_of(8);
        let inverse = OnGrid::sizes(max_degree, rings, 5 * (max_degree + 1) / 2 + 64, channels, threads);
        let called = operator.called + inverse.called;
        let beside = inverse.held + if inverse.made > called { inverse.made } else { called };
        operator.held + if operator.made > beside { operator.made } else { beside }
    }

    /// Returns a bound on its condition number: the ratio of the largest and the smallest density, not below the floor.
    pub fn condition(&self) -> f64 {
        self.condition
    }

    /// Computes `M r`: (K, c) for coefficients r, (K, c).
    ///
    /// # Errors
    ///
    /// [`TransformError::Shape`]: r doesn't have `K = (L + 1)^2` rows.
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
    /// On the grid of degree L, from moments to degree 2L and a factor of each degree at least as high.
    fn new(max_degree: usize, moments: &[f64], factors: &[f64]) -> Result<Self, TransformError> {
        let (grid, twice) = RingGrid::new(max_degree, Size::Coarse)?;
        let density = grid.function(&twice, moments, Some(&factors[..=2 * max_degree]));
        Ok(Self { grid, density })
    }

    /// The share of the sphere where the density is below a bound.
    fn below(&self, bound: f64) -> f64 {
        let mut below = self.density.clone();
        self.grid.weigh(&mut below, |[weight, mirror], point| {
            let share = |value: f64, weight: f64| if value < bound { weight } else { 0.0 };
            (point.re, point.im) = (share(point.re, weight), share(point.im, mirror));
        });
        below.iter().map(|point| point.re + point.im).sum::<f64>() / (4.0 * std::f64::consts::PI)
    }
}

/// The factor of each degree up to 2L for a scale c.
fn smoothing(max_degree: usize, scale: f64) -> Vec<f64> {
    let scale = scale / max_degree.max(1) as f64;
    (0..=2 * max_degree).map(|l| (-0.5 * (scale * l as f64).powi(2)).exp()).collect()
}

/// The standard deviation of the smoothed density, relative to its mean: by Parseval's equation, without its values.
fn deviation(moments: &[f64], factors: &[f64]) -> f64 {
    let squares = moments.iter().enumerate().skip(1).map(|(column, s)| (factors[degree_order(column).0] * s).powi(2));
    (squares.sum::<f64>()).sqrt() / moments[0].abs()
}
