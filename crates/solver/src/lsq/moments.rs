//! Least-squares problems that are given only by sums over the samples: moments, right-hand sides and sums of squares.
//! The samples themselves aren't needed, so their number is unlimited and the sums may have been computed elsewhere.
//!
//! Moments determine `N = A^T W A + P` ([`MomentOperator`]), and `b = A^T W f` and `sum w f^2` are given. These data
//! determine the solution, and the weighted sum of squares of its residual:
//!
//! ```text
//! |W^(1/2) (f - A x)|^2 = sum w f^2 - x^T b - x^T (b - A^T W A x),
//! ```
//!
//! The data also suffice for cross-validation and, with the Gram matrix from the same moments, for factors and standard
//! errors. The residual at each sample is unknown. Rounding errors of moments are a few eps times `sum w`, and no pass
//! over the samples corrects these errors. If the condition number of A approaches 1e7, digits of the solution are
//! lost. The residual's sum of squares is a difference with an error of a few eps times `sum w f^2`. If the mean of f
//! is large, this error can exceed the difference; [`MomentProblem::lost`] detects this.

use std::f64::consts::PI;
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
/// The moments determine a residual's sum of squares if it is at least this fraction of the target's sum of squares,
/// `sum w f^2`. Measured errors are up to 6e-15 of `sum w f^2`, so the rms of such a residual is accurate to 1 %.
const LEAST_SQUARE: f64 = 1e-12;
/// A residual of any size is accepted if `sum w f^2` is at most this multiple of `sum w (f - mean)^2`, because the
/// error of the residual's rms is then below 1e-6 of the standard deviation of f.
const LARGEST_RATIO: f64 = 100.0;

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
    /// [`SolverError::MomentsDegree`] for a higher degree, [`SolverError::SumsNotFinite`] for sums that contain a NaN
    /// or an infinity, [`SolverError::Sums`] for arrays of the wrong size, [`SolverError::NoSamples`] for sums over no
    /// samples, and the errors of [`MomentOperator::new`].
    pub fn new(sums: &SampleSums, max_degree: usize) -> Result<Self, SolverError> {
        if max_degree > sums.max_degree {
            return Err(SolverError::MomentsDegree { found: max_degree, max_degree: sums.max_degree });
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

    /// Returns the problem with the same moments, and with the values `A x` of known coefficients x (K, c) as targets.
    #[cfg(feature = "dense")]
    pub(crate) fn of_known(&self, x: &Array2<f64>) -> Result<Self, SolverError> {
        let right_sides = self.operator().apply(x.view())?;
        let squares = dots(x, &right_sides);
        Ok(Self { right_sides, squares, normal: self.normal.clone(), weight: self.weight, rows: self.rows })
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

    /// Returns the Gram matrix `A^T W A`, computed from this problem's moments.
    ///
    /// # Errors
    ///
    /// The errors of [`MomentGram::new`].
    pub fn gram(&self) -> Result<MomentGram, SolverError> {
        Ok(MomentGram::new(self.max_degree(), self.normal.moments())?)
    }

    /// Computes `sum w (f - A x)^2` of each column, at least zero, for coefficients x (K, c).
    ///
    /// The result is a difference of sums, whose error is a few eps times `sum w f^2`: see [`lost`](Self::lost).
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

    /// Returns for each column whether rounding errors hide its residual, because the column's mean is much larger than
    /// its deviation from the mean. `residual_squares` (c) contains the residuals' sums of squares.
    pub fn lost(&self, residual_squares: &[f64]) -> Vec<bool> {
        let columns = residual_squares.iter().zip(&self.squares).zip(self.centred_squares());
        columns.map(|((&left, &all), centred)| is_lost(left, all, centred)).collect()
    }

    /// Returns the column with the largest values if rounding errors hide the residual of all columns together. `left`
    /// is the sum of that residual's squares.
    pub(super) fn lost_together(&self, left: f64) -> Option<usize> {
        let lost = is_lost(left, self.squares.iter().sum(), self.centred_squares().iter().sum());
        let largest = self.squares.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1));
        largest.filter(|_| lost).map(|(column, _)| column)
    }

    /// Returns the problem whose targets are the values minus the weighted mean of their column.
    pub(super) fn centred(&self) -> Self {
        let mut right_sides = self.right_sides.clone();
        for (mut column, mean) in right_sides.columns_mut().into_iter().zip(self.means()) {
            // The constant function 1 has the moments to degree L as its right-hand side, so subtract the mean times
            // the moments.
            column.iter_mut().zip(self.normal.moments()).for_each(|(sum, moment)| *sum -= mean * moment);
        }
        Self { right_sides, squares: self.centred_squares(), normal: self.normal.clone(), ..*self }
    }

    /// Returns the weighted means (c) of the columns: `sum w f` is `sqrt(4 pi)` times the right-hand side of degree 0.
    fn means(&self) -> Vec<f64> {
        self.right_sides.row(0).iter().map(|sum| (4.0 * PI).sqrt() * sum / self.weight).collect()
    }

    /// Returns `sum w (f - mean)^2` of each column, at least zero.
    fn centred_squares(&self) -> Vec<f64> {
        let columns = self.squares.iter().zip(self.means());
        columns.map(|(square, mean)| (square - mean * mean * self.weight).max(0.0)).collect()
    }
}

/// Returns whether rounding errors hide a residual with the sum of squares `left`. `all` is `sum w f^2`, and `centred`
/// is `sum w (f - mean)^2`.
fn is_lost(left: f64, all: f64, centred: f64) -> bool {
    left < LEAST_SQUARE * all && all > LARGEST_RATIO * centred
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
