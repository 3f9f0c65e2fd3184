//! Solves C C^T x = b for a Cholesky factor C (K, K) that consists of tiles C_ij, by two triangular solves: C y = b
//! (forward) and C^T x = y (backward).
//!
//! Each of the two solves reads every tile of C once; together they take 2 K^2 flops per column of b. With few columns,
//! the solves are bound by memory bandwidth. With many columns, they are bound by the speed of faer's matrix products.
//!
//! In the forward solve, each thread owns some tile rows and processes the tile columns in file order. The thread
//! subtracts `C_ij y_j` from its own rows as soon as y_j is available. The owner of row j + 1 processes this row first
//! and publishes `y_(j + 1)` before it processes its other rows. The other threads then needn't wait until the owner
//! has finished the column. In the backward solve, each thread owns some tile columns and processes each column from
//! the last row upwards: `x_j = C_jj^-T (y_j - sum_i C_ij^T x_i)`. The owner of the next column runs half a column
//! behind. This owner needs x_j only for the last term of its sum, and by then x_j is available. Threads don't wait at
//! any other point, and there are no barriers.
//!
//! The order of summation depends only on the tiles, so results are bit-identical for any number of threads.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};

use ndarray::ArrayViewMut2;
use spharm_harmonics::product::Matrix;
use spharm_monitor::{Monitor, Silent};
use spharm_store::factor::TileValues;

use crate::SolverError;
use crate::cholesky::kernels::{Kernels, widen};
use crate::cholesky::tiles::{Cursor, Tiles};
use crate::dense;

/// Smallest number of right-hand sides for which faer's matrix products are faster than the kernels, which process
/// three right-hand sides at a time.
const MANY: usize = 16;

/// Solves `C C^T x = b`: `x` (K, c) contains b on entry and the solution on return.
pub(crate) fn solve(tiles: &dyn Tiles, mut x: ArrayViewMut2<'_, f64>, threads: usize) -> Result<(), SolverError> {
    let grid = tiles.grid();
    assert_eq!(x.nrows(), grid.size(), "the right-hand sides must have as many rows as the factor");
    let channels = x.ncols();
    if channels == 0 {
        return Ok(());
    }
    let blocks = (0..grid.columns())
        .map(|at| {
            let rows = x.slice(ndarray::s![grid.range(at), ..]);
            rows.columns().into_iter().flatten().copied().collect()
        })
        .collect();
    let solved = run(tiles, blocks, channels, threads, 0, Direction::Both, &Silent)?;
    for (at, block) in solved.iter().enumerate() {
        let range = grid.range(at);
        let rows = range.len();
        let mut out = x.slice_mut(ndarray::s![range, ..]);
        for (mut out, values) in out.columns_mut().into_iter().zip(block.chunks_exact(rows)) {
            out.iter_mut().zip(values).for_each(|(out, value)| *out = *value);
        }
    }
    Ok(())
}

/// The solves to perform.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Direction {
    /// Computes `C^-1 b` only.
    Forward,
    /// Computes `C^-T C^-1 b`.
    Both,
}

/// Performs the solves of `direction` for right-hand sides that are given as one block (rows, c) per tile row,
/// column-major. Blocks before tile row `first` must be zero: the forward solve skips them. Without a backward solve,
/// these blocks are returned unchanged. With a backward solve, they are returned empty, because that solve doesn't
/// compute them.
pub(crate) fn run(
    tiles: &dyn Tiles,
    blocks: Vec<Vec<f64>>,
    channels: usize,
    threads: usize,
    first: usize,
    direction: Direction,
    monitor: &dyn Monitor,
) -> Result<Vec<Vec<f64>>, SolverError> {
    let count = tiles.grid().columns();
    let threads = threads.clamp(1, count);
    let mut owned: Vec<Vec<Option<Vec<f64>>>> = (0..threads).map(|_| vec![None; count]).collect();
    let job = Job {
        tiles,
        channels,
        threads,
        first,
        direction,
        monitor,
        forward: (0..count).map(|_| OnceLock::new()).collect(),
        backward: (0..count).map(|_| OnceLock::new()).collect(),
        stopped: AtomicBool::new(false),
        error: Mutex::new(None),
    };
    for (row, block) in blocks.into_iter().enumerate() {
        if row < first {
            let _ = job.forward[row].set(block);
            let _ = job.backward[row].set(Vec::new());
        } else {
            owned[row % threads][row] = Some(block);
        }
    }
    std::thread::scope(|scope| {
        // These are dedicated threads, not threads of a pool: each may wait for results of another, so all must run at
        // the same time.
        let mut owned = owned.into_iter().enumerate();
        let mine = owned.next();
        for (thread, rows) in owned {
            let job = &job;
            scope.spawn(move || job.guarded(thread, rows));
        }
        if let Some((thread, rows)) = mine {
            job.guarded(thread, rows);
        }
    });
    if let Some(error) = job.error.into_inner().unwrap_or_else(PoisonError::into_inner) {
        return Err(error);
    }
    let solved = if direction == Direction::Both { job.backward } else { job.forward };
    Ok(solved.into_iter().filter_map(OnceLock::into_inner).collect())
}

struct Job<'a> {
    tiles: &'a dyn Tiles,
    channels: usize,
    threads: usize,
    first: usize,
    direction: Direction,
    /// Monitor that is checked for interruption before each tile, because a tile takes milliseconds if there are many
    /// columns.
    monitor: &'a dyn Monitor,
    /// Solution y of the forward solve, one block per tile row. Each block is set when it has been computed.
    forward: Vec<OnceLock<Vec<f64>>>,
    /// Solution x of the backward solve, also one block per tile row.
    backward: Vec<OnceLock<Vec<f64>>>,
    /// Set if a thread fails, so that the other threads don't wait for its results.
    stopped: AtomicBool,
    error: Mutex<Option<SolverError>>,
}

/// Reason why a thread stops early.
enum Stop {
    /// This thread failed with an error.
    Failed(SolverError),
    /// Another thread failed and reports its error.
    Others,
}

impl<E: Into<SolverError>> From<E> for Stop {
    fn from(error: E) -> Self {
        Self::Failed(error.into())
    }
}

impl Job<'_> {
    fn guarded(&self, thread: usize, rows: Vec<Option<Vec<f64>>>) {
        /// Stops the other threads on a panic, so that they don't wait forever.
        struct StopOthers<'a>(&'a AtomicBool);
        impl Drop for StopOthers<'_> {
            fn drop(&mut self) {
                if std::thread::panicking() {
                    self.0.store(true, Ordering::Release);
                }
            }
        }
        let _guard = StopOthers(&self.stopped);
        if let Err(Stop::Failed(error)) = self.work(thread, rows) {
            self.error.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
            self.stopped.store(true, Ordering::Release);
        }
    }

    fn work(&self, thread: usize, rows: Vec<Option<Vec<f64>>>) -> Result<(), Stop> {
        let (mut cursor, mut wide) = (Cursor::default(), Vec::new());
        self.tiles.prepare(thread, self.threads)?;
        self.go_forward(rows, &mut cursor, &mut wide)?;
        if self.direction == Direction::Both {
            self.go_backward(thread, &mut cursor, &mut wide)?;
        }
        Ok(self.tiles.finish(&mut cursor)?)
    }

    fn go_forward(
        &self,
        mut rows: Vec<Option<Vec<f64>>>,
        cursor: &mut Cursor,
        wide: &mut Vec<f64>,
    ) -> Result<(), Stop> {
        let Some(last) = rows.iter().rposition(Option::is_some) else { return Ok(()) };
        if let Some(block) = rows[self.first].take() {
            self.publish(self.first, block, cursor, wide)?;
        }
        for column in self.first..last {
            let y = self.wait(&self.forward[column])?;
            for (row, slot) in rows.iter_mut().enumerate().skip(column + 1) {
                let Some(block) = slot else { continue };
                self.monitor.check()?;
                let height = block.len() / self.channels;
                let tile = self.tiles.tile(row, column, cursor)?;
                // Tile rows are assigned to the threads in turn, so this thread's next tile is `threads` tiles further
                // on.
                let ahead = (self.threads * bytes(tile)) as isize;
                match tile {
                    TileValues::F64(tile) if self.channels < MANY => {
                        f64::subtract(tile, height, y, block, self.channels, ahead)
                    }
                    TileValues::F32(tile) if self.channels < MANY => {
                        f32::subtract(tile, height, y, block, self.channels, ahead)
                    }
                    tile => dense::subtract_product(matrix(tile, height, wide), y, block),
                }
                if row == column + 1
                    && let Some(block) = slot.take()
                {
                    self.publish(row, block, cursor, wide)?;
                }
            }
        }
        Ok(())
    }

    /// Computes and publishes `y_j = C_jj^-1 b_j`.
    fn publish(&self, row: usize, mut block: Vec<f64>, cursor: &mut Cursor, wide: &mut Vec<f64>) -> Result<(), Stop> {
        let height = block.len() / self.channels;
        match self.tiles.tile(row, row, cursor)? {
            TileValues::F64(tile) if self.channels < MANY => f64::solve(tile, &mut block, self.channels),
            TileValues::F32(tile) if self.channels < MANY => f32::solve(tile, &mut block, self.channels),
            tile => dense::solve_lower(matrix(tile, height, wide), &mut block),
        }
        let _ = self.forward[row].set(block);
        Ok(())
    }

    fn go_backward(&self, thread: usize, cursor: &mut Cursor, wide: &mut Vec<f64>) -> Result<(), Stop> {
        let count = self.forward.len();
        for column in (self.first..count).rev().filter(|column| column % self.threads == thread) {
            let mut block = self.wait(&self.forward[column])?.to_vec();
            for row in (column + 1..count).rev() {
                self.monitor.check()?;
                let x = self.wait(&self.backward[row])?;
                let height = x.len() / self.channels;
                let tile = self.tiles.tile(row, column, cursor)?;
                let ahead = -(bytes(tile) as isize);
                match tile {
                    TileValues::F64(tile) if self.channels < MANY => {
                        f64::subtract_transposed(tile, height, x, &mut block, self.channels, ahead);
                    }
                    TileValues::F32(tile) if self.channels < MANY => {
                        f32::subtract_transposed(tile, height, x, &mut block, self.channels, ahead);
                    }
                    tile => dense::subtract_adjoint_product(matrix(tile, height, wide), x, &mut block),
                }
            }
            let height = block.len() / self.channels;
            match self.tiles.tile(column, column, cursor)? {
                TileValues::F64(tile) if self.channels < MANY => f64::solve_transposed(tile, &mut block, self.channels),
                TileValues::F32(tile) if self.channels < MANY => f32::solve_transposed(tile, &mut block, self.channels),
                tile => dense::solve_lower_transposed(matrix(tile, height, wide), &mut block),
            }
            let _ = self.backward[column].set(block);
        }
        Ok(())
    }

    /// Waits for a block that another thread computes, and returns it. Usually the block is already available.
    /// Otherwise the thread spins for a while, and then yields its processor repeatedly. If there are more threads than
    /// processors, yielding costs much less than spinning.
    fn wait<'b>(&self, block: &'b OnceLock<Vec<f64>>) -> Result<&'b [f64], Stop> {
        const SPINS: usize = 2000;
        let mut spins = 0;
        loop {
            if let Some(values) = block.get() {
                return Ok(values);
            }
            if self.stopped.load(Ordering::Acquire) {
                return Err(Stop::Others);
            }
            spins += 1;
            if spins < SPINS { std::hint::spin_loop() } else { std::thread::yield_now() }
        }
    }
}

fn bytes(tile: TileValues<'_>) -> usize {
    match tile {
        TileValues::F64(values) => size_of_val(values),
        TileValues::F32(values) => size_of_val(values),
    }
}

/// Returns a tile as a matrix of f64 values. Values of f32 are first widened into `wide`.
fn matrix<'m>(tile: TileValues<'m>, rows: usize, wide: &'m mut Vec<f64>) -> Matrix<'m> {
    let values: &[f64] = match tile {
        TileValues::F64(values) => values,
        TileValues::F32(values) => {
            wide.resize(values.len(), 0.0);
            widen(values, wide);
            wide
        }
    };
    Matrix::new(values, rows, values.len() / rows, rows)
}
