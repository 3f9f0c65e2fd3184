//! Divides a lower triangle into square tiles on and below the diagonal. Tiles in the last tile row and tile column may
//! be smaller.

use std::ops::Range;

use crate::error::StoreError;
use crate::format::{MAX_TILE, MAX_TILES};

/// A lower triangle (K, K) divided into tiles of `tile` rows and columns. Tiles in the last tile row have fewer rows,
/// and the tile in the last tile column has fewer columns, if `tile` doesn't divide K.
///
/// Tiles are numbered from 0, one tile column after another. Within a tile column, numbers increase from the diagonal
/// downwards.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TileGrid {
    size: usize,
    tile: usize,
}

impl TileGrid {
    /// Divides a triangle of `size` rows and columns into tiles of `tile` rows and columns. `tile` must be a multiple
    /// of 8 from 8 to 1,024.
    ///
    /// # Errors
    ///
    /// [`StoreError::FactorLayout`] if the tiles exceed the limits of the format.
    pub fn new(size: usize, tile: usize) -> Result<Self, StoreError> {
        Self::checked(size, tile).ok_or(StoreError::FactorLayout { size, tile })
    }

    pub(crate) fn checked(size: usize, tile: usize) -> Option<Self> {
        let wrong = size == 0 || tile == 0 || tile > MAX_TILE || !tile.is_multiple_of(8);
        // Limit the number of tile columns first, so that the number of tiles computed below can't overflow.
        let fits = !wrong && size.div_ceil(tile) as u64 <= MAX_TILES;
        let grid = Self { size, tile };
        (fits && grid.count() as u64 <= MAX_TILES).then_some(grid)
    }

    /// Returns the number of rows and columns of the triangle, K.
    pub fn size(&self) -> usize {
        self.size
    }

    /// Returns the number of rows and columns of a full tile.
    pub fn tile(&self) -> usize {
        self.tile
    }

    /// Returns the number of tile columns, which equals the number of tile rows.
    pub fn columns(&self) -> usize {
        self.size.div_ceil(self.tile)
    }

    /// Returns the number of tiles.
    pub fn count(&self) -> usize {
        self.columns() * (self.columns() + 1) / 2
    }

    /// Returns the triangle's rows in tile row `at`. Tile column `at` has the same range of columns.
    pub fn range(&self, at: usize) -> Range<usize> {
        (at * self.tile).min(self.size)..((at + 1) * self.tile).min(self.size)
    }

    /// Returns the number of the tile in the given tile row and tile column.
    ///
    /// # Panics
    ///
    /// If the tile lies above the diagonal or outside the grid.
    pub fn index(&self, row: usize, column: usize) -> usize {
        let n = self.columns();
        assert!(column <= row && row < n, "tile ({row}, {column}) is not in the lower triangle of {n} tile rows");
        self.first_of(column) + row - column
    }

    /// Returns the number of the diagonal tile of a tile column.
    fn first_of(&self, column: usize) -> usize {
        // With n tile columns, the tile columns before this one have n, n - 1, ... tiles.
        column * self.columns() - column * column.saturating_sub(1) / 2
    }

    /// Returns the tile row and tile column of tile number `index`: the inverse of the method [`index`](Self::index).
    ///
    /// # Panics
    ///
    /// If no tile has this number.
    pub fn place(&self, index: usize) -> (usize, usize) {
        assert!(index < self.count(), "expected a tile number below {}, found {index}", self.count());
        let (mut column, mut end) = (0, self.columns());
        while end - column > 1 {
            let middle = column.midpoint(end);
            if self.first_of(middle) <= index { column = middle } else { end = middle }
        }
        (column + index - self.first_of(column), column)
    }

    /// Returns the number of values in a tile.
    pub fn len(&self, row: usize, column: usize) -> usize {
        self.range(row).len() * self.range(column).len()
    }

    /// Returns the row and column of every tile, in the order of their numbers.
    pub fn tiles(&self) -> impl Iterator<Item = (usize, usize)> + use<> {
        let n = self.columns();
        (0..n).flat_map(move |column| (column..n).map(move |row| (row, column)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_cover_the_triangle_in_order() {
        for (size, tile) in [(1, 8), (8, 8), (9, 8), (100, 16), (121, 24), (64, 64)] {
            let grid = TileGrid::new(size, tile).unwrap();
            let mut values = 0;
            for (at, (row, column)) in grid.tiles().enumerate() {
                assert_eq!(grid.index(row, column), at);
                assert_eq!(grid.place(at), (row, column));
                assert!(grid.len(row, column) > 0);
                values += if row == column { 0 } else { grid.len(row, column) };
            }
            assert_eq!(grid.tiles().count(), grid.count());
            let diagonal: usize = (0..grid.columns()).map(|j| grid.range(j).len().pow(2)).sum();
            assert_eq!(2 * values + diagonal, size * size);
        }
    }

    #[test]
    fn what_the_format_has_no_room_for_is_refused() {
        for (size, tile) in [(0, 8), (10, 0), (10, 12), (10, 1032), (usize::MAX, 8), (1 << 40, 1024), (2896 * 128, 128)]
        {
            assert!(TileGrid::new(size, tile).is_err(), "{size} {tile}");
        }
        assert!(TileGrid::new(2895 * 128, 128).is_ok());
    }
}
