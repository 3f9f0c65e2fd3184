//! A least-squares problem as iterations and refinements use it, from samples or from moments.

use ndarray::Array2;
use spharm_transform::MomentOperator;

use super::columns::add_scaled_rows;
use super::normal_equations::NormalEquations;
use crate::SolverError;

/// Products with the normal matrix, and the gradient that they are held against in the end.
pub(crate) trait Problem: Sync {
    /// `A^T W f`, (K, c).
    fn right_sides(&self) -> Result<Array2<f64>, SolverError>;

    /// `N x`, for iterations.
    fn product(&self, x: &Array2<f64>) -> Result<Array2<f64>, SolverError>;

    /// `A^T W (f - A x) - P x` as exactly as it can be had, and the residual `f - A x`, (n, c), where there are samples.
    fn gradient(&self, x: &Array2<f64>) -> Result<(Array2<f64>, Option<Array2<f64>>), SolverError>;
}

/// A problem whose samples are at hand. Products are by moments where there are some.
#[derive(Clone, Copy)]
pub(crate) struct Sampled<'a> {
    pub(crate) equations: NormalEquations<'a>,
    /// f, (n, c).
    pub(crate) targets: &'a Array2<f64>,
    pub(crate) moments: Option<&'a MomentOperator>,
}

impl Problem for Sampled<'_> {
    fn right_sides(&self) -> Result<Array2<f64>, SolverError> {
        self.equations.adjoint(self.targets)
    }

    fn product(&self, x: &Array2<f64>) -> Result<Array2<f64>, SolverError> {
        match self.moments {
            Some(moments) => penalised_product(moments, self.equations.penalty, x),
            None => self.equations.apply(x),
        }
    }

    fn gradient(&self, x: &Array2<f64>) -> Result<(Array2<f64>, Option<Array2<f64>>), SolverError> {
        let (gradient, residual) = self.equations.gradient(self.targets, x)?;
        Ok((gradient, Some(residual)))
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
