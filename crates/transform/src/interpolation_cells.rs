//! Multiplies kernel values with the grid, for points that share cells.
//!
//! The kernels of points in one cell cover the same grid points if their width is even. Spreading sums the points'
//! values in registers and adds the sums to the grid once. A point then costs only its products, at the rate of a
//! matrix product, instead of reading and writing the w x w grid values under its kernel, which are in different cache
//! lines. Interpolation reads the grid once for several points. Channels are processed one at a time.

use std::ops::Range;

use multiversion::{multiversion, target::target_cfg_f};

use crate::batch::Batch;
use crate::grid::Layout;
use crate::kernel::Kernel;
use crate::lanes::{fused, load};

/// Number of points of one cell that are interpolated together.
const TOGETHER: usize = 4;

/// Computes the same values as [`interpolate_batch`](crate::interpolation_batch::interpolate_batch).
pub(crate) fn interpolate_cells(
    layout: Layout,
    grid: &[f64],
    first_row: usize,
    kernel: &Kernel,
    batch: &Batch,
    values: &mut [f64],
) {
    match kernel.padded {
        ..=12 => interpolate_cells_12(layout, grid, first_row, kernel.width, batch, values),
        _ => interpolate_cells_16(layout, grid, first_row, kernel.width, batch, values),
    }
}

/// Computes the same values as [`spread_batch`](crate::interpolation_batch::spread_batch).
pub(crate) fn spread_cells(
    layout: Layout,
    grid: &mut [f64],
    first_row: usize,
    kernel: &Kernel,
    batch: &Batch,
    values: &[f64],
) {
    match kernel.padded {
        ..=12 => spread_cells_12(layout, grid, first_row, kernel.width, batch, values),
        _ => spread_cells_16(layout, grid, first_row, kernel.width, batch, values),
    }
}

/// Defines the functions for kernels whose padded width is at most `$lanes`. Sums of `$rows` by `$across` grid values
/// fit in the registers of AVX-512.
macro_rules! kernels_for {
    ($interpolate:ident, $spread:ident, $lanes:literal, [$rows:literal, $across:literal], $arm_rows:literal) => {
        #[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
        fn $interpolate(
            layout: Layout,
            grid: &[f64],
            first_row: usize,
            width: usize,
            batch: &Batch,
            values: &mut [f64],
        ) {
            let count = values.len() / layout.channels;
            let mut point = 0;
            while point < count {
                let grid = &grid[start(layout, first_row, batch, point)..];
                let values = &mut values[point * layout.channels..];
                let four = end_of_cell(batch, point, count.min(point + TOGETHER)) == point + TOGETHER;
                match (target_cfg_f!(any(target_feature = "fma", target_arch = "aarch64")), four) {
                    (true, true) => gather::<$lanes, TOGETHER, true>(layout, grid, width, batch, point, values),
                    (true, false) => gather::<$lanes, 1, true>(layout, grid, width, batch, point, values),
                    (false, true) => gather::<$lanes, TOGETHER, false>(layout, grid, width, batch, point, values),
                    (false, false) => gather::<$lanes, 1, false>(layout, grid, width, batch, point, values),
                }
                point += if four { TOGETHER } else { 1 };
            }
        }

        #[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
        fn $spread(layout: Layout, grid: &mut [f64], first_row: usize, width: usize, batch: &Batch, values: &[f64]) {
            let count = values.len() / layout.channels;
            let mut point = 0;
            while point < count {
                let end = end_of_cell(batch, point, count);
                let grid = &mut grid[start(layout, first_row, batch, point)..];
                if target_cfg_f!(target_feature = "avx512f") {
                    scatter::<$lanes, $rows, $across, true>(layout, grid, width, batch, point..end, values);
                } else if target_cfg_f!(target_arch = "aarch64") {
                    scatter::<$lanes, $arm_rows, 4, true>(layout, grid, width, batch, point..end, values);
                } else if target_cfg_f!(target_feature = "fma") {
                    scatter::<$lanes, 4, 4, true>(layout, grid, width, batch, point..end, values);
                } else {
                    scatter::<$lanes, 4, 4, false>(layout, grid, width, batch, point..end, values);
                }
                point = end;
            }
        }
    };
}
kernels_for!(interpolate_cells_12, spread_cells_12, 12, [12, 4], 12);
kernels_for!(interpolate_cells_16, spread_cells_16, 16, [16, 8], 8);

/// Returns the index, in the first channel, of the first value under a point's kernel. The grid's first row has index
/// `first_row`.
#[inline(always)]
fn start(layout: Layout, first_row: usize, batch: &Batch, point: usize) -> usize {
    let [row, column] = batch.corner(point);
    (row - first_row) * layout.row() + column
}

/// Returns the first point after `point` whose kernel covers other grid points, or `count` if there is none.
#[inline(always)]
fn end_of_cell(batch: &Batch, point: usize, count: usize) -> usize {
    let mut end = point + 1;
    while end < count && batch.corner(end) == batch.corner(point) {
        end += 1;
    }
    end
}

/// Computes the values of all channels at P points of one cell. `values` (points, channels), row-major, starts with the
/// first of these points, and `grid` with the first value under their kernels.
#[inline(always)]
fn gather<const W: usize, const P: usize, const FMA: bool>(
    layout: Layout,
    grid: &[f64],
    width: usize,
    batch: &Batch,
    point: usize,
    values: &mut [f64],
) {
    let (row_values, column_values) = (&batch.row_values[point..point + P], &batch.column_values[point..point + P]);
    for channel in 0..layout.channels {
        let mut sums = [[0.0; W]; P];
        for (r, line) in grid[channel * layout.stride..].chunks(layout.row()).take(width).enumerate() {
            let Some(line) = line.first_chunk::<W>() else { break };
            for (sums, weights) in sums.iter_mut().zip(row_values) {
                for (sum, value) in sums.iter_mut().zip(line) {
                    *sum = fused::<FMA>(weights[r], *value, *sum);
                }
            }
        }
        // Only loops are used, because a closure that isn't inlined is compiled for the oldest supported processor.
        for (p, (sums, columns)) in sums.iter().zip(column_values).enumerate() {
            let mut four = [0.0; 4];
            for (columns, sums) in columns.chunks_exact(4).zip(sums.chunks_exact(4)) {
                for i in 0..4 {
                    four[i] = fused::<FMA>(columns[i], sums[i], four[i]);
                }
            }
            values[p * layout.channels + channel] = (four[0] + four[2]) + (four[1] + four[3]);
        }
    }
}

/// Spreads the values of all channels at some points of one cell to the grid. `grid` starts with the first value under
/// the kernels of these points. `values` (points of the batch, channels) is row-major. R rows and L columns of the grid
/// are processed at a time.
#[inline(always)]
fn scatter<const W: usize, const R: usize, const L: usize, const FMA: bool>(
    layout: Layout,
    grid: &mut [f64],
    width: usize,
    batch: &Batch,
    points: Range<usize>,
    values: &[f64],
) {
    for channel in 0..layout.channels {
        for row in (0..width).step_by(R) {
            for column in (0..W).step_by(L) {
                let values = &values[channel..];
                let sums = sums::<R, L, FMA>(batch, points.clone(), [row, column], values, layout.channels);
                let start = row * layout.row() + channel * layout.stride + column;
                // Rows beyond the kernel's width are skipped: the kernel is zero there, and the rows may lie beyond the
                // strip.
                let lines = grid[start..].chunks_mut(layout.row()).take(width - row);
                for (sums, line) in sums.iter().zip(lines) {
                    let Some(line) = line.first_chunk_mut::<L>() else { break };
                    for (value, sum) in line.iter_mut().zip(sums) {
                        *value += sum;
                    }
                }
            }
        }
    }
}

/// Returns R by L sums over points. Each summand is the product of a point's value and one of the point's R by L kernel
/// values. The values of successive points are `stride` apart.
#[inline(always)]
fn sums<const R: usize, const L: usize, const FMA: bool>(
    batch: &Batch,
    points: Range<usize>,
    [row, column]: [usize; 2],
    values: &[f64],
    stride: usize,
) -> [[f64; L]; R] {
    let mut sums = [[0.0; L]; R];
    let mut point = points.start;
    while point < points.end {
        let value = values[point * stride];
        let weights: [f64; R] = load(&batch.row_values[point], row);
        let mut columns: [f64; L] = load(&batch.column_values[point], column);
        for column in &mut columns {
            *column *= value;
        }
        // The inner loop runs over rows: the optimiser unrolls it and forms vectors of columns. If the loops are
        // exchanged, the optimiser forms vectors of rows, which takes eight times as long.
        for i in 0..L {
            for r in 0..R {
                sums[r][i] = fused::<FMA>(weights[r], columns[i], sums[r][i]);
            }
        }
        point += 1;
    }
    sums
}
