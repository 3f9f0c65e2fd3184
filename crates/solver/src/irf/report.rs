//! Defines the report on a fit by iterative residual fitting, and records the fit's passes.

use std::ops::{Range, RangeInclusive};
use std::time::Instant;

use serde::Serialize;
use spharm_monitor::{Interrupted, Level, Monitor};

use super::plan::IrfPlan;
use crate::chunked_rows::ChunkedRows;
use crate::residual::ResidualNorms;

/// Report on a fit by iterative residual fitting.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct IrfReport {
    /// Name of the method: `irf`, `sirf`, `mirf` or `nlsf`.
    pub method: &'static str,
    /// Whether the passes were accelerated by conjugate gradients.
    pub accelerated: bool,
    /// Requested number of passes, p, without refinements.
    pub passes: usize,
    /// Highest degree, L.
    pub max_degree: usize,
    /// Number of rows (directions), n.
    pub rows: usize,
    /// Number of columns of targets fitted together, c.
    pub channels: usize,
    /// Number of threads.
    pub threads: usize,
    /// Reports on the blocks of degrees, in the order of a pass.
    pub blocks: Vec<BlockReport>,
    /// Reports on the passes in order, including refinements.
    #[serde(rename = "sweeps")]
    pub history: Vec<PassReport>,
    /// Wall time by kind of work.
    pub seconds: IrfSeconds,
    /// Memory plan of the fit.
    pub memory: IrfPlan,
}

/// Report on one block of degrees.
#[derive(Debug, Clone, Serialize)]
pub struct BlockReport {
    /// First degree of the block.
    pub first_degree: usize,
    /// Last degree of the block, inclusive.
    pub last_degree: usize,
    /// Number of basis functions of the block.
    pub columns: usize,
    /// Solver of the block: `cholesky` of the Gram matrix, or `rank-revealing`.
    pub solver: &'static str,
    /// Numerical rank of the block.
    pub rank: usize,
    /// Estimated condition number of the block; infinite (null in JSON) if it is singular.
    pub condition: f64,
}

/// Report on one pass over all blocks. For an accelerated fit, the report covers one iteration, which consists of two
/// passes.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct PassReport {
    /// Number of the pass, from 1. For an iteration of an accelerated fit, the number of the iteration's second pass.
    pub pass: usize,
    /// Whether this is an additional pass, which removes rounding errors of the full least squares.
    pub refinement: bool,
    /// Wall time of the pass in seconds.
    pub seconds: f64,
    /// Bytes read from the store.
    pub bytes_read: u64,
    /// Norms of each target's residual after the pass.
    pub residuals: Vec<ResidualNorms>,
}

/// Wall time by kind of work in seconds, summed over the blocks.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct IrfSeconds {
    /// Seconds for opening blocks, including waits until read-ahead has started.
    pub open: f64,
    /// Seconds for computing Gram matrices, right-hand sides, factorisations and solutions, including reading the data
    /// for them.
    pub solve: f64,
    /// Seconds for updating the residual.
    pub update: f64,
}

/// Runs `work` and adds its wall time to `seconds`.
pub(super) fn timed<T>(seconds: &mut f64, work: impl FnOnce() -> T) -> T {
    let started = Instant::now();
    let result = work();
    *seconds += started.elapsed().as_secs_f64();
    result
}

/// Records the passes of a fit and reports progress to the monitor.
pub(super) struct Recorder<'a> {
    /// Range of columns of each target.
    groups: &'a [Range<usize>],
    /// Flags (n) of the rows that are excluded from residual norms.
    unread: Option<Vec<bool>>,
    pub(super) monitor: &'a dyn Monitor,
    pub(super) seconds: IrfSeconds,
    pub(super) history: Vec<PassReport>,
    pass: usize,
    refinement: bool,
    started: Instant,
}

impl<'a> Recorder<'a> {
    pub(super) fn new(groups: &'a [Range<usize>], unread: Option<Vec<bool>>, monitor: &'a dyn Monitor) -> Self {
        let (seconds, history) = (IrfSeconds::default(), Vec::new());
        Self { groups, unread, monitor, seconds, history, pass: 0, refinement: false, started: Instant::now() }
    }

    pub(super) fn begin_pass(&mut self, pass: usize, refinement: bool) {
        (self.pass, self.refinement, self.started) = (pass, refinement, Instant::now());
    }

    pub(super) fn end_pass(&mut self, residual: &ChunkedRows, bytes_read: u64) {
        let residuals = self.groups.iter().map(|group| residual.norms(group, self.unread.as_deref())).collect();
        let (pass, refinement, seconds) = (self.pass, self.refinement, self.started.elapsed().as_secs_f64());
        self.history.push(PassReport { pass, refinement, seconds, bytes_read, residuals });
        let name = if refinement { "refinement after pass" } else { "pass" };
        let gigabytes = bytes_read as f64 / 1e9;
        self.monitor.note(Level::Detail, format_args!("{name} {pass}: {seconds:.2} s, {gigabytes:.2} GB read"));
    }

    pub(super) fn begin_block(&self, degrees: &RangeInclusive<usize>) -> Result<(), Interrupted> {
        let (pass, first, last) = (self.pass, degrees.start(), degrees.end());
        self.monitor.note(Level::Status, format_args!("pass {pass}, degrees {first} to {last}"));
        self.monitor.check()
    }

    /// Advances the progress by a block's number of columns. Blocks of refinements aren't counted, because the number
    /// of refinements isn't known beforehand.
    pub(super) fn end_block(&self, columns: usize) {
        if !self.refinement {
            self.monitor.step(columns as u64);
        }
    }
}
