//! Blocks of samples, placed on the fine grid and sorted by strips.

use crate::points::place;
use crate::sample_sums::griddings::Griddings;
use crate::sample_sums::occupied::Occupied;

/// Samples of a block: with their places they fit the L2 cache.
pub(super) const BLOCK: usize = 1 << 14;

/// Samples with weight, sorted by the strips of the grids.
#[derive(Debug)]
pub(super) struct Block {
    /// Samples of the block, those without weight among them.
    pub(super) rows: usize,
    /// Row and column of the cell of the fine grid.
    pub(super) cells: Vec<[u32; 2]>,
    /// Position in the cell along rows and columns, in [0, 1).
    pub(super) fractions: Vec<[f64; 2]>,
    /// Weight and weighted values of each sample, (samples, 1 + c) row-major.
    pub(super) values: Vec<f64>,
    /// First sample of each strip, and at the end the number of samples.
    pub(super) first: Vec<u32>,
    /// Sum of the weights.
    pub(super) weight: f64,
    /// `sum w f^2` of each channel.
    pub(super) squares: Vec<f64>,
}

impl Block {
    /// Places and sorts samples, and marks where they are. `values` is (samples, c) row-major.
    pub(super) fn new(
        directions: &[[f64; 3]],
        weights: Option<&[f64]>,
        values: &[f64],
        channels: usize,
        griddings: &Griddings,
        occupied: &Occupied,
    ) -> Self {
        let (grid, rows) = (griddings.both[0].grid, griddings.rows_together());
        let weight = |i: usize| weights.map_or(1.0, |weights| weights[i]);
        let mut places = Vec::with_capacity(directions.len());
        let mut first = vec![0u32; griddings.strips() + 1];
        let (mut total, mut squares) = (0.0, vec![0.0; channels]);
        for (i, &[x, y, z]) in directions.iter().enumerate() {
            let w = weight(i);
            if w == 0.0 {
                continue;
            }
            let (row, row_fraction) = place(z, (x * x + y * y).sqrt(), grid);
            let (column, column_fraction) = place(x, y, grid);
            occupied.mark([row, column], [row_fraction, column_fraction], grid);
            first[row as usize / rows + 1] += 1;
            places.push((i as u32, [row, column], [row_fraction, column_fraction]));
            total += w;
            for (square, f) in squares.iter_mut().zip(&values[i * channels..(i + 1) * channels]) {
                *square += w * f * f;
            }
        }
        for strip in 1..first.len() {
            first[strip] += first[strip - 1];
        }
        let count = places.len();
        let mut block = Self {
            rows: directions.len(),
            cells: vec![[0; 2]; count],
            fractions: vec![[0.0; 2]; count],
            values: vec![0.0; count * (1 + channels)],
            first: Vec::new(),
            weight: total,
            squares,
        };
        let mut next = first.clone();
        for (i, cell, fraction) in places {
            let i = i as usize;
            let next = &mut next[cell[0] as usize / rows];
            let at = *next as usize;
            *next += 1;
            (block.cells[at], block.fractions[at]) = (cell, fraction);
            let w = weight(i);
            let [out_weight, out @ ..] = &mut block.values[at * (1 + channels)..(at + 1) * (1 + channels)] else {
                continue;
            };
            *out_weight = w;
            for (out, f) in out.iter_mut().zip(&values[i * channels..(i + 1) * channels]) {
                *out = w * f;
            }
        }
        block.first = first;
        block
    }

    /// Number of samples with weight.
    pub(super) fn len(&self) -> usize {
        self.cells.len()
    }
}
