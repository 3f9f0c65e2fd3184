//! Applies the normal equations `N x = A^T W f`, `N = A^T W A + P`, by products with the basis.

use std::borrow::Cow;

use ndarray::{Array2, Zip};

use super::columns::{add_scaled_rows, scale_rows};
use super::preconditioner::Diagonal;
use crate::SolverError;
use crate::operator::Operator;

/// The normal equations of a weighted and penalised least-squares problem.
#[derive(Clone, Copy)]
pub struct NormalEquations<'a> {
    /// Operator of the basis, A.
    pub operator: &'a dyn Operator,
    /// Weights w (n); all 1 if `None`.
    pub weights: Option<&'a [f64]>,
    /// Diagonal (K) of the penalty P; zero if `None`.
    pub penalty: Option<&'a [f64]>,
}

impl NormalEquations<'_> {
    /// Computes the product `N x` with the normal matrix N.
    pub(crate) fn apply(&self, x: &Array2<f64>) -> Result<Array2<f64>, SolverError> {
        let mut y = self.operator.normal(x.view(), self.weights)?;
        if let Some(penalty) = self.penalty {
            add_scaled_rows(&mut y, penalty, x);
        }
        Ok(y)
    }

    /// Returns the inverse of the diagonal that the normal matrix N would have on an even sampling. Iterations that
    /// reports list as having no preconditioner use this inverse as a diagonal preconditioner.
    pub fn diagonal(&self) -> Diagonal {
        let weight = self.weights.map_or(self.operator.rows() as f64, |weights| weights.iter().sum());
        Diagonal::new(self.operator.max_degree(), weight, self.penalty)
    }

    /// Computes `A^T W s` for samples s (n, c).
    pub(crate) fn adjoint(&self, samples: &Array2<f64>) -> Result<Array2<f64>, SolverError> {
        self.operator.apply_adjoint(self.weighted(samples).view())
    }

    /// Computes `W s`: multiplies each row of the samples s (n, c) by the row's weight.
    pub(crate) fn weighted<'s>(&self, samples: &'s Array2<f64>) -> Cow<'s, Array2<f64>> {
        let mut samples = Cow::Borrowed(samples);
        if let Some(weights) = self.weights {
            scale_rows(samples.to_mut(), weights);
        }
        samples
    }

    /// Computes the residual `f - A x`.
    pub(crate) fn residual(&self, targets: &Array2<f64>, x: &Array2<f64>) -> Result<Array2<f64>, SolverError> {
        let mut residual = self.operator.apply(x.view())?;
        Zip::from(&mut residual).and(targets).par_for_each(|residual, target| *residual = target - *residual);
        Ok(residual)
    }

    /// Computes the gradient `A^T W (f - A x) - P x` and the residual `f - A x`.
    pub(crate) fn gradient(
        &self,
        targets: &Array2<f64>,
        x: &Array2<f64>,
    ) -> Result<(Array2<f64>, Array2<f64>), SolverError> {
        let residual = self.residual(targets, x)?;
        let mut gradient = self.adjoint(&residual)?;
        if let Some(penalty) = self.penalty {
            let minus: Vec<f64> = penalty.iter().map(|p| -p).collect();
            add_scaled_rows(&mut gradient, &minus, x);
        }
        Ok((gradient, residual))
    }
}
