//! Dense matrices: products, Cholesky factors, eigenvalues and singular values.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{LltError, cholesky_in_place as factor, cholesky_in_place_scratch};
use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::linalg::solvers::{DenseSolveCore, Llt, SelfAdjointEigen, Solve, Svd};
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::{Accum, Mat, MatMut, MatRef, Par, Side};

use crate::NotPositiveDefinite;

impl From<LltError> for NotPositiveDefinite {
    fn from(LltError::NonPositivePivot { index }: LltError) -> Self {
        Self { column: index }
    }
}

/// Computes `out = scale a b`, or `out += scale a b` with [`Accum::Add`], for matrices `a` (m, k), `b` (k, n) and `out`
/// (m, n).
///
/// # Panics
///
/// Panics if the shapes don't match.
pub fn matmul(out: MatMut<'_, f64>, accumulate: Accum, a: MatRef<'_, f64>, b: MatRef<'_, f64>, scale: f64) {
    faer::linalg::matmul::matmul(out, accumulate, a, b, scale, Par::Seq);
}

/// Computes the lower triangle of `out += scale a a^T` for matrices `a` (k, n) and `out` (k, k). Takes `n k (k + 1)`
/// flops.
///
/// # Panics
///
/// Panics if the shapes don't match.
pub fn add_gram(out: MatMut<'_, f64>, a: MatRef<'_, f64>, scale: f64) {
    let (lower, whole) = (BlockStructure::TriangularLower, BlockStructure::Rectangular);
    triangular::matmul(out, lower, Accum::Add, a, whole, a.transpose(), whole, scale, Par::Seq);
}

/// Replaces the lower triangle of a symmetric matrix (k, k) by the matrix's lower Cholesky factor. Entries above the
/// diagonal are unspecified afterwards. Takes `k^3 / 3` flops.
///
/// # Errors
///
/// [`NotPositiveDefinite`] if the matrix isn't numerically positive definite. A NaN isn't always detected.
pub fn cholesky_in_place(matrix: MatMut<'_, f64>) -> Result<(), NotPositiveDefinite> {
    let mut scratch = MemBuffer::new(cholesky_in_place_scratch::<f64>(matrix.nrows(), Par::Seq, Default::default()));
    let stack = MemStack::new(&mut scratch);
    factor(matrix, Default::default(), Par::Seq, stack, Default::default())?;
    Ok(())
}

/// Replaces the matrix `x` (k, c) by `a^-1 x`, where `a` (k, k) is lower triangular. Entries above the diagonal of `a`
/// aren't read.
///
/// # Panics
///
/// Panics if the shapes don't match.
pub fn solve_lower(a: MatRef<'_, f64>, x: MatMut<'_, f64>) {
    solve_lower_triangular_in_place(a, x, Par::Seq);
}

/// Replaces the matrix `x` (k, c) by `a^-1 x`, where `a` (k, k) is upper triangular. Entries below the diagonal of `a`
/// aren't read.
///
/// # Panics
///
/// Panics if the shapes don't match.
pub fn solve_upper(a: MatRef<'_, f64>, x: MatMut<'_, f64>) {
    solve_upper_triangular_in_place(a, x, Par::Seq);
}

/// The Cholesky factor of a dense symmetric matrix.
#[derive(Debug)]
pub struct Cholesky(Llt<f64>);

impl Cholesky {
    /// Factors a symmetric matrix (k, k) given by its lower triangle.
    ///
    /// # Errors
    ///
    /// [`NotPositiveDefinite`] if the matrix isn't numerically positive definite.
    pub fn new(matrix: MatRef<'_, f64>) -> Result<Self, NotPositiveDefinite> {
        Ok(Self(Llt::new(matrix, Side::Lower)?))
    }

    /// Returns the natural logarithm of the matrix's determinant.
    pub fn log_determinant(&self) -> f64 {
        let lower = self.0.L();
        (0..lower.nrows()).map(|k| 2.0 * lower[(k, k)].ln()).sum()
    }

    /// Returns the solutions (k, c) for the right-hand sides `right` (k, c).
    pub fn solve(&self, right: MatRef<'_, f64>) -> Mat<f64> {
        self.0.solve(right)
    }

    /// Returns the inverse (k, k) of the matrix, which is symmetric up to rounding.
    pub fn inverse(&self) -> Mat<f64> {
        self.0.inverse()
    }
}

/// Error returned if the iteration of a decomposition doesn't converge, for example because of a NaN.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NoConvergence;

impl std::fmt::Display for NoConvergence {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("the decomposition of a matrix didn't converge")
    }
}

impl std::error::Error for NoConvergence {}

/// The thin singular value decomposition `a = u diag(s) v^T` of a matrix a (m, n), with `k = min(m, n)` singular
/// values.
#[derive(Debug)]
pub struct ThinSvd(Svd<f64>);

impl ThinSvd {
    /// Decomposes a matrix (m, n).
    ///
    /// # Errors
    ///
    /// [`NoConvergence`] if the iteration doesn't converge, for example because of a NaN.
    pub fn new(matrix: MatRef<'_, f64>) -> Result<Self, NoConvergence> {
        matrix.thin_svd().map(Self).map_err(|_| NoConvergence)
    }

    /// Returns the left singular vectors (m, k) as columns.
    pub fn u(&self) -> MatRef<'_, f64> {
        self.0.U()
    }

    /// Returns the k singular values in decreasing order.
    pub fn singular(&self) -> Vec<f64> {
        self.0.S().column_vector().iter().copied().collect()
    }

    /// Returns the right singular vectors (n, k) as columns.
    pub fn v(&self) -> MatRef<'_, f64> {
        self.0.V()
    }
}

/// The eigenvalues and eigenvectors of a symmetric matrix.
#[derive(Debug)]
pub struct SymmetricEigen(SelfAdjointEigen<f64>);

impl SymmetricEigen {
    /// Decomposes a symmetric matrix (k, k) given by its lower triangle.
    ///
    /// # Errors
    ///
    /// [`NoConvergence`] if the iteration doesn't converge, for example because of a NaN.
    pub fn new(matrix: MatRef<'_, f64>) -> Result<Self, NoConvergence> {
        matrix.self_adjoint_eigen(Side::Lower).map(Self).map_err(|_| NoConvergence)
    }

    /// Returns the k eigenvalues in ascending order.
    pub fn values(&self) -> Vec<f64> {
        self.0.S().column_vector().iter().copied().collect()
    }

    /// Returns the eigenvectors (k, k) as columns, in the order of the eigenvalues.
    pub fn vectors(&self) -> MatRef<'_, f64> {
        self.0.U()
    }
}
