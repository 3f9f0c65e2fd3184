//! Runs iterative residual fitting over a store, with as many columns at a time as the memory allows.

use std::time::Instant;

use spharm_monitor::{Level, Monitor};
use spharm_solver::{
    BlockOperator, ChunkedRows, DiskOperator, GramMatrix, IrfParams, IrfSolver, Method as Blocks, Operator,
    SolverError, irf, moment_gram, moment_gram_bytes,
};
use spharm_store::Scalar;
use spharm_transform::MomentGram;

use super::batches::{Run, Solved};
use super::job::Job;
use super::shared::{counted, in_batches};
use crate::machine::check_limits;
use crate::report::BatchReport;
use crate::{Error, FitWarning, defaults};

/// Fits all targets in batches.
pub(crate) fn run<T: Send, E: From<Error> + Send>(run: &mut Run<'_, T, E>) -> Result<(), E> {
    let mark = Instant::now();
    let (count, monitor) = (run.count, run.monitor);
    // In most studies all targets have as many channels as the first target.
    let channels = run.channels();
    let (Some(scheme), Some(method)) = (run.job.scheme.take(), run.job.params.method.blocks()) else {
        return Err(Error::NeedsStore { method: run.job.params.method.name() }.into());
    };
    let operator = DiskOperator::new(scheme);
    let planner = Planner { operator: &operator, method };
    run.job.threads = planner.fitting_threads(&run.job, channels, monitor);
    let moments = planner.moments(&run.job, channels, count > 1)?;
    let moments = moments.as_ref();
    let together = planner.surfaces_together(&run.job, moments, count, channels)?;
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
        for (group, target) in batch.targets() {
            targets.set_columns(group.start, target);
        }
        let fit = fitter.fit(targets, &batch.groups, monitor)?;
        let sweeps = fit.report.history.iter().map(|sweep| (sweep.refinement, sweep.residuals.clone())).collect();
        Ok(Solved {
            coefficients: fit.coefficients.values().to_owned(),
            sweeps,
            standard_errors: None,
            denoised: Vec::new(),
            surface_distances: Vec::new(),
            warnings: FitWarning::of_blocks(&fit.report.blocks),
            per_target: Vec::new(),
            at_centres: Vec::new(),
            report: BatchReport::Streamed(fit.report),
        })
    })
}

/// Chooses the largest settings of iterative residual fitting that stay within the memory budget.
struct Planner<'o> {
    operator: &'o DiskOperator,
    method: Blocks,
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
            // A target with more channels than the others may leave no memory for the Gram matrices from moments.
            Some(moments) if irf::plan(self.operator, columns, &params).is_ok() => {
                IrfSolver::with_gram(self.operator, columns, params, moments)
            }
            _ => IrfSolver::new(self.operator, columns, IrfParams { gram_bytes: None, ..params }),
        }?;
        let plan = fitter.plan();
        let decoded = if self.operator.is_direct() { 0 } else { plan.basis };
        check_limits(plan.arrays + plan.work + plan.grams + plan.factors + plan.reserved + decoded, plan.basis)?;
        Ok(fitter)
    }

    /// Returns the moments from which Gram matrices are computed. Returns `None` if the basis isn't in f64, if memory
    /// doesn't suffice to compute the moments, or if their memory would force blocks to be read more often or factors
    /// to be recomputed.
    fn moments(&self, job: &Job<'_>, channels: usize, reuse: bool) -> Result<Option<MomentGram>, Error> {
        let max_degree = job.params.max_degree;
        // The moments need transforms of twice the degree, which may be above the highest degree of transforms.
        let Ok(making) = moment_gram_bytes(self.operator.rows(), max_degree) else { return Ok(None) };
        if job.scalar != Scalar::F64 || job.held(1, channels) + making > job.memory {
            return Ok(None);
        }
        let plan = |gram_bytes| {
            let params = self.params(job, 1, channels, reuse, gram_bytes);
            irf::plan(self.operator, channels, &params).ok()
        };
        let fits = match (plan(None), plan(Some(MomentGram::bytes(max_degree)))) {
            (None, with) => with.is_some(),
            (Some(_), None) => false,
            (Some(without), Some(with)) => {
                let twice = |whole: &[bool]| whole.iter().filter(|&&whole| !whole).count();
                with.read_ahead >= without.read_ahead
                    && with.keep_factors >= without.keep_factors
                    && twice(&with.whole) <= twice(&without.whole)
            }
        };
        if !fits {
            return Ok(None);
        }
        Ok(Some(moment_gram(&job.sphere.directions, job.weights.as_deref(), max_degree)?))
    }

    /// Returns the largest number of surfaces that can be fitted together within the budget if every block is held in
    /// memory as a whole. If that number is zero, returns the largest number with blocks read in parts.
    fn surfaces_together(
        &self,
        job: &Job<'_>,
        moments: Option<&MomentGram>,
        surfaces: usize,
        channels: usize,
    ) -> Result<usize, Error> {
        let gram_bytes = moments.map(GramMatrix::bytes);
        let plan = |together: usize| {
            let params = self.params(job, together, channels, surfaces > together, gram_bytes);
            irf::plan(self.operator, together * channels, &params)
        };
        let whole = |&together: &usize| plan(together).is_ok_and(|plan| plan.whole.iter().all(|&whole| whole));
        let most = surfaces.min(defaults::MOST_TOGETHER);
        if let Some(together) = (1..=most).rev().find(whole) {
            return Ok(together);
        }
        match (1..=most).rev().find(|&together| plan(together).is_ok()) {
            Some(together) => Ok(together),
            None => match plan(1) {
                Err(SolverError::Budget { budget, needed, granularity }) => {
                    let needed = self.least_by_moments(job, channels).map_or(needed, |least| least.min(needed));
                    Err(SolverError::Budget { budget, needed, granularity }.into())
                }
                found => Ok(found.map(|_| 1)?),
            },
        }
    }

    /// Returns the smallest budget in bytes for fits of one surface with Gram matrices computed from moments. Returns
    /// `None` if the Gram matrices can't be computed from moments.
    fn least_by_moments(&self, job: &Job<'_>, channels: usize) -> Option<usize> {
        let max_degree = job.params.max_degree;
        let making = moment_gram_bytes(self.operator.rows(), max_degree).ok().filter(|_| job.scalar == Scalar::F64)?;
        let params = self.params(job, 1, channels, false, Some(MomentGram::bytes(max_degree)));
        // The error of a plan without memory states the memory that suffices.
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
