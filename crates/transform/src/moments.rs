//! Applies the normal operator `A^T diag(w) A` of n scattered weighted directions, using their moments, at a cost that
//! doesn't depend on n.
//!
//! The *moments* `s_{lm} = sum_i w_i S_{lm}(x_i)` to degree 2L define a function `S = sum s_{lm} S_{lm}`. A product h
//! of two harmonics of degrees up to L has degree 2L, so `sum_i w_i h(x_i) = integral of S h`. The integrand has degree
//! 4L. It is integrated exactly by 2L + 1 Gauss-Legendre rings with at least 4L + 1 azimuths each. Let `A_g` be the
//! basis on this grid, and `q_g` the quadrature weights. Then, for every x,
//!
//! ```text
//! A^T diag(w) A x = A_g^T D A_g x,   D = diag(q_g S(g))
//! ```
//!
//! Next to the poles, where high orders vanish, rings have fewer azimuths. [`MomentGram`](crate::MomentGram) computes
//! the matrix itself from the same moments. The moments of a sampling are the sums of the moments of its parts.
//!
//! # Cost
//!
//! Each channel costs `L^3` fused products for Legendre sums, in pairs of rings, and Fourier transforms of about
//! `11 L^2` points. For the memory, see [`MomentOperator::bytes`].
//!
//! # Range
//!
//! L is at most half of the highest degree of a [`Transform`](crate::Transform). Weights may be negative. Errors are a
//! few eps times `sum |w|`: if the normal matrix of a sampling has a large condition number, eigenvectors of small
//! eigenvalues lose digits, as they would with the matrix itself.
//!
//! On the circle, the corresponding operator is the Toeplitz matrix of H. G. Feichtinger, K. Gröchenig and T. Strohmer,
//! "Efficient numerical methods in non-uniform sampling theory", Numer. Math. 69 (1995). That matrix is applied by
//! means of Fourier transforms.
//!
//! ```
//! use ndarray::Array2;
//! use spharm_transform::MomentOperator;
//!
//! // The uniform measure: all moments but the first vanish, and the normal operator is the identity.
//! let mut moments = vec![0.0; 25]; // to degree 2 L = 4
//! moments[0] = (4.0 * std::f64::consts::PI).sqrt();
//! let operator = MomentOperator::new(2, &moments)?;
//! let x = Array2::from_shape_fn((9, 2), |(k, c)| (k + c) as f64);
//! assert!((operator.apply(x.view())? - &x).iter().all(|off| off.abs() < 1e-14));
//! # Ok::<(), spharm_transform::TransformError>(())
//! ```

mod inverse_density;
mod on_grid;
mod ring_grid;
mod sums;
#[cfg(test)]
mod tests;

use ndarray::{Array2, ArrayView2};
use spharm_harmonics::basis_size;

use crate::TransformError;
use on_grid::{OnGrid, Sizes};
use ring_grid::{RingGrid, Size};

pub use inverse_density::InverseDensity;
pub use sums::SampleSums;

/// The normal operator `A^T diag(w) A` (K, K) of the canonical basis to degree L, from the moments of the weights.
///
/// Methods run on the rayon pool from which they are called; results are bit-identical for any number of threads.
/// Several threads can use an operator at once.
#[derive(Debug)]
pub struct MomentOperator {
    /// The operator `A_g^T D A_g` on the quadrature grid, see the [module](self).
    on_grid: OnGrid,
    norm: f64,
}

impl MomentOperator {
    /// Number of channels that a product processes together. The channels share Legendre functions and fit in the cache
    /// together.
    pub const CHANNELS: usize = ring_grid::CHANNELS;

    /// Builds the operator to degree L = `max_degree` from the moments `sum_i w_i S_{lm}(x_i)` to degree 2L, `(2L +
    /// 1)^2` values in canonical order.
    ///
    /// # Errors
    ///
    /// - [`TransformError::MomentCount`] if the number of moments isn't `(2L + 1)^2`.
    /// - [`TransformError::MomentNotFinite`] if a moment is NaN or infinite.
    /// - [`TransformError::Harmonics`] if L is above [`MAX_DEGREE`](spharm_harmonics::MAX_DEGREE).
    pub fn new(max_degree: usize, moments: &[f64]) -> Result<Self, TransformError> {
        check(max_degree, moments)?;
        let (grid, twice) = RingGrid::new(max_degree, Size::Exact)?;
        let mut density = grid.function(&twice, moments, None);
        drop(twice);
        let norm = density.iter().fold(0.0, |norm: f64, point| norm.max(point.re.abs()).max(point.im.abs()));
        grid.weigh(&mut density, |[weight, mirror], point| {
            (point.re, point.im) = (weight * point.re, mirror * point.im);
        });
        Ok(Self { on_grid: OnGrid::new(grid, density), norm })
    }

    /// Returns the peak memory of an operator in bytes, either during construction or during calls with `channels`
    /// channels on `threads` threads. The peak memory is about `240 (L + 1)^2` during construction. Afterwards it is
    /// `90 (L + 1)^2`, and calls need another `72 (L + 1)^2` for each channel that is being processed, up to 3 on each
    /// thread.
    pub const fn bytes(max_degree: usize, channels: usize, threads: usize) -> usize {
        let Sizes { held, made, called } = Self::sizes(max_degree, channels, threads);
        held + if made > called { made } else { called }
    }

    const fn sizes(max_degree: usize, channels: usize, threads: usize) -> Sizes {
        let rings = (max_degree + 1).next_multiple_of(8);
        OnGrid::sizes(max_degree, rings, 4 * (max_degree + 1) + 64, channels, threads)
    }

    /// Returns the highest degree, L.
    pub fn max_degree(&self) -> usize {
        self.on_grid.max_degree()
    }

    /// Returns the number of rows and of columns, `K = (L + 1)^2`.
    pub fn size(&self) -> usize {
        basis_size(self.max_degree())
    }

    /// Returns a bound on the largest absolute eigenvalue of the operator: the largest `|S(g)|` at a point g of the
    /// grid. It is a bound because the quadrature is exact, so `A_g^T diag(q_g) A_g` is the identity.
    pub fn norm(&self) -> f64 {
        self.norm
    }

    /// Computes `A^T diag(w) A x` for coefficients x. Both x and the result have shape (K, c).
    ///
    /// # Errors
    ///
    /// [`TransformError::Shape`] if x doesn't have `K = (L + 1)^2` rows.
    pub fn apply(&self, x: ArrayView2<'_, f64>) -> Result<Array2<f64>, TransformError> {
        self.on_grid.apply(x)
    }
}

/// Checks the number and the values of moments up to twice the degree `max_degree`.
pub(crate) fn check(max_degree: usize, moments: &[f64]) -> Result<(), TransformError> {
    let degree = 2 * max_degree;
    let expected = basis_size(degree);
    if moments.len() != expected {
        return Err(TransformError::MomentCount { degree, expected, found: moments.len() });
    }
    match moments.iter().position(|moment| !moment.is_finite()) {
        Some(column) => Err(TransformError::MomentNotFinite { column, found: moments[column] }),
        None => Ok(()),
    }
}
