//! Computes the Cholesky factorisation G = C C^T of a K x K matrix by the left-looking algorithm, one panel of tile
//! columns at a time.
//!
//! For each panel of columns J = [a, b), the matrix's source ([`GramMatrix`]) computes the rows from a downwards,
//! G[a.., J], and [`Kernels`] compute
//!
//! ```text
//! P = G[a.., J] - sum_k C[a.., k] C[J, k]^T        (gemm, for about 512 columns k at a time)
//! C[J, J] = chol(P[J])                              (potrf)
//! C[b.., J] = P[b..] C[J, J]^-T                     (trsm)
//! ```
//!
//! Then the finished tiles are stored. Earlier columns are read again for each panel. With panels of w columns, a
//! factorisation reads 4 K^3 / (3 w) bytes in total, so wider panels reduce this amount. A factorisation takes K^3 / 3
//! flops. If the factor is in memory, "reading" means copying tiles into panels. The order in which the terms of an
//! entry are summed depends only on the panels' width.

use std::ops::Range;

use rayon::prelude::*;
use spharm_harmonics::index::degree_order;
use spharm_harmonics::product::Matrix;
use spharm_monitor::Monitor;
use spharm_store::TileGrid;

use crate::SolverError;
use crate::cholesky::tiles::Finished;
use crate::gram::GramMatrix;
use crate::threaded::{Kernels, ThreadedKernels};

/// Number of finished columns of the factor whose products are subtracted from a panel at a time. It is large enough
/// that `dgemm`'s memory traffic on the panel is negligible.
const RUN: usize = 512;
/// Number of rows of the factor that are gathered into contiguous memory at a time.
const ROWS: usize = 4096;

/// Division of a matrix into the panels of a factorisation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Panels {
    pub(crate) grid: TileGrid,
    /// Number of tile columns of a panel.
    pub(crate) width: usize,
    pub(crate) threads: usize,
}

impl Panels {
    /// Returns the size in bytes of the workspace that a factorisation needs.
    pub(crate) fn bytes(&self) -> usize {
        let (size, tile) = (self.grid.size(), self.grid.tile());
        let width = (self.width * tile).min(size);
        let run = RUN.max(tile).min(size);
        let rows = ROWS.max(tile).min(size);
        // The workspace consists of the panel, a copy of its triangle, a gathered run of the panel's rows, a gathered
        // run of other rows, and two tiles per thread.
        let values = size * width + width * width + width * run + rows * run + 2 * self.threads * tile * tile;
        8 * values
    }

    /// Returns the number of flops of the entire factorisation.
    pub(crate) fn flops(&self) -> f64 {
        (self.grid.size() as f64).powi(3) / 3.0
    }
}

/// Factorises the matrix G of `source`, stores the factor's tiles in `finished`, and returns the 1-norm of G. Progress
/// is reported in flops.
pub(crate) fn factorise(
    source: &dyn GramMatrix,
    finished: &dyn Finished,
    panels: &Panels,
    monitor: &dyn Monitor,
) -> Result<f64, SolverError> {
    let Panels { grid, width, threads } = *panels;
    let (size, count) = (grid.size(), grid.columns());
    assert_eq!(source.size(), size, "the Gram matrix and its tiles must have the same size");
    let mut sums = vec![0.0; size];
    let (mut panel, mut top, mut other) = (Vec::new(), Vec::new(), Vec::new());
    for first in (0..count).step_by(width) {
        let columns = first..(first + width).min(count);
        let (a, b) = (grid.range(first).start, grid.range(columns.end - 1).end);
        let (rows, wide) = (size - a, b - a);
        panel.clear();
        panel.resize(rows * wide, 0.0);
        monitor.check()?;
        source.tile(a..size, a..b, &mut panel, rows)?;
        add_norms(&panel, rows, &mut sums[a..]);
        let run = (RUN / grid.tile()).max(1);
        for start in (0..first).step_by(run) {
            let before = start..(start + run).min(first);
            before.clone().for_each(|column| finished.will_need(first, column));
            let k = before.len() * grid.tile();
            gather(finished, grid, columns.clone(), before.clone(), &mut top)?;
            let step = (ROWS / grid.tile()).max(1);
            for row in (first..count).step_by(step) {
                monitor.check()?;
                let tiles = row..(row + step).min(count);
                let range = grid.range(row).start..grid.range(tiles.end - 1).end;
                gather(finished, grid, tiles, before.clone(), &mut other)?;
                let (height, at) = (range.len(), range.start - a);
                let (left, right) = (Matrix::new(&other, height, k, height), Matrix::new(&top, wide, k, wide));
                Kernels::with_threads(threads).subtract_outer(left, right, &mut panel[at..], rows);
                monitor.step(2 * (height * wide * k) as u64);
            }
        }
        monitor.check()?;
        Kernels::with_threads(threads).cholesky(&mut panel, wide, rows).map_err(|column| not_positive(a + column))?;
        // LAPACK's comparison with zero doesn't detect a NaN.
        if let Some(column) = (0..wide).find(|j| !panel[j * rows + j].is_finite()) {
            return Err(not_positive(a + column));
        }
        if rows > wide {
            let triangle: Vec<f64> = panel.chunks(rows).flat_map(|column| &column[..wide]).copied().collect();
            let triangle = Matrix::new(&triangle, wide, wide, wide);
            Kernels::with_threads(threads).divide_by_transpose(triangle, &mut panel[wide..], rows - wide, rows);
        }
        let wide = wide as u64;
        monitor.step(wide * wide * (wide / 3 + rows as u64 - wide));
        put(finished, grid, columns, &panel, rows)?;
    }
    // f64::max isn't used here, because it would ignore a NaN.
    Ok(sums.into_iter().fold(0.0, |m, s| if s > m || s.is_nan() { s } else { m }))
}

fn not_positive(column: usize) -> SolverError {
    SolverError::NotPositiveDefinite { column, degree: degree_order(column).0 }
}

/// Adds a panel of G's lower triangle to the column sums of |G|. `sums` begins at the panel's first row.
fn add_norms(panel: &[f64], rows: usize, sums: &mut [f64]) {
    for (j, column) in panel.chunks_exact(rows).enumerate() {
        sums[j] += column[j..].iter().map(|value| value.abs()).sum::<f64>();
        for (sum, value) in sums[j + 1..].iter_mut().zip(&column[j + 1..]) {
            *sum += value.abs();
        }
    }
}

/// Gathers the finished tiles in a range of tile rows and a range of tile columns into one matrix, column-major without
/// gaps. The tile columns must have full width.
fn gather(
    finished: &dyn Finished,
    grid: TileGrid,
    rows: Range<usize>,
    columns: Range<usize>,
    out: &mut Vec<f64>,
) -> Result<(), SolverError> {
    let start = grid.range(rows.start).start;
    let height = grid.range(rows.end - 1).end - start;
    out.resize(height * columns.len() * grid.tile(), 0.0);
    out.par_chunks_exact_mut(height * grid.tile()).zip(columns).try_for_each_init(Vec::new, |tile, (out, column)| {
        for row in rows.clone() {
            let range = grid.range(row);
            tile.resize(grid.len(row, column), 0.0);
            finished.get(row, column, tile)?;
            for (out, values) in out.chunks_exact_mut(height).zip(tile.chunks_exact(range.len())) {
                out[range.start - start..range.end - start].copy_from_slice(values);
            }
        }
        Ok(())
    })
}

/// Stores the tiles of a computed panel in `finished`.
fn put(
    finished: &dyn Finished,
    grid: TileGrid,
    columns: Range<usize>,
    panel: &[f64],
    rows: usize,
) -> Result<(), SolverError> {
    let start = grid.range(columns.start).start;
    let tiles: Vec<(usize, usize)> = columns.flat_map(|j| (j..grid.columns()).map(move |i| (i, j))).collect();
    tiles.into_par_iter().try_for_each_init(Vec::new, |tile, (row, column)| {
        let (height, width) = (grid.range(row), grid.range(column));
        tile.clear();
        for (k, j) in width.enumerate() {
            let values = &panel[(j - start) * rows..(j - start + 1) * rows];
            let at = tile.len();
            tile.extend_from_slice(&values[height.start - start..height.end - start]);
            if row == column {
                tile[at..at + k].fill(0.0);
            }
        }
        finished.put(row, column, tile)
    })
}
