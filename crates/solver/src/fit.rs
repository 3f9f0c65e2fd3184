//! Iterative residual fitting: the sweep over the blocks, pass after pass.
//!
//! ```text
//! r = f, a = 0
//! for each pass
//!     for each block (A_d .. A_e)
//!         solve  min | W^(1/2) (A_block x - r) |
//!         a_block += x,  r -= A_block x
//! ```
//!
//! after Shen and Chung (3DPVT 2006), section 3.3. Solving a block is one step of block Gauss-Seidel on the normal
//! equations, so for p to infinity the passes converge to the full least squares whatever the blocks.
//!
//! Cost of the first pass for c columns: `n k (k + 1)` flops for each block's Gram matrix, `4 n K c` for adjoints and
//! updates, and one look at every byte of the basis (two where a block doesn't fit the budget). Later passes need the
//! adjoints and updates only and run as fast as the basis comes from memory.

use std::ops::{Range, RangeInclusive};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use ndarray::{Array2, ArrayView2};
use spharm_harmonics::Coefficients;
use spharm_harmonics::basis_size;
use spharm_harmonics::index::first_column;

use crate::SolverError;
use crate::block::{Context, Factor, Solved, solve};
use crate::dense;
use crate::grams::BlockGrams;
use crate::operator::{Block, BlockOperator};
use crate::plan::{Plan, plan};
use crate::report::{BlockReport, FitReport, Residual, Seconds, SweepReport};
use crate::rows::ChunkedRows;
use crate::schedule::{Method, columns};
use crate::workers::{update, workers};

/// How to fit.
#[derive(Debug, Clone)]
pub struct FitParams {
    /// Highest degree, L.
    pub max_degree: usize,
    /// Blocks and passes.
    pub method: Method,
    /// Sweeps after the last pass that remove what rounding left over; they end early when they change nothing. Of use
    /// for [`Method::Nlsf`], whose one block may be ill-conditioned.
    pub refinements: usize,
    /// Weight of each row in the least squares, (n).
    pub weights: Option<Vec<f64>>,
    /// Most bytes of memory to take, mapped windows included.
    pub memory: usize,
    /// Bytes that the caller holds already, which count against the budget.
    pub held: usize,
    /// Threads, on the rayon pool that the fit is called in.
    pub threads: usize,
    /// Whether more fits will follow on the same [`Fitter`], so that factors are worth keeping.
    pub reuse: bool,
    /// Conjugate gradients over pairs of passes, which converge in far fewer of them; see `accelerated.rs`.
    pub accelerate: bool,
    /// Bytes held by the source of the blocks' Gram matrices, for the plan of a fit that is to have one.
    /// [`Fitter::new`] and [`Fitter::with_grams`] set it to what they are given.
    pub gram_source: Option<usize>,
}

impl Default for FitParams {
    fn default() -> Self {
        Self {
            max_degree: 100,
            method: Method::Irf { passes: 1, granularity: 100 },
            refinements: 0,
            weights: None,
            memory: 256 << 20,
            held: 0,
            threads: rayon::current_num_threads(),
            reuse: false,
            accelerate: false,
            gram_source: None,
        }
    }
}

/// The coefficients, and how they were come by.
#[derive(Debug, Clone)]
pub struct Fit {
    /// Canonical coefficients, (K, c).
    pub coefficients: Coefficients,
    /// Report.
    pub report: FitReport,
}

/// What a fit tells while it runs.
#[derive(Debug)]
#[non_exhaustive]
pub enum FitEvent<'a> {
    /// A block is about to be solved: number of the sweep from 1, its degrees.
    Solving(usize, RangeInclusive<usize>),
    /// A block was solved: number of the sweep from 1, columns done in it, degrees of the block.
    Block(usize, usize, RangeInclusive<usize>),
    /// A sweep is over.
    Sweep(&'a SweepReport),
}

/// Change of the coefficients, relative to their norm, below which a refinement is the last.
const REFINED: f64 = 1e-14;

/// Fits batch after batch of targets on one operator, and keeps the blocks' factors from one to the next.
pub struct Fitter<'o> {
    pub(crate) operator: &'o dyn BlockOperator,
    pub(crate) params: FitParams,
    grams: Option<&'o dyn BlockGrams>,
    channels: usize,
    pub(crate) blocks: Vec<RangeInclusive<usize>>,
    plan: Plan,
    /// Square roots of the weights, (n).
    pub(crate) roots: Option<Vec<f64>>,
    factors: Vec<Option<Factor>>,
    block_reports: Vec<BlockReport>,
}

impl<'o> Fitter<'o> {
    /// Plans fits of up to `channels` columns at a time.
    ///
    /// # Errors
    ///
    /// [`SolverError::Budget`], and what is wrong with the parameters.
    pub fn new(operator: &'o dyn BlockOperator, channels: usize, params: FitParams) -> Result<Self, SolverError> {
        Self::planned(operator, channels, params, None)
    }

    /// The same with the blocks' Gram matrices from `grams`, which must be that of the operator's basis, in f64, with the
    /// weights of `params`. Passes then cost their adjoints and updates only, the first one too.
    ///
    /// # Errors
    ///
    /// Those of [`Fitter::new`]; [`SolverError::Degree`] for a source that ends below the fit's highest degree.
    pub fn with_grams(
        operator: &'o dyn BlockOperator,
        channels: usize,
        params: FitParams,
        grams: &'o dyn BlockGrams,
    ) -> Result<Self, SolverError> {
        if params.max_degree > grams.max_degree() {
            return Err(SolverError::Degree { found: params.max_degree, max_degree: grams.max_degree() });
        }
        Self::planned(operator, channels, params, Some(grams))
    }

    fn planned(
        operator: &'o dyn BlockOperator,
        channels: usize,
        params: FitParams,
        grams: Option<&'o dyn BlockGrams>,
    ) -> Result<Self, SolverError> {
        let params = FitParams { gram_source: grams.map(BlockGrams::bytes), ..params };
        check(operator, &params)?;
        let blocks = params.method.blocks(params.max_degree)?;
        let plan = plan(operator, channels, &params)?;
        let roots = params.weights.as_ref().map(|weights| weights.iter().map(|w| w.sqrt()).collect());
        let factors = vec![None; blocks.len()];
        Ok(Self { operator, params, grams, channels, blocks, plan, roots, factors, block_reports: Vec::new() })
    }

    /// Most columns that a batch may have.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// The memory plan.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// The blocks of a pass.
    pub fn blocks(&self) -> &[RangeInclusive<usize>] {
        &self.blocks
    }

    /// Fits targets, (n, c), whose columns belong together as `groups` says (three for a surface, one for a signal).
    ///
    /// # Errors
    ///
    /// [`SolverError::Store`] when the basis is damaged or changes, [`SolverError::Interrupted`] when `cancel` was set,
    /// [`SolverError::Rows`] and [`SolverError::NotFinite`] for targets that can't be fitted.
    pub fn fit(
        &mut self,
        targets: ChunkedRows,
        groups: &[Range<usize>],
        cancel: &AtomicBool,
        event: &dyn Fn(FitEvent<'_>),
    ) -> Result<Fit, SolverError> {
        let expected = self.operator.rows();
        if targets.rows() != expected {
            return Err(SolverError::Rows { what: "the target", expected, found: targets.rows() });
        }
        if let Some((row, column)) = targets.not_finite() {
            return Err(SolverError::NotFinite { row, column });
        }
        let channels = targets.channels();
        if channels > self.channels {
            return Err(SolverError::Channels { planned: self.channels, found: channels });
        }
        dense::set_blas_threads(1);
        let mut residual = targets;
        let mut coefficients = Array2::<f64>::zeros((basis_size(self.params.max_degree), channels));
        let mut seconds = Seconds::default();
        let watch = Watch { groups, cancel, event };
        let sweeps = match self.params.accelerate {
            true => self.accelerated(&mut residual, &mut coefficients, &mut seconds, &watch)?,
            false => self.passes(&mut residual, &mut coefficients, &mut seconds, &watch)?,
        };
        let report = FitReport {
            method: self.params.method.name(),
            accelerated: self.params.accelerate,
            passes: self.params.method.passes(),
            max_degree: self.params.max_degree,
            rows: expected,
            channels,
            threads: self.params.threads,
            blocks: self.block_reports.clone(),
            sweeps,
            seconds,
            memory: self.plan.clone(),
        };
        Ok(Fit { coefficients: Coefficients::new(coefficients)?, report })
    }

    /// Pass after pass, then the refinements.
    fn passes(
        &mut self,
        residual: &mut ChunkedRows,
        coefficients: &mut Array2<f64>,
        seconds: &mut Seconds,
        watch: &Watch<'_>,
    ) -> Result<Vec<SweepReport>, SolverError> {
        let mut sweeps: Vec<SweepReport> = Vec::new();
        let passes = self.params.method.passes();
        let mut last_change = f64::INFINITY;
        for sweep in 1..=passes + self.params.refinements {
            let started = Instant::now();
            let swept = self.sweep(sweep, Way::Forward, residual, coefficients, seconds, watch)?;
            sweeps.push(watch.report(sweep.min(passes), sweep > passes, residual, started, swept.bytes_read));
            let change = relative_change(&swept.change, coefficients);
            // Rounding has been reached when a further sweep changes nothing, or no less than the one before. What
            // needed a rank-revealing solve is as good as it gets: it doesn't suffer from the Gram matrix's condition.
            let refined = sweep > passes && (change < REFINED || change >= 0.5 * last_change);
            if refined || (sweep >= passes && self.block_reports.iter().any(|b| b.solver != "cholesky")) {
                break;
            }
            last_change = change;
        }
        Ok(sweeps)
    }

    /// One sweep over the blocks.
    pub(crate) fn sweep(
        &mut self,
        sweep: usize,
        way: Way,
        residual: &mut ChunkedRows,
        coefficients: &mut Array2<f64>,
        seconds: &mut Seconds,
        watch: &Watch<'_>,
    ) -> Result<Swept, SolverError> {
        let &Watch { cancel, event, .. } = watch;
        let operator = self.operator;
        let context = Context {
            operator,
            roots: self.roots.as_deref(),
            grams: self.grams,
            channels: residual.channels(),
            threads: self.params.threads,
            spare: self.plan.spare(),
            budget: self.plan.budget,
            cancel,
        };
        let open = |at: usize| -> Result<Box<dyn Block + 'o>, SolverError> {
            let block = operator.open(self.blocks[at].clone(), self.plan.residency(at))?;
            block.prefetch();
            Ok(block)
        };
        let mut crew = workers(operator, residual, context.roots, context.threads);
        let zero = vec![0.0; context.channels];
        let mut swept = Swept { change: zero.clone(), energy: zero, bytes_read: 0 };
        let count = self.blocks.len();
        let (course, mut done): (Vec<usize>, usize) = match way {
            Way::Forward => ((0..count).collect(), 0),
            Way::Backward => ((0..count - 1).rev().collect(), columns(&self.blocks[count - 1])),
        };
        let mut ahead = None;
        for (step, &at) in course.iter().enumerate() {
            let degrees = &self.blocks[at];
            if cancel.load(Ordering::Relaxed) {
                return Err(SolverError::Interrupted);
            }
            let mut mark = Instant::now();
            let block = match ahead.take() {
                Some(block) => block,
                None => open(at)?,
            };
            if let (true, Some(&next)) = (self.plan.read_ahead, course.get(step + 1)) {
                ahead = Some(open(next)?);
            }
            seconds.open += lap(&mut mark);
            event(FitEvent::Solving(sweep, degrees.clone()));
            let solved = match solve(&context, &*block, degrees, &mut crew, self.factors[at].as_ref()) {
                Ok(solved) => solved,
                // A basis that was cut off under the solver looks singular; closing the block tells what happened.
                Err(error) => return Err(block.close().err().unwrap_or(error)),
            };
            seconds.solve += lap(&mut mark);
            let Solved { x, factor, energy } = solved;
            if let Some(factor) = factor {
                if self.block_reports.len() == at {
                    self.block_reports.push(report_of(degrees, &factor));
                }
                if self.plan.keep_factors {
                    self.factors[at] = Some(factor);
                }
            }
            update(&*block, &mut crew, &x)?;
            swept.bytes_read += block.bytes_read();
            block.close()?;
            seconds.update += lap(&mut mark);
            let first = first_column(*degrees.start());
            let mut rows = coefficients.slice_mut(ndarray::s![first..first + columns(degrees), ..]);
            rows.iter_mut().zip(&x).for_each(|(sum, x)| *sum += x);
            for row in x.chunks_exact(context.channels) {
                swept.change.iter_mut().zip(row).for_each(|(sum, x)| *sum += x * x);
            }
            swept.energy.iter_mut().zip(&energy).for_each(|(sum, energy)| *sum += energy);
            done += columns(degrees);
            event(FitEvent::Block(sweep, done, degrees.clone()));
        }
        Ok(swept)
    }
}

/// The order in which a sweep takes the blocks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Way {
    /// From the first to the last.
    Forward,
    /// From the last but one to the first, after a forward sweep: the last block has just been solved, and solving it
    /// again would give zero.
    Backward,
}

/// What a sweep did, column by column.
pub(crate) struct Swept {
    /// Squared norm of the change of the coefficients, (c).
    pub(crate) change: Vec<f64>,
    /// Decrease of the residual's weighted squared norm, (c).
    pub(crate) energy: Vec<f64>,
    pub(crate) bytes_read: u64,
}

/// Who looks on while a fit runs.
pub(crate) struct Watch<'a> {
    pub(crate) groups: &'a [Range<usize>],
    pub(crate) cancel: &'a AtomicBool,
    pub(crate) event: &'a dyn Fn(FitEvent<'_>),
}

impl Watch<'_> {
    /// Tells, and gives back, what a sweep that began at `started` came to.
    pub(crate) fn report(
        &self,
        pass: usize,
        refinement: bool,
        residual: &ChunkedRows,
        started: Instant,
        bytes_read: u64,
    ) -> SweepReport {
        let residuals = self.groups.iter().map(|group| {
            let (mean_square, max_square) = residual.squared_norms(group);
            Residual { mean_square, max_square }
        });
        let residuals = residuals.collect();
        let report = SweepReport { pass, refinement, residuals, seconds: started.elapsed().as_secs_f64(), bytes_read };
        (self.event)(FitEvent::Sweep(&report));
        report
    }
}

/// Of a change with these squared norms, relative to the coefficients, the largest of all columns.
fn relative_change(change: &[f64], coefficients: &Array2<f64>) -> f64 {
    let norms = coefficients.columns().into_iter().map(|column| column.iter().map(|a| a * a).sum::<f64>());
    let relative = change.iter().zip(norms).map(|(change, norm)| (change / norm.max(f64::MIN_POSITIVE)).sqrt());
    relative.fold(0.0, f64::max)
}

/// Fits one batch of targets: [`Fitter::new`] and [`Fitter::fit`].
///
/// # Errors
///
/// Those of the two.
pub fn fit(
    operator: &dyn BlockOperator,
    targets: ArrayView2<'_, f64>,
    groups: &[Range<usize>],
    params: &FitParams,
) -> Result<Fit, SolverError> {
    let mut fitter = Fitter::new(operator, targets.ncols(), params.clone())?;
    let targets = ChunkedRows::from_array(targets, operator.chunk_rows());
    fitter.fit(targets, groups, &AtomicBool::new(false), &|_| {})
}

/// Seconds since `mark`, which is set to now.
fn lap(mark: &mut Instant) -> f64 {
    let now = Instant::now();
    (now - std::mem::replace(mark, now)).as_secs_f64()
}

fn report_of(degrees: &RangeInclusive<usize>, factor: &Factor) -> BlockReport {
    BlockReport {
        first_degree: *degrees.start(),
        last_degree: *degrees.end(),
        columns: columns(degrees),
        solver: factor.name(),
        rank: factor.rank(columns(degrees)),
        condition: factor.condition(),
    }
}

fn check(operator: &dyn BlockOperator, params: &FitParams) -> Result<(), SolverError> {
    let expected = operator.rows();
    if params.threads == 0 {
        return Err(SolverError::TooSmall { what: "the number of threads", least: 1, found: 0 });
    }
    if params.max_degree > operator.max_degree() {
        return Err(SolverError::Degree { found: params.max_degree, max_degree: operator.max_degree() });
    }
    if let Some(weights) = &params.weights {
        check_weights(weights, expected)?;
    }
    Ok(())
}

/// Refuses weights that aren't one finite, not negative number for each row, or are all zero.
pub(crate) fn check_weights(weights: &[f64], rows: usize) -> Result<(), SolverError> {
    if weights.len() != rows {
        return Err(SolverError::Rows { what: "the list of weights", expected: rows, found: weights.len() });
    }
    let bad = |weight: &f64| !weight.is_finite() || *weight < 0.0;
    let all_zero = weights.iter().all(|&weight| weight == 0.0);
    if let Some(row) = weights.iter().position(bad).or(all_zero.then_some(0)) {
        return Err(SolverError::Weight { row, found: weights[row] });
    }
    Ok(())
}
