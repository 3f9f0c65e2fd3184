//! The Gram matrix of a sampling by its moments, as a source for factors.

use std::ops::Range;

use ndarray::{Array2, ArrayView2};
use spharm_harmonics::Directions;
use spharm_transform::{MomentGram, Transform, TransformParams};

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
    let params = TransformParams { max_degree: 2 * max_degree, accuracy: 1e-13, channels: 1 };
    let transform = Transform::new(directions, &params)?;
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
