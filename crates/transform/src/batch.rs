//! Computes the kernel values of a batch of points, and the points' places on the grid.

use std::ops::Range;

use crate::grid::{Layout, MARGIN};
use crate::kernel::{Kernel, MAX_WIDTH};
use crate::points::Points;

/// Number of points whose kernel values are computed together.
pub(crate) const BATCH: usize = 32;

/// Kernel values of at most [`BATCH`] points, and row and column of the first grid value under each point's kernel.
pub(crate) struct Batch {
    pub(crate) rows: [usize; BATCH],
    pub(crate) columns: [usize; BATCH],
    pub(crate) row_values: [[f64; MAX_WIDTH]; BATCH],
    pub(crate) column_values: [[f64; MAX_WIDTH]; BATCH],
    /// Whether at least every second point's kernel covers the same grid points as the kernel of the previous point.
    pub(crate) dense: bool,
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

    /// Computes the kernel values of at most [`BATCH`] points, given by their cells and by their positions in these
    /// cells.
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
        // Narrow kernels read and write few grid values, so they gain nothing if successive points share a cell.
        self.dense = kernel.padded > 8
            && 2 * (1..count).filter(|&i| self.corner(i) == self.corner(i - 1)).count() >= count.max(1);
    }

    /// Returns row and column of the first grid value under a point's kernel.
    #[inline(always)]
    pub(crate) fn corner(&self, point: usize) -> [usize; 2] {
        [self.rows[point], self.columns[point]]
    }
}
