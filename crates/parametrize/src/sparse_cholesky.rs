//! Computes sparse Cholesky factors of symmetric matrices that consist of small blocks. The symbolic analysis is reused
//! for all matrices with the same sparsity pattern.
//!
//! On a surface of n vertices, a factorisation takes O(n^1.5) flops, and the factor has O(n log n) entries.

use spharm_linalg::{MatMut, SparseFactor, SparsePattern};
use spharm_monitor::{Interrupted, Monitor};

use crate::background::abandonable;

/// If a matrix has at least this number of unknowns, its factorisation runs on its own thread, so that it can be
/// interrupted.
const LONG: usize = 20_000;

/// The symbolic factorisation of a sparsity pattern.
pub(crate) struct Symbolic {
    pattern: SparsePattern,
    size: usize,
}

/// The Cholesky factor of one matrix.
pub(crate) struct Factor(SparseFactor);

impl Symbolic {
    /// Analyses a symmetric pattern of blocks of `size` rows and columns. `columns` lists the columns of each row,
    /// including the diagonal, in any order; `starts` contains the index in `columns` of each row's first entry.
    /// Returns `None` if memory runs out.
    pub(crate) fn new(
        size: usize,
        starts: &[u32],
        columns: &[u32],
        monitor: &dyn Monitor,
    ) -> Result<Option<Self>, Interrupted> {
        let n = starts.len() - 1;
        let mut begins = Vec::with_capacity(size * n + 1);
        let mut rows = Vec::with_capacity(size * size * columns.len() / 2 + size * size * n);
        begins.push(0);
        for v in 0..n {
            for k in 0..size {
                rows.extend(size * v + k..size * (v + 1));
                for &w in later(starts, columns, v).0 {
                    if w as usize > v {
                        rows.extend(size * w as usize..size * (w as usize + 1));
                    }
                }
                begins.push(rows.len());
            }
        }
        let pattern = abandonable(size * n >= LONG, monitor, move || SparsePattern::new(begins, rows))?;
        Ok(pattern.map(|pattern| Self { pattern, size }))
    }

    /// Factors a matrix with the analysed pattern. Each block consists of `N` = `size`^2 numbers, stored row by row.
    /// Returns `None` if the matrix isn't numerically positive definite.
    pub(crate) fn factor<const N: usize>(
        &self,
        starts: &[u32],
        columns: &[u32],
        blocks: Vec<[f64; N]>,
        monitor: &dyn Monitor,
    ) -> Result<Option<Factor>, Interrupted> {
        let (n, size) = (starts.len() - 1, self.size);
        let mut values = Vec::with_capacity(self.pattern.entries());
        for v in 0..n {
            let (columns, first) = later(starts, columns, v);
            let own = columns.iter().position(|&w| w as usize == v).unwrap_or(0);
            for k in 0..size {
                // The pattern contains the columns' entries below the diagonal. By symmetry these entries equal the
                // rows' entries to the right of the diagonal.
                values.extend_from_slice(&blocks[first + own][size * k + k..size * (k + 1)]);
                for (at, &w) in columns.iter().enumerate() {
                    if w as usize > v {
                        values.extend_from_slice(&blocks[first + at][size * k..size * (k + 1)]);
                    }
                }
            }
        }
        drop(blocks);
        let pattern = self.pattern.clone();
        let found = abandonable(size * n >= LONG, monitor, move || pattern.factor(&values))?;
        Ok(found.map(Factor))
    }
}

/// Returns the columns of a row's blocks, and the index in `columns` of the row's first block.
fn later<'a>(starts: &[u32], columns: &'a [u32], row: usize) -> (&'a [u32], usize) {
    let first = starts[row] as usize;
    (&columns[first..starts[row + 1] as usize], first)
}

impl Factor {
    /// Replaces the right-hand side `x` by the solution.
    pub(crate) fn solve(&self, x: &mut [f64]) {
        let rows = x.len();
        self.0.solve(MatMut::from_column_major_slice_mut(x, rows, 1));
    }
}
