//! Assembles a symmetric sparse matrix of 2 x 2 blocks from triangles, with a block for each vertex and each ordered
//! pair of neighbouring vertices.
//!
//! Both halves of the symmetric matrix are stored, so each row can be processed independently of the others. Products
//! with vectors and sums over triangles therefore run on all cores and give the same bits for any number of cores.

use rayon::prelude::*;

use crate::local::NUMBERS;

/// Number of results kept per triangle: the gradient (6) and the lower half of the Hessian (21).
pub(crate) const KEPT: usize = NUMBERS - 1;

/// Number of matrix rows per parallel task.
const ROWS: usize = 1024;

/// The sparsity pattern of the matrix, and the position of each triangle's blocks in it.
pub(crate) struct Pattern {
    /// Index in `columns` of each row's first block. The last entry is the length of `columns`.
    pub(crate) starts: Vec<u32>,
    /// For each block, the vertex that its column belongs to. Each row begins with the block of the row's own vertex,
    /// followed by the blocks of the neighbours in ascending order.
    pub(crate) columns: Vec<u32>,
    /// Index in `corners` of each vertex's first entry. The last entry is the length of `corners`.
    around: Vec<u32>,
    /// The triangle corners at each vertex, each encoded as three times the triangle's index plus the corner's number
    /// (0 to 2).
    corners: Vec<u32>,
    /// For each entry of `corners`, the positions of the triangle's two other vertices within the matrix row.
    places: Vec<[u32; 2]>,
}

impl Pattern {
    /// Builds the pattern for triangles over the vertices 0..n.
    pub(crate) fn new(n: usize, faces: &[[u32; 3]]) -> Self {
        let mut around = vec![0_u32; n + 1];
        faces.iter().flatten().for_each(|&v| around[v as usize + 1] += 1);
        (0..n).for_each(|v| around[v + 1] += around[v]);
        let mut next = around.clone();
        let mut corners = vec![0_u32; 3 * faces.len()];
        for (f, face) in faces.iter().enumerate() {
            for (k, &v) in face.iter().enumerate() {
                corners[next[v as usize] as usize] = (3 * f + k) as u32;
                next[v as usize] += 1;
            }
        }
        let others = |corner: u32| {
            let (face, k) = (faces[corner as usize / 3], corner as usize % 3);
            [face[(k + 1) % 3], face[(k + 2) % 3]]
        };
        let mut starts = Vec::with_capacity(n + 1);
        let mut columns = Vec::with_capacity(n + 3 * faces.len());
        let mut places = Vec::with_capacity(corners.len());
        let mut row: Vec<u32> = Vec::new();
        starts.push(0);
        for v in 0..n {
            let corners = &corners[around[v] as usize..around[v + 1] as usize];
            row.clear();
            row.extend(corners.iter().flat_map(|&corner| others(corner)));
            row.sort_unstable();
            row.dedup();
            // The search always succeeds: the row contains every neighbour.
            let place = |w: u32| 1 + row.binary_search(&w).unwrap_or(0) as u32;
            places.extend(corners.iter().map(|&corner| others(corner).map(place)));
            columns.push(v as u32);
            columns.extend(&row);
            starts.push(columns.len() as u32);
        }
        Self { starts, columns, around, corners, places }
    }

    /// Returns the number of vertices.
    pub(crate) fn rows(&self) -> usize {
        self.starts.len() - 1
    }

    /// Returns the index range of a row's blocks.
    pub(crate) fn range(&self, row: usize) -> std::ops::Range<usize> {
        self.starts[row] as usize..self.starts[row + 1] as usize
    }

    /// Returns the vertices that the columns of the blocks in row `v` belong to: `v` itself, then its neighbours.
    pub(crate) fn columns_of(&self, v: u32) -> &[u32] {
        &self.columns[self.range(v as usize)]
    }

    /// Sums the triangles' gradients into `gradient` (two numbers per vertex) and their Hessians into `blocks`, row by
    /// row.
    pub(crate) fn sum(&self, local: &[[f64; KEPT]], gradient: &mut [[f64; 2]], blocks: &mut [[f64; 4]]) {
        let mut tasks = Vec::with_capacity(self.rows().div_ceil(ROWS));
        let mut rest = blocks;
        for (chunk, gradient) in gradient.chunks_mut(ROWS).enumerate() {
            let rows = chunk * ROWS..(chunk * ROWS + gradient.len());
            let (own, others) = rest.split_at_mut((self.starts[rows.end] - self.starts[rows.start]) as usize);
            rest = others;
            tasks.push((rows, gradient, own));
        }
        tasks.into_par_iter().for_each(|(rows, gradient, blocks)| {
            blocks.fill([0.0; 4]);
            let first = self.starts[rows.start];
            for (row, slope) in rows.zip(gradient) {
                *slope = [0.0; 2];
                let blocks = &mut blocks[(self.starts[row] - first) as usize..(self.starts[row + 1] - first) as usize];
                let range = self.around[row] as usize..self.around[row + 1] as usize;
                for (&corner, places) in self.corners[range.clone()].iter().zip(&self.places[range]) {
                    let (numbers, k) = (&local[corner as usize / 3], corner as usize % 3);
                    slope[0] += numbers[2 * k];
                    slope[1] += numbers[2 * k + 1];
                    add_block(&mut blocks[0], numbers, k, k);
                    add_block(&mut blocks[places[0] as usize], numbers, k, (k + 1) % 3);
                    add_block(&mut blocks[places[1] as usize], numbers, k, (k + 2) % 3);
                }
            }
        });
    }
}

/// Adds to `block` the 2 x 2 part of a triangle's Hessian that belongs to corners i and j.
fn add_block(block: &mut [f64; 4], numbers: &[f64; KEPT], i: usize, j: usize) {
    let entry = |row: usize, column: usize| {
        let (high, low) = (row.max(column), row.min(column));
        numbers[6 + high * (high + 1) / 2 + low]
    };
    block[0] += entry(2 * i, 2 * j);
    block[1] += entry(2 * i, 2 * j + 1);
    block[2] += entry(2 * i + 1, 2 * j);
    block[3] += entry(2 * i + 1, 2 * j + 1);
}
