//! Operations on dense matrices on the calling thread. They are used for matrices that are too small for several
//! threads, and by threads that each process their own matrices. [`threaded`](crate::threaded) processes large matrices
//! on several threads.
//!
//! Matrices are column-major slices, with one exception. The right-hand sides and solutions for a block of k basis
//! functions and c targets are arrays (k, c) in row-major order, so that each part of a block corresponds to a
//! contiguous slice.

use spharm_harmonics::product::Matrix;
use spharm_linalg::{Accum, Mat, MatMut, MatRef, NoConvergence, ThinSvd, matmul};

use crate::condition;

fn view(matrix: Matrix<'_>) -> MatRef<'_, f64> {
    let (rows, columns) = (matrix.rows(), matrix.columns());
    MatRef::from_column_major_slice_with_stride(matrix.values(), rows, columns, matrix.leading())
}

/// Computes the lower triangle of `gram += block^T block`: block (n, k), gram (k, k), column-major. Takes `n k (k + 1)`
/// flops.
pub(crate) fn accumulate_gram(block: Matrix<'_>, gram: &mut [f64]) {
    let k = block.columns();
    assert_eq!(gram.len(), k * k, "expected a Gram matrix of {k} x {k} values");
    let (block, gram) = (view(block), MatMut::from_column_major_slice_mut(gram, k, k));
    spharm_linalg::add_gram(gram, block.transpose(), 1.0);
}

/// Computes `out += block^T r`: block (n, k), r (n, c), out (k, c) row-major.
pub(crate) fn accumulate_adjoint(block: Matrix<'_>, r: Matrix<'_>, out: &mut [f64]) {
    let (k, c) = (block.columns(), r.columns());
    assert!(out.len() == k * c && r.rows() == block.rows(), "expected matching shapes for an adjoint of {k} x {c}");
    let out = MatMut::from_column_major_slice_mut(out, c, k);
    matmul(out, Accum::Add, view(r).transpose(), view(block), 1.0);
}

/// Computes `out += sign block x`: block (n, k), x (k, c) row-major, out (n, c) column-major.
pub(crate) fn accumulate_synthesis(block: Matrix<'_>, x: &[f64], sign: f64, out: &mut [f64]) {
    let (rows, k) = (block.rows(), block.columns());
    assert!(
        k > 0 && x.len().is_multiple_of(k) && out.len() == rows * (x.len() / k),
        "expected matching shapes for a synthesis with {rows} x {k}"
    );
    let c = x.len() / k;
    let out = MatMut::from_column_major_slice_mut(out, rows, c);
    matmul(out, Accum::Add, view(block), MatRef::from_row_major_slice(x, k, c), sign);
}

/// Computes the lower Cholesky factor, in place, of a matrix (k, k) given by its lower triangle; returns false if the
/// matrix isn't numerically positive definite.
pub(crate) fn cholesky(matrix: &mut [f64], k: usize) -> bool {
    assert_eq!(matrix.len(), k * k, "expected a matrix of {k} x {k} values");
    spharm_linalg::cholesky_in_place(MatMut::from_column_major_slice_mut(matrix, k, k)).is_ok()
}

/// Estimates the reciprocal condition number, in the 1-norm, of a matrix from the matrix's norm and its factor from
/// [`cholesky`]. Returns zero if the estimate isn't finite.
pub(crate) fn reciprocal_condition(norm: f64, factor: &[f64], k: usize) -> f64 {
    let inverse = condition::one_norm(k, &mut |x| {
        cholesky_solve(factor, k, x);
        Ok::<(), std::convert::Infallible>(())
    });
    let Ok(inverse) = inverse;
    let reciprocal = 1.0 / (norm * inverse);
    if reciprocal.is_finite() { reciprocal } else { 0.0 }
}

/// Returns the 1-norm of a symmetric matrix (k, k) given by its lower triangle.
pub(crate) fn symmetric_norm(matrix: &[f64], k: usize) -> f64 {
    let mut sums = vec![0.0; k];
    for (j, column) in matrix.chunks_exact(k).enumerate() {
        for (i, value) in column.iter().enumerate().skip(j) {
            sums[j] += value.abs();
            if i > j {
                sums[i] += value.abs();
            }
        }
    }
    // f64::max isn't used here, because it would ignore a NaN.
    sums.into_iter().fold(0.0, |m, s| if s > m || s.is_nan() { s } else { m })
}

/// Solves `C C^T x = b` with the factor C from [`cholesky`]: `x` (k, c), row-major, contains b on entry and the
/// solution on return.
pub(crate) fn cholesky_solve(factor: &[f64], k: usize, x: &mut [f64]) {
    assert!(
        factor.len() == k * k && x.len().is_multiple_of(k),
        "expected a factor of {k} x {k} values and right-hand sides of {k} rows"
    );
    let factor = MatRef::from_column_major_slice(factor, k, k);
    let c = x.len() / k;
    let mut x = MatMut::from_row_major_slice_mut(x, k, c);
    spharm_linalg::solve_lower(factor, x.as_mut());
    spharm_linalg::solve_upper(factor.transpose(), x);
}

/// Computes the triangular factor R of the QR factorisation of a matrix (rows, columns), column-major, in place. On
/// return, the matrix's first `min(rows, columns)` rows contain R, with zeros below the diagonal.
pub(crate) fn triangularise(matrix: &mut [f64], rows: usize, columns: usize) {
    assert_eq!(matrix.len(), rows * columns, "expected a matrix of {rows} x {columns} values");
    spharm_linalg::triangularise(MatMut::from_column_major_slice_mut(matrix, rows, columns));
}

/// The minimum-norm solution of a least-squares problem with k unknowns and c right-hand sides.
pub(crate) struct MinimumNorm {
    /// The solution, (k, c) row-major.
    pub(crate) x: Vec<f64>,
    /// Numerical rank of the problem's matrix.
    pub(crate) rank: usize,
    /// Ratio of the largest to the smallest singular value; infinite if the smallest is zero.
    pub(crate) condition: f64,
}

/// Solves `r x = z` in the minimum-norm least-squares sense: r (m, k), z (m, c), column-major. Singular values up to
/// `tolerance` times the largest are treated as zero.
pub(crate) fn minimum_norm(r: &[f64], z: &[f64], m: usize, tolerance: f64) -> Result<MinimumNorm, NoConvergence> {
    let (k, c) = (r.len() / m, z.len() / m);
    if !r.iter().all(|value| value.is_finite()) {
        return Err(NoConvergence);
    }
    let r = MatRef::from_column_major_slice(r, m, k);
    let z = MatRef::from_column_major_slice(z, m, c);
    let found = ThinSvd::new(r)?;
    let (u, singular, v) = (found.u(), found.singular(), found.v());
    let largest = singular.first().copied().unwrap_or(0.0);
    let smallest = singular.last().copied().unwrap_or(0.0);
    let rank = singular.iter().filter(|&&s| s > tolerance * largest).count();
    let mut projected = Mat::<f64>::zeros(rank, c);
    matmul(projected.as_mut(), Accum::Replace, u.subcols(0, rank).transpose(), z, 1.0);
    for column in projected.as_mut().col_iter_mut() {
        column.iter_mut().zip(&singular).for_each(|(value, singular)| *value /= singular);
    }
    let mut x = vec![0.0; k * c];
    let solution = MatMut::from_row_major_slice_mut(&mut x, k, c);
    matmul(solution, Accum::Replace, v.subcols(0, rank), projected.as_ref(), 1.0);
    let condition = if smallest > 0.0 { largest / smallest } else { f64::INFINITY };
    Ok(MinimumNorm { x, rank, condition })
}

/// Computes `out -= a y`: a (rows, k), y (k, c), out (rows, c), column-major.
pub(crate) fn subtract_product(a: Matrix<'_>, y: &[f64], out: &mut [f64]) {
    subtract(view(a), y, out);
}

/// Computes `out -= a^T x`: a (rows, k), x (rows, c), out (k, c), column-major.
pub(crate) fn subtract_adjoint_product(a: Matrix<'_>, x: &[f64], out: &mut [f64]) {
    subtract(view(a).transpose(), x, out);
}

fn subtract(a: MatRef<'_, f64>, y: &[f64], out: &mut [f64]) {
    let (rows, k) = a.shape();
    let c = y.len() / k;
    let out = MatMut::from_column_major_slice_mut(out, rows, c);
    matmul(out, Accum::Add, a, MatRef::from_column_major_slice(y, k, c), -1.0);
}

/// Computes `x = C^-1 x`: C (k, k) lower triangular, x (k, c) column-major.
pub(crate) fn solve_lower(c: Matrix<'_>, x: &mut [f64]) {
    let (k, columns) = (c.rows(), x.len() / c.rows());
    spharm_linalg::solve_lower(view(c), MatMut::from_column_major_slice_mut(x, k, columns));
}

/// Computes `x = C^-T x`: C (k, k) lower triangular, x (k, c) column-major.
pub(crate) fn solve_lower_transposed(c: Matrix<'_>, x: &mut [f64]) {
    let (k, columns) = (c.rows(), x.len() / c.rows());
    let x = MatMut::from_column_major_slice_mut(x, k, columns);
    spharm_linalg::solve_upper(view(c).transpose(), x);
}
