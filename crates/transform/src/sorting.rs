//! Reorders samples from the caller's order of the directions to the order of the places, in which directions are
//! sorted by grid cells, and back.
//!
//! Directions come in any order, so each value is read from a different location. Speed depends on the number of these
//! reads in flight at once, and on reading the cache lines of a row only once for all groups of channels.

use std::sync::atomic::{AtomicU32, Ordering};

/// Number of rows that are processed for all groups of channels before the next rows. The data read for these rows stay
/// in the L1 cache.
const ROWS: usize = 64;

/// Consecutive groups of channels.
#[derive(Clone, Copy)]
pub(crate) struct Columns {
    /// Index of the first channel of the first group.
    pub(crate) first: usize,
    /// Number of channels of each group.
    pub(crate) count: usize,
}

/// Fills an array (rows, channels of the group) for each group of channels. `order` lists the direction of each row.
/// `fill` writes the values of a direction, starting from a given channel.
pub(crate) fn sort(
    order: &[u32],
    columns: Columns,
    groups: &mut [&mut [f64]],
    fill: &impl Fn(usize, usize, &mut [f64]),
) {
    let Columns { first, count } = columns;
    for (chunk, order) in order.chunks(ROWS).enumerate() {
        for (group, rows) in groups.iter_mut().enumerate() {
            let rows = &mut rows[chunk * ROWS * count..][..order.len() * count];
            let column = first + group * count;
            match count {
                1 => sort_rows(order, column, rows.as_chunks_mut::<1>().0, fill),
                2 => sort_rows(order, column, rows.as_chunks_mut::<2>().0, fill),
                3 => sort_rows(order, column, rows.as_chunks_mut::<3>().0, fill),
                _ => {
                    for (row, direction) in rows.chunks_exact_mut(count).zip(order) {
                        fill(*direction as usize, column, row);
                    }
                }
            }
        }
    }
}

/// Sorts rows whose length is known to the compiler, so that the loops are a few instructions long.
#[inline(always)]
fn sort_rows<const C: usize>(
    order: &[u32],
    column: usize,
    rows: &mut [[f64; C]],
    fill: &impl Fn(usize, usize, &mut [f64]),
) {
    for (row, direction) in rows.iter_mut().zip(order) {
        fill(*direction as usize, column, row);
    }
}

/// Copies values from `groups`, which are in sorted order, to `samples`, the rows of a run of directions with
/// `channels` values each. Each group has `length` values: a row for each place, with the group's channels.
pub(crate) fn unsort(
    ranks: &[AtomicU32],
    columns: Columns,
    groups: &[f64],
    length: usize,
    samples: &mut [f64],
    channels: usize,
) {
    let Columns { first, count } = columns;
    for (ranks, samples) in ranks.chunks(ROWS).zip(samples.chunks_mut(ROWS * channels)) {
        for (group, sorted) in groups.chunks_exact(length.max(1)).enumerate() {
            let columns = Columns { first: first + group * count, count };
            match count {
                1 => unsort_rows(ranks, columns, sorted.as_chunks::<1>().0, samples, channels),
                2 => unsort_rows(ranks, columns, sorted.as_chunks::<2>().0, samples, channels),
                3 => unsort_rows(ranks, columns, sorted.as_chunks::<3>().0, samples, channels),
                _ => {
                    for (row, rank) in samples.chunks_exact_mut(channels).zip(ranks) {
                        let at = rank.load(Ordering::Relaxed) as usize * count;
                        row[columns.first..][..count].copy_from_slice(&sorted[at..at + count]);
                    }
                }
            }
        }
    }
}

#[inline(always)]
fn unsort_rows<const C: usize>(
    ranks: &[AtomicU32],
    columns: Columns,
    sorted: &[[f64; C]],
    samples: &mut [f64],
    channels: usize,
) {
    for (row, rank) in samples.chunks_exact_mut(channels).zip(ranks) {
        row[columns.first..][..C].copy_from_slice(&sorted[rank.load(Ordering::Relaxed) as usize]);
    }
}
