//! The arithmetic of a factorisation: in double precision by OpenBLAS, in single precision, at twice the rate, by faer.
//!
//! Of the latter products and divisions run for a range of rows on each thread of the rayon pool that the call is in.
//! The triangle on a panel's diagonal is widened for OpenBLAS, whose own routines in single precision aren't linked.
//!
//! Matrices are column-major slices with a leading dimension.

use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Accum, MatMut, MatRef, Par};
use spharm_harmonics::product::Matrix;

use crate::blas::Blas;
use crate::cholesky::kernels::Real;

/// Fewer rows are no work for several threads.
const ROWS: usize = 256;

/// A matrix (rows, columns) without gaps between its columns.
#[derive(Clone, Copy)]
pub(crate) struct Block<'a, S> {
    values: &'a [S],
    rows: usize,
    columns: usize,
}

impl<'a, S> Block<'a, S> {
    /// Takes the first `rows * columns` values.
    ///
    /// # Panics
    ///
    /// If there are fewer.
    pub(crate) fn new(values: &'a [S], rows: usize, columns: usize) -> Self {
        Self { values: &values[..rows * columns], rows, columns }
    }
}

impl<'a> From<Block<'a, f64>> for Matrix<'a> {
    fn from(block: Block<'a, f64>) -> Self {
        Self::new(block.values, block.rows, block.columns, block.rows)
    }
}

impl<'a> From<Block<'a, f32>> for MatRef<'a, f32> {
    fn from(block: Block<'a, f32>) -> Self {
        Self::from_column_major_slice(block.values, block.rows, block.columns)
    }
}

/// What a factorisation does with its values.
pub(crate) trait Arithmetic: Real + Default {
    /// Bytes that a panel of so many rows and columns takes in double precision beside its own.
    fn wide_bytes(rows: usize, columns: usize) -> usize;
    /// Rounds a panel: into `own`, where it isn't the panel itself.
    fn rounded<'a>(wide: &'a mut [f64], own: &'a mut Vec<Self>) -> &'a mut [Self];
    /// Computes `out -= a b^T`: a (rows, k), b (columns, k), out (rows, columns) with `leading`.
    fn subtract_outer(a: Block<'_, Self>, b: Block<'_, Self>, out: &mut [Self], leading: usize, threads: usize);
    /// Computes the lower Cholesky factor, in place, of a matrix (k, k) with `leading`, given by its lower triangle.
    /// Fails with the column, from 0, at which the matrix isn't positive definite.
    fn cholesky(matrix: &mut [Self], k: usize, leading: usize, threads: usize) -> Result<(), usize>;
    /// Computes `out = out c^-T`: c (k, k) lower triangular, out (rows, k) with `leading`.
    fn divide_by_transpose(c: Block<'_, Self>, out: &mut [Self], rows: usize, leading: usize, threads: usize);
}

impl Arithmetic for f64 {
    fn wide_bytes(_rows: usize, _columns: usize) -> usize {
        0
    }

    fn rounded<'a>(wide: &'a mut [f64], _own: &'a mut Vec<f64>) -> &'a mut [f64] {
        wide
    }

    fn subtract_outer(a: Block<'_, f64>, b: Block<'_, f64>, out: &mut [f64], leading: usize, threads: usize) {
        Blas::with_threads(threads).subtract_outer(a.into(), b.into(), out, leading);
    }

    fn cholesky(matrix: &mut [f64], k: usize, leading: usize, threads: usize) -> Result<(), usize> {
        Blas::with_threads(threads).cholesky(matrix, k, leading)
    }

    fn divide_by_transpose(c: Block<'_, f64>, out: &mut [f64], rows: usize, leading: usize, threads: usize) {
        Blas::with_threads(threads).divide_by_transpose(c.into(), out, rows, leading);
    }
}

impl Arithmetic for f32 {
    fn wide_bytes(rows: usize, columns: usize) -> usize {
        8 * (rows * columns + columns * columns)
    }

    fn rounded<'a>(wide: &'a mut [f64], own: &'a mut Vec<f32>) -> &'a mut [f32] {
        own.clear();
        own.extend(wide.iter().map(|&value| value as f32));
        own
    }

    fn subtract_outer(a: Block<'_, f32>, b: Block<'_, f32>, out: &mut [f32], leading: usize, threads: usize) {
        let out = MatMut::from_column_major_slice_with_stride_mut(out, a.rows, b.rows, leading);
        subtract_outer(a.into(), b.into(), out, threads);
    }

    fn cholesky(matrix: &mut [f32], k: usize, leading: usize, threads: usize) -> Result<(), usize> {
        let mut wide: Vec<f64> = Vec::with_capacity(k * k);
        for column in matrix.chunks(leading).take(k) {
            wide.extend(column[..k].iter().map(|&value| f64::from(value)));
        }
        Blas::with_threads(threads).cholesky(&mut wide, k, k)?;
        for (wide, column) in wide.chunks_exact(k).zip(matrix.chunks_mut(leading)) {
            column.iter_mut().zip(wide).for_each(|(value, wide)| *value = *wide as f32);
        }
        Ok(())
    }

    fn divide_by_transpose(c: Block<'_, f32>, out: &mut [f32], rows: usize, leading: usize, threads: usize) {
        let out = MatMut::from_column_major_slice_with_stride_mut(out, rows, c.columns, leading);
        divide_by_transpose(c.into(), out, threads);
    }
}

fn subtract_outer(a: MatRef<'_, f32>, b: MatRef<'_, f32>, out: MatMut<'_, f32>, threads: usize) {
    if threads < 2 || a.nrows() < ROWS {
        return matmul(out, Accum::Add, a, b.transpose(), -1.0, Par::Seq);
    }
    let first = share(a.nrows(), threads);
    let ((over, under), (upper, lower)) = (a.split_at_row(first), out.split_at_row_mut(first));
    rayon::join(
        || subtract_outer(over, b, upper, threads / 2),
        || subtract_outer(under, b, lower, threads - threads / 2),
    );
}

fn divide_by_transpose(c: MatRef<'_, f32>, out: MatMut<'_, f32>, threads: usize) {
    if threads < 2 || out.nrows() < ROWS {
        return solve_lower_triangular_in_place(c, out.transpose_mut(), Par::Seq);
    }
    let first = share(out.nrows(), threads);
    let (upper, lower) = out.split_at_row_mut(first);
    rayon::join(|| divide_by_transpose(c, upper, threads / 2), || divide_by_transpose(c, lower, threads - threads / 2));
}

/// The rows of the first half of the threads: whole tiles of products.
fn share(rows: usize, threads: usize) -> usize {
    (rows * (threads / 2) / threads).next_multiple_of(48).min(rows)
}
