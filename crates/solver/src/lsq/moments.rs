//! Least squares from sums over the samples alone, for any number of samples. The sums may have been computed
//! elsewhere.
//!
//! Moments determine `N = A^T W A + P` ([`MomentOperator`]), and `b = A^T W f` and `sum w f^2` are given. These data
//! determine the solution, the weighted sum of squares of its residual,
//!
//! ```text
//! |W^(1/2) (f - A x)|^2 = sum w f^2 - x^T b - x^T (b - A^T W A x),
//! ```
//!
//! cross-validation, and, with the Gram matrix from the same moments, factors and standard errors. The residual at each
//! sample is unknown. Rounding errors of moments are a few eps times `sum w`, and no pass over the samples corrects
//! them: if the condition number of A approaches 1e7, digits of the solution are lost.

use std::ops::Range;
use std::sync::Arc;

use ndarray::Array2;
use spharm_harmonics::basis_size;
use spharm_transform::{MomentGram, MomentOperator, SampleSums};

use super::columns::dots;
use super::problem::{Problem, ProductError, penalised_product};
use crate::{MomentNormal, SolverError};

/// Estimated rounding error of products with a [`MomentOperator`], relative to its norm. Measured errors are 9e-15 at
/// degree 100 and 2e-14 at degree 500.
const PRODUCT_ERROR: f64 = 1e-13;

/// A least-squares problem up to degree L, given by its moments.
#[derive(Debug, Clone)]
pub struct MomentProblem {
    normal: Arc<MomentNormal>,
    right_sides: Array2<f64>,
    squares: Vec<f64>,
    weight: f64,
    rows: usize,
}

impl MomentProblem {
    /// Creates the problem up to degree L = `max_degree`, at most the degree of the sums.
    ///
    /// # Errors
    ///
    /// [`SolverError::Degree`] for a higher degree, [`SolverError::SumsNotFinite`] for sums that contain a NaN or an
    /// infinity, [`SolverError::Sums`] for arrays of the wrong size, [`SolverError::NoSamples`] for sums over no
    /// samples, and the errors of [`MomentOperator::new`].
    pub fn new(sums: &SampleSums, max_degree: usize) -> Result<Self, SolverError> {
        if max_degree > sums.max_degree {
            return Err(SolverError::Degree { found: max_degree, max_degree: sums.max_degree });
        }
        if sums.count == 0 || sums.weight <= 0.0 {
            return Err(SolverError::NoSamples { count: sums.count, weight: sums.weight });
        }
        let mut values = sums.right_sides.iter().chain(&sums.squares).chain([&sums.weight]);
        if !values.all(|value| value.is_finite()) {
            return Err(SolverError::SumsNotFinite);
        }
        for (what, expected, found) in [
            ("the right-hand sides", basis_size(sums.max_degree), sums.right_sides.nrows()),
            ("the list of squares", sums.right_sides.ncols(), sums.squares.len()),
        ] {
            if expected != found {
                return Err(SolverError::Sums { what, expected, found });
            }
        }
        let right_sides = sums.right_sides.slice(ndarray::s![..basis_size(max_degree), ..]).to_owned();
        let moments = &sums.moments[..sums.moments.len().min(basis_size(2 * max_degree))];
        let normal = Arc::new(MomentNormal::new(max_degree, moments.to_vec())?);
        let rows = usize::try_from(sums.count).unwrap_or(usize::MAX);
        Ok(Self { normal, right_sides, squares: sums.squares.clone(), weight: sums.weight, rows })
    }

    /// Returns the highest degree, L.
    pub fn max_degree(&self) -> usize {
        self.operator().max_degree()
    }

    /// Returns the number of columns of the targets, c.
    pub fn channels(&self) -> usize {
        self.right_sides.ncols()
    }

    /// Returns the problem for a range of the columns, with the same moments.
    #[must_use]
    pub fn of_columns(&self, columns: Range<usize>) -> Self {
        let right_sides = self.right_sides.slice(ndarray::s![.., columns.clone()]).to_owned();
        Self {
            right_sides,
            squares: self.squares[columns].to_vec(),
            normal: self.normal.clone(),
            weight: self.weight,
            rows: self.rows,
        }
    }

    /// Returns the number of samples with nonzero weight, n.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Returns the sum of the weights.
    pub fn weight(&self) -> f64 {
        self.weight
    }

    /// Returns the normal operator without a penalty.
    pub fn operator(&self) -> &MomentOperator {
        self.normal.operator()
    }

    /// Returns the normal matrix without a penalty.
    #[cfg(feature = "dense")]
    pub(crate) fn normal(&self) -> &MomentNormal {
        &self.normal
    }

    /// Returns the Gram matrix `A^T W A`, from the same moments.
    ///
    /// # Errors
    ///
    /// The errors of [`MomentGram::new`].
    pub fn gram(&self) -> Result<MomentGram, SolverError> {
        Ok(MomentGram::new(self.max_degree(), self.normal.moments())?)
    }

    /// Computes `sum w (f - A x)^2` of each column, at least zero, for coefficients x (K, c).
    ///
    /// The result is a difference of sums, whose error is a few eps times `sum w f^2`.
    ///
    /// # Errors
    ///
    /// The errors of [`MomentOperator::apply`].
    pub fn residual_squares(&self, x: &Array2<f64>) -> Result<Vec<f64>, SolverError> {
        let rest = &self.right_sides - &self.operator().apply(x.view())?;
        let (explained, left) = (dots(x, &self.right_sides), dots(x, &rest));
        let squares = self.squares.iter().zip(explained).zip(left);
        Ok(squares.map(|((square, explained), left)| (square - explained - left).max(0.0)).collect())
    }
}

/// A problem given by its moments, with a penalty.
pub(crate) struct Summed<'a> {
    pub(crate) problem: &'a MomentProblem,
    /// Diagonal (K) of the penalty P.
    pub(crate) penalty: Option<&'a [f64]>,
}

impl Problem for Summed<'_> {
    fn right_sides(&self) -> Result<Array2<f64>, SolverError> {
        Ok(self.problem.right_sides.clone())
    }

    fn product(&self, x: &Array2<f64>) -> Result<Array2<f64>, SolverError> {
        penalised_product(self.problem.operator(), self.penalty, x)
    }

    fn gradient(&self, x: &Array2<f64>) -> Result<(Array2<f64>, Option<Array2<f64>>), SolverError> {
        Ok((&self.problem.right_sides - &self.product(x)?, None))
    }

    fn columns_together(&self) -> Option<usize> {
        Some(MomentOperator::CHANNELS)
    }

    fn product_error(&self) -> Option<ProductError> {
        let norm = self.problem.operator().norm();
        self.penalty.is_none().then_some(ProductError { relative: PRODUCT_ERROR, norm })
    }
}
