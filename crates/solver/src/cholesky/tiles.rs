//! Access to the tiles of a Cholesky factor: in memory, in a store, or in an unfinished file.

use std::sync::{Arc, OnceLock};

use spharm_store::TileGrid;
use spharm_store::factor::{FactorWriter, TileValues, TileWindow};

use crate::SolverError;

/// The tile buffer and the window (memory map) that a thread is currently using.
#[derive(Debug, Default)]
pub(crate) struct Cursor {
    /// Buffer for a tile that must be copied.
    pub(crate) buffer: Vec<f64>,
    /// Window on the current tile column.
    pub(crate) window: Option<Arc<TileWindow>>,
}

/// A lower triangular factor whose tiles can be read by several threads.
pub(crate) trait Tiles: Sync {
    fn grid(&self) -> TileGrid;

    /// Returns the values of a tile, column-major without gaps.
    fn tile<'c>(&'c self, row: usize, column: usize, cursor: &'c mut Cursor) -> Result<TileValues<'c>, SolverError>;

    /// Prepares the calling thread. Each of `threads` threads calls this before its first tile.
    fn prepare(&self, _thread: usize, _threads: usize) -> Result<(), SolverError> {
        Ok(())
    }

    /// Ends the calling thread's use of tiles. Each thread calls this after its last tile; the thread's results are
    /// valid only if this call succeeds.
    fn finish(&self, _cursor: &mut Cursor) -> Result<(), SolverError> {
        Ok(())
    }
}

/// Tiles that a factorisation has finished and reads again for later panels. Diagonal tiles are zero above the
/// diagonal.
pub(crate) trait Finished: Sync {
    fn put(&self, row: usize, column: usize, values: &[f64]) -> Result<(), SolverError>;
    fn get(&self, row: usize, column: usize, values: &mut [f64]) -> Result<(), SolverError>;
    /// Announces that tiles of tile column `column` will be read, starting at tile row `row`.
    fn will_need(&self, _row: usize, _column: usize) {}
}

/// Tiles in memory.
#[derive(Debug)]
pub(crate) struct MemoryTiles {
    grid: TileGrid,
    tiles: Vec<OnceLock<Values>>,
}

#[derive(Debug, Clone)]
enum Values {
    F64(Vec<f64>),
    F32(Vec<f32>),
}

impl MemoryTiles {
    pub(crate) fn new(grid: TileGrid) -> Self {
        Self { grid, tiles: (0..grid.count()).map(|_| OnceLock::new()).collect() }
    }

    /// Rounds every tile to single precision. The double-precision values of each tile are freed before the next tile
    /// is rounded.
    pub(crate) fn narrow(&mut self) {
        for tile in &mut self.tiles {
            if let Some(Values::F64(values)) = tile.take() {
                let _ = tile.set(Values::F32(values.iter().map(|&value| value as f32).collect()));
            }
        }
    }

    fn set(&self, row: usize, column: usize, values: Values) {
        let set = self.tiles[self.grid.index(row, column)].set(values);
        assert!(set.is_ok(), "tile ({row}, {column}) must be computed only once");
    }

    fn values(&self, row: usize, column: usize) -> &Values {
        let values = self.tiles[self.grid.index(row, column)].get();
        values.unwrap_or_else(|| panic!("tile ({row}, {column}) is read before it is computed"))
    }
}

impl Tiles for MemoryTiles {
    fn grid(&self) -> TileGrid {
        self.grid
    }

    fn tile<'c>(&'c self, row: usize, column: usize, _: &'c mut Cursor) -> Result<TileValues<'c>, SolverError> {
        Ok(match self.values(row, column) {
            Values::F64(values) => TileValues::F64(values),
            Values::F32(values) => TileValues::F32(values),
        })
    }
}

impl Finished for MemoryTiles {
    fn put(&self, row: usize, column: usize, values: &[f64]) -> Result<(), SolverError> {
        self.set(row, column, Values::F64(values.to_vec()));
        Ok(())
    }

    fn get(&self, row: usize, column: usize, values: &mut [f64]) -> Result<(), SolverError> {
        match self.values(row, column) {
            Values::F64(tile) => values.copy_from_slice(tile),
            Values::F32(tile) => values.iter_mut().zip(tile).for_each(|(out, value)| *out = f64::from(*value)),
        }
        Ok(())
    }
}

impl Finished for FactorWriter {
    fn put(&self, row: usize, column: usize, values: &[f64]) -> Result<(), SolverError> {
        Ok(self.put(row, column, values)?)
    }

    fn get(&self, row: usize, column: usize, values: &mut [f64]) -> Result<(), SolverError> {
        Ok(self.get(row, column, values)?)
    }

    fn will_need(&self, row: usize, column: usize) {
        self.will_need(row, column);
    }
}

/// Tiles that are read back from an unpublished factor, to estimate the condition number.
impl Tiles for FactorWriter {
    fn grid(&self) -> TileGrid {
        self.grid()
    }

    fn tile<'c>(&'c self, row: usize, column: usize, cursor: &'c mut Cursor) -> Result<TileValues<'c>, SolverError> {
        cursor.buffer.resize(self.grid().len(row, column), 0.0);
        self.get(row, column, &mut cursor.buffer)?;
        Ok(TileValues::F64(&cursor.buffer))
    }
}
