//! Implements a Cholesky factor that is read from a store.

use std::sync::{Arc, Mutex, PoisonError, Weak};

use ndarray::Array2;
use spharm_monitor::Monitor;
use spharm_store::factor::{Condition, FactorFile, TileValues, TileWindow};
use spharm_store::{Scalar, TileGrid};

use crate::SolverError;
use crate::cholesky::tiles::{Cursor, Tiles};
use crate::cholesky::{CholeskyFactor, inverse, triangular};

/// A factor read from a store through windows: memory maps of its tile columns.
///
/// If the file fits in the budget, windows are kept between solves. Otherwise each window is dropped when its tile
/// column has been processed, so that only a few columns occupy memory and address space at a time.
#[derive(Debug)]
pub struct StoredFactor {
    file: FactorFile,
    kept: bool,
    windows: Vec<Mutex<Held>>,
    threads: usize,
}

/// State of the window (memory map) on a tile column.
#[derive(Debug)]
enum Held {
    /// The tile column hasn't been mapped yet.
    None,
    /// The window stays mapped between solves.
    Kept(Arc<TileWindow>),
    /// The window is unmapped when the last thread that uses it drops it.
    Shared(Weak<TileWindow>),
}

impl StoredFactor {
    /// Creates a factor from an open file, for solves on `threads` threads. Windows are kept between solves if the
    /// file's size is at most `memory` bytes.
    pub fn new(file: FactorFile, memory: usize, threads: usize) -> Self {
        let kept = file.file_len() <= memory as u64;
        let windows = (0..file.header().grid.columns()).map(|_| Mutex::new(Held::None)).collect();
        Self { file, kept, windows, threads }
    }

    /// Returns the factor's file.
    pub fn file(&self) -> &FactorFile {
        &self.file
    }

    /// Returns the window on a tile column: the current window if one is open, otherwise a new window.
    fn window(&self, column: usize) -> Result<Arc<TileWindow>, SolverError> {
        let mut held = self.windows[column].lock().unwrap_or_else(PoisonError::into_inner);
        let there = match &*held {
            Held::None => None,
            Held::Kept(window) => Some(window.clone()),
            Held::Shared(window) => window.upgrade(),
        };
        if let Some(window) = there {
            return Ok(window);
        }
        let window = Arc::new(self.file.window(column)?);
        window.will_need();
        *held = if self.kept { Held::Kept(window.clone()) } else { Held::Shared(Arc::downgrade(&window)) };
        Ok(window)
    }
}

impl Tiles for StoredFactor {
    fn grid(&self) -> TileGrid {
        self.file.header().grid
    }

    /// On first use, maps the pages of this thread's share of the tile columns. If each thread mapped every page by
    /// page faults, that would cost as much as reading the factor.
    fn prepare(&self, thread: usize, threads: usize) -> Result<(), SolverError> {
        if !self.kept {
            return Ok(());
        }
        for column in (thread..self.windows.len()).step_by(threads) {
            let new = matches!(&*self.windows[column].lock().unwrap_or_else(PoisonError::into_inner), Held::None);
            if new {
                self.window(column)?.populate();
            }
        }
        Ok(())
    }

    fn tile<'c>(&'c self, row: usize, column: usize, cursor: &'c mut Cursor) -> Result<TileValues<'c>, SolverError> {
        if cursor.window.as_ref().is_none_or(|window| window.column() != column) {
            self.finish(cursor)?;
            cursor.window = Some(self.window(column)?);
        }
        let Some(window) = &cursor.window else { unreachable!("the window was set above") };
        Ok(window.values(row)?)
    }

    fn finish(&self, cursor: &mut Cursor) -> Result<(), SolverError> {
        Ok(cursor.window.take().map_or(Ok(()), |window| window.check())?)
    }
}

impl CholeskyFactor for StoredFactor {
    fn size(&self) -> usize {
        self.grid().size()
    }

    fn scalar(&self) -> Scalar {
        self.file.header().scalar
    }

    fn condition(&self) -> Condition {
        self.file.header().condition
    }

    fn solve(&self, x: &mut Array2<f64>) -> Result<(), SolverError> {
        triangular::solve(self, x.view_mut(), self.threads)
    }

    fn inverse_diagonal(&self, monitor: &dyn Monitor) -> Result<Vec<f64>, SolverError> {
        inverse::diagonal(self, self.threads, monitor)
    }

    fn penalised_diagonals(&self, penalty: &[f64], monitor: &dyn Monitor) -> Result<(Vec<f64>, Vec<f64>), SolverError> {
        inverse::penalised_diagonals(self, penalty, self.threads, monitor)
    }
}
