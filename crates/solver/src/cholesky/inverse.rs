//! Computes the diagonal of G^-1, for standard errors: (G^-1)_kk = ||C^-1 e_k||^2.
//!
//! The forward solve is applied to unit vectors, a few tile columns at a time; the leading zeros of a vector are
//! skipped. This takes K^3 / 3 flops, as many as the factorisation, and 8 K bytes of workspace per vector.

use spharm_monitor::{Monitor, Stage};

use crate::SolverError;
use crate::cholesky::tiles::Tiles;
use crate::cholesky::triangular::{Direction, run};

/// Number of unit vectors that are processed together: enough for matrix products to run at full speed.
const TOGETHER: usize = 512;

/// Computes the diagonal (K) of `(C C^T)^-1`.
pub(crate) fn diagonal(tiles: &dyn Tiles, threads: usize, monitor: &dyn Monitor) -> Result<Vec<f64>, SolverError> {
    let grid = tiles.grid();
    monitor.begin(Stage::counted("standard errors", "columns"), grid.size() as u64);
    let step = (TOGETHER / grid.tile()).max(1);
    let mut diagonal = Vec::with_capacity(grid.size());
    for first in (0..grid.columns()).step_by(step) {
        let start = grid.range(first).start;
        let channels = grid.range((first + step - 1).min(grid.columns() - 1)).end - start;
        let unit = |at: usize| {
            let rows = grid.range(at);
            let mut block = if at < first { Vec::new() } else { vec![0.0; rows.len() * channels] };
            for (row, column) in
                rows.clone().filter(|row| (start..start + channels).contains(row)).map(|r| (r, r - start))
            {
                block[column * rows.len() + row - rows.start] = 1.0;
            }
            block
        };
        let blocks = (0..grid.columns()).map(unit).collect();
        let solved = run(tiles, blocks, channels, threads, first, Direction::Forward, monitor)?;
        let mut sums = vec![0.0; channels];
        for (at, block) in solved.iter().enumerate().skip(first) {
            for (sum, column) in sums.iter_mut().zip(block.chunks_exact(grid.range(at).len())) {
                *sum += column.iter().map(|value| value * value).sum::<f64>();
            }
        }
        diagonal.extend(sums);
        monitor.step(channels as u64);
    }
    monitor.end();
    Ok(diagonal)
}
