//! The least-squares problem that iterations and refinements solve, given by samples or by moments.

use std::sync::Arc;

use ndarray::Array2;
use spharm_transform::MomentOperator;

use super::columns::{add_scaled_rows, dots};
use super::normal_equations::NormalEquations;
use crate::{MomentNormal, SolverError};

/// Products with the normal matrix, and the gradient used for the final check of a solution.
pub(crate) trait Problem: Sync {
    /// Returns the right-hand sides `A^T W f` (K, c).
    fn right_sides(&self) -> Result<Array2<f64>, SolverError>;

    /// Computes the product `N x` with the normal matrix, for iterations.
    fn product(&self, x: &Array2<f64>) -> Result<Array2<f64>, SolverError>;

    /// Computes the gradient `A^T W (f - A x) - P x` as accurately as possible, and the residual `f - A x` (n, c) if
    /// there are samples.
    fn gradient(&self, x: &Array2<f64>) -> Result<(Array2<f64>, Option<Array2<f64>>), SolverError>;

    /// Returns a bound on the errors of [`product`](Self::product), compared with a product that is computed from the
    /// samples, or with the exact product if there are no samples; `None` if unknown.
    fn product_error(&self) -> Option<ProductError> {
        None
    }

    /// Returns the number of columns that a product processes at a time; `None` if a product processes all columns
    /// together.
    fn columns_together(&self) -> Option<usize> {
        None
    }

    /// Computes only the residual, at half the cost of the gradient; returns `None` if there are no samples.
    fn residual(&self, _x: &Array2<f64>) -> Result<Option<Residual>, SolverError> {
        Ok(None)
    }
}

/// A bound on the errors of products `N x` with the normal matrix N: `relative * norm`, for x of norm 1.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ProductError {
    /// Error relative to the norm of N.
    pub(crate) relative: f64,
    /// A bound on the norm of N.
    pub(crate) norm: f64,
}

/// A residual, with the slope `(A x)^T W r` of each of its columns r.
pub(crate) struct Residual {
    /// Residual `f - A x` (n, c).
    pub(crate) values: Array2<f64>,
    /// Slopes `(A x)^T W r` (c) of the columns.
    pub(crate) slopes: Vec<f64>,
}

/// A problem with samples. Products are computed by moments if `moments` is set, else by samples.
#[derive(Clone, Copy)]
pub(crate) struct Sampled<'a> {
    pub(crate) equations: NormalEquations<'a>,
    /// Targets f (n, c).
    pub(crate) targets: &'a Array2<f64>,
    pub(crate) moments: Option<&'a Moments>,
}

/// The normal matrix from moments.
pub(crate) struct Moments {
    pub(crate) normal: Arc<MomentNormal>,
    /// Relative accuracy of the moments.
    pub(crate) accuracy: f64,
}

impl Problem for Sampled<'_> {
    fn right_sides(&self) -> Result<Array2<f64>, SolverError> {
        self.equations.adjoint(self.targets)
    }

    fn product(&self, x: &Array2<f64>) -> Result<Array2<f64>, SolverError> {
        match self.moments {
            Some(moments) => penalised_product(moments.normal.operator(), self.equations.penalty, x),
            None => self.equations.apply(x),
        }
    }

    fn gradient(&self, x: &Array2<f64>) -> Result<(Array2<f64>, Option<Array2<f64>>), SolverError> {
        let (gradient, residual) = self.equations.gradient(self.targets, x)?;
        Ok((gradient, Some(residual)))
    }

    fn product_error(&self) -> Option<ProductError> {
        // With an error bound, the solver may use the gradient that the iteration has updated, after comparing it with
        // [`Residual::slopes`]. The slopes don't include a penalty, so this function returns no bound if there is a
        // penalty.
        let moments = self.moments.filter(|_| self.equations.penalty.is_none())?;
        Some(ProductError { relative: moments.accuracy, norm: moments.normal.operator().norm() })
    }

    fn columns_together(&self) -> Option<usize> {
        self.moments.map(|_| MomentOperator::CHANNELS)
    }

    fn residual(&self, x: &Array2<f64>) -> Result<Option<Residual>, SolverError> {
        let residual = self.equations.residual(self.targets, x)?;
        let weighted = self.equations.weighted(&residual);
        let (total, left) = (dots(self.targets, &weighted), dots(&residual, &weighted));
        let slopes = total.iter().zip(left).map(|(total, left)| total - left).collect();
        Ok(Some(Residual { values: residual, slopes }))
    }
}

/// Computes `A^T W A x + P x` by moments.
pub(crate) fn penalised_product(
    moments: &MomentOperator,
    penalty: Option<&[f64]>,
    x: &Array2<f64>,
) -> Result<Array2<f64>, SolverError> {
    let mut y = moments.apply(x.view())?;
    if let Some(penalty) = penalty {
        add_scaled_rows(&mut y, penalty, x);
    }
    Ok(y)
}
