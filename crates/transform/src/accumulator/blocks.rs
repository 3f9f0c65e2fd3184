//! Blocks of samples, placed on the fine grid and sorted by strip.

use crate::accumulator::griddings::Griddings;
use crate::cells::{Place, place};

/// Number of samples in a block. The samples of a block and their places on the grid fit in the L2 cache.
pub(super) const BLOCK: usize = 1 << 14;

/// Samples of a block, in input order. If no weights are given, w = 1. The values are (samples, c), row-major.
#[derive(Clone, Copy)]
pub(super) struct Samples<'a> {
    pub(super) directions: &'a [[f64; 3]],
    pub(super) weights: Option<&'a [f64]>,
    pub(super) values: &'a [f64],
}

/// Samples of nonzero weight, sorted by strip of the grids.
#[derive(Debug)]
pub(super) struct Block {
    /// Number of samples of the block, including those of weight 0.
    pub(super) rows: usize,
    /// Row and column of each sample's cell in the fine grid.
    pub(super) cells: Vec<[u32; 2]>,
    /// Position of each sample in its cell, along rows and columns, in [0, 1).
    pub(super) fractions: Vec<[f64; 2]>,
    /// Weight and weighted values (samples, 1 + c) of each sample, row-major.
    pub(super) values: Vec<f64>,
    /// Index of the first sample of each strip, followed by the number of samples.
    pub(super) first: Vec<u32>,
    /// Sum of the weights.
    pub(super) weight: f64,
    /// Weighted sum of squares, `sum w f^2`, of each channel.
    pub(super) squares: Vec<f64>,
}

impl Block {
    /// Creates an empty block of samples with `channels` channels.
    pub(super) fn new(channels: usize) -> Self {
        let squares = vec![0.0; channels];
        let (cells, fractions, values, first) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        Self { rows: 0, cells, fractions, values, first, weight: 0.0, squares }
    }

    /// Places and sorts samples. The previous contents of the block are lost; its memory is reused.
    pub(super) fn fill(
        &mut self,
        Samples { directions, weights, values }: Samples<'_>,
        griddings: &Griddings,
        places: &mut Vec<Place>,
    ) {
        let channels = self.squares.len();
        let (grid, rows) = (griddings.both[0].grid, griddings.rows_together());
        let weight = |i: usize| weights.map_or(1.0, |weights| weights[i]);
        let refill = |list: &mut Vec<u32>| {
            list.clear();
            list.resize(griddings.strips() + 1, 0);
        };
        refill(&mut self.first);
        (self.rows, self.weight) = (directions.len(), 0.0);
        self.squares.fill(0.0);
        places.resize(directions.len(), ([0; 2], [0.0; 2]));
        place(directions, grid, places);
        let mut count = 0;
        for (i, (cell, _)) in places.iter().enumerate() {
            let w = weight(i);
            if w == 0.0 {
                continue;
            }
            self.first[cell[0] as usize / rows + 1] += 1;
            count += 1;
            self.weight += w;
            for (square, f) in self.squares.iter_mut().zip(&values[i * channels..(i + 1) * channels]) {
                *square += w * f * f;
            }
        }
        for strip in 1..self.first.len() {
            self.first[strip] += self.first[strip - 1];
        }
        self.cells.resize(count, [0; 2]);
        self.fractions.resize(count, [0.0; 2]);
        self.values.resize(count * (1 + channels), 0.0);
        let mut next = self.first.clone();
        for (i, &(cell, fraction)) in places.iter().enumerate() {
            let w = weight(i);
            if w == 0.0 {
                continue;
            }
            let next = &mut next[cell[0] as usize / rows];
            let at = *next as usize;
            *next += 1;
            (self.cells[at], self.fractions[at]) = (cell, fraction);
            let out = &mut self.values[at * (1 + channels)..(at + 1) * (1 + channels)];
            out[0] = w;
            for (out, f) in out[1..].iter_mut().zip(&values[i * channels..(i + 1) * channels]) {
                *out = w * f;
            }
        }
    }

    /// Returns the number of samples of nonzero weight.
    pub(super) fn len(&self) -> usize {
        self.cells.len()
    }
}
