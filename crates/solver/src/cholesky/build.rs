//! Computing a factor: what it takes, in memory or into a store.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use ndarray::Array2;
use rayon::prelude::*;
use spharm_monitor::{Interrupted, Level, Monitor};
use spharm_store::factor::{Condition, FactorFile, StartedFactor, check_factor_space, open_factor, start_factor};
use spharm_store::{FactorSpec, FactorWriter, Scalar, StoreError, StoreWarning, TileGrid};

use crate::SolverError;
use crate::cholesky::factorise::{Panels, factorise as into_tiles};
use crate::cholesky::source::GramSource;
use crate::cholesky::tiles::{Finished, MemoryTiles, Tiles};
use crate::cholesky::{CholeskyFactor, condition, inverse, sweep};

/// Rows and columns of a tile unless asked otherwise: 128 KiB of f64, which the L2 cache of any core holds.
pub const DEFAULT_TILE: usize = 128;
/// Columns of a panel where memory doesn't matter: wider ones gain nothing when the rest of the factor is in memory.
const PANEL: usize = 1024;
/// Columns of the widest panel out of core, where wider ones spare reading.
const WIDEST: usize = 4096;
/// The program itself, its stacks and allocator.
const BASE: usize = 16 << 20;

/// How to compute a factor.
#[derive(Debug, Clone)]
pub struct FactorParams {
    /// Scalar type that the factor is kept in. It is computed in double precision either way: rounding the finished
    /// factor costs a relative 6e-8 of each entry and never its existence, as a factorisation in single precision would
    /// from condition numbers of 1e7 on.
    pub scalar: Scalar,
    /// Rows and columns of a tile, a multiple of 8.
    pub tile: usize,
    /// Most bytes of memory to take.
    pub memory: usize,
    /// Bytes of them that the Gram matrix's source and the caller take.
    pub held: usize,
    /// Threads to use.
    pub threads: usize,
    /// Build even what is large or doesn't seem to fit the disk.
    pub allow_large: bool,
}

impl Default for FactorParams {
    fn default() -> Self {
        Self {
            scalar: Scalar::F64,
            tile: DEFAULT_TILE,
            memory: 2 << 30,
            held: 0,
            threads: rayon::current_num_threads(),
            allow_large: false,
        }
    }
}

/// What computing a factor takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct FactorPlan {
    /// Whether all of it is held in memory; else finished columns are read back from the unfinished file.
    pub in_memory: bool,
    /// Columns of a panel.
    pub panel: usize,
    /// Bytes of memory.
    pub memory: usize,
    /// Bytes of disk while it is made; 0 for one that stays in memory.
    pub disk: u64,
}

/// What happens while a factor is computed.
#[derive(Debug)]
#[non_exhaustive]
pub enum FactorEvent<'a> {
    /// The store has something to say: it waits for another builder.
    Note(std::fmt::Arguments<'a>),
    /// It isn't there and is going to be computed: the plan, and the flops that it takes.
    Planned(FactorPlan, f64),
    /// Flops done since the last event.
    Progress(f64),
    /// All columns are there; the condition is being estimated.
    Estimating,
}

/// What [`build_factor`] did.
#[derive(Debug)]
pub struct FactorReport {
    /// The factor in the store.
    pub file: FactorFile,
    /// Whether it was there already, or another builder published it meanwhile.
    pub present: bool,
    /// Bytes of memory planned.
    pub memory: usize,
    /// The damaged file that was warnings, if there was one.
    pub warnings: Vec<StoreWarning>,
}

/// What factorising a matrix of `size` columns takes, in memory when `disk` is false.
///
/// # Errors
///
/// [`StoreError::Budget`] with the least that works; [`StoreError::FactorLayout`].
pub fn plan_factor(size: usize, params: &FactorParams, disk: bool) -> Result<(FactorPlan, TileGrid), SolverError> {
    let grid = TileGrid::new(size, params.tile)?;
    let threads = params.threads.max(1);
    let fixed = BASE + params.held + threads * crate::dense::RESERVED_PER_THREAD + 128 * grid.count();
    let all: usize = grid.tiles().map(|(row, column)| 8 * grid.len(row, column)).sum();
    let panels = |width: usize| Panels { grid, width, threads };
    let plan = |width: usize, in_memory: bool| FactorPlan {
        in_memory,
        panel: (width * grid.tile()).min(size),
        // Right-hand sides of the condition estimate are no more than a panel.
        memory: fixed + panels(width).bytes() + if in_memory { all } else { 0 },
        disk: 0,
    };
    let widths = |most: usize| (1..=(most / grid.tile()).clamp(1, grid.columns())).rev();
    // A narrow panel in memory still beats reading back from disk.
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

/// What building a factor into a store takes, checked against memory and disk before any work; nothing is written.
///
/// # Errors
///
/// [`StoreError::Budget`], [`StoreError::Space`], [`StoreError::FactorLayout`].
pub fn plan_stored_factor(
    store: &Path,
    size: usize,
    params: &FactorParams,
) -> Result<(FactorPlan, TileGrid), SolverError> {
    let (mut plan, grid) = plan_factor(size, params, true)?;
    plan.disk = check_factor_space(store, grid, params.scalar, !plan.in_memory, params.allow_large)?;
    Ok((plan, grid))
}

/// A factor in memory.
#[derive(Debug)]
pub struct Factor {
    tiles: MemoryTiles,
    scalar: Scalar,
    condition: Condition,
    threads: usize,
}

/// Factorises G in memory.
///
/// # Errors
///
/// [`SolverError::NotPositiveDefinite`], [`StoreError::Budget`], [`StoreError::Interrupted`], those of the source.
pub fn factorise(
    source: &dyn GramSource,
    params: &FactorParams,
    cancel: &AtomicBool,
    event: &(dyn Fn(FactorEvent<'_>) + Sync),
) -> Result<Factor, SolverError> {
    let (plan, grid) = plan_factor(source.size(), params, false)?;
    let panels = Panels { grid, width: plan.panel.div_ceil(grid.tile()), threads: params.threads.max(1) };
    event(FactorEvent::Planned(plan, panels.flops()));
    let mut tiles = MemoryTiles::new(grid);
    let condition = compute(source, &tiles, &panels, cancel, event)?;
    if params.scalar == Scalar::F32 {
        tiles.narrow();
    }
    Ok(Factor { tiles, scalar: params.scalar, condition, threads: panels.threads })
}

/// Builds the factor of `spec` into `store`, unless it is there.
///
/// G's weights and penalty have to be those of `spec`: it is what the file says about itself.
///
/// # Errors
///
/// [`SolverError::NotPositiveDefinite`], [`StoreError::Budget`] and [`StoreError::Space`] before any work,
/// [`StoreError::Interrupted`], [`StoreError::Io`], those of the source. Nothing is left behind.
pub fn build_factor(
    store: &Path,
    spec: &FactorSpec,
    source: &dyn GramSource,
    params: &FactorParams,
    cancel: &AtomicBool,
    event: &(dyn Fn(FactorEvent<'_>) + Sync),
) -> Result<FactorReport, SolverError> {
    assert_eq!(source.size(), spec.size(), "the Gram matrix is that of the degree");
    // A finished one is left alone, whatever the budget.
    if let Ok(file) = open_factor(store, spec, Some(params.scalar)) {
        return Ok(FactorReport { file, present: true, memory: 0, warnings: Vec::new() });
    }
    let (plan, grid) = plan_stored_factor(store, spec.size(), params)?;
    let panels = Panels { grid, width: plan.panel.div_ceil(grid.tile()), threads: params.threads.max(1) };
    let waiting = Waiting { cancel, event };
    let (writer, warnings) = match start_factor(store, spec, params.scalar, grid, !plan.in_memory, &waiting)? {
        StartedFactor::Present(file) => {
            return Ok(FactorReport { file, present: true, memory: 0, warnings: Vec::new() });
        }
        StartedFactor::New { writer, warnings } => (writer, warnings),
    };
    event(FactorEvent::Planned(plan, panels.flops()));
    let condition = if plan.in_memory {
        let tiles = MemoryTiles::new(grid);
        let condition = compute(source, &tiles, &panels, cancel, event)?;
        copy(&tiles, &writer, cancel)?;
        condition
    } else {
        compute(source, &*writer, &panels, cancel, event)?
    };
    let published = writer.publish(condition)?;
    let file = open_factor(store, spec, Some(params.scalar))?;
    Ok(FactorReport { file, present: published.is_none(), memory: plan.memory, warnings })
}

/// The caller's events as a monitor.
struct Waiting<'a> {
    cancel: &'a AtomicBool,
    event: &'a (dyn Fn(FactorEvent<'_>) + Sync),
}

impl Monitor for Waiting<'_> {
    fn note(&self, _: Level, text: std::fmt::Arguments<'_>) {
        (self.event)(FactorEvent::Note(text));
    }

    fn cancelled(&self) -> bool {
        self.cancel.cancelled()
    }
}

/// Factorises into tiles, then estimates the condition with them.
fn compute<T: Tiles + Finished>(
    source: &dyn GramSource,
    tiles: &T,
    panels: &Panels,
    cancel: &AtomicBool,
    event: &(dyn Fn(FactorEvent<'_>) + Sync),
) -> Result<Condition, SolverError> {
    let norm = into_tiles(source, tiles, panels, cancel, &|flops| event(FactorEvent::Progress(flops)))?;
    event(FactorEvent::Estimating);
    let inverse = condition::one_norm(panels.grid.size(), &mut |x: &mut Array2<f64>| {
        if cancel.load(std::sync::atomic::Ordering::Relaxed) {
            return Err(StoreError::Interrupted(Interrupted).into());
        }
        sweep::solve(tiles, x, panels.threads)
    })?;
    let reciprocal = 1.0 / (norm * inverse);
    // An estimate that overflowed stands for a matrix as bad as can be.
    let reciprocal = if reciprocal.is_finite() { reciprocal.min(1.0) } else { 0.0 };
    Ok(Condition { norm, reciprocal })
}

/// Writes a factor in memory to a file.
fn copy(tiles: &MemoryTiles, writer: &FactorWriter, cancel: &AtomicBool) -> Result<(), SolverError> {
    let all: Vec<(usize, usize)> = tiles.grid().tiles().collect();
    all.into_par_iter().try_for_each_init(Vec::new, |values, (row, column)| {
        if cancel.load(std::sync::atomic::Ordering::Relaxed) {
            return Err(StoreError::Interrupted(Interrupted).into());
        }
        values.resize(tiles.grid().len(row, column), 0.0);
        Finished::get(tiles, row, column, values)?;
        Ok(writer.put(row, column, values)?)
    })
}

impl CholeskyFactor for Factor {
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
        sweep::solve(&self.tiles, x, self.threads)
    }

    fn inverse_diagonal(&self) -> Result<Vec<f64>, SolverError> {
        inverse::diagonal(&self.tiles, self.threads)
    }
}
