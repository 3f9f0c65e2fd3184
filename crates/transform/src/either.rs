//! Computes synthesis by direct sums or a transform, whichever is faster.

use ndarray::{Array2, ArrayView2};
use spharm_harmonics::index::{basis_size, max_degree_of};
use spharm_harmonics::{Directions, HarmonicsError};

use crate::{FINEST, Transform, TransformError, TransformParams};

/// Largest product of the numbers of directions and coefficients at which direct sums are faster than planning a
/// transform. At this size both take some milliseconds.
const DIRECT: usize = 3_000_000;

/// Evaluates the c functions with the canonical `coefficients` (K, c) at n directions, and returns the samples (n, c).
/// The relative accuracy is [`FINEST`] or better.
///
/// For repeated synthesis at the same directions, plan a [`Transform`] once.
///
/// # Errors
///
/// - [`TransformError::Harmonics`] with [`HarmonicsError::NotABasisSize`] if K isn't `(L + 1)^2`.
/// - [`TransformError::Harmonics`] with [`HarmonicsError::DegreeTooHigh`] if L is above
///   [`MAX_DEGREE`](spharm_harmonics::MAX_DEGREE).
/// - [`TransformError::TooManyDirections`] if n is above 2^32 - 1.
pub fn synthesis(directions: &Directions, coefficients: ArrayView2<'_, f64>) -> Result<Array2<f64>, TransformError> {
    let (rows, channels) = coefficients.dim();
    let max_degree = max_degree_of(rows).ok_or(HarmonicsError::NotABasisSize { rows })?;
    if max_degree > spharm_harmonics::MAX_DEGREE || directions.len() * basis_size(max_degree) <= DIRECT {
        return Ok(spharm_harmonics::synthesis(directions, coefficients)?);
    }
    let params = TransformParams { max_degree, accuracy: FINEST, channels: channels.clamp(1, 3) };
    Transform::new(directions, &params)?.synthesis(coefficients)
}
