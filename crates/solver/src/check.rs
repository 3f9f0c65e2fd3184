//! Checks callers' arguments.

use ndarray::{Array2, ArrayView2, Axis};
use rayon::prelude::*;

use crate::SolverError;

/// Number of rows of the targets that are checked at a time.
const RUN: usize = 1 << 14;

/// Returns an error if the number of weights isn't `rows`, if a weight is negative or not finite, or if all weights are
/// zero.
pub(crate) fn weights(weights: &[f64], rows: usize) -> Result<(), SolverError> {
    if weights.len() != rows {
        return Err(SolverError::Rows { what: "the list of weights", expected: rows, found: weights.len() });
    }
    let bad = |weight: &f64| !weight.is_finite() || *weight < 0.0;
    let all_zero = weights.iter().all(|&weight| weight == 0.0);
    if let Some(row) = weights.iter().position(bad).or(all_zero.then_some(0)) {
        return Err(SolverError::Weight { row, found: weights[row] });
    }
    Ok(())
}

/// Returns an error if `unread`, a list of flags that exclude rows from the residual's norms, doesn't have `rows`
/// entries.
pub(crate) fn unread(unread: Option<&Vec<bool>>, rows: usize) -> Result<(), SolverError> {
    match unread.map(Vec::len).filter(|found| *found != rows) {
        Some(found) => Err(SolverError::Rows { what: "the list of unread rows", expected: rows, found }),
        None => Ok(()),
    }
}

/// Returns an error if the targets (one column per function to fit) don't have `rows` rows, or if they contain a NaN or
/// an infinity.
pub(crate) fn targets(targets: &Array2<f64>, rows: usize) -> Result<(), SolverError> {
    if targets.nrows() != rows {
        return Err(SolverError::Rows { what: "the target", expected: rows, found: targets.nrows() });
    }
    // Check the values in runs of rows, so that the loop over a run has no branches.
    let finite = |run: ArrayView2<'_, f64>| run.iter().fold(true, |all, value| all & value.is_finite());
    if targets.axis_chunks_iter(Axis(0), RUN).into_par_iter().all(finite) {
        return Ok(());
    }
    match targets.indexed_iter().find(|(_, value)| !value.is_finite()) {
        Some(((row, column), _)) => Err(SolverError::NotFinite { row, column }),
        None => Ok(()),
    }
}
