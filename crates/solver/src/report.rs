//! What a fit tells about itself.

use ndarray::ArrayView2;
use serde::Serialize;

use crate::plan::Plan;

/// Report of a fit.
#[derive(Debug, Clone, Serialize)]
pub struct FitReport {
    /// `irf`, `sirf`, `mirf` or `nlsf`.
    pub method: &'static str,
    /// Whether the passes were accelerated by conjugate gradients.
    pub accelerated: bool,
    /// Passes, p, without refinements.
    pub passes: usize,
    /// Highest degree, L.
    pub max_degree: usize,
    /// Rows, n.
    pub rows: usize,
    /// Columns of the targets fitted together, c.
    pub channels: usize,
    /// Threads.
    pub threads: usize,
    /// The blocks of a pass.
    pub blocks: Vec<BlockReport>,
    /// One entry a sweep over the blocks, refinements among them.
    pub sweeps: Vec<SweepReport>,
    /// Where the time went.
    pub seconds: Seconds,
    /// The memory plan.
    pub memory: Plan,
}

/// One block of a pass.
#[derive(Debug, Clone, Serialize)]
pub struct BlockReport {
    /// First degree.
    pub first_degree: usize,
    /// Last degree, inclusive.
    pub last_degree: usize,
    /// Number of basis functions.
    pub columns: usize,
    /// `cholesky` of the Gram matrix, or `rank-revealing`.
    pub solver: &'static str,
    /// Numerical rank.
    pub rank: usize,
    /// Estimated condition number of the block; infinite (null in JSON) when it is singular.
    pub condition: f64,
}

/// One sweep over all blocks; of an accelerated fit one iteration, which is two passes.
#[derive(Debug, Clone, Serialize)]
pub struct SweepReport {
    /// Number of the pass, from 1; of an iteration, its last one.
    pub pass: usize,
    /// A sweep beyond the passes asked for, which removes what rounding left of the full least squares.
    pub refinement: bool,
    /// Wall time.
    pub seconds: f64,
    /// Bytes read from the store.
    pub bytes_read: u64,
    /// For each target: mean and maximum over the rows of the squared norm of its residual, in its own unit squared.
    pub residuals: Vec<Residual>,
}

/// Size of one target's residual.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Residual {
    /// Mean over the rows of the squared norm.
    pub mean_square: f64,
    /// Maximum over the rows.
    pub max_square: f64,
}

impl Residual {
    /// Of a target's residual, (n, c).
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

/// Seconds by kind of work, summed over the blocks.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct Seconds {
    /// Opening blocks and waiting for read-ahead to be set off.
    pub open: f64,
    /// Gram matrices, adjoints, factorisations and solves, with the reading of what they need.
    pub solve: f64,
    /// Updates of the residual.
    pub update: f64,
}
