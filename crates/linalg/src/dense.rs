//! Dense matrices: products, Cholesky and QR factors, eigenvalues and singular values.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{LltError, cholesky_in_place as factor, cholesky_in_place_scratch};
use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::linalg::qr::no_pivoting::factor::{qr_in_place, qr_in_place_scratch, recommended_block_size};
use faer::linalg::solvers::{DenseSolveCore, Llt, SelfAdjointEigen, Solve, Svd};
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::{Accum, Mat, MatMut, MatRef, Par, Side};

use crate::NotPositiveDefinite;

impl From<LltError> for NotPositiveDefinite {
    fn from(LltError::NonPositivePivot { index }: LltError) -> Self {
        Self { column: index }
    }
}

/// Computes `out = scale a b`, or `out += scale a b` with [`Accum::Add`]: a (m, k), b (k, n), out (m, n).
///
/// # Panics
///
/// If the shapes don't match.
pub fn matmul(out: MatMut<'_, f64>, accumulate: Accum, a: MatRef<'_, f64>, b: MatRef<'_, f64>, scale: f64) {
    faer::linalg::matmul::matmul(out, accumulate, a, b, scale, Par::Seq);
}

/// Computes the lower triangle of `out += scale a a^T`: a (k, n), out (k, k). Takes `n k (k + 1)` flops.
///
/// # Panics
///
/// If the shapes don't match.
pub fn add_gram(out: MatMut<'_, f64>, a: MatRef<'_, f64>, scale: f64) {
    let (lower, whole) = (BlockStructure::TriangularLower, BlockStructure::Rectangular);
    triangular::matmul(out, lower, Accum::Add, a, whole, a.transpose(), whole, scale, Par::Seq);
}

/// Computes the lower Cholesky factor, in place, of a matrix (k, k) given by its lower triangle. Entries above the
/// diagonal are unspecified afterwards. Takes `k^3 / 3` flops.
///
/// # Errors
///
/// [`NotPositiveDefinite`]. A NaN isn't always detected.
pub fn cholesky_in_place(matrix: MatMut<'_, f64>) -> Result<(), NotPositiveDefinite> {
    let mut scratch = MemBuffer::new(cholesky_in_place_scratch::<f64>(matrix.nrows(), Par::Seq, Default::default()));
    let stack = MemStack::new(&mut scratch);
    factor(matrix, Default::default(), Par::Seq, stack, Default::default())?;
    Ok(())
}

/// Computes `x = a^-1 x` with the lower triangle of a: a (k, k), x (k, c).
///
/// # Panics
///
/// If the shapes don't match.
pub fn solve_lower(a: MatRef<'_, f64>, x: MatMut<'_, f64>) {
    solve_lower_triangular_in_place(a, x, Par::Seq);
}

/// Computes `x = a^-1 x` with the upper triangle of a: a (k, k), x (k, c).
///
/// # Panics
///
/// If the shapes don't match.
pub fn solve_upper(a: MatRef<'_, f64>, x: MatMut<'_, f64>) {
    solve_upper_triangular_in_place(a, x, Par::Seq);
}

/// Computes the triangular factor R of a QR factorisation, in place. What is below the diagonal are reflectors
/// afterwards.
pub fn triangularise(matrix: MatMut<'_, f64>) {
    let (rows, columns) = matrix.shape();
    let block = recommended_block_size::<f64>(rows, columns);
    let mut reflectors = Mat::zeros(block, rows.min(columns));
    let requirement = qr_in_place_scratch::<f64>(rows, columns, block, Par::Seq, Default::default());
    let mut scratch = MemBuffer::new(requirement);
    qr_in_place(matrix, reflectors.as_mut(), Par::Seq, MemStack::new(&mut scratch), Default::default());
}

/// The Cholesky factor of a dense symmetric matrix.
#[derive(Debug)]
pub struct Cholesky(Llt<f64>);

impl Cholesky {
    /// Factors a symmetric matrix, (k, k), given by its lower triangle.
    ///
    /// # Errors
    ///
    /// [`NotPositiveDefinite`].
    pub fn new(matrix: MatRef<'_, f64>) -> Result<Self, NotPositiveDefinite> {
        Ok(Self(Llt::new(matrix, Side::Lower)?))
    }

    /// Returns the natural logarithm of the matrix's determinant.
    pub fn log_determinant(&self) -> f64 {
        let lower = self.0.L();
        (0..lower.nrows()).map(|k| 2.0 * lower[(k, k)].ln()).sum()
    }

    /// Returns the solution for right-hand sides, (k, c).
    pub fn solve(&self, right: MatRef<'_, f64>) -> Mat<f64> {
        self.0.solve(right)
    }

    /// Returns the inverse of the matrix, (k, k), which is symmetric up to rounding.
    pub fn inverse(&self) -> Mat<f64> {
        self.0.inverse()
    }
}

/// Error of a decomposition whose iteration didn't converge, as with NaN.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NoConvergence;

impl std::fmt::Display for NoConvergence {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("the decomposition of a matrix didn't converge")
    }
}

impl std::error::Error for NoConvergence {}

/// The thin singular value decomposition `a = u diag(s) v^T`: a (m, n), with `k = min(m, n)`.
#[derive(Debug)]
pub struct ThinSvd(Svd<f64>);

impl ThinSvd {
    /// Decomposes a matrix.
    ///
    /// # Errors
    ///
    /// [`NoConvergence`].
    pub fn new(matrix: MatRef<'_, f64>) -> Result<Self, NoConvergence> {
        matrix.thin_svd().map(Self).map_err(|_| NoConvergence)
    }

    /// Returns the left singular vectors, (m, k).
    pub fn u(&self) -> MatRef<'_, f64> {
        self.0.U()
    }

    /// Returns the singular values in decreasing order, k.
    pub fn singular(&self) -> Vec<f64> {
        self.0.S().column_vector().iter().copied().collect()
    }

    /// Returns the right singular vectors, (n, k).
    pub fn v(&self) -> MatRef<'_, f64> {
        self.0.V()
    }
}

/// The eigenvalues and eigenvectors of a symmetric matrix.
#[derive(Debug)]
pub struct SymmetricEigen(SelfAdjointEigen<f64>);

impl SymmetricEigen {
    /// Decomposes a symmetric matrix, (k, k), given by its lower triangle.
    ///
    /// # Errors
    ///
    /// [`NoConvergence`].
    pub fn new(matrix: MatRef<'_, f64>) -> Result<Self, NoConvergence> {
        matrix.self_adjoint_eigen(Side::Lower).map(Self).map_err(|_| NoConvergence)
    }

    /// Returns the eigenvalues in ascending order, k.
    pub fn values(&self) -> Vec<f64> {
        self.0.S().column_vector().iter().copied().collect()
    }

    /// Returns the eigenvectors as columns, in the order of the eigenvalues, (k, k).
    pub fn vectors(&self) -> MatRef<'_, f64> {
        self.0.U()
    }
}
