//! Computes Cholesky factors in memory or in a store, and plans the memory and disk space that they need.

use std::path::Path;

use ndarray::{Array2, ArrayViewMut1, Axis};
use rayon::prelude::*;
use spharm_monitor::{Level, Monitor, Stage, Unit};
use spharm_store::factor::{Condition, FactorFile, StartedFactor, check_factor_space, open_factor, start_factor};
use spharm_store::{FactorSpec, FactorWriter, Scalar, StoreError, StoreWarning, TileGrid};

use crate::SolverError;
use crate::cholesky::factorise::{Panels, factorise as into_tiles};
use crate::cholesky::tiles::{Finished, MemoryTiles, Tiles};
use crate::cholesky::{CholeskyFactor, inverse, triangular};
use crate::condition;
use crate::gram::GramMatrix;
use crate::threaded::{Kernels, ThreadedKernels};

/// Default number of rows and columns of a tile: a tile of f64 takes 128 KiB, which fits in the L2 cache of any core.
pub const DEFAULT_TILE: usize = 128;
/// Largest number of columns of a panel (the columns that are computed together) if the entire factor is in memory.
/// Wider panels wouldn't be faster.
const PANEL: usize = 1024;
/// Largest number of columns of a panel if the factor is computed out of core. Out of core, wider panels save time,
/// because less data is read from disk.
const WIDEST: usize = 4096;
/// Bytes of memory for the program itself, its stacks and its allocator.
const BASE: usize = 16 << 20;

/// Parameters of a Cholesky factorisation.
#[derive(Debug, Clone)]
pub struct FactorParams {
    /// Scalar type of the finished factor; default f64. The factor is computed in double precision in either case.
    /// Rounding the finished factor causes a relative error of 6e-8 in each entry, whereas a factorisation in single
    /// precision could fail at condition numbers of 1e7 or more.
    pub scalar: Scalar,
    /// Number of rows and columns of a tile, a multiple of 8; default [`DEFAULT_TILE`].
    pub tile: usize,
    /// Memory budget in bytes; default 2 GiB.
    pub memory: usize,
    /// Bytes of `memory` that the Gram matrix and the caller already use; default 0.
    pub held: usize,
    /// Number of threads; 0 (default) for the number of threads of the caller's rayon pool.
    pub threads: usize,
    /// Whether to build a factor even if it is large or doesn't seem to fit on the disk; default false.
    pub allow_large: bool,
}

impl Default for FactorParams {
    fn default() -> Self {
        Self { scalar: Scalar::F64, tile: DEFAULT_TILE, memory: 2 << 30, held: 0, threads: 0, allow_large: false }
    }
}

/// Plan for computing a factor: panel width, memory, and disk space.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct FactorPlan {
    /// Whether the entire factor is held in memory; otherwise finished columns are read back from the unfinished file.
    pub in_memory: bool,
    /// Number of the factor's columns that are computed together, as a panel.
    pub panel: usize,
    /// Bytes of memory for the factorisation.
    pub memory: usize,
    /// Bytes of address space that [`Kernels`] reserve in addition to `memory`; they count towards the process's limit
    /// on data.
    pub reserved: usize,
    /// Bytes of disk space during the computation; 0 for a factor that stays in memory.
    pub disk: u64,
}

/// The result of [`build_factor`].
#[derive(Debug)]
pub struct FactorReport {
    /// The factor in the store.
    pub file: FactorFile,
    /// Whether the factor already existed, or another builder published it during the computation.
    pub present: bool,
    /// Memory planned for the computation in bytes; 0 if the factor already existed.
    pub memory: usize,
    /// Warning about a damaged file that was replaced; empty if no file was damaged.
    pub warnings: Vec<StoreWarning>,
}

/// Plans the factorisation of a matrix with `size` columns, and divides the matrix into tiles. The factor is held in
/// memory if the budget allows it. Otherwise it is computed out of core if `disk` is set.
///
/// # Errors
///
/// [`StoreError::Budget`], with the smallest sufficient budget, if the budget is too small even for the narrowest
/// panels; [`StoreError::FactorLayout`] if the store format doesn't allow the tile size or the number of tiles.
pub fn plan_factor(size: usize, params: &FactorParams, disk: bool) -> Result<(FactorPlan, TileGrid), SolverError> {
    let grid = TileGrid::new(size, params.tile)?;
    let threads = crate::threads(params.threads);
    let fixed = BASE + params.held + threads * Kernels::TOUCHED_PER_THREAD + 128 * grid.count();
    let all: usize = grid.tiles().map(|(row, column)| 8 * grid.len(row, column)).sum();
    let panels = |width: usize| Panels { grid, width, threads };
    let plan = |width: usize, in_memory: bool| FactorPlan {
        in_memory,
        panel: (width * grid.tile()).min(size),
        // No memory is added for the right-hand sides of the condition estimate, because they need no more memory than
        // a panel.
        memory: fixed + panels(width).bytes() + if in_memory { all } else { 0 },
        reserved: threads * Kernels::RESERVED_PER_THREAD,
        disk: 0,
    };
    let widths = |most: usize| (1..=(most / grid.tile()).clamp(1, grid.columns())).rev();
    // A factorisation in memory is faster than one that reads back from disk, even with narrow panels.
    let inside = widths(PANEL).map(|width| plan(width, true)).find(|plan| plan.memory <= params.memory);
    let outside = || widths(WIDEST).map(|width| plan(width, false)).find(|plan| plan.memory <= params.memory);
    let found = if disk { inside.or_else(outside) } else { inside };
    match found {
        Some(plan) => Ok((plan, grid)),
        None => {
            let needed = plan(1, !disk).memory;
            Err(StoreError::Budget { budget: params.memory, needed }.into())
        }
    }
}

/// Plans the computation of a factor in a store, and checks that memory and disk space suffice. Writes nothing.
///
/// # Errors
///
/// [`StoreError::Budget`] if the memory budget is too small, [`StoreError::Space`] if the disk has too little free
/// space or the factor is too large, [`StoreError::FactorLayout`] if the store format doesn't allow the tile size or
/// the number of tiles.
pub fn plan_stored_factor(
    store: &Path,
    size: usize,
    params: &FactorParams,
) -> Result<(FactorPlan, TileGrid), SolverError> {
    let (mut plan, grid) = plan_factor(size, params, true)?;
    plan.disk = check_factor_space(store, grid, params.scalar, !plan.in_memory, params.allow_large)?;
    Ok((plan, grid))
}

/// A Cholesky factor in memory.
#[derive(Debug)]
pub struct MemoryFactor {
    tiles: MemoryTiles,
    scalar: Scalar,
    condition: Condition,
    threads: usize,
}

/// Computes the Cholesky factor of `source`, a matrix G, in memory.
///
/// Reports one stage, `factor`, in flops, to the monitor.
///
/// # Errors
///
/// [`SolverError::NotPositiveDefinite`] if G isn't numerically positive definite, [`StoreError::Budget`] if the memory
/// budget is too small, [`SolverError::Interrupted`] if the monitor cancels the computation, and the errors of
/// `source`.
pub fn factorise(
    source: &dyn GramMatrix,
    params: &FactorParams,
    monitor: &dyn Monitor,
) -> Result<MemoryFactor, SolverError> {
    let (plan, grid) = plan_factor(source.size(), params, false)?;
    let panels = Panels { grid, width: plan.panel.div_ceil(grid.tile()), threads: crate::threads(params.threads) };
    let mut tiles = MemoryTiles::new(grid);
    let condition = compute(source, &tiles, &panels, monitor)?;
    if params.scalar == Scalar::F32 {
        tiles.narrow();
    }
    Ok(MemoryFactor { tiles, scalar: params.scalar, condition, threads: panels.threads })
}

/// Builds the factor described by `spec` into `store`, unless it already exists.
///
/// `source` (the matrix G) must have been computed with the weights and the penalty of `spec`, which are recorded in
/// the file. Reports one stage, `factor`, in flops, to the monitor, unless the factor already exists.
///
/// # Errors
///
/// Before any work: [`StoreError::Budget`] or [`StoreError::Space`] if memory or disk space doesn't suffice. During the
/// work: [`SolverError::NotPositiveDefinite`] if G isn't numerically positive definite, [`SolverError::Interrupted`] if
/// the monitor cancels the computation, [`StoreError::Io`] if the store can't be written, and the errors of `source`.
/// No files are left behind.
///
/// # Panics
///
/// If the sizes of the Gram matrix and of `spec` differ.
pub fn build_factor(
    store: &Path,
    spec: &FactorSpec,
    source: &dyn GramMatrix,
    params: &FactorParams,
    monitor: &dyn Monitor,
) -> Result<FactorReport, SolverError> {
    assert_eq!(source.size(), spec.size(), "the Gram matrix must have the size of the factor");
    // Use an existing factor regardless of the budget.
    if let Ok(file) = open_factor(store, spec, Some(params.scalar)) {
        return Ok(FactorReport { file, present: true, memory: 0, warnings: Vec::new() });
    }
    let (plan, grid) = plan_stored_factor(store, spec.size(), params)?;
    let panels = Panels { grid, width: plan.panel.div_ceil(grid.tile()), threads: crate::threads(params.threads) };
    let (writer, warnings) = match start_factor(store, spec, params.scalar, grid, !plan.in_memory, monitor)? {
        StartedFactor::Present(file) => {
            return Ok(FactorReport { file, present: true, memory: 0, warnings: Vec::new() });
        }
        StartedFactor::New { writer, warnings } => (writer, warnings),
    };
    let condition = if plan.in_memory {
        let tiles = MemoryTiles::new(grid);
        let condition = compute(source, &tiles, &panels, monitor)?;
        copy(&tiles, &writer, monitor)?;
        condition
    } else {
        compute(source, &*writer, &panels, monitor)?
    };
    let published = writer.publish(condition)?;
    let file = open_factor(store, spec, Some(params.scalar))?;
    Ok(FactorReport { file, present: published.is_none(), memory: plan.memory, warnings })
}

/// Factorises the matrix `source`, stores the factor in `tiles`, and estimates the condition number by solving with
/// that factor.
fn compute<T: Tiles + Finished>(
    source: &dyn GramMatrix,
    tiles: &T,
    panels: &Panels,
    monitor: &dyn Monitor,
) -> Result<Condition, SolverError> {
    monitor.begin(Stage { name: "factor", unit: Unit::Flops }, panels.flops() as u64);
    let norm = into_tiles(source, tiles, panels, monitor)?;
    monitor.note(Level::Status, format_args!("estimating the condition number"));
    let inverse = condition::one_norm(panels.grid.size(), &mut |x: &mut [f64]| {
        monitor.check()?;
        triangular::solve(tiles, ArrayViewMut1::from(x).insert_axis(Axis(1)), panels.threads)
    })?;
    monitor.end();
    let reciprocal = 1.0 / (norm * inverse);
    // An estimate that overflowed is treated as an infinite condition number.
    let reciprocal = if reciprocal.is_finite() { reciprocal.min(1.0) } else { 0.0 };
    Ok(Condition { norm, reciprocal })
}

/// Copies a factor from memory to a file that isn't published yet.
fn copy(tiles: &MemoryTiles, writer: &FactorWriter, monitor: &dyn Monitor) -> Result<(), SolverError> {
    let all: Vec<(usize, usize)> = tiles.grid().tiles().collect();
    all.into_par_iter().try_for_each_init(Vec::new, |values, (row, column)| {
        monitor.check()?;
        values.resize(tiles.grid().len(row, column), 0.0);
        Finished::get(tiles, row, column, values)?;
        Ok(writer.put(row, column, values)?)
    })
}

impl CholeskyFactor for MemoryFactor {
    fn size(&self) -> usize {
        self.tiles.grid().size()
    }

    fn scalar(&self) -> Scalar {
        self.scalar
    }

    fn condition(&self) -> Condition {
        self.condition
    }

    fn solve(&self, x: &mut Array2<f64>) -> Result<(), SolverError> {
        triangular::solve(&self.tiles, x.view_mut(), self.threads)
    }

    fn inverse_diagonal(&self, monitor: &dyn Monitor) -> Result<Vec<f64>, SolverError> {
        inverse::diagonal(&self.tiles, self.threads, monitor)
    }

    fn penalised_diagonals(&self, penalty: &[f64], monitor: &dyn Monitor) -> Result<(Vec<f64>, Vec<f64>), SolverError> {
        inverse::penalised_diagonals(&self.tiles, penalty, self.threads, monitor)
    }
}
