//! The size of a target's residual.

use ndarray::{ArrayView2, Axis};
use rayon::prelude::*;
use serde::Serialize;

/// Rows whose squares are summed together.
const RUN: usize = 1 << 14;

/// Mean and maximum over the rows (vertices) of the squared norm of one target's residual, in the target's unit squared.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct ResidualNorms {
    /// Mean over the rows of the squared norm.
    pub mean_square: f64,
    /// Maximum over the rows of the squared norm.
    pub max_square: f64,
}

impl ResidualNorms {
    /// Computes the norms of a target's residual, (n, c).
    pub fn of(residual: ArrayView2<'_, f64>) -> Self {
        // By runs of rows, whatever the number of threads: the same sums.
        let runs: Vec<[f64; 2]> = residual
            .axis_chunks_iter(Axis(0), RUN)
            .into_par_iter()
            .map(|rows| {
                rows.rows().into_iter().fold([0.0, 0.0], |[sum, max]: [f64; 2], row| {
                    let square = row.iter().map(|r| r * r).sum::<f64>();
                    [sum + square, max.max(square)]
                })
            })
            .collect();
        let [sum, max] = runs.iter().fold([0.0, 0.0], |[sum, max]: [f64; 2], run| [sum + run[0], max.max(run[1])]);
        Self { mean_square: sum / residual.nrows() as f64, max_square: max }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn norms_are_of_rows() {
        let found = ResidualNorms::of(ndarray::array![[3.0, 4.0], [0.0, -1.0], [2.0, 0.0]].view());
        assert_eq!((found.mean_square, found.max_square), (10.0, 25.0));
    }
}
