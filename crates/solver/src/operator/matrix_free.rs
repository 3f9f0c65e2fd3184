//! The basis as fast transforms, without a matrix.

use ndarray::{Array2, ArrayView2};
use spharm_harmonics::{Directions, basis_size};
use spharm_transform::{Transform, TransformParams};

use super::Operator;
use crate::SolverError;

/// A basis at scattered directions by [`Transform`]; to the accuracy that it was made for.
#[derive(Debug)]
pub struct MatrixFreeOperator {
    transform: Transform,
}

impl MatrixFreeOperator {
    /// Plans transforms for `directions`.
    ///
    /// # Errors
    ///
    /// Those of [`Transform::new`].
    pub fn new(directions: &Directions, params: &TransformParams) -> Result<Self, SolverError> {
        Ok(Self { transform: Transform::new(directions, params)? })
    }

    /// Returns the transform.
    pub fn transform(&self) -> &Transform {
        &self.transform
    }
}

impl Operator for MatrixFreeOperator {
    fn rows(&self) -> usize {
        self.transform.directions()
    }

    fn max_degree(&self) -> usize {
        self.transform.max_degree()
    }

    fn apply(&self, x: ArrayView2<'_, f64>) -> Result<Array2<f64>, SolverError> {
        let columns = basis_size(self.max_degree());
        if x.nrows() < columns {
            // Of lower degree: the degrees above it are zero.
            let mut padded = Array2::zeros((columns, x.ncols()));
            padded.slice_mut(ndarray::s![..x.nrows(), ..]).assign(&x);
            return Ok(self.transform.synthesis(padded.view())?);
        }
        Ok(self.transform.synthesis(x)?)
    }

    fn apply_adjoint(&self, r: ArrayView2<'_, f64>) -> Result<Array2<f64>, SolverError> {
        Ok(self.transform.adjoint_synthesis(r)?)
    }

    fn normal(&self, x: ArrayView2<'_, f64>, weights: Option<&[f64]>) -> Result<Array2<f64>, SolverError> {
        let weights = weights.map(|weights| self.transform.sorted_weights(weights)).transpose()?;
        Ok(self.transform.normal(x, weights.as_ref())?)
    }
}
