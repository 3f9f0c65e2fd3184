//! Sums the kernels of a node's samples to the node's patch (see [`nodal`](super)). Each [piece](super::incidence) of a
//! patch is computed by a small matrix product in registers.

use multiversion::{multiversion, target::target_cfg_f};

use super::patches::{COLUMNS, ROWS};
use crate::batch::{BATCH, Batch};
use crate::kernel::MAX_WIDTH;
use crate::lanes::{fused, load};

/// Kernels of some samples over the rows of a strip and the columns of a piece of a node's patch, with space for the
/// parts of kernels that extend beyond these rows and columns.
pub(super) struct Kernels {
    pub(super) batch: Batch,
    /// For each sample of a node, the kernel's values at the strip's rows, multiplied by the node's share in the
    /// sample's value and by the sample's weight.
    rows: [[f64; MAX_WIDTH + ROWS + MAX_WIDTH]; BATCH],
    columns: [[f64; MAX_WIDTH + COLUMNS + MAX_WIDTH]; BATCH],
}

impl Kernels {
    pub(super) fn new() -> Self {
        Self {
            batch: Batch::new(),
            rows: [[0.0; MAX_WIDTH + ROWS + MAX_WIDTH]; BATCH],
            columns: [[0.0; MAX_WIDTH + COLUMNS + MAX_WIDTH]; BATCH],
        }
    }

    /// Copies the batch's kernel values into `rows` and `columns`, so that each kernel starts at its corner. A corner
    /// is a row of the grid's strip and a column of the patch's piece; both may be negative. The values in `rows` are
    /// multiplied by `counts`.
    pub(super) fn shift(&mut self, corners: &[[isize; 2]], counts: &[f64]) {
        for (i, (&[down, along], count)) in corners.iter().zip(counts).enumerate() {
            let at = |from: isize| MAX_WIDTH.saturating_add_signed(from);
            self.rows[i] = [0.0; MAX_WIDTH + ROWS + MAX_WIDTH];
            self.columns[i] = [0.0; MAX_WIDTH + COLUMNS + MAX_WIDTH];
            if let Some(rows) = self.rows[i][at(down)..].first_chunk_mut::<MAX_WIDTH>() {
                *rows = self.batch.row_values[i].map(|value| count * value);
            }
            if let Some(columns) = self.columns[i][at(along)..].first_chunk_mut::<MAX_WIDTH>() {
                *columns = self.batch.column_values[i];
            }
        }
    }
}

/// Adds the first `count` of the kernels to consecutive rows of a node's piece (see the [module](self)). The i-th of
/// these rows is row `first_row + i` of the strip of the grid, and is stored in `values` at index `places[i]`.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
pub(super) fn add_kernels(
    kernels: &Kernels,
    count: usize,
    first_row: usize,
    places: &[u32],
    values: &mut [[f64; COLUMNS]],
) {
    let mut done = 0;
    while done < places.len() {
        let (row, places) = (first_row + done, &places[done..]);
        let fma = target_cfg_f!(any(target_feature = "fma", target_arch = "aarch64"));
        // The number of rows processed together is limited by the registers for their sums.
        done += match (target_cfg_f!(target_feature = "avx512f"), fma, places.len()) {
            (true, _, 8..) => add_to_rows::<8, true>(kernels, count, row, places, values),
            (_, true, 2..) => add_to_rows::<2, true>(kernels, count, row, places, values),
            (_, true, _) => add_to_rows::<1, true>(kernels, count, row, places, values),
            _ => add_to_rows::<1, false>(kernels, count, row, places, values),
        };
    }
}

/// Adds kernels to R rows. Returns R.
#[inline(always)]
fn add_to_rows<const R: usize, const FMA: bool>(
    kernels: &Kernels,
    count: usize,
    row: usize,
    places: &[u32],
    values: &mut [[f64; COLUMNS]],
) -> usize {
    let mut sums = [[0.0; COLUMNS]; R];
    for (sums, &place) in sums.iter_mut().zip(places) {
        *sums = values[place as usize];
    }
    for (rows, columns) in kernels.rows[..count].iter().zip(&kernels.columns) {
        let rows: [f64; R] = load(rows, MAX_WIDTH + row);
        let columns: [f64; COLUMNS] = load(columns, MAX_WIDTH);
        // The inner loop runs over rows. With the loops exchanged, the compiler emits gather instructions.
        for (k, column) in columns.iter().enumerate() {
            for (sums, row) in sums.iter_mut().zip(&rows) {
                sums[k] = fused::<FMA>(*row, *column, sums[k]);
            }
        }
    }
    for (sums, &place) in sums.iter().zip(places) {
        values[place as usize] = *sums;
    }
    R
}
