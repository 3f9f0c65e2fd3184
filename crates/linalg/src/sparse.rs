//! Cholesky factors of sparse symmetric matrices. The sparsity pattern is analysed once for all matrices that have it.

use std::sync::Arc;

use faer::linalg::solvers::Solve;
use faer::sparse::linalg::solvers::{Llt, SymbolicLlt};
use faer::sparse::{Argsort, Pair, SparseColMat, SparseColMatRef, SymbolicSparseColMat};
use faer::{MatMut, Side};

/// The pattern of a symmetric matrix's lower triangle, and the analysis of its factor. A clone shares both.
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
    /// Analyses a pattern: `rows` lists the rows of each column at and below the diagonal, and `starts` has the start
    /// of each column in `rows` and, last, the end. Returns `None` if memory runs out.
    ///
    /// # Panics
    ///
    /// If `starts` isn't ascending, or the rows of a column aren't.
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
    /// If `values` hasn't as many values as the pattern has entries.
    pub fn factor(&self, values: &[f64]) -> Option<SparseFactor> {
        let matrix = SparseColMatRef::new(self.pattern.as_ref().as_ref(), values);
        Llt::try_new_with_symbolic(self.analysis.clone(), matrix, Side::Lower).ok().map(SparseFactor)
    }
}

/// A pattern given by entries in any order, of which those at the same place are summed.
#[derive(Clone, Debug)]
pub struct SparseSum {
    pattern: SparsePattern,
    order: Arc<Argsort<usize>>,
}

impl SparseSum {
    /// Analyses the pattern of a matrix (n, n) with entries at `[row, column]`; those above the diagonal are ignored.
    /// Returns `None` if an entry isn't in the matrix, or if memory runs out.
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
    /// If `values` has another length than the entries.
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
    /// Replaces right-hand sides, (n, c), by the solutions.
    ///
    /// # Panics
    ///
    /// If `x` hasn't n rows.
    pub fn solve(&self, x: MatMut<'_, f64>) {
        self.0.solve_in_place(x);
    }
}
