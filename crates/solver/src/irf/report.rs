//! What a fit reports, and how it is recorded.

use std::ops::{Range, RangeInclusive};
use std::time::Instant;

use serde::Serialize;
use spharm_monitor::{Interrupted, Level, Monitor};

use super::plan::IrfPlan;
use crate::chunked_rows::ChunkedRows;
use crate::residual::ResidualNorms;

/// Report of a fit.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct IrfReport {
    /// `irf`, `sirf`, `mirf` or `nlsf`.
    pub method: &'static str,
    /// Whether the passes were accelerated by conjugate gradients.
    pub accelerated: bool,
    /// Number of passes asked for, p, without refinements.
    pub passes: usize,
    /// Highest degree, L.
    pub max_degree: usize,
    /// Rows, n.
    pub rows: usize,
    /// Columns of the targets fitted together, c.
    pub channels: usize,
    /// Threads.
    pub threads: usize,
    /// The blocks of a pass.
    pub blocks: Vec<BlockReport>,
    /// The passes made, refinements among them, in order.
    #[serde(rename = "sweeps")]
    pub history: Vec<PassReport>,
    /// Where the time went.
    pub seconds: IrfSeconds,
    /// The memory plan.
    pub memory: IrfPlan,
}

/// One block of a pass.
#[derive(Debug, Clone, Serialize)]
pub struct BlockReport {
    /// First degree.
    pub first_degree: usize,
    /// Last degree, inclusive.
    pub last_degree: usize,
    /// Number of basis functions.
    pub columns: usize,
    /// `cholesky` of the Gram matrix, or `rank-revealing`.
    pub solver: &'static str,
    /// Numerical rank.
    pub rank: usize,
    /// Estimated condition number of the block; infinite (null in JSON) when it is singular.
    pub condition: f64,
}

/// One pass over all blocks; of an accelerated fit one iteration, which is two passes.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct PassReport {
    /// Number of the pass, from 1; of an iteration, that of its second pass.
    pub pass: usize,
    /// Whether this is a pass beyond those asked for, which removes what rounding left of the full least squares.
    pub refinement: bool,
    /// Wall time, seconds.
    pub seconds: f64,
    /// Bytes read from the store.
    pub bytes_read: u64,
    /// The residual of each target after the pass.
    pub residuals: Vec<ResidualNorms>,
}

/// Seconds by kind of work, summed over the blocks.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct IrfSeconds {
    /// Opening blocks and waiting for read-ahead to be set off.
    pub open: f64,
    /// Gram matrices, adjoints, factorisations and solves, with the reading of what they need.
    pub solve: f64,
    /// Updates of the residual.
    pub update: f64,
}

/// Runs `work` and adds the seconds that it took to `seconds`.
pub(super) fn timed<T>(seconds: &mut f64, work: impl FnOnce() -> T) -> T {
    let started = Instant::now();
    let result = work();
    *seconds += started.elapsed().as_secs_f64();
    result
}

/// Records the passes of a fit and shows its progress.
pub(super) struct Recorder<'a> {
    /// Columns of each target.
    groups: &'a [Range<usize>],
    /// Rows that residual norms leave out, (n).
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
        self.monitor.note(Level::Detail, format_args!("{name} {pass}: {seconds:.2} s, {gigabytes:.2} GB"));
    }

    pub(super) fn begin_block(&self, degrees: &RangeInclusive<usize>) -> Result<(), Interrupted> {
        let (pass, first, last) = (self.pass, degrees.start(), degrees.end());
        self.monitor.note(Level::Status, format_args!("pass {pass}, degrees {first} to {last}"));
        self.monitor.check()
    }

    /// So many columns of the basis are done. Those of refinements aren't counted: it isn't known how many will be
    /// needed.
    pub(super) fn end_block(&self, columns: usize) {
        if !self.refinement {
            self.monitor.step(columns as u64);
        }
    }
}
