//! The Gram matrix of a sampling by its moments, as a source for factors.

use std::ops::Range;

use ndarray::{Array2, ArrayView2};
use spharm_harmonics::{Directions, HarmonicsError, MAX_DEGREE};
use spharm_transform::{FINEST, MomentGram, Transform, TransformParams};

use crate::SolverError;
use crate::cholesky::GramSource;

/// The Gram matrix of the basis at weighted directions, without the basis.
///
/// # Errors
///
/// Those of the transforms, to twice the degree.
pub fn moment_gram(
    directions: &Directions,
    weights: Option<&[f64]>,
    max_degree: usize,
) -> Result<MomentGram, SolverError> {
    let transform = Transform::new(directions, &moments(max_degree))?;
    let n = directions.len();
    let weights = match weights {
        Some(weights) if weights.len() != n => {
            return Err(SolverError::Rows { what: "the list of weights", expected: n, found: weights.len() });
        }
        Some(weights) => Array2::from_shape_fn((n, 1), |(i, _)| weights[i]),
        None => Array2::ones((n, 1)),
    };
    let moments = transform.adjoint_synthesis(ArrayView2::from(&weights))?;
    Ok(MomentGram::new(max_degree, moments.as_slice().unwrap_or_default())?)
}

/// Bytes that [`moment_gram`] takes while it works and what comes out of it, for so many directions.
///
/// # Errors
///
/// Those of the transforms, to twice the degree, which must not be above [`MAX_DEGREE`].
pub fn moment_gram_bytes(directions: usize, max_degree: usize) -> Result<usize, SolverError> {
    if 2 * max_degree > MAX_DEGREE {
        return Err(HarmonicsError::DegreeTooHigh { degree: max_degree, max: MAX_DEGREE / 2 }.into());
    }
    let transform = Transform::bytes(&moments(max_degree), directions, 1)?;
    Ok(transform.max(MomentGram::bytes(max_degree)) + 8 * directions)
}

/// What moments take: all digits, since the Gram matrix's condition is the square of the basis's.
fn moments(max_degree: usize) -> TransformParams {
    TransformParams { max_degree: 2 * max_degree, accuracy: FINEST, channels: 1 }
}

impl GramSource for MomentGram {
    fn size(&self) -> usize {
        MomentGram::size(self)
    }

    fn tile(
        &self,
        rows: Range<usize>,
        columns: Range<usize>,
        out: &mut [f64],
        leading: usize,
    ) -> Result<(), SolverError> {
        MomentGram::tile(self, rows, columns, out, leading);
        Ok(())
    }
}
