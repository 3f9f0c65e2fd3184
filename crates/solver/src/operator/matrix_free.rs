//! Implements the basis by fast transforms, without storing its matrix.

use std::sync::OnceLock;

use ndarray::{Array2, ArrayView2};
use spharm_harmonics::{Directions, basis_size};
use spharm_transform::{Transform, TransformParams};

use super::Operator;
use crate::gram::{check_count, moment_normal};
use crate::{MomentNormal, SolverError};

/// A basis at scattered directions, whose products are computed by a [`Transform`] to the accuracy of its parameters.
#[derive(Debug)]
pub struct MatrixFreeOperator {
    transform: Transform,
    /// Transform of twice the degree at the same directions, for moments; `None` unless created by `with_moments`.
    twice: Option<Transform>,
    accuracy: f64,
}

impl MatrixFreeOperator {
    /// Plans transforms for `directions`.
    ///
    /// # Errors
    ///
    /// The errors of [`Transform::new`].
    pub fn new(directions: &Directions, params: &TransformParams) -> Result<Self, SolverError> {
        Ok(Self { transform: Transform::new(directions, params)?, twice: None, accuracy: params.accuracy })
    }

    /// Plans transforms for `directions`. The directions are sorted once, for these transforms and for those of
    /// [`moments`](Self::moments).
    ///
    /// # Errors
    ///
    /// The errors of [`Transform::new`] for twice the degree.
    pub fn with_moments(directions: &Directions, params: &TransformParams) -> Result<Self, SolverError> {
        let TransformParams { max_degree, accuracy, channels } = *params;
        let twice = TransformParams { max_degree: 2 * max_degree, accuracy, channels: channels + 1 };
        let twice = Transform::new(directions, &twice)?;
        Ok(Self { transform: twice.to_degree(max_degree, channels)?, twice: Some(twice), accuracy })
    }

    /// Returns the bytes that [`with_moments`](Self::with_moments) needs in addition to [`new`](Self::new), for calls
    /// with `channels` channels, including the normal operator from moments on `threads` threads.
    ///
    /// # Errors
    ///
    /// The errors of [`Transform::bytes`].
    pub fn moment_bytes(
        params: &TransformParams,
        directions: usize,
        channels: usize,
        threads: usize,
    ) -> Result<usize, SolverError> {
        let TransformParams { max_degree, accuracy, channels: group } = *params;
        let twice = TransformParams { max_degree: 2 * max_degree, accuracy, channels: group };
        // Moments have degrees up to 2L, so their grids are twice as wide. There is one grid for each channel of a
        // group, and one for the weights.
        let grids = Transform::bytes(&twice, directions, channels.min(group) + 1)?;
        Ok(grids + MomentNormal::bytes(max_degree, channels, threads))
    }

    /// Computes the normal matrix from moments at `directions`, which must be the operator's directions, to at least
    /// the given relative accuracy. The weights (n) are all 1 by default. If the operator was created by
    /// [`with_moments`](Self::with_moments) and is accurate enough, also computes the right-hand sides of the targets
    /// (n, c), in the same pass over the samples.
    ///
    /// # Errors
    ///
    /// [`SolverError::Rows`] if the number of weights is wrong, and the errors of the transforms and of
    /// [`MomentNormal::new`].
    pub fn moments(
        &self,
        directions: &Directions,
        weights: Option<&[f64]>,
        accuracy: f64,
        targets: Option<&Array2<f64>>,
    ) -> Result<(MomentNormal, Option<Array2<f64>>), SolverError> {
        let max_degree = self.max_degree();
        let Some(twice) = self.twice.as_ref().filter(|_| self.accuracy <= accuracy) else {
            return Ok((moment_normal(directions, weights, max_degree, accuracy)?, None));
        };
        check_count(self.rows(), weights)?;
        let none = Array2::zeros((self.rows(), 0));
        let sums = twice.weighted_sums(targets.unwrap_or(&none).view(), weights)?;
        let normal = MomentNormal::new(max_degree, sums.column(0).to_vec())?;
        let right_sides = targets.map(|_| sums.slice(ndarray::s![..basis_size(max_degree), 1..]).to_owned());
        Ok((normal, right_sides))
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
            // If x is of lower degree, coefficients of higher degrees are zero.
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

/// A [`MatrixFreeOperator`] whose transforms are planned when they are first needed. Until then the plan's memory is
/// available to other work, such as computing moments.
#[derive(Debug)]
pub struct DeferredOperator<'a> {
    directions: &'a Directions,
    params: TransformParams,
    planned: OnceLock<MatrixFreeOperator>,
}

impl<'a> DeferredOperator<'a> {
    /// Creates the operator without planning: invalid parameters cause an error in the first product.
    pub fn new(directions: &'a Directions, params: &TransformParams) -> Self {
        Self { directions, params: *params, planned: OnceLock::new() }
    }

    fn planned(&self) -> Result<&MatrixFreeOperator, SolverError> {
        if let Some(planned) = self.planned.get() {
            return Ok(planned);
        }
        // Plan before the cell is initialised. Planning within `get_or_init` could cause a deadlock, because this
        // thread may meanwhile take up other work that itself waits for the cell.
        let planned = MatrixFreeOperator::new(self.directions, &self.params)?;
        Ok(self.planned.get_or_init(|| planned))
    }
}

impl Operator for DeferredOperator<'_> {
    fn rows(&self) -> usize {
        self.directions.len()
    }

    fn max_degree(&self) -> usize {
        self.params.max_degree
    }

    fn apply(&self, x: ArrayView2<'_, f64>) -> Result<Array2<f64>, SolverError> {
        self.planned()?.apply(x)
    }

    fn apply_adjoint(&self, r: ArrayView2<'_, f64>) -> Result<Array2<f64>, SolverError> {
        self.planned()?.apply_adjoint(r)
    }

    fn normal(&self, x: ArrayView2<'_, f64>, weights: Option<&[f64]>) -> Result<Array2<f64>, SolverError> {
        self.planned()?.normal(x, weights)
    }
}
