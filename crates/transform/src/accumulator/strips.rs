//! Spreads blocks of samples to the fine and the coarse grid, strip by strip.

use std::iter::repeat_with;
use std::ops::Range;

use rayon::prelude::*;

use crate::accumulator::blocks::Block;
use crate::accumulator::griddings::Griddings;
use crate::accumulator::occupied::Occupied;
use crate::batch::{BATCH, Batch};
use crate::grid::Layout;
use crate::interpolation_batch::spread_batch;
use crate::kernel::Kernel;
use crate::points::CellSorter;

/// Marks the cells of all blocks' samples and adds the samples to the grids, in an order that doesn't depend on the
/// number of threads.
pub(super) fn spread(
    griddings: &Griddings,
    channels: usize,
    kernels: &[Kernel; 2],
    [fine, coarse]: &mut [Vec<f64>; 2],
    blocks: &[Block],
    occupied: &Occupied,
) {
    let layouts = griddings.layouts(channels);
    let heights = [griddings.rows_together(), griddings.rows_together() / 2];
    // The rows of every second strip don't overlap, so different threads can process these strips at the same time.
    for colour in 0..2 {
        let rows = |i: usize| heights[i] * layouts[i].row();
        let fine = fine[colour * rows(0)..].chunks_mut(2 * rows(0));
        // Without channels the coarse grid is empty, and nothing is spread to it.
        let coarse = coarse[colour * rows(1)..].chunks_mut((2 * rows(1)).max(1)).chain(repeat_with(Default::default));
        let mut tasks: Vec<_> = fine
            .zip(coarse)
            .enumerate()
            .map(|(i, (fine, coarse))| (2 * i + colour, [fine, coarse]))
            .filter(|(strip, _)| *strip < griddings.strips())
            .map(|(strip, grids)| (count(blocks, strip), strip, grids))
            .filter(|(count, ..)| *count > 0)
            .collect();
        // The longest tasks come first, so that no thread starts a long task at the end.
        tasks.sort_by_key(|(count, ..)| std::cmp::Reverse(*count));
        tasks.into_par_iter().with_max_len(1).for_each_init(Gathered::default, |gathered, (_, strip, grids)| {
            gathered.gather(blocks, strip, channels, layouts[0].around, heights[0]);
            occupied.mark(&gathered.cells, &gathered.fractions, layouts[0].around);
            let firsts = [strip * heights[0], strip * heights[1]];
            gathered.spread(layouts, firsts, kernels, grids);
        });
    }
}

fn run(block: &Block, strip: usize) -> Range<usize> {
    block.first[strip] as usize..block.first[strip + 1] as usize
}

fn count(blocks: &[Block], strip: usize) -> usize {
    blocks.iter().map(|block| run(block, strip).len()).sum()
}

/// The samples of one strip, sorted by cell, or by tile of columns if there are few samples.
#[derive(Default)]
struct Gathered {
    cells: Vec<[u32; 2]>,
    fractions: Vec<[f64; 2]>,
    weights: Vec<f64>,
    /// Weighted values (samples, c), row-major.
    values: Vec<f64>,
    sorter: CellSorter,
}

impl Gathered {
    fn gather(&mut self, blocks: &[Block], strip: usize, channels: usize, around: usize, rows: usize) {
        let count = count(blocks, strip);
        self.cells.resize(count, [0; 2]);
        self.fractions.resize(count, [0.0; 2]);
        self.weights.resize(count, 0.0);
        self.values.resize(count * channels, 0.0);
        let samples = blocks.iter().flat_map(|block| run(block, strip).map(move |sample| (block, sample)));
        let Self { cells, fractions, weights, values, sorter } = self;
        let cell = |(block, sample): &(&Block, usize)| block.cells[*sample];
        let rows = strip * rows..(strip + 1) * rows;
        sorter.sort(around, rows, count, samples, cell, |(block, sample), at| {
            let found = &block.values[sample * (1 + channels)..(sample + 1) * (1 + channels)];
            (cells[at], fractions[at], weights[at]) = (block.cells[sample], block.fractions[sample], found[0]);
            values[at * channels..(at + 1) * channels].copy_from_slice(&found[1..]);
        });
    }

    /// Spreads the samples to rows of the fine grid and to rows of the coarse grid; `firsts` are the indices of the
    /// first rows.
    fn spread(
        &mut self,
        layouts: [Layout; 2],
        firsts: [usize; 2],
        kernels: &[Kernel; 2],
        [fine, coarse]: [&mut [f64]; 2],
    ) {
        let channels = layouts[1].channels;
        let mut batch = Batch::new();
        for at in (0..self.cells.len()).step_by(BATCH) {
            let end = self.cells.len().min(at + BATCH);
            let (cells, fractions) = (&mut self.cells[at..end], &mut self.fractions[at..end]);
            batch.fill_at(layouts[0], &kernels[0], cells, fractions);
            spread_batch(layouts[0], fine, firsts[0], &kernels[0], &batch, &self.weights[at..end]);
            if channels == 0 {
                continue;
            }
            for (cell, fraction) in cells.iter_mut().zip(fractions.iter_mut()) {
                for (cell, fraction) in cell.iter_mut().zip(fraction) {
                    // Position in the cell of the coarse grid, which is twice as large.
                    *fraction = 0.5 * (f64::from(*cell % 2) + *fraction);
                    *cell /= 2;
                }
            }
            batch.fill_at(layouts[1], &kernels[1], cells, fractions);
            let values = &self.values[at * channels..end * channels];
            spread_batch(layouts[1], coarse, firsts[1], &kernels[1], &batch, values);
        }
    }
}
