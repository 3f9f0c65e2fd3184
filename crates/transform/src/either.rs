//! Synthesis by the faster of direct sums and a transform.

use ndarray::{Array2, ArrayView2};
use spharm_harmonics::index::{basis_size, max_degree_of};
use spharm_harmonics::{Directions, HarmonicsError};

use crate::{FINEST, Transform, TransformError, TransformParams};

/// Largest number of directions times coefficients at which direct sums are faster than planning a transform. At this
/// size both take some milliseconds.
const DIRECT: usize = 3_000_000;

/// Evaluates c functions at `directions` from their canonical `coefficients`, (K, c), to a relative accuracy of at
/// least [`FINEST`], and returns the samples, (n, c).
///
/// For repeated synthesis at the same directions, plan a [`Transform`] once.
///
/// # Errors
///
/// - [`TransformError::Harmonics`] with [`HarmonicsError::NotABasisSize`]: K isn't `(L + 1)^2`.
/// - [`TransformError::Harmonics`] with [`HarmonicsError::DegreeTooHigh`]: L is above
///   [`MAX_DEGREE`](spharm_harmonics::MAX_DEGREE).
/// - [`TransformError::TooManyDirections`]: n is above 2^32 - 1.
pub fn synthesis(directions: &Directions, coefficients: ArrayView2<'_, f64>) -> Result<Array2<f64>, TransformError> {
    let (rows, channels) = coefficients.dim();
    let max_degree = max_degree_of(rows).ok_or(HarmonicsError::NotABasisSize { rows })?;
    if max_degree > spharm_harmonics::MAX_DEGREE || directions.len() * basis_size(max_degree) <= DIRECT {
        return Ok(spharm_harmonics::synthesis(directions, coefficients)?);
    }
    let params = TransformParams { max_degree, accuracy: FINEST, channels: channels.clamp(1, 3) };
    Transform::new(directions, &params)?.synthesis(coefficients)
}
