//! Batches of points: their kernel values, and the products of these with the grid.
//!
//! There is a compiled kernel for every padded width and for one, two and three channels: the sums over a point's
//! neighbourhood then stay in registers. Batches of which many points share a cell go to
//! [`interpolation_cells`](crate::interpolation_cells).

use std::ops::Range;

use multiversion::{multiversion, target::target_cfg_f};

use crate::grid::{Layout, MARGIN};
use crate::interpolation_cells::{interpolate_cells, spread_cells};
use crate::kernel::{Kernel, MAX_WIDTH};
use crate::lanes::fused;
use crate::points::Points;

/// Points whose kernel values are computed together.
pub(crate) const BATCH: usize = 32;

/// Kernel values of at most [`BATCH`] points, and the places of their first grid values.
pub(crate) struct Batch {
    rows: [usize; BATCH],
    columns: [usize; BATCH],
    pub(crate) row_values: [[f64; MAX_WIDTH]; BATCH],
    pub(crate) column_values: [[f64; MAX_WIDTH]; BATCH],
    /// Whether at least every second point's kernel lies over the same grid points as the one before.
    dense: bool,
}

impl Batch {
    pub(crate) fn new() -> Self {
        Self {
            rows: [0; BATCH],
            columns: [0; BATCH],
            row_values: [[0.0; MAX_WIDTH]; BATCH],
            column_values: [[0.0; MAX_WIDTH]; BATCH],
            dense: false,
        }
    }

    /// Computes the kernel values of the points at `places`, at most [`BATCH`] of them.
    pub(crate) fn fill(&mut self, layout: Layout, kernel: &Kernel, points: &Points, places: Range<usize>) {
        self.fill_at(layout, kernel, &points.cells[places.clone()], &points.fractions[places]);
    }

    /// Computes the kernel values of points in these cells, at most [`BATCH`] of them, at these positions in them.
    pub(crate) fn fill_at(&mut self, layout: Layout, kernel: &Kernel, cells: &[[u32; 2]], fractions: &[[f64; 2]]) {
        let (mut row_arguments, mut column_arguments) = ([0.0; BATCH], [0.0; BATCH]);
        let count = cells.len();
        for (i, (&[row, column], &[row_fraction, column_fraction])) in cells.iter().zip(fractions).enumerate() {
            let (first, argument) = kernel.place(row, row_fraction);
            (self.rows[i], row_arguments[i]) = (first.wrapping_add_unsigned(layout.margin) as usize, argument);
            let (first, argument) = kernel.place(column, column_fraction);
            (self.columns[i], column_arguments[i]) = (first.wrapping_add_unsigned(MARGIN) as usize, argument);
        }
        kernel.values(&row_arguments[..count], &mut self.row_values[..count]);
        kernel.values(&column_arguments[..count], &mut self.column_values[..count]);
        self.dense = 2 * (1..count).filter(|&i| self.corner(i) == self.corner(i - 1)).count() >= count.max(1);
    }

    /// Row and column of the first grid value under a point's kernel.
    #[inline(always)]
    pub(crate) fn corner(&self, point: usize) -> [usize; 2] {
        [self.rows[point], self.columns[point]]
    }
}

/// Interpolates the batch's points from `grid`, whose first row is row `first_row`: (points, channels) row-major.
pub(crate) fn interpolate_batch(
    layout: Layout,
    grid: &[f64],
    first_row: usize,
    kernel: &Kernel,
    batch: &Batch,
    values: &mut [f64],
) {
    if batch.dense {
        return interpolate_cells(layout, grid, first_row, kernel, batch, values);
    }
    for channel in (0..layout.channels).step_by(3) {
        match (kernel.padded, layout.channels - channel) {
            (4 | 8, 1) => interpolate_8_1(layout, grid, first_row, kernel.width, batch, values, channel),
            (4 | 8, 2) => interpolate_8_2(layout, grid, first_row, kernel.width, batch, values, channel),
            (4 | 8, _) => interpolate_8_3(layout, grid, first_row, kernel.width, batch, values, channel),
            (12, 1) => interpolate_12_1(layout, grid, first_row, kernel.width, batch, values, channel),
            (12, 2) => interpolate_12_2(layout, grid, first_row, kernel.width, batch, values, channel),
            (12, _) => interpolate_12_3(layout, grid, first_row, kernel.width, batch, values, channel),
            (_, 1) => interpolate_16_1(layout, grid, first_row, kernel.width, batch, values, channel),
            (_, 2) => interpolate_16_2(layout, grid, first_row, kernel.width, batch, values, channel),
            _ => interpolate_16_3(layout, grid, first_row, kernel.width, batch, values, channel),
        }
    }
}

/// Adds the values of the batch's points, (points, channels) row-major, to `grid`, whose first row is row `first_row`.
pub(crate) fn spread_batch(
    layout: Layout,
    grid: &mut [f64],
    first_row: usize,
    kernel: &Kernel,
    batch: &Batch,
    values: &[f64],
) {
    if batch.dense {
        return spread_cells(layout, grid, first_row, kernel, batch, values);
    }
    for channel in (0..layout.channels).step_by(3) {
        match (kernel.padded, layout.channels - channel) {
            (4 | 8, 1) => spread_8_1(layout, grid, first_row, kernel.width, batch, values, channel),
            (4 | 8, 2) => spread_8_2(layout, grid, first_row, kernel.width, batch, values, channel),
            (4 | 8, _) => spread_8_3(layout, grid, first_row, kernel.width, batch, values, channel),
            (12, 1) => spread_12_1(layout, grid, first_row, kernel.width, batch, values, channel),
            (12, 2) => spread_12_2(layout, grid, first_row, kernel.width, batch, values, channel),
            (12, _) => spread_12_3(layout, grid, first_row, kernel.width, batch, values, channel),
            (_, 1) => spread_16_1(layout, grid, first_row, kernel.width, batch, values, channel),
            (_, 2) => spread_16_2(layout, grid, first_row, kernel.width, batch, values, channel),
            _ => spread_16_3(layout, grid, first_row, kernel.width, batch, values, channel),
        }
    }
}

macro_rules! kernels_for {
    ($interpolate:ident, $spread:ident, $lanes:literal, $channels:literal) => {
        #[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
        fn $interpolate(
            layout: Layout,
            grid: &[f64],
            first_row: usize,
            width: usize,
            batch: &Batch,
            values: &mut [f64],
            channel: usize,
        ) {
            for (point, values) in values.chunks_exact_mut(layout.channels).enumerate() {
                let sums = if target_cfg_f!(target_feature = "fma") {
                    gather::<$lanes, $channels, true>(layout, grid, first_row, width, batch, point, channel)
                } else {
                    gather::<$lanes, $channels, false>(layout, grid, first_row, width, batch, point, channel)
                };
                values[channel..channel + $channels].copy_from_slice(&sums);
            }
        }

        #[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
        fn $spread(
            layout: Layout,
            grid: &mut [f64],
            first_row: usize,
            width: usize,
            batch: &Batch,
            values: &[f64],
            channel: usize,
        ) {
            for (point, values) in values.chunks_exact(layout.channels).enumerate() {
                let mut value = [0.0; $channels];
                value.copy_from_slice(&values[channel..channel + $channels]);
                if target_cfg_f!(target_feature = "fma") {
                    scatter::<$lanes, $channels, true>(layout, grid, first_row, width, batch, point, channel, value);
                } else {
                    scatter::<$lanes, $channels, false>(layout, grid, first_row, width, batch, point, channel, value);
                }
            }
        }
    };
}
kernels_for!(interpolate_8_1, spread_8_1, 8, 1);
kernels_for!(interpolate_8_2, spread_8_2, 8, 2);
kernels_for!(interpolate_8_3, spread_8_3, 8, 3);
kernels_for!(interpolate_12_1, spread_12_1, 12, 1);
kernels_for!(interpolate_12_2, spread_12_2, 12, 2);
kernels_for!(interpolate_12_3, spread_12_3, 12, 3);
kernels_for!(interpolate_16_1, spread_16_1, 16, 1);
kernels_for!(interpolate_16_2, spread_16_2, 16, 2);
kernels_for!(interpolate_16_3, spread_16_3, 16, 3);

/// Values of C channels at one point.
#[inline(always)]
fn gather<const W: usize, const C: usize, const FMA: bool>(
    layout: Layout,
    grid: &[f64],
    first_row: usize,
    width: usize,
    batch: &Batch,
    point: usize,
    channel: usize,
) -> [f64; C] {
    let mut sums = [[0.0; W]; C];
    let start = (batch.rows[point] - first_row) * layout.row() + channel * layout.stride + batch.columns[point];
    let rows = grid[start..].chunks_exact(layout.row());
    for (weight, row) in batch.row_values[point][..width].iter().zip(rows) {
        let mut lines = row.chunks(layout.stride);
        for sums in &mut sums {
            let Some(line) = lines.next().and_then(|line| line.first_chunk::<W>()) else { break };
            for (sum, value) in sums.iter_mut().zip(line) {
                *sum = fused::<FMA>(*weight, *value, *sum);
            }
        }
    }
    // Loops throughout: a closure that isn't inlined is compiled for the oldest processor.
    let columns = &batch.column_values[point];
    let mut result = [0.0; C];
    for (result, sums) in result.iter_mut().zip(&sums) {
        let mut four = [0.0; 4];
        for (columns, sums) in columns.chunks_exact(4).zip(sums.chunks_exact(4)) {
            for i in 0..4 {
                four[i] = fused::<FMA>(columns[i], sums[i], four[i]);
            }
        }
        *result = (four[0] + four[2]) + (four[1] + four[3]);
    }
    result
}

/// Adds values of C channels at one point to the grid.
#[inline(always)]
#[allow(clippy::too_many_arguments, reason = "a kernel")]
fn scatter<const W: usize, const C: usize, const FMA: bool>(
    layout: Layout,
    grid: &mut [f64],
    first_row: usize,
    width: usize,
    batch: &Batch,
    point: usize,
    channel: usize,
    value: [f64; C],
) {
    let mut columns = [[0.0; W]; C];
    for (columns, value) in columns.iter_mut().zip(value) {
        for (scaled, column) in columns.iter_mut().zip(&batch.column_values[point]) {
            *scaled = value * column;
        }
    }
    let start = (batch.rows[point] - first_row) * layout.row() + channel * layout.stride + batch.columns[point];
    // The last row of a strip's kernels ends with its grid: it isn't whole, and counts.
    let rows = grid[start..].chunks_mut(layout.row());
    for (weight, row) in batch.row_values[point][..width].iter().zip(rows) {
        let mut lines = row.chunks_mut(layout.stride);
        for columns in &columns {
            let Some(line) = lines.next().and_then(|line| line.first_chunk_mut::<W>()) else { break };
            for (value, column) in line.iter_mut().zip(columns) {
                *value = fused::<FMA>(*weight, *column, *value);
            }
        }
    }
}
