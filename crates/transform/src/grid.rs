//! The oversampled grid of real values, with margins.
//!
//! Rows are colatitudes `2 pi i / M`, `i = 0..=M/2`, columns are azimuths `2 pi k / M`. Rows and columns have margins,
//! so that a kernel near an edge needs no special case. A margin row beyond a pole copies the row at the same distance
//! on the near side of the pole, shifted by half a turn; a margin column copies the column a full turn away. The values
//! of all channels of a row are contiguous: (rows, channels, columns).

use std::ops::Range;

use rayon::prelude::*;

use crate::kernel::MAX_WIDTH;

/// Number of margin columns before the first column: half the width of the widest kernel.
pub(crate) const MARGIN: usize = MAX_WIDTH / 2;

/// Sizes of a grid, and the memory layout of its rows and columns.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Layout {
    /// Number of columns without margins, M: grid points around the sphere.
    pub(crate) around: usize,
    pub(crate) channels: usize,
    /// Number of values from one channel of a row to the next.
    pub(crate) stride: usize,
    /// Number of margin rows before the first row, and also after the last row.
    pub(crate) margin: usize,
    /// Number of rows per strip. Points are sorted by strip, and strips are distributed among threads.
    pub(crate) strip: usize,
}

impl Layout {
    /// Lays out a grid for kernels of `width` points.
    pub(crate) fn new(around: usize, width: usize, channels: usize) -> Self {
        let columns = (around + MARGIN + MAX_WIDTH + 1).next_multiple_of(8);
        // A stride of an odd number of cache lines prevents the same column of successive rows from mapping to a few
        // sets of the cache.
        let stride = if (columns / 8).is_multiple_of(2) { columns + 8 } else { columns };
        let margin = width.div_ceil(2);
        // Kernels of a strip's points extend beyond the strip by one margin on either side: with its margins, a strip
        // is twice as high.
        Self { around, channels, stride, margin, strip: 2 * margin }
    }

    /// Returns the number of rows from pole to pole, without margins.
    pub(crate) fn core_rows(&self) -> usize {
        self.around / 2 + 1
    }

    /// Returns the number of values of a row, with margins.
    pub(crate) fn row(&self) -> usize {
        self.channels * self.stride
    }

    /// Returns the number of values of the grid, with margins.
    pub(crate) fn len(&self) -> usize {
        // With the additional row, a slice of the length of a row can start at any column of the last row.
        (self.core_rows().next_multiple_of(self.strip) + self.strip + 1) * self.row()
    }

    /// Returns the rows (channels, columns) of a grid from pole to pole, `count` at a time, with margin columns.
    pub(crate) fn core_mut<'a>(&self, grid: &'a mut [f64], count: usize) -> rayon::slice::ChunksMut<'a, f64> {
        grid[self.margin * self.row()..][..self.core_rows() * self.row()].par_chunks_mut(count * self.row())
    }

    /// Returns the index range of a channel's columns, without margins, in rows from [`core_mut`](Self::core_mut).
    pub(crate) fn line(&self, row: usize, channel: usize) -> Range<usize> {
        let start = row * self.row() + channel * self.stride + MARGIN;
        start..start + self.around
    }

    /// Returns, for each line beyond a pole, the start of the line and the start of the line that it copies.
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

    /// Fills the margins with copies of the corresponding grid values.
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

    /// Applies the transpose of [`extend`](Self::extend): adds the margins to the corresponding grid values.
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
