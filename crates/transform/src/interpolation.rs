//! Interpolation from the grid to the directions, and spreading from the directions to the grid.
//!
//! A kernel covers w by w grid points. Per channel, a direction costs `w^2` fused products. In addition, each direction
//! costs two Horner schemes of about `w + 4` steps over w lanes, which all channels share. Interpolation reads `8 w^2`
//! bytes per channel and direction, and spreading reads and writes as many. These bytes are in the L1 cache, because
//! the directions are sorted.

use std::ops::Range;

use rayon::prelude::*;

use crate::batch::{BATCH, Batch};
use crate::grid::Layout;
use crate::interpolation_batch::{interpolate_batch, spread_batch};
use crate::kernel::Kernel;
use crate::points::Points;

/// Interpolates from the grid to the points, and writes the results to `values` (places, channels), row-major.
pub(crate) fn interpolate(layout: Layout, grid: &[f64], kernel: &Kernel, points: &Points, values: &mut [f64]) {
    let channels = layout.channels;
    // Number of places per task: enough to be worth a task, and few enough that every thread gets some tasks.
    const TASK: usize = 1024;
    values.par_chunks_mut(TASK * channels).enumerate().for_each_init(Batch::new, |batch, (task, values)| {
        for (i, values) in values.chunks_mut(BATCH * channels).enumerate() {
            let first = task * TASK + i * BATCH;
            batch.fill(layout, kernel, points, first..first + values.len() / channels);
            interpolate_batch(layout, grid, 0, kernel, batch, values);
        }
    });
}

/// Spreads values at the sorted points to a grid of zeros: the transpose of [`interpolate`]. `values` (points,
/// channels) is row-major.
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

/// Interpolates values from the first grid, and spreads them to the second grid, which must be zero. If `weights` are
/// given, one per sorted point, the values at each point are multiplied by its weight before they are spread. Each
/// point's kernel values are computed once.
pub(crate) fn interpolate_and_spread(
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

/// Calls `work` for each strip with its places, its first row and the rows under its kernels. Every second strip is
/// processed first, by several threads, because the rows of these strips don't overlap. Then the remaining strips are
/// processed in the same way. Sums are therefore formed in the same order on any number of threads.
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
        // The longest tasks come first, so that no thread starts a long task at the end.
        tasks.sort_by_key(|(places, ..)| std::cmp::Reverse(places.len()));
        tasks.into_par_iter().with_max_len(1).for_each(|(places, first, rows)| work(places, first, rows));
    }
}
