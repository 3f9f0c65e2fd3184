//! Synthesis by direct sums or by a transform, whichever is faster.

use ndarray::{Array2, ArrayView2};
use spharm_harmonics::index::{basis_size, max_degree_of};
use spharm_harmonics::{Directions, HarmonicsError};

use crate::{FINEST, Transform, TransformError, TransformParams};

/// Products of directions and coefficients below which direct sums are faster than planning a transform: some
/// milliseconds of either.
const DIRECT: usize = 3_000_000;

/// Samples, (n, c), of the functions with the canonical coefficients `coefficients`, (K, c), at `directions`, to a relative
/// accuracy of [`FINEST`] at least.
///
/// # Errors
///
/// [`HarmonicsError::NotABasisSize`], [`HarmonicsError::DegreeTooHigh`], [`TransformError::TooManyDirections`].
pub fn synthesis(directions: &Directions, coefficients: ArrayView2<'_, f64>) -> Result<Array2<f64>, TransformError> {
    let (rows, channels) = coefficients.dim();
    let max_degree = max_degree_of(rows).ok_or(HarmonicsError::NotABasisSize { rows })?;
    if max_degree > spharm_harmonics::MAX_DEGREE || directions.len() * basis_size(max_degree) <= DIRECT {
        return Ok(spharm_harmonics::synthesis(directions, coefficients)?);
    }
    let params = TransformParams { max_degree, accuracy: FINEST, channels: channels.clamp(1, 3) };
    Transform::new(directions, &params)?.synthesis(coefficients)
}
