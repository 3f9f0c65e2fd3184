//! The size of a target's residual.

use ndarray::ArrayView2;
use serde::Serialize;

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
        let (mut sum, mut max) = (0.0, 0.0f64);
        for row in residual.rows() {
            let square = row.iter().map(|r| r * r).sum::<f64>();
            sum += square;
            max = max.max(square);
        }
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
