//! Norms of a target's residual.

use ndarray::{ArrayView2, Axis};
use rayon::prelude::*;
use serde::Serialize;

/// Number of rows whose squared norms are summed at a time.
const RUN: usize = 1 << 14;

/// Mean and maximum of the squared norms of the rows (vertices) of one target's residual, in the square of the target's
/// unit.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct ResidualNorms {
    /// Mean of the rows' squared norms.
    pub mean_square: f64,
    /// Maximum of the rows' squared norms.
    pub max_square: f64,
}

impl ResidualNorms {
    /// Computes the norms of a target's residual (n, c).
    pub fn of(residual: ArrayView2<'_, f64>) -> Self {
        Self::without(residual, None)
    }

    /// Computes the norms of a target's residual (n, c) over the rows that aren't marked in `unread` (n).
    pub fn without(residual: ArrayView2<'_, f64>, unread: Option<&[bool]>) -> Self {
        // Sum runs of a fixed number of rows, so that the sums don't depend on the number of threads.
        let runs: Vec<[f64; 2]> = residual
            .axis_chunks_iter(Axis(0), RUN)
            .into_par_iter()
            .enumerate()
            .map(|(run, rows)| {
                rows.rows().into_iter().enumerate().fold([0.0, 0.0], |[sum, max]: [f64; 2], (i, row)| {
                    if unread.is_some_and(|unread| unread[run * RUN + i]) {
                        return [sum, max];
                    }
                    let square = row.iter().map(|r| r * r).sum::<f64>();
                    [sum + square, max.max(square)]
                })
            })
            .collect();
        let [sum, max] = runs.iter().fold([0.0, 0.0], |[sum, max]: [f64; 2], run| [sum + run[0], max.max(run[1])]);
        Self { mean_square: sum / rows_read(residual.nrows(), unread) as f64, max_square: max }
    }
}

/// Returns the number of rows that aren't marked in `unread`.
pub(crate) fn rows_read(rows: usize, unread: Option<&[bool]>) -> usize {
    unread.map_or(rows, |unread| unread.iter().filter(|unread| !**unread).count())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn norms_are_of_rows() {
        let found = ResidualNorms::of(ndarray::array![[3.0, 4.0], [0.0, -1.0], [2.0, 0.0]].view());
        assert_eq!((found.mean_square, found.max_square), (10.0, 25.0));
        let residual = ndarray::array![[3.0, 4.0], [0.0, -1.0], [2.0, 0.0]];
        let found = ResidualNorms::without(residual.view(), Some(&[true, false, false]));
        assert_eq!((found.mean_square, found.max_square), (2.5, 4.0));
    }
}
