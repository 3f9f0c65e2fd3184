//! Newton's systems by faer's sparse Cholesky, whose symbolic part serves all steps.
//!
//! O(n^1.5) flops and O(n log n) numbers on a surface of n vertices.

use std::sync::Arc;

use faer::linalg::solvers::Solve;
use faer::sparse::linalg::solvers::{Llt, SymbolicLlt};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMat};
use faer::{Mat, Side};
use spharm_monitor::{Interrupted, Monitor};

use crate::background::abandonable;
use crate::blocks::Pattern;

/// Vertices from which on a factorisation takes long.
const LONG: usize = 20_000;

/// Relative shift of the diagonal: turning the whole sphere costs nothing, and the matrix must be definite.
const SHIFT: f64 = 1e-8;

/// The symbolic factorisation of a pattern.
pub(crate) struct Direct {
    pattern: Arc<SymbolicSparseColMat<usize>>,
    symbolic: SymbolicLlt<usize>,
}

impl Direct {
    /// Analyses a pattern. Returns `None` where faer can't, which is for want of memory.
    pub(crate) fn new(blocks: &Pattern, monitor: &dyn Monitor) -> Result<Option<Self>, Interrupted> {
        let n = blocks.rows();
        let mut columns = Vec::with_capacity(2 * n + 1);
        let mut rows = Vec::with_capacity(2 * blocks.columns.len() + n);
        columns.push(0);
        for v in 0..n {
            let later = blocks.columns[blocks.range(v)][1..].iter().filter(|&&w| w as usize > v);
            let later = later.flat_map(|&w| [2 * w as usize, 2 * w as usize + 1]);
            rows.extend([2 * v, 2 * v + 1]);
            rows.extend(later.clone());
            columns.push(rows.len());
            rows.push(2 * v + 1);
            rows.extend(later);
            columns.push(rows.len());
        }
        let pattern = Arc::new(SymbolicSparseColMat::new_checked(2 * n, 2 * n, columns, None, rows));
        let theirs = Arc::clone(&pattern);
        let symbolic =
            abandonable(n >= LONG, monitor, move || SymbolicLlt::try_new(theirs.as_ref().as_ref(), Side::Lower))?;
        Ok(symbolic.ok().map(|symbolic| Self { pattern, symbolic }))
    }

    /// Solves for minus the gradient. Returns `None` where the matrix isn't definite, by rounding or overflow.
    pub(crate) fn solve(
        &self,
        rows: &Pattern,
        blocks: &[[f64; 4]],
        gradient: &[[f64; 2]],
        monitor: &dyn Monitor,
    ) -> Result<Option<Vec<[f64; 2]>>, Interrupted> {
        let n = rows.rows();
        let mut values = Vec::with_capacity(self.pattern.row_idx().len());
        for v in 0..n {
            let range = rows.range(v);
            let [a, _, b, c] = blocks[range.start];
            let shifted = |x: f64| x * (1.0 + SHIFT) + f64::MIN_POSITIVE;
            let row = rows.columns[range.clone()].iter().zip(&blocks[range]).skip(1);
            let later = row.filter(|(w, _)| **w as usize > v);
            values.extend([shifted(a), b]);
            values.extend(later.clone().flat_map(|(_, block)| [block[0], block[1]]));
            values.push(shifted(c));
            values.extend(later.flat_map(|(_, block)| [block[2], block[3]]));
        }
        let (pattern, symbolic) = (Arc::clone(&self.pattern), self.symbolic.clone());
        let mut solution = Mat::from_fn(2 * n, 1, |i, _| -gradient[i / 2][i % 2]);
        let solved = abandonable(n >= LONG, monitor, move || {
            let matrix = SparseColMatRef::new(pattern.as_ref().as_ref(), &values);
            let factor = Llt::try_new_with_symbolic(symbolic, matrix, Side::Lower).ok()?;
            factor.solve_in_place(solution.as_mut());
            Some(solution)
        })?;
        Ok(solved.map(|solution| (0..n).map(|v| [solution[(2 * v, 0)], solution[(2 * v + 1, 0)]]).collect()))
    }
}
