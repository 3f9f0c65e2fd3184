//! Implements the threaded operations with faer: large matrices are halved repeatedly into tiles, which rayon's threads
//! process.
//!
//! The halving of a matrix depends only on its size, so results don't depend on the number of threads. faer's own
//! parallelism isn't used, because it is a compile-time feature of the entire program. It would also parallelise the
//! sequential calls of faer in other crates.

use spharm_harmonics::product::Matrix;
use spharm_linalg::{Accum, MatMut, MatRef, NotPositiveDefinite, add_gram, cholesky_in_place, matmul, solve_lower};

use super::{ThreadedKernels, assert_extent};

/// Largest number of rows and columns of a tile. Products of larger tiles aren't faster. With smaller tiles, the
/// factors of products are copied into packed form more often.
const TILE: usize = 512;
/// Largest order of a matrix that is factorised by one thread.
const FACTOR: usize = 256;
/// Largest number of rows for which one thread solves with a triangular factor. More rows are split between threads.
const DIVIDED_ROWS: usize = 256;

/// Runs faer on the threads of the caller's rayon pool.
#[derive(Debug)]
pub struct Faer {
    parallel: bool,
}

impl ThreadedKernels for Faer {
    const RESERVED_PER_THREAD: usize = 0;
    /// Bytes that a thread needs for copies of the factors of a product. They suffice for the two tiles of a product in
    /// `cholesky/factorise.rs`, and for a tile of a Gram matrix that is summed over 2,048 rows of the basis.
    const TOUCHED_PER_THREAD: usize = 20 << 20;

    fn version() -> String {
        "faer 0.24".to_owned()
    }

    fn with_threads(threads: usize) -> Self {
        Self { parallel: threads > 1 }
    }

    fn accumulate_gram(&mut self, block: Matrix<'_>, gram: &mut [f64], leading: usize) {
        let k = block.columns();
        let block = view(block);
        self.add_gram(block.transpose(), view_mut(gram, k, k, leading), 1.0);
    }

    fn cholesky(&mut self, matrix: &mut [f64], k: usize, leading: usize) -> Result<(), usize> {
        self.factorise(view_mut(matrix, k, k, leading))
    }

    fn divide_by_transpose(&mut self, c: Matrix<'_>, out: &mut [f64], rows: usize, leading: usize) {
        assert_eq!(c.rows(), c.columns(), "the triangle must be square");
        self.divide(view(c), view_mut(out, rows, c.columns(), leading));
    }

    fn subtract_outer(&mut self, a: Matrix<'_>, b: Matrix<'_>, out: &mut [f64], leading: usize) {
        assert_eq!(a.columns(), b.columns(), "both factors must have the same number of columns");
        self.subtract(view(a), view(b), view_mut(out, a.rows(), b.rows(), leading));
    }
}

impl Faer {
    /// Runs two independent tasks, in parallel if there is more than one thread.
    fn join(&self, first: impl FnOnce() + Send, second: impl FnOnce() + Send) {
        if self.parallel {
            rayon::join(first, second);
        } else {
            first();
            second();
        }
    }

    /// Computes the lower triangle of `out += sign a a^T`: a (k, n).
    fn add_gram(&self, a: MatRef<'_, f64>, out: MatMut<'_, f64>, sign: f64) {
        if out.nrows() <= TILE {
            add_gram(out, a, sign);
            return;
        }
        let half = half(out.nrows());
        let (upper, lower) = a.split_at_row(half);
        let (first, _, below, second) = out.split_at_mut(half, half);
        self.join(
            || self.add_product(lower, upper, below, sign),
            || self.join(|| self.add_gram(upper, first, sign), || self.add_gram(lower, second, sign)),
        );
    }

    fn subtract(&self, a: MatRef<'_, f64>, b: MatRef<'_, f64>, out: MatMut<'_, f64>) {
        self.add_product(a, b, out, -1.0);
    }

    /// Computes `out += sign a b^T`: a (rows, k), b (columns, k).
    fn add_product(&self, a: MatRef<'_, f64>, b: MatRef<'_, f64>, out: MatMut<'_, f64>, sign: f64) {
        let (rows, columns) = out.shape();
        if rows.max(columns) <= TILE {
            matmul(out, Accum::Add, a, b.transpose(), sign);
        } else if rows >= columns {
            let half = half(rows);
            let (above, below) = a.split_at_row(half);
            let (first, second) = out.split_at_row_mut(half);
            self.join(|| self.add_product(above, b, first, sign), || self.add_product(below, b, second, sign));
        } else {
            let half = half(columns);
            let (left, right) = b.split_at_row(half);
            let (first, second) = out.split_at_col_mut(half);
            self.join(|| self.add_product(a, left, first, sign), || self.add_product(a, right, second, sign));
        }
    }

    /// Computes `out = out C^-T`, each row independently.
    fn divide(&self, c: MatRef<'_, f64>, out: MatMut<'_, f64>) {
        if out.nrows() <= DIVIDED_ROWS {
            solve_lower(c, out.transpose_mut());
            return;
        }
        let half = half(out.nrows());
        let (above, below) = out.split_at_row_mut(half);
        self.join(|| self.divide(c, above), || self.divide(c, below));
    }

    /// Computes the lower Cholesky factor of a matrix divided into 2 x 2 blocks. First factorises the upper diagonal
    /// block and divides the block below it by the transpose of that factor. Then subtracts the product of the result
    /// and its transpose from the lower diagonal block, and factorises this block.
    fn factorise(&self, matrix: MatMut<'_, f64>) -> Result<(), usize> {
        let k = matrix.nrows();
        if k <= FACTOR {
            return cholesky_in_place(matrix).map_err(|NotPositiveDefinite { column }| column);
        }
        let half = half(k);
        let (mut first, _, mut below, mut second) = matrix.split_at_mut(half, half);
        self.factorise(first.as_mut())?;
        self.divide(first.as_ref(), below.as_mut());
        self.add_gram(below.as_ref(), second.as_mut(), -1.0);
        self.factorise(second).map_err(|column| half + column)
    }
}

/// Returns the number of rows of the first half: a multiple of 64, so that the tiles of larger matrices are all aligned
/// in the same way.
fn half(rows: usize) -> usize {
    (rows / 2).next_multiple_of(64)
}

fn view(matrix: Matrix<'_>) -> MatRef<'_, f64> {
    MatRef::from_column_major_slice_with_stride(matrix.values(), matrix.rows(), matrix.columns(), matrix.leading())
}

fn view_mut(values: &mut [f64], rows: usize, columns: usize, leading: usize) -> MatMut<'_, f64> {
    assert_extent(values, rows, columns, leading);
    MatMut::from_column_major_slice_with_stride_mut(values, rows, columns, leading)
}
