//! Cholesky factors of sparse symmetric matrices. The sparsity pattern is analysed once for all matrices that have it.

use std::sync::Arc;

use faer::linalg::solvers::Solve;
use faer::sparse::linalg::solvers::{Llt, SymbolicLlt};
use faer::sparse::{Argsort, Pair, SparseColMat, SparseColMatRef, SymbolicSparseColMat};
use faer::{MatMut, Side};

/// The sparsity pattern of a symmetric matrix's lower triangle, and the analysis of the Cholesky factor. Clones share
/// this data instead of copying it.
#[derive(Clone)]
pub struct SparsePattern {
    pattern: Arc<SymbolicSparseColMat<usize>>,
    analysis: SymbolicLlt<usize>,
}

impl std::fmt::Debug for SparsePattern {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SparsePattern").field("order", &self.pattern.ncols()).finish_non_exhaustive()
    }
}

impl SparsePattern {
    /// Analyses the pattern of a matrix (n, n). `rows` lists the row indices of entries at and below the diagonal,
    /// column by column. `starts` has n + 1 elements: the position in `rows` at which each column starts, followed by
    /// the length of `rows`. Returns `None` if memory runs out.
    ///
    /// # Panics
    ///
    /// Panics if `starts` isn't ascending, or the row indices of a column aren't.
    pub fn new(starts: Vec<usize>, rows: Vec<usize>) -> Option<Self> {
        let n = starts.len() - 1;
        Self::analyse(SymbolicSparseColMat::new_checked(n, n, starts, None, rows))
    }

    fn analyse(pattern: SymbolicSparseColMat<usize>) -> Option<Self> {
        let analysis = SymbolicLlt::try_new(pattern.as_ref(), Side::Lower).ok()?;
        Some(Self { pattern: Arc::new(pattern), analysis })
    }

    /// Returns the number of entries of the pattern.
    pub fn entries(&self) -> usize {
        self.pattern.row_idx().len()
    }

    /// Factors the matrix with `values` in the order of the pattern's entries. Returns `None` if it isn't numerically
    /// positive definite, or if memory runs out.
    ///
    /// # Panics
    ///
    /// Panics if the number of values isn't the pattern's number of entries.
    pub fn factor(&self, values: &[f64]) -> Option<SparseFactor> {
        let matrix = SparseColMatRef::new(self.pattern.as_ref().as_ref(), values);
        Llt::try_new_with_symbolic(self.analysis.clone(), matrix, Side::Lower).ok().map(SparseFactor)
    }
}

/// A sparsity pattern given by entries in any order. The values of entries at the same position are summed.
#[derive(Clone, Debug)]
pub struct SparseSum {
    pattern: SparsePattern,
    order: Arc<Argsort<usize>>,
}

impl SparseSum {
    /// Analyses the pattern of a matrix (n, n) from the `[row, column]` indices of its entries. Entries above the
    /// diagonal are ignored. Returns `None` if an index is out of range, or if memory runs out.
    pub fn new(n: usize, entries: &[[usize; 2]]) -> Option<Self> {
        let pairs: Vec<Pair<usize, usize>> = entries.iter().map(|&[row, col]| Pair { row, col }).collect();
        let (pattern, order) = SymbolicSparseColMat::try_new_from_indices(n, n, &pairs).ok()?;
        Some(Self { pattern: SparsePattern::analyse(pattern)?, order: Arc::new(order) })
    }

    /// Factors the matrix with `values` in the order of the entries. Returns `None` if it isn't numerically positive
    /// definite, or if memory runs out.
    ///
    /// # Panics
    ///
    /// Panics if the number of values isn't the number of entries.
    pub fn factor(&self, values: &[f64]) -> Option<SparseFactor> {
        let pattern = self.pattern.pattern.as_ref().clone();
        let matrix = SparseColMat::new_from_argsort(pattern, &self.order, values).ok()?;
        Llt::try_new_with_symbolic(self.pattern.analysis.clone(), matrix.as_ref(), Side::Lower).ok().map(SparseFactor)
    }
}

/// The Cholesky factor of a sparse symmetric matrix (n, n).
#[derive(Debug)]
pub struct SparseFactor(Llt<usize, f64>);

impl SparseFactor {
    /// Replaces the right-hand sides `x` (n, c) by the solutions.
    ///
    /// # Panics
    ///
    /// Panics if `x` doesn't have n rows.
    pub fn solve(&self, x: MatMut<'_, f64>) {
        self.0.solve_in_place(x);
    }
}
