//! Defines the sums over samples from which a least-squares fit is computed.

use ndarray::{Array2, ArrayView2, s};
use spharm_harmonics::{Directions, basis_size};

use crate::{Transform, TransformError, TransformParams};

/// The sums over samples that determine a least-squares fit to degree L. They consist of `(2L + 1)^2 + c (L + 1)^2`
/// values and a few more, regardless of the number of samples. Sums over parts of the samples can be added.
#[derive(Debug, Clone, PartialEq)]
pub struct SampleSums {
    /// Highest degree of a fit, L.
    pub max_degree: usize,
    /// Moments `sum_i w_i S_{lm}(x_i)` to degree 2L, `(2L + 1)^2` values in canonical order.
    pub moments: Vec<f64>,
    /// Right-hand sides `A^T W f = sum_i w_i f_i S_{lm}(x_i)` (K, c), to degree L.
    pub right_sides: Array2<f64>,
    /// Weighted sum of squares, `sum_i w_i f_i^2`, of each of the c channels.
    pub squares: Vec<f64>,
    /// Sum of the weights, `sum_i w_i`.
    pub weight: f64,
    /// Number of samples with a weight other than zero.
    pub count: u64,
}

impl SampleSums {
    /// Computes the sums of samples `values` (n, c) at n directions, with `weights` (n). If no weights are given,
    /// w = 1. `accuracy` is a relative accuracy, as for a [`Transform`].
    ///
    /// Takes one pass: samples are sorted and kernels evaluated once for moments and right-hand sides.
    ///
    /// # Errors
    ///
    /// [`TransformError::Shape`] if the number of values or weights isn't n. Also the errors of [`Transform::new`] for
    /// degree 2L.
    pub fn new(
        directions: &Directions,
        weights: Option<&[f64]>,
        values: ArrayView2<'_, f64>,
        max_degree: usize,
        accuracy: f64,
    ) -> Result<Self, TransformError> {
        let (n, channels) = values.dim();
        let expect = |what: &'static str, found: usize| match directions.len() {
            expected if expected == found => Ok(()),
            expected => Err(TransformError::Shape { what, expected, found }),
        };
        expect("samples", n)?;
        expect("weights", weights.map_or(n, <[f64]>::len))?;
        let weight = |i: usize| weights.map_or(1.0, |weights| weights[i]);
        let params = TransformParams { max_degree: 2 * max_degree, accuracy, channels: channels + 1 };
        let transform = Transform::new(directions, &params)?;
        let sums = transform.weighted_sums(values, weights)?;
        let square = |c: usize| (0..n).map(|i| weight(i) * values[[i, c]].powi(2)).sum();
        Ok(Self {
            max_degree,
            moments: sums.column(0).to_vec(),
            right_sides: sums.slice(s![..basis_size(max_degree), 1..]).to_owned(),
            squares: (0..channels).map(square).collect(),
            weight: (0..n).map(weight).sum(),
            count: (0..n).filter(|i| weight(*i) != 0.0).count() as u64,
        })
    }
}
