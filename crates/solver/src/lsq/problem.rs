//! A least-squares problem as iterations and refinements use it, from samples or from moments.

use std::sync::Arc;

use ndarray::Array2;
use spharm_transform::MomentOperator;

use super::columns::{add_scaled_rows, dots};
use super::normal_equations::NormalEquations;
use crate::{MomentNormal, SolverError};

/// Products with the normal matrix, and the gradient that they are held against in the end.
pub(crate) trait Problem: Sync {
    /// `A^T W f`, (K, c).
    fn right_sides(&self) -> Result<Array2<f64>, SolverError>;

    /// `N x`, for iterations.
    fn product(&self, x: &Array2<f64>) -> Result<Array2<f64>, SolverError>;

    /// `A^T W (f - A x) - P x` as exactly as it can be had, and the residual `f - A x`, (n, c), where there are
    /// samples.
    fn gradient(&self, x: &Array2<f64>) -> Result<(Array2<f64>, Option<Array2<f64>>), SolverError>;

    /// How far products are from the samples' own, or from exact ones where there are no samples; `None` where that
    /// isn't known.
    fn product_error(&self) -> Option<ProductError> {
        None
    }

    /// Columns that products take together, where they take those of more after each other; `None` where they don't.
    fn columns_together(&self) -> Option<usize> {
        None
    }

    /// The residual alone, at half the cost of the gradient; `None` where there are no samples.
    fn residual(&self, _x: &Array2<f64>) -> Result<Option<Residual>, SolverError> {
        Ok(None)
    }
}

/// A bound on the errors of products.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ProductError {
    /// Relative to the norm of N.
    pub(crate) relative: f64,
    /// A bound on the norm of N.
    pub(crate) norm: f64,
}

/// A residual r.
pub(crate) struct Residual {
    /// `f - A x`, (n, c).
    pub(crate) values: Array2<f64>,
    /// `(A x)^T W r` of each column.
    pub(crate) slopes: Vec<f64>,
}

/// A problem whose samples are at hand. Products are by moments where there are some.
#[derive(Clone, Copy)]
pub(crate) struct Sampled<'a> {
    pub(crate) equations: NormalEquations<'a>,
    /// f, (n, c).
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
        // A penalty is no part of what the residual's slope shows.
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

/// `A^T W A x + P x` by moments.
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
