//! Runs iterative residual fitting over a store, with as many columns at a time as the memory allows.

use std::ops::RangeInclusive;
use std::time::Instant;

use ndarray::Axis;
use spharm_monitor::{Level, Monitor, Silent};
use spharm_solver::{
    BlockOperator, ChunkedRows, DiskOperator, GramMatrix, IrfParams, IrfPlan, IrfSolver, Method as Blocks, Operator,
    SolverError, irf, moment_gram, moment_gram_bytes,
};
use spharm_store::Scalar;
use spharm_transform::MomentGram;

use super::batches::{PerTarget, Run, Solved};
use super::job::Job;
use super::shared::{counted, in_batches};
use crate::machine::check_limits;
use crate::report::BatchReport;
use crate::{Error, FitWarning, defaults};

/// Fits all targets in batches.
pub(crate) fn run<T: Send, E: From<Error> + Send>(run: &mut Run<'_, T, E>) -> Result<(), E> {
    let mark = Instant::now();
    let (count, monitor) = (run.count, run.monitor);
    // The plan assumes that all targets have as many channels as the first target, which is true in most studies.
    let channels = run.channels();
    let (operator, method) = basis(&mut run.job)?;
    let planner = Planner { operator: &operator, method };
    run.job.threads = planner.fitting_threads(&run.job, channels, monitor);
    let gram_bytes = planner.gram_bytes(&run.job, count, channels);
    let moments = gram_bytes.map(|_| planner.moments(&run.job)).transpose()?;
    let moments = moments.as_ref();
    let together = planner.choose(&run.job, gram_bytes, count, channels)?.together;
    let mut fitter = planner.fitter(&run.job, moments, together, channels, count > together)?;
    run.readers = run.job.threads.min(together);
    run.seconds.plan += mark.elapsed().as_secs_f64();
    planner.note_plan(&run.job, &fitter, count, together, monitor);

    let columns = fitter.channels();
    run.each_batch(columns, |job, batch| {
        if batch.columns() > fitter.channels() {
            // A single target with more channels than planned gets its own batch and its own plan.
            fitter = planner.fitter(job, moments, 1, batch.columns(), true)?;
        }
        let mut targets = ChunkedRows::zeros(operator.rows(), batch.columns(), operator.chunk_rows());
        let mut spreads = Vec::with_capacity(batch.groups.len());
        for (group, target) in batch.targets() {
            spreads.push(target.var_axis(Axis(0), 0.0).sum().sqrt());
            targets.set_columns(group.start, target);
        }
        let fit = fitter.fit(targets, &batch.groups, monitor)?;
        let sweeps = fit.report.history.iter().map(|sweep| (sweep.refinement, sweep.residuals.clone())).collect();
        let of_target = |target: usize| {
            let warnings = FitWarning::of_passes(&fit.report.history, target, spreads[target]).into_iter().collect();
            PerTarget { optimality: None, warnings }
        };
        let per_target = (0..batch.groups.len()).map(of_target).collect();
        Ok(Solved {
            coefficients: fit.coefficients.values().to_owned(),
            sweeps,
            standard_errors: None,
            denoised: Vec::new(),
            surface_distances: Vec::new(),
            warnings: FitWarning::of_blocks(&fit.report.blocks),
            per_target,
            at_centres: Vec::new(),
            report: BatchReport::Streamed(fit.report),
        })
    })
}

/// Checks that the memory suffices to fit `count` surfaces, without fitting them.
pub(crate) fn check(mut job: Job<'_>, count: usize) -> Result<(), Error> {
    /// Number of channels of a surface.
    const CHANNELS: usize = 3;
    let (operator, method) = basis(&mut job)?;
    let planner = Planner { operator: &operator, method };
    job.threads = planner.fitting_threads(&job, CHANNELS, &Silent);
    let gram_bytes = planner.gram_bytes(&job, count, CHANNELS);
    planner.check_limits(&planner.choose(&job, gram_bytes, count, CHANNELS)?.plan)
}

/// Takes the basis out of a job. Returns it together with the blocks of degrees that the job's method fits.
fn basis(job: &mut Job<'_>) -> Result<(DiskOperator, Blocks), Error> {
    match (job.scheme.take(), job.params.method.blocks()) {
        (Some(scheme), Some(method)) => Ok((DiskOperator::new(scheme), method)),
        _ => Err(Error::NeedsStore { method: job.params.method.name() }),
    }
}

/// Chooses settings of iterative residual fitting that read as little of the basis as the memory budget allows.
struct Planner<'o> {
    operator: &'o DiskOperator,
    method: Blocks,
}

/// A possible number of surfaces to fit together, with the memory plan of such a fit and the amount of the basis that
/// it reads.
struct Choice {
    together: usize,
    /// Number of columns that one pass reads from the basis, summed over all batches.
    reads: usize,
    plan: IrfPlan,
}

impl<'o> Planner<'o> {
    fn params(
        &self,
        job: &Job<'_>,
        together: usize,
        channels: usize,
        reuse: bool,
        gram_bytes: Option<usize>,
    ) -> IrfParams {
        IrfParams {
            max_degree: job.params.max_degree,
            method: self.method,
            refinements: if self.method == Blocks::Nlsf { defaults::REFINEMENTS } else { 0 },
            weights: job.weights.clone(),
            unread: job.unread.clone(),
            memory: job.memory,
            held: job.held(together, channels),
            threads: job.threads,
            reuse,
            accelerate: job.params.method.accelerated(),
            gram_bytes,
        }
    }

    fn fitter<'m>(
        &self,
        job: &Job<'_>,
        moments: Option<&'m MomentGram>,
        together: usize,
        channels: usize,
        reuse: bool,
    ) -> Result<IrfSolver<'m>, Error>
    where
        'o: 'm,
    {
        let columns = together * channels;
        let params = self.params(job, together, channels, reuse, moments.map(GramMatrix::bytes));
        let fitter = match moments {
            // A target with more channels than the other targets may leave no memory for the Gram matrices from
            // moments.
            Some(moments) if irf::plan(self.operator, columns, &params).is_ok() => {
                IrfSolver::with_gram(self.operator, columns, params, moments)
            }
            _ => IrfSolver::new(self.operator, columns, IrfParams { gram_bytes: None, ..params }),
        }?;
        self.check_limits(fitter.plan())?;
        Ok(fitter)
    }

    /// Checks that this process's limits allow a plan.
    fn check_limits(&self, plan: &IrfPlan) -> Result<(), Error> {
        let decoded = if self.operator.is_direct() { 0 } else { plan.basis };
        check_limits(plan.arrays + plan.work + plan.grams + plan.factors + plan.reserved + decoded, plan.basis)
    }

    /// Returns the bytes of the moments from which Gram matrices are computed. Returns `None` if the basis isn't in
    /// f64, if memory doesn't suffice to compute the moments, or if their memory would force blocks to be read more
    /// often or factors to be recomputed.
    fn gram_bytes(&self, job: &Job<'_>, surfaces: usize, channels: usize) -> Option<usize> {
        let max_degree = job.params.max_degree;
        // The moments need transforms of twice the degree, which may be above the highest degree of transforms.
        let making = moment_gram_bytes(self.operator.rows(), max_degree).ok()?;
        if job.scalar != Scalar::F64 || job.held(1, channels) + making > job.memory {
            return None;
        }
        let bytes = MomentGram::bytes(max_degree);
        let best = |gram_bytes| self.best(job, gram_bytes, surfaces, channels).ok();
        let fits = match (best(None), best(Some(bytes))) {
            (None, with) => with.is_some(),
            (Some(_), None) => false,
            (Some(without), Some(with)) => {
                with.reads < without.reads
                    || with.reads == without.reads
                        && with.plan.read_ahead >= without.plan.read_ahead
                        && with.plan.keep_factors >= without.plan.keep_factors
            }
        };
        fits.then_some(bytes)
    }

    /// Computes the moments from which Gram matrices are computed.
    fn moments(&self, job: &Job<'_>) -> Result<MomentGram, Error> {
        Ok(moment_gram(&job.sphere.directions, job.weights.as_deref(), job.params.max_degree)?)
    }

    /// Returns the number of surfaces to fit together that minimises the number of bytes read from the basis, within
    /// the memory budget. A batch reads a block once if the whole block is in memory, otherwise twice. If several
    /// numbers are equally good, returns the largest.
    fn best(
        &self,
        job: &Job<'_>,
        gram_bytes: Option<usize>,
        surfaces: usize,
        channels: usize,
    ) -> Result<Choice, SolverError> {
        let blocks = self.method.blocks(job.params.max_degree)?;
        let choice = |together: usize| -> Result<Choice, SolverError> {
            let params = self.params(job, together, channels, surfaces > together, gram_bytes);
            let plan = irf::plan(self.operator, together * channels, &params)?;
            let columns =
                |(degrees, whole): (&RangeInclusive<usize>, &bool)| irf::columns(degrees) * if *whole { 1 } else { 2 };
            let columns: usize = blocks.iter().zip(&plan.whole).map(columns).sum();
            Ok(Choice { together, reads: surfaces.div_ceil(together) * columns, plan })
        };
        let numbers = (1..=surfaces.min(defaults::MOST_TOGETHER)).rev();
        let best = numbers.filter_map(|together| choice(together).ok()).min_by_key(|choice| choice.reads);
        best.map_or_else(|| choice(1), Ok)
    }

    /// Returns the [`best`](Self::best) number of surfaces to fit together, or an error with the smallest budget that
    /// suffices.
    fn choose(
        &self,
        job: &Job<'_>,
        gram_bytes: Option<usize>,
        surfaces: usize,
        channels: usize,
    ) -> Result<Choice, Error> {
        self.best(job, gram_bytes, surfaces, channels).map_err(|error| match error {
            SolverError::Budget { budget, needed, granularity } => {
                let needed = self.least_by_moments(job, channels).map_or(needed, |least| least.min(needed));
                SolverError::Budget { budget, needed, granularity }.into()
            }
            error => error.into(),
        })
    }

    /// Returns the smallest budget in bytes for fits of one surface with Gram matrices computed from moments. Returns
    /// `None` if the Gram matrices can't be computed from moments.
    fn least_by_moments(&self, job: &Job<'_>, channels: usize) -> Option<usize> {
        let max_degree = job.params.max_degree;
        let making = moment_gram_bytes(self.operator.rows(), max_degree).ok().filter(|_| job.scalar == Scalar::F64)?;
        let params = self.params(job, 1, channels, false, Some(MomentGram::bytes(max_degree)));
        // A plan with a budget of 0 fails, and its error states the sufficient budget.
        match irf::plan(self.operator, channels, &IrfParams { memory: 0, ..params }) {
            Err(SolverError::Budget { needed, .. }) => Some(needed.max(job.held(1, channels) + making)),
            _ => None,
        }
    }

    /// Returns the largest number of threads for which the budget suffices, at least one. Each thread accumulates its
    /// own sums; on a node with many cores, these sums alone may exceed the budget.
    fn fitting_threads(&self, job: &Job<'_>, channels: usize, monitor: &dyn Monitor) -> usize {
        let asked = job.threads;
        let fits = |&threads: &usize| {
            let held = super::job::held(job.sphere.directions.len(), job.sphere.faces.len(), 1, channels, 1);
            let params = IrfParams { held, threads, ..self.params(job, 1, channels, false, None) };
            irf::plan(self.operator, channels, &params).is_ok()
        };
        let Some(threads) = (1..=asked).rev().find(fits) else { return 1 };
        if threads < asked {
            let text = format_args!("{threads} threads instead of {asked}, to stay within the memory budget");
            monitor.note(Level::Info, text);
        }
        threads
    }

    fn note_plan(
        &self,
        job: &Job<'_>,
        fitter: &IrfSolver<'_>,
        surfaces: usize,
        together: usize,
        monitor: &dyn Monitor,
    ) {
        let (plan, blocks) = (fitter.plan(), fitter.blocks().len());
        let text = format_args!(
            "{} with {} vertices, degree {}: method {} with {} of {}{}, {} of {} MiB of memory planned",
            counted(surfaces, "target", "targets"),
            self.operator.rows(),
            job.params.max_degree,
            self.method.name(),
            counted(self.method.passes(), "pass", "passes"),
            counted(blocks, "block", "blocks"),
            in_batches(surfaces, together),
            plan.total.div_ceil(1 << 20),
            plan.budget >> 20,
        );
        monitor.note(Level::Info, text);
        let twice = plan.whole.iter().filter(|&&whole| !whole).count();
        if twice > 0 {
            let blocks = counted(twice, "block", "blocks");
            monitor
                .note(Level::Info, format_args!("not kept in memory, and therefore read again for each use: {blocks}"));
        }
    }
}
