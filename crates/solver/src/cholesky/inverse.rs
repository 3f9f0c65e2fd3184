//! Computes the diagonals of G^-1 and G^-1 P G^-1, from which standard errors are computed. Here G = C C^T is a
//! factorised matrix (K, K) and P is a diagonal penalty. Entry k of the diagonal of G^-1 is the squared norm of C^-1
//! e_k, with the unit vector e_k.
//!
//! C^-1 is applied to all unit vectors, a few tile columns at a time; the leading zeros of a vector are skipped. This
//! takes K^3 / 3 flops, as many as the factorisation, and 8 K bytes of workspace per vector.
//!
//! Entry k of the diagonal of G^-1 P G^-1 is the sum of P_j (G^-1)_jk^2 over j. The computation needs all columns of
//! G^-1, but only the entries on and below the diagonal, because G^-1 is symmetric. It takes 2 K^3 / 3 flops, and 16 K
//! bytes of workspace per vector.

use std::ops::Range;

use spharm_monitor::{Monitor, Stage};
use spharm_store::TileGrid;

use crate::SolverError;
use crate::cholesky::tiles::Tiles;
use crate::cholesky::triangular::{Direction, run};

/// Number of unit vectors that are processed together: enough for matrix products to run at full speed.
const TOGETHER: usize = 512;

/// Computes the diagonal (K) of `(C C^T)^-1` from the tiles of the Cholesky factor C.
pub(crate) fn diagonal(tiles: &dyn Tiles, threads: usize, monitor: &dyn Monitor) -> Result<Vec<f64>, SolverError> {
    let grid = tiles.grid();
    monitor.begin(Stage::counted("standard errors", "columns"), grid.size() as u64);
    let step = (TOGETHER / grid.tile()).max(1);
    let mut diagonal = Vec::with_capacity(grid.size());
    for first in (0..grid.columns()).step_by(step) {
        let (blocks, columns) = units(grid, first, step);
        let channels = columns.len();
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

/// Computes the diagonals (K) of `(C C^T)^-1` and of `(C C^T)^-1 P (C C^T)^-1` for the Cholesky factor C. `penalty` (K)
/// is the diagonal of P.
pub(crate) fn penalised_diagonals(
    tiles: &dyn Tiles,
    penalty: &[f64],
    threads: usize,
    monitor: &dyn Monitor,
) -> Result<(Vec<f64>, Vec<f64>), SolverError> {
    let grid = tiles.grid();
    monitor.begin(Stage::counted("standard errors", "columns"), grid.size() as u64);
    // A column takes twice as much workspace as in `diagonal`, so half as many columns are solved together.
    let step = (TOGETHER / 2 / grid.tile()).max(1);
    let (mut inverse, mut penalised) = (vec![0.0; grid.size()], vec![0.0; grid.size()]);
    for first in (0..grid.columns()).step_by(step) {
        let (blocks, columns) = units(grid, first, step);
        let solved = run(tiles, blocks, columns.len(), threads, first, Direction::Both, monitor)?;
        for (at, block) in solved.iter().enumerate().skip(first) {
            let rows = grid.range(at);
            for (column, values) in columns.clone().zip(block.chunks_exact(rows.len())) {
                // G^-1 is symmetric, so each entry below the diagonal also contributes as its mirror entry above the
                // diagonal.
                for (row, value) in rows.clone().zip(values).filter(|(row, _)| *row >= column) {
                    penalised[column] += penalty[row] * value * value;
                    if row == column {
                        inverse[column] = *value;
                    } else {
                        penalised[row] += penalty[column] * value * value;
                    }
                }
            }
        }
        monitor.step(columns.len() as u64);
    }
    monitor.end();
    Ok((inverse, penalised))
}

/// Returns the columns of the identity matrix in the `step` tile columns starting at `first`, as blocks for [`run`],
/// and the range of these columns.
fn units(grid: TileGrid, first: usize, step: usize) -> (Vec<Vec<f64>>, Range<usize>) {
    let columns = grid.range(first).start..grid.range((first + step - 1).min(grid.columns() - 1)).end;
    let unit = |at: usize| {
        let rows = grid.range(at);
        let mut block = if at < first { Vec::new() } else { vec![0.0; rows.len() * columns.len()] };
        for row in rows.clone().filter(|row| columns.contains(row)) {
            block[(row - columns.start) * rows.len() + row - rows.start] = 1.0;
        }
        block
    };
    ((0..grid.columns()).map(unit).collect(), columns.clone())
}
