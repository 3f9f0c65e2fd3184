//! The oversampled grid of real values, and interpolation between it and the directions.
//!
//! Rows are colatitudes `2 pi i / M`, `i = 0..=M/2`, columns azimuths `2 pi k / M`; both have margins, so that a kernel
//! near an edge needs no special case. A row of the margin over a pole is the row as far below it, half a turn on; a
//! column of the margin is the column a turn on. Values of all channels of a row are together: (rows, channels, columns).
//!
//! A direction costs `w^2` fused products a channel and a Horner scheme of `w + 4` steps over w lanes twice, which all
//! channels share. Interpolation reads and spreading reads and writes `8 w^2` bytes a channel, in the L1 cache, as
//! directions are sorted.

use std::ops::Range;

use multiversion::{multiversion, target::target_cfg_f};
use rayon::prelude::*;

use crate::kernel::{Kernel, MAX_WIDTH};
use crate::points::Points;

/// Columns before the first; half of the widest kernel.
const MARGIN: usize = MAX_WIDTH / 2;
/// Points whose kernel values are computed together.
const BATCH: usize = 32;

/// Sizes of a grid.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Layout {
    /// Points around.
    pub(crate) around: usize,
    pub(crate) channels: usize,
    /// Distance of a row's channels.
    stride: usize,
    /// Rows before the first and after the last.
    margin: usize,
    /// Rows of a strip of points; see [`over_strips`].
    pub(crate) strip: usize,
}

impl Layout {
    /// For kernels of `width` points.
    pub(crate) fn new(around: usize, width: usize, channels: usize) -> Self {
        let columns = (around + MARGIN + MAX_WIDTH + 1).next_multiple_of(8);
        // An odd number of cache lines, so that a column of rows doesn't fall into few sets of the cache.
        let stride = if (columns / 8).is_multiple_of(2) { columns + 8 } else { columns };
        let margin = width.div_ceil(2);
        // Kernels of a strip's points reach a margin to either side: with its margins it is two strips high.
        Self { around, channels, stride, margin, strip: 2 * margin }
    }

    /// Rows from pole to pole.
    pub(crate) fn core_rows(&self) -> usize {
        self.around / 2 + 1
    }

    /// Values of a row.
    fn row(&self) -> usize {
        self.channels * self.stride
    }

    /// Values of the grid.
    pub(crate) fn len(&self) -> usize {
        // And one row, so that rows counted from any column are whole.
        (self.core_rows().next_multiple_of(self.strip) + self.strip + 1) * self.row()
    }

    /// The rows of a grid from pole to pole, `count` at a time, each (channels, columns) with margins.
    pub(crate) fn core_mut<'a>(&self, grid: &'a mut [f64], count: usize) -> rayon::slice::ChunksMut<'a, f64> {
        grid[self.margin * self.row()..][..self.core_rows() * self.row()].par_chunks_mut(count * self.row())
    }

    /// The columns of a channel in rows that [`core_mut`](Self::core_mut) gives, without their margins.
    pub(crate) fn line(&self, row: usize, channel: usize) -> Range<usize> {
        let start = row * self.row() + channel * self.stride + MARGIN;
        start..start + self.around
    }

    /// Starts of the lines over the poles and of the lines that they are copies of.
    fn over_the_poles(&self) -> impl Iterator<Item = [usize; 2]> + use<> {
        let layout = *self;
        let last = layout.core_rows() - 1;
        (1..=layout.margin).flat_map(move |above| {
            let start = move |row: usize, channel: usize| row * layout.row() + channel * layout.stride;
            (0..layout.channels).flat_map(move |channel| {
                let line = |row| start(row, channel);
                [
                    [line(layout.margin - above), line(layout.margin + above)],
                    [line(layout.margin + last + above), line(layout.margin + last - above)],
                ]
            })
        })
    }

    /// Fills the margins from the core.
    pub(crate) fn extend(&self, grid: &mut [f64]) {
        let m = self.around;
        let wrap = |line: &mut [f64]| {
            line.copy_within(m..m + MARGIN, 0);
            line.copy_within(MARGIN..MARGIN + MAX_WIDTH + 1, MARGIN + m);
        };
        self.core_mut(grid, 1).for_each(|row| row.chunks_exact_mut(self.stride).for_each(wrap));
        for [over, core] in self.over_the_poles() {
            for k in [0, m / 2] {
                let turned = core + MARGIN + (m / 2 - k);
                grid.copy_within(turned..turned + m / 2, over + MARGIN + k);
            }
            wrap(&mut grid[over..over + self.stride]);
        }
    }

    /// The transpose of [`extend`](Self::extend): adds the margins to the values that they are copies of.
    pub(crate) fn fold(&self, grid: &mut [f64]) {
        let m = self.around;
        let unwrap = |line: &mut [f64]| {
            for k in 0..=MAX_WIDTH {
                line[MARGIN + k] += line[MARGIN + m + k];
            }
            for k in 0..MARGIN {
                line[m + k] += line[k];
            }
        };
        for [over, core] in self.over_the_poles() {
            unwrap(&mut grid[over..over + self.stride]);
            for k in 0..m {
                grid[core + MARGIN + (k + m / 2) % m] += grid[over + MARGIN + k];
            }
        }
        self.core_mut(grid, 1).for_each(|row| row.chunks_exact_mut(self.stride).for_each(unwrap));
    }
}

/// Kernel values of a few points.
struct Batch {
    rows: [usize; BATCH],
    columns: [usize; BATCH],
    row_values: [[f64; MAX_WIDTH]; BATCH],
    column_values: [[f64; MAX_WIDTH]; BATCH],
}

impl Batch {
    fn new() -> Self {
        Self {
            rows: [0; BATCH],
            columns: [0; BATCH],
            row_values: [[0.0; MAX_WIDTH]; BATCH],
            column_values: [[0.0; MAX_WIDTH]; BATCH],
        }
    }

    fn fill(&mut self, layout: Layout, kernel: &Kernel, points: &Points, places: Range<usize>) {
        let (mut row_arguments, mut column_arguments) = ([0.0; BATCH], [0.0; BATCH]);
        let count = places.len();
        for (i, place) in places.enumerate() {
            let ([row, column], [row_fraction, column_fraction]) = (points.cells[place], points.fractions[place]);
            let (first, argument) = kernel.place(row, row_fraction);
            (self.rows[i], row_arguments[i]) = (first.wrapping_add_unsigned(layout.margin) as usize, argument);
            let (first, argument) = kernel.place(column, column_fraction);
            (self.columns[i], column_arguments[i]) = (first.wrapping_add_unsigned(MARGIN) as usize, argument);
        }
        kernel.values(&row_arguments[..count], &mut self.row_values[..count]);
        kernel.values(&column_arguments[..count], &mut self.column_values[..count]);
    }
}

/// Values at the points, (places, channels) row-major, interpolated from the grid.
pub(crate) fn interpolate(layout: Layout, grid: &[f64], kernel: &Kernel, points: &Points, values: &mut [f64]) {
    let channels = layout.channels;
    // Enough places for a task to be worth it, and few enough for all threads to have some.
    const TASK: usize = 1024;
    values.par_chunks_mut(TASK * channels).enumerate().for_each_init(Batch::new, |batch, (task, values)| {
        for (i, values) in values.chunks_mut(BATCH * channels).enumerate() {
            let first = task * TASK + i * BATCH;
            batch.fill(layout, kernel, points, first..first + values.len() / channels);
            interpolate_batch(layout, grid, 0, kernel, batch, values);
        }
    });
}

/// Adds the values at the points, (places, channels) row-major, to an empty grid: the transpose of [`interpolate`].
pub(crate) fn spread(layout: Layout, grid: &mut [f64], kernel: &Kernel, points: &Points, values: &[f64]) {
    let channels = layout.channels;
    over_strips(layout, grid, points, |places, first_row, rows| {
        let mut batch = Batch::new();
        let mut at = places.start;
        while at < places.end {
            let next = (at + BATCH).min(places.end);
            batch.fill(layout, kernel, points, at..next);
            spread_batch(layout, rows, first_row, kernel, &batch, &values[at * channels..next * channels]);
            at = next;
        }
    });
}

/// Interpolates from one grid, multiplies by weights (by place, or by none), and spreads on another, empty one.
pub(crate) fn pass_on(
    layout: Layout,
    [from, to]: [&mut [f64]; 2],
    kernel: &Kernel,
    points: &Points,
    weights: Option<&[f64]>,
) {
    let channels = layout.channels;
    let from = &*from;
    over_strips(layout, to, points, |places, first_row, rows| {
        let mut batch = Batch::new();
        let mut values = vec![0.0; BATCH * channels];
        let mut at = places.start;
        while at < places.end {
            let next = (at + BATCH).min(places.end);
            let values = &mut values[..(next - at) * channels];
            batch.fill(layout, kernel, points, at..next);
            interpolate_batch(layout, from, 0, kernel, &batch, values);
            if let Some(weights) = weights {
                for (values, weight) in values.chunks_exact_mut(channels).zip(&weights[at..next]) {
                    for value in values {
                        *value *= weight;
                    }
                }
            }
            spread_batch(layout, rows, first_row, kernel, &batch, values);
            at = next;
        }
    });
}

/// Calls `work` for each strip with its places, its first row and the rows under its kernels. Those of every second
/// strip don't overlap, so that they can go to different threads, and the sums have the same order for any number of
/// them.
fn over_strips(
    layout: Layout,
    grid: &mut [f64],
    points: &Points,
    work: impl Fn(Range<usize>, usize, &mut [f64]) + Sync,
) {
    let strip = layout.strip;
    for colour in 0..2 {
        let mut tasks: Vec<(Range<usize>, usize, &mut [f64])> = grid[colour * strip * layout.row()..]
            .chunks_mut(2 * strip * layout.row())
            .enumerate()
            .filter_map(|(i, rows)| {
                let index = 2 * i + colour;
                let places = *points.strips.get(index)?..*points.strips.get(index + 1)?;
                (!places.is_empty()).then_some((places, index * strip, rows))
            })
            .collect();
        // The longest first: no thread is left with one at the end.
        tasks.sort_by_key(|(places, ..)| std::cmp::Reverse(places.len()));
        tasks.into_par_iter().with_max_len(1).for_each(|(places, first, rows)| work(places, first, rows));
    }
}

fn interpolate_batch(
    layout: Layout,
    grid: &[f64],
    first_row: usize,
    kernel: &Kernel,
    batch: &Batch,
    values: &mut [f64],
) {
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

fn spread_batch(layout: Layout, grid: &mut [f64], first_row: usize, kernel: &Kernel, batch: &Batch, values: &[f64]) {
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

#[inline(always)]
fn fused<const FMA: bool>(a: f64, b: f64, c: f64) -> f64 {
    if FMA { a.mul_add(b, c) } else { a * b + c }
}
