//! Stores patches in the order in which they are added to a grid: strip by strip, tile by tile, row by row.

/// Number of columns of a piece: three vectors of eight.
pub(super) const COLUMNS: usize = 24;

/// Number of rows of the grid that are processed together.
pub(super) const ROWS: usize = 32;

/// Pieces of patches on a strip of the grid, in the order in which they are added. Their values are weights of nodes.
#[derive(Debug, Default)]
pub(super) struct Patches {
    pub(super) tiles: Vec<Tile>,
    /// The nodes of the tiles' rows.
    pub(super) nodes: Vec<u32>,
    /// Weights (nodes, [`COLUMNS`]) of the nodes in each column.
    pub(super) values: Vec<[f64; COLUMNS]>,
}

/// Pieces of patches that cover the same columns of a strip.
#[derive(Debug)]
pub(super) struct Tile {
    /// First column, margin included.
    pub(super) column: usize,
    /// Index of the first node of each row, followed by the end of the last row's nodes.
    pub(super) first: [u32; ROWS + 1],
}
