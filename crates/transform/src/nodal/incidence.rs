//! Lists the samples of each node, places the samples' kernels on the grid, and sums the kernels.

use std::ops::Range;

use rayon::prelude::*;

use super::kernels::{Kernels, add_kernels};
use super::patches::{COLUMNS, Patches, ROWS, Tile};
use super::samples::NodalSamples;
use crate::FINEST;
use crate::batch::BATCH;
use crate::cells::place;
use crate::grid::{Layout, MARGIN};
use crate::gridding::Gridding;
use crate::kernel::Kernel;

/// Number of directions placed by one task.
const RUN: usize = 4096;

/// Number of columns from one possible start of a piece to the next. The grid's size and its margin are multiples of
/// this number.
const STEP: usize = 8;

/// A part of a node's patch (the sum of the kernels of the node's samples), in the rows of one strip of the grid. It
/// has `COLUMNS` columns, beginning with column `COLUMNS * part` of the patch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Piece {
    /// First column of the piece in units of [`STEP`] columns, not counting the grid's margin.
    column: u32,
    node: u32,
    part: u32,
}

/// The grid points under a node's kernels.
#[derive(Debug, Clone, Copy)]
struct Extent {
    /// Index of the first row, counting the rows of the grid's margin.
    row: u32,
    rows: u32,
    /// First column, a multiple of [`STEP`] from 0 to the grid's size.
    column: u32,
    /// Number of pieces of the node's patch. Pieces beyond the grid's last column continue at its first column.
    pieces: u32,
}

impl Extent {
    /// Returns the rows within a strip, counted from the strip's first row.
    fn rows_of(&self, strip: usize) -> Range<usize> {
        let first = strip * ROWS;
        let (start, end) = (self.row as usize, (self.row + self.rows) as usize);
        start.saturating_sub(first)..end.min(first + ROWS).saturating_sub(first)
    }
}

/// A triangle with samples.
#[derive(Debug)]
pub(super) struct Element {
    pub(super) nodes: [u32; 3],
    /// Sums `sum_i w_i lambda_ij lambda_ik` over the samples i, for the corners j and k <= j, row by row. Sample i has
    /// the weight `w_i` and the barycentric coordinates `lambda_i`.
    pub(super) products: [f64; 6],
    /// Index of the triangle's first sample. Its samples end before the first sample of the next element.
    first: usize,
}

/// Samples placed on the grid, and the samples of each node.
#[derive(Debug)]
pub(super) struct Incidence {
    gridding: Gridding,
    kernel: Kernel,
    /// Row and column of each sample's cell; `fractions` contains the sample's position in the cell.
    cells: Vec<[u32; 2]>,
    fractions: Vec<[f64; 2]>,
    /// For each sample, the shares of its triangle's corners in the sample's value, times the sample's weight.
    shares: Vec<[f64; 3]>,
    elements: Vec<Element>,
    /// Position of each node's first triangle in `elements_of`.
    first: Vec<usize>,
    /// For each node and each of its triangles, the triangle's index and the node's position among the three corners.
    elements_of: Vec<(u32, u32)>,
    extents: Vec<Extent>,
    /// The pieces of the nodes' patches on each strip of the grid, from west to east.
    strips: Vec<Vec<Piece>>,
}

impl Incidence {
    pub(super) fn new(gridding: Gridding, max_degree: usize, triangles: usize, samples: usize) -> Self {
        Self {
            gridding,
            kernel: Kernel::new(gridding.width, max_degree, gridding.grid, FINEST),
            cells: Vec::with_capacity(samples),
            fractions: Vec::with_capacity(samples),
            shares: Vec::with_capacity(samples),
            elements: Vec::with_capacity(triangles),
            first: Vec::new(),
            elements_of: Vec::new(),
            extents: Vec::new(),
            strips: Vec::new(),
        }
    }

    pub(super) fn elements(&self) -> &[Element] {
        &self.elements
    }

    pub(super) fn layout(&self, channels: usize) -> Layout {
        Layout::new(self.gridding.grid, self.gridding.reach, channels)
    }

    pub(super) fn gridding(&self) -> Gridding {
        self.gridding
    }

    /// Returns the total number of values in all patches.
    pub(super) fn patch_values(&self) -> usize {
        self.extents.iter().map(|extent| extent.rows as usize * extent.pieces as usize * COLUMNS).sum()
    }

    pub(super) fn strips(&self) -> usize {
        let layout = self.layout(1);
        (layout.core_rows() + 2 * layout.margin).div_ceil(ROWS)
    }

    /// Returns the pieces on a strip.
    pub(super) fn pieces(&self, strip: usize) -> &[Piece] {
        self.strips.get(strip).map_or(&[], Vec::as_slice)
    }

    /// Adds samples, except those of weight 0.
    pub(super) fn add(&mut self, NodalSamples { directions, weights, nodes, shares }: NodalSamples<'_>) {
        const PAIRS: [(usize, usize); 6] = [(0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2)];
        let mut places = vec![([0; 2], [0.0; 2]); directions.len()];
        places.par_chunks_mut(RUN).zip(directions.par_chunks(RUN)).for_each(|(places, directions)| {
            place(directions, self.gridding.grid, places);
        });
        let samples = places.into_iter().zip(weights).zip(nodes.iter().zip(shares));
        for (((cell, fraction), &weight), (&nodes, &shares)) in samples {
            if weight == 0.0 {
                continue;
            }
            if self.elements.last().is_none_or(|last| last.nodes != nodes) {
                self.elements.push(Element { nodes, products: [0.0; 6], first: self.cells.len() });
            }
            let weighted = shares.map(|share| weight * share);
            self.cells.push(cell);
            self.fractions.push(fraction);
            self.shares.push(weighted);
            if let Some(Element { products, .. }) = self.elements.last_mut() {
                for (product, (j, k)) in products.iter_mut().zip(PAIRS) {
                    *product += weighted[j] * shares[k];
                }
            }
        }
    }

    /// Lists the triangles of each of the `nodes` nodes. For each strip of the grid, lists the pieces of the nodes'
    /// patches in this strip.
    pub(super) fn sort(&mut self, nodes: usize) {
        self.first = vec![0; nodes + 1];
        for &node in self.elements.iter().flat_map(|element| &element.nodes) {
            self.first[node as usize + 1] += 1;
        }
        for node in 0..nodes {
            self.first[node + 1] += self.first[node];
        }
        let mut next = self.first.clone();
        self.elements_of = vec![(0, 0); 3 * self.elements.len()];
        for (number, element) in (0..).zip(&self.elements) {
            for (corner, &node) in (0..).zip(&element.nodes) {
                let at = &mut next[node as usize];
                self.elements_of[*at] = (number, corner);
                *at += 1;
            }
        }
        self.extents = (0..nodes).into_par_iter().with_min_len(256).map(|node| self.extent(node)).collect();
        self.strips = vec![Vec::new(); self.strips()];
        for (node, extent) in (0..).zip(&self.extents).filter(|(_, extent)| extent.rows > 0) {
            let rows = extent.row as usize..(extent.row + extent.rows) as usize;
            let strips = rows.start / ROWS..rows.end.div_ceil(ROWS);
            for part in 0..extent.pieces {
                let column = (extent.column as usize + COLUMNS * part as usize) % self.gridding.grid / STEP;
                let piece = Piece { column: column as u32, node, part };
                self.strips[strips.clone()].iter_mut().for_each(|pieces| pieces.push(piece));
            }
        }
        self.strips.par_iter_mut().for_each(|pieces| pieces.sort_unstable());
    }

    /// Calls `found` for each sample whose value depends on a node. The arguments are the sample's index, and the
    /// node's share in the sample's value, times the sample's weight.
    #[inline]
    fn each_sample(&self, node: usize, mut found: impl FnMut(usize, f64)) {
        for &(element, corner) in &self.elements_of[self.first[node]..self.first[node + 1]] {
            let next = self.elements.get(element as usize + 1).map_or(self.cells.len(), |next| next.first);
            for sample in self.elements[element as usize].first..next {
                found(sample, self.shares[sample][corner as usize]);
            }
        }
    }

    /// Returns row and column of the first grid point under a sample's kernel. Rows are counted from the start of a
    /// margin of `margin` rows.
    fn corner(&self, sample: usize, margin: usize) -> [isize; 2] {
        let ([row, column], [across, along]) = (self.cells[sample], self.fractions[sample]);
        [self.kernel.place(row, across).0 + margin as isize, self.kernel.place(column, along).0]
    }

    fn extent(&self, node: usize) -> Extent {
        let (around, margin) = (self.gridding.grid as isize, self.layout(1).margin);
        let (mut rows, mut columns, mut origin) = ([isize::MAX, isize::MIN], [0, 0], None);
        self.each_sample(node, |sample, _| {
            let [row, column] = self.corner(sample, margin);
            rows = [rows[0].min(row), rows[1].max(row)];
            // Column offset from the first sample, along the shorter way around the sphere.
            let away = column - *origin.get_or_insert(column);
            let away = within(away + around / 2, around) - around / 2;
            columns = [columns[0].min(away), columns[1].max(away)];
        });
        let Some(origin) = origin else { return Extent { row: 0, rows: 0, column: 0, pieces: 0 } };
        let first = (origin + columns[0]).rem_euclid(around) as usize;
        let column = first / STEP * STEP;
        let width = first - column + (columns[1] - columns[0]) as usize + self.kernel.width;
        Extent {
            row: rows[0] as u32,
            rows: (rows[1] - rows[0]) as u32 + self.kernel.width as u32,
            column: column as u32,
            pieces: width.div_ceil(COLUMNS) as u32,
        }
    }

    /// Computes the patches' values for the given pieces, which are all in strip `strip`.
    pub(super) fn patches(&self, strip: usize, pieces: &[Piece], out: &mut Patches) {
        out.tiles.clear();
        out.nodes.clear();
        out.values.clear();
        let mut kernels = Kernels::new();
        for pieces in pieces.chunk_by(|a, b| a.column == b.column) {
            let rows = |piece: &Piece| self.extents[piece.node as usize].rows_of(strip);
            let mut first = [0; ROWS + 1];
            pieces.iter().flat_map(rows).for_each(|row| first[row + 1] += 1);
            first[0] = out.nodes.len() as u32;
            for row in 0..ROWS {
                first[row + 1] += first[row];
            }
            out.nodes.resize(first[ROWS] as usize, 0);
            out.values.resize(first[ROWS] as usize, [0.0; COLUMNS]);
            let mut next = first;
            for piece in pieces {
                let rows = rows(piece);
                let places = &mut next[rows.clone()];
                places.iter().for_each(|&at| out.nodes[at as usize] = piece.node);
                self.add_kernels(*piece, strip, rows.start, places, &mut kernels, &mut out.values);
                places.iter_mut().for_each(|at| *at += 1);
            }
            out.tiles.push(Tile { column: pieces[0].column as usize * STEP + MARGIN, first });
        }
    }

    /// Adds the kernels of the samples of `piece`'s node to the rows of `piece`. The i-th of these rows is row
    /// `first_row + i` of the strip, and is stored in `values` at index `places[i]`.
    fn add_kernels(
        &self,
        piece: Piece,
        strip: usize,
        first_row: usize,
        places: &[u32],
        kernels: &mut Kernels,
        values: &mut [[f64; COLUMNS]],
    ) {
        let (layout, node) = (self.layout(1), piece.node as usize);
        let (around, width) = (self.gridding.grid as isize, self.kernel.width as isize);
        let first_column = self.extents[node].column as isize;
        let first_of_piece = (COLUMNS * piece.part as usize) as isize;
        let (mut cells, mut fractions) = ([[0; 2]; BATCH], [[0.0; 2]; BATCH]);
        let (mut corners, mut counts, mut found) = ([[0; 2]; BATCH], [0.0; BATCH], 0);
        let mut add = |cells: &[[u32; 2]], fractions: &[[f64; 2]], corners: &[[isize; 2]], counts: &[f64]| {
            kernels.batch.fill_at(layout, &self.kernel, cells, fractions);
            kernels.shift(corners, counts);
            add_kernels(kernels, corners.len(), first_row, places, values);
        };
        self.each_sample(node, |sample, share| {
            let [row, column] = self.corner(sample, layout.margin);
            let along = within(column - first_column, around) - first_of_piece;
            let down = row - (strip * ROWS) as isize;
            // Skip kernels that don't reach the piece.
            let beside = |from: isize, end: usize| from <= -width || from >= end as isize;
            if beside(along, COLUMNS) || beside(down, ROWS) {
                return;
            }
            (cells[found], fractions[found]) = (self.cells[sample], self.fractions[sample]);
            (corners[found], counts[found]) = ([down, along], share);
            found += 1;
            if found == BATCH {
                add(&cells, &fractions, &corners, &counts);
                found = 0;
            }
        });
        add(&cells[..found], &fractions[..found], &corners[..found], &counts[..found]);
    }
}

/// Maps a column to the equivalent column in `0..around`, in steps of a full turn. The column must be less than two
/// turns outside this range.
fn within(mut column: isize, around: isize) -> isize {
    while column < 0 {
        column += around;
    }
    while column >= around {
        column -= around;
    }
    column
}
