//! Patches in the order in which they are added to a grid: strip by strip, tile by tile, row by row.

/// Columns of a piece: three vectors of eight.
pub(super) const COLUMNS: usize = 24;

/// Rows of the grid that are processed together.
pub(super) const ROWS: usize = 32;

/// Pieces of patches on a strip of the grid: the weights of nodes there, in the order in which they are added.
#[derive(Debug, Default)]
pub(super) struct Patches {
    pub(super) tiles: Vec<Tile>,
    /// The nodes of the tiles' rows.
    pub(super) nodes: Vec<u32>,
    /// Weights of these nodes in each column, (nodes, [`COLUMNS`]).
    pub(super) values: Vec<[f64; COLUMNS]>,
}

/// Pieces over the same columns.
#[derive(Debug)]
pub(super) struct Tile {
    /// First column, margin included.
    pub(super) column: usize,
    /// For each row, where its nodes begin, and where those of the last row end.
    pub(super) first: [u32; ROWS + 1],
}
