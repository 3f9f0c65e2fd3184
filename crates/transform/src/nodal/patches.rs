//! Stores patches (see [`nodal`](super)) in the order in which they are added to a grid: strip by strip, tile by tile,
//! row by row.

/// Number of columns of a piece: three vectors of eight.
pub(super) const COLUMNS: usize = 24;

/// Number of rows of the grid that are processed together.
pub(super) const ROWS: usize = 32;

/// The pieces of the nodes' patches (see [`nodal`](super)) that lie in a strip of the grid, in the order in which they
/// are added to the grid. A piece's value at a grid point is the factor by which the node's value is multiplied before
/// it is added to this point.
#[derive(Debug, Default)]
pub(super) struct Patches {
    pub(super) tiles: Vec<Tile>,
    /// For each row of each tile, the nodes whose pieces cover the row.
    pub(super) nodes: Vec<u32>,
    /// For each entry of `nodes`, the factors of the node's value in the [`COLUMNS`] columns of the tile.
    pub(super) values: Vec<[f64; COLUMNS]>,
}

/// Pieces of patches that cover the same columns of a strip.
#[derive(Debug)]
pub(super) struct Tile {
    /// First column, margin included.
    pub(super) column: usize,
    /// Index in [`Patches::nodes`] of the first node of each row, followed by the end of the last row's nodes.
    pub(super) first: [u32; ROWS + 1],
}
