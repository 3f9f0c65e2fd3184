//! Multiplies the kernel values of a batch of points with the grid.
//!
//! There is a separate function for every padded kernel width and for one, two and three channels, so that the sums
//! over a point's neighbourhood stay in registers. Batches in which many points share a cell are passed to
//! [`interpolation_cells`](crate::interpolation_cells).

use multiversion::{multiversion, target::target_cfg_f};

use crate::batch::Batch;
use crate::grid::Layout;
use crate::interpolation_cells::{interpolate_cells, spread_cells};
use crate::kernel::Kernel;
use crate::lanes::fused;

/// Interpolates from `grid`, whose first row has index `first_row`, to the batch's points, and writes the results to
/// `values` (points, channels), row-major.
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

/// Spreads the values (points, channels) at the batch's points, row-major, to `grid`, whose first row has index
/// `first_row`.
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
                let sums = if target_cfg_f!(any(target_feature = "fma", target_arch = "aarch64")) {
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
                if target_cfg_f!(any(target_feature = "fma", target_arch = "aarch64")) {
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

/// Returns the values of C channels at one point.
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
    // Only loops are used, because a closure that isn't inlined is compiled for the oldest supported processor.
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

/// Spreads the values of C channels at one point to the grid.
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
    // The last grid row under a kernel may be cut short by the end of the strip's grid. `chunks_mut` still returns this
    // shorter row.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::MAX_WIDTH;

    /// Compares the results for points of three cells, in runs of one to nine points, with the results for each point
    /// by itself.
    #[test]
    fn points_of_a_cell_are_as_points_by_themselves() {
        for (width, channels) in [(4, 1), (7, 2), (8, 5), (11, 3), (12, 4), (14, 1), (16, 3)] {
            let kernel = Kernel::new(width, 10, 64, 1e-12);
            let layout = Layout::new(64, MAX_WIDTH, channels);
            let cells: Vec<[u32; 2]> = [(1, [9, 20]), (6, [9, 21]), (9, [12, 3]), (2, [9, 20])]
                .iter()
                .flat_map(|&(n, cell)| vec![cell; n])
                .collect();
            let fraction = |i: usize, k: usize| (0.137 * ((i + 1) * (k + 3)) as f64).fract();
            let fractions: Vec<[f64; 2]> = (0..cells.len()).map(|i| [fraction(i, 0), fraction(i, 1)]).collect();
            let values: Vec<f64> = (0..cells.len() * channels).map(|i| (i as f64 * 0.7).sin()).collect();
            let grid: Vec<f64> = (0..layout.len()).map(|i| (i as f64 * 0.3).cos()).collect();
            let mut together = Batch::new();
            together.fill_at(layout, &kernel, &cells, &fractions);
            let (mut sums, mut found) = (vec![0.0; layout.len()], vec![0.0; values.len()]);
            spread_cells(layout, &mut sums, 0, &kernel, &together, &values);
            interpolate_cells(layout, &grid, 0, &kernel, &together, &mut found);
            let (mut expected_sums, mut expected) = (vec![0.0; layout.len()], vec![0.0; values.len()]);
            for i in 0..cells.len() {
                let mut one = Batch::new();
                one.fill_at(layout, &kernel, &cells[i..=i], &fractions[i..=i]);
                let own = i * channels..(i + 1) * channels;
                spread_batch(layout, &mut expected_sums, 0, &kernel, &one, &values[own.clone()]);
                interpolate_batch(layout, &grid, 0, &kernel, &one, &mut expected[own]);
            }
            let largest = |values: &[f64]| values.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
            for (found, expected) in [(&sums, &expected_sums), (&found, &expected)] {
                let off: Vec<f64> = found.iter().zip(expected).map(|(found, expected)| found - expected).collect();
                let scale = largest(expected);
                assert!(
                    scale > 0.0 && largest(&off) < 1e-13 * scale,
                    "{width} {channels}: {} of {scale}",
                    largest(&off)
                );
            }
        }
    }
}
