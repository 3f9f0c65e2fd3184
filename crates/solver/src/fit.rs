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

use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use ndarray::{Array2, ArrayView2};
use spharm_harmonics::Coefficients;
use spharm_harmonics::basis_size;
use spharm_harmonics::index::first_column;

use crate::SolverError;
use crate::block::{Context, Factor, solve};
use crate::dense;
use crate::operator::{Block, Operator};
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
    /// The memory plan, and the number of blocks of a pass.
    Planned(&'a Plan, usize),
    /// A block was solved: number of the sweep from 1, columns done in it, degrees of the block.
    Block(usize, usize, std::ops::RangeInclusive<usize>),
    /// A sweep is over.
    Sweep(&'a SweepReport),
}

/// Change of the coefficients, relative to their norm, below which a refinement is the last.
const REFINED: f64 = 1e-14;

/// Fits targets, (n, c), whose columns belong together as `groups` says (three for a surface, one for a signal).
///
/// # Errors
///
/// [`SolverError::Budget`] and other refusals before anything is read; [`SolverError::Store`] when the basis is
/// damaged or changes; [`SolverError::Interrupted`] when `cancel` was set.
pub fn fit(
    operator: &dyn Operator,
    targets: ArrayView2<'_, f64>,
    groups: &[Range<usize>],
    params: &FitParams,
    cancel: &AtomicBool,
    event: &dyn Fn(FitEvent<'_>),
) -> Result<Fit, SolverError> {
    check(operator, targets, params)?;
    let blocks = params.method.blocks(params.max_degree)?;
    let channels = targets.ncols();
    let plan = plan(operator, channels, params)?;
    event(FitEvent::Planned(&plan, blocks.len()));
    dense::set_blas_threads(1);

    let roots: Option<Vec<f64>> = params.weights.as_ref().map(|weights| weights.iter().map(|w| w.sqrt()).collect());
    let context = Context {
        operator,
        roots: roots.as_deref(),
        channels,
        threads: params.threads,
        spare: plan.spare(),
        budget: plan.budget,
    };
    let mut residual = ChunkedRows::from_array(targets, operator.chunk_rows());
    let mut coefficients = Array2::<f64>::zeros((basis_size(params.max_degree), channels));
    let mut factors: Vec<Option<Factor>> = vec![None; blocks.len()];
    let mut block_reports = Vec::new();
    let mut sweeps: Vec<SweepReport> = Vec::new();
    let mut seconds = Seconds::default();
    let passes = params.method.passes();
    let mut last_change = f64::INFINITY;
    let open = |block: usize| -> Result<Box<dyn Block + '_>, SolverError> {
        let opened = operator.open(blocks[block].clone(), plan.residency(block))?;
        opened.prefetch();
        Ok(opened)
    };
    for sweep in 1..=passes + params.refinements {
        let started = Instant::now();
        let mut bytes_read = 0;
        let (mut change, mut done) = (0.0f64, 0);
        let mut crew = workers(operator, &mut residual, roots.as_deref(), params.threads);
        let mut ahead = None;
        for (at, degrees) in blocks.iter().enumerate() {
            if cancel.load(Ordering::Relaxed) {
                return Err(SolverError::Interrupted);
            }
            let mark = Instant::now();
            let block = match ahead.take() {
                Some(block) => block,
                None => open(at)?,
            };
            if plan.read_ahead && at + 1 < blocks.len() {
                ahead = Some(open(at + 1)?);
            }
            seconds.open += lap(&mut mark.clone());
            let mut mark = Instant::now();
            let (x, made) = solve(&context, &*block, degrees, &mut crew, factors[at].as_ref())?;
            seconds.solve += lap(&mut mark);
            if let Some(factor) = made {
                if sweep == 1 {
                    block_reports.push(report_of(degrees, &factor));
                }
                if plan.keep_factors {
                    factors[at] = Some(factor);
                }
            }
            update(&*block, &mut crew, &x)?;
            seconds.update += lap(&mut mark);
            bytes_read += block.bytes_read();
            block.close()?;
            let first = first_column(*degrees.start());
            let mut rows = coefficients.slice_mut(ndarray::s![first..first + columns(degrees), ..]);
            rows.iter_mut().zip(&x).for_each(|(sum, x)| *sum += x);
            change += x.iter().map(|x| x * x).sum::<f64>();
            done += columns(degrees);
            event(FitEvent::Block(sweep, done, degrees.clone()));
        }
        drop(crew);
        let residuals = groups.iter().map(|group| {
            let (mean_square, max_square) = residual.squared_norms(group);
            Residual { mean_square, max_square }
        });
        let report = SweepReport {
            pass: sweep.min(passes),
            refinement: sweep > passes,
            residuals: residuals.collect(),
            seconds: started.elapsed().as_secs_f64(),
            bytes_read,
        };
        event(FitEvent::Sweep(&report));
        sweeps.push(report);
        let norm = coefficients.iter().map(|a| a * a).sum::<f64>();
        let change = (change / norm.max(f64::MIN_POSITIVE)).sqrt();
        // Rounding has been reached when a further sweep changes nothing, or no less than the one before.
        if sweep > passes && (change < REFINED || change >= 0.5 * last_change) {
            break;
        }
        last_change = change;
    }
    let report = FitReport {
        method: params.method.name(),
        passes,
        max_degree: params.max_degree,
        rows: operator.rows(),
        channels,
        threads: params.threads,
        blocks: block_reports,
        sweeps,
        seconds,
        memory: plan,
    };
    Ok(Fit { coefficients: Coefficients::new(coefficients)?, report })
}

/// Seconds since `mark`, which is set to now.
fn lap(mark: &mut Instant) -> f64 {
    let now = Instant::now();
    (now - std::mem::replace(mark, now)).as_secs_f64()
}

fn report_of(degrees: &std::ops::RangeInclusive<usize>, factor: &Factor) -> BlockReport {
    BlockReport {
        first_degree: *degrees.start(),
        last_degree: *degrees.end(),
        columns: columns(degrees),
        solver: factor.name(),
        rank: factor.rank(columns(degrees)),
        condition: factor.condition(),
    }
}

fn check(operator: &dyn Operator, targets: ArrayView2<'_, f64>, params: &FitParams) -> Result<(), SolverError> {
    let expected = operator.rows();
    if targets.nrows() != expected {
        return Err(SolverError::Rows { what: "the target", expected, found: targets.nrows() });
    }
    if params.threads == 0 {
        return Err(SolverError::TooSmall { what: "the number of threads", least: 1, found: 0 });
    }
    if let Some(((row, column), _)) = targets.indexed_iter().find(|(_, value)| !value.is_finite()) {
        return Err(SolverError::NotFinite { row, column });
    }
    if let Some(weights) = &params.weights {
        if weights.len() != expected {
            return Err(SolverError::Rows { what: "the list of weights", expected, found: weights.len() });
        }
        let bad = |weight: &f64| !weight.is_finite() || *weight < 0.0;
        if let Some(row) = weights.iter().position(bad).or((weights.iter().all(|&w| w == 0.0)).then_some(0)) {
            return Err(SolverError::Weight { row, found: weights[row] });
        }
    }
    Ok(())
}
