//! Iterative residual fitting over a store: as many columns at a time as the memory allows.

use std::sync::atomic::AtomicBool;
use std::time::Instant;

use anyhow::Result;
use spharm_cli::console::Unit;
use spharm_cli::machine::check_limits;
use spharm_cli::size::Size;
use spharm_harmonics::basis_size;
use spharm_solver::grams::BlockGrams;
use spharm_solver::lsq::{moment_gram, moment_gram_bytes};
use spharm_solver::{
    BlockOperator, ChunkedRows, DiskOperator, FitEvent, FitParams, Fitter, Method, Operator, SolverError,
};
use spharm_store::{Scalar, Scheme};
use spharm_transform::MomentGram;

use super::job::{Batch, Job, Queue, Solved};
use super::outputs::Item;
use super::report::{BatchReport, Fitted, Seconds};
use super::{MOST_TOGETHER, REFINEMENTS};

/// Fits all items by `method` over the basis of `scheme`.
pub(crate) fn run(
    job: &mut Job<'_>,
    method: Method,
    scheme: Scheme,
    items: &[Item],
    cancel: &AtomicBool,
) -> Result<(Vec<Fitted>, Vec<BatchReport>)> {
    let operator = DiskOperator::new(scheme);
    let queue = job.queue(items)?;
    // The first one tells the channels of all, which are the same in most studies.
    let channels = queue.channels();
    let mut seconds = job.seconds;
    let mut streamed = Streamed { job, method, operator, moments: None };
    streamed.lower_threads(channels);
    let mark = Instant::now();
    streamed.moments = streamed.moments(channels, items.len() > 1)?;
    seconds.plan += mark.elapsed().as_secs_f64();
    let done = streamed.fit_all(items.len(), channels, queue, &mut seconds, cancel)?;
    job.seconds = seconds;
    Ok(done)
}

struct Streamed<'j, 'c> {
    job: &'j mut Job<'c>,
    method: Method,
    operator: DiskOperator,
    /// The blocks' Gram matrices, where the memory has room for their source.
    moments: Option<MomentGram>,
}

impl Streamed<'_, '_> {
    fn fit_all(
        &self,
        surfaces: usize,
        channels: usize,
        queue: Queue<'_>,
        seconds: &mut Seconds,
        cancel: &AtomicBool,
    ) -> Result<(Vec<Fitted>, Vec<BatchReport>)> {
        let mark = Instant::now();
        let together = self.surfaces_together(surfaces, channels)?;
        let mut fitter = self.fitter(together, channels, surfaces > together)?;
        seconds.plan += mark.elapsed().as_secs_f64();
        self.say_plan(&fitter, surfaces, together);
        let sweeps = surfaces.div_ceil(together) * self.method.passes();
        let total = (sweeps * basis_size(self.job.cli.max_degree)) as u64;
        let progress = self.job.console.progress("fit", total, Unit::Count("columns"));
        let columns = fitter.channels();
        self.job.each_batch(queue, columns, seconds, |batch: &Batch<'_>| {
            if batch.columns() > fitter.channels() {
                // One target with more channels than were planned for has a batch, and a plan, of its own.
                fitter = self.fitter(1, batch.columns(), true)?;
            }
            let mut targets = ChunkedRows::zeros(self.operator.rows(), batch.columns(), self.operator.chunk_rows());
            for (group, target) in batch.targets() {
                targets.set_columns(group.start, target);
            }
            let last = std::cell::Cell::new(0);
            let fit = fitter.fit(targets, &batch.groups, cancel, &|event| match event {
                FitEvent::Solving(sweep, degrees) => {
                    progress.say(format!("pass {sweep}, degrees {} to {}", degrees.start(), degrees.end()));
                }
                FitEvent::Block(sweep, done, _) if sweep <= self.method.passes() => {
                    let before = if done <= last.get() { 0 } else { last.get() };
                    progress.add((done - before) as u64);
                    last.set(done);
                }
                FitEvent::Sweep(report) => {
                    let name = if report.refinement { "refinement after pass" } else { "pass" };
                    let gigabytes = report.bytes_read as f64 / 1e9;
                    self.job
                        .console
                        .detail(format!("{name} {}: {:.2} s, {gigabytes:.2} GB", report.pass, report.seconds));
                }
                _ => {}
            })?;
            let sweeps = fit.report.sweeps.iter().map(|sweep| (sweep.refinement, sweep.residuals.clone())).collect();
            Ok(Solved {
                coefficients: fit.coefficients.values().to_owned(),
                sweeps,
                standard_errors: None,
                report: BatchReport::Streamed(fit.report),
            })
        })
    }

    fn fitter(&self, together: usize, channels: usize, reuse: bool) -> Result<Fitter<'_>> {
        let (columns, params) = (together * channels, self.params(together, channels, reuse));
        let fitter = match &self.moments {
            // A target with more channels than the others may leave no room for it.
            Some(moments) if spharm_solver::plan(&self.operator, columns, &params).is_ok() => {
                Fitter::with_grams(&self.operator, columns, params, moments)
            }
            _ => Fitter::new(&self.operator, columns, FitParams { gram_source: None, ..params }),
        };
        let fitter = fitter.map_err(|error| match error {
            error @ SolverError::Weight { .. } => {
                anyhow::Error::from(error).context(format!("--weights {}", self.job.cli.weights))
            }
            error => error.into(),
        })?;
        self.check_limits(&fitter)?;
        Ok(fitter)
    }

    fn params(&self, together: usize, channels: usize, reuse: bool) -> FitParams {
        FitParams {
            max_degree: self.job.cli.max_degree,
            method: self.method,
            refinements: if self.method == Method::Nlsf { REFINEMENTS } else { 0 },
            weights: self.job.weights.clone(),
            memory: self.job.memory(),
            held: self.job.held(together, channels),
            threads: self.job.threads,
            reuse,
            accelerate: self.job.cli.accelerate,
            gram_source: self.moments.as_ref().map(BlockGrams::bytes),
        }
    }

    /// The source of Gram matrices, for a basis in f64: where the memory has room to make it, and to hold it without a
    /// block being read more often or a factor made again for its sake.
    fn moments(&self, channels: usize, reuse: bool) -> Result<Option<MomentGram>> {
        let (job, max_degree) = (&self.job, self.job.cli.max_degree);
        // Beyond the range of the transforms, which need twice the degree, there are none.
        let Ok(making) = moment_gram_bytes(self.operator.rows(), max_degree) else { return Ok(None) };
        if job.scalar != Scalar::F64 || job.held(1, channels) + making > job.memory() {
            return Ok(None);
        }
        let plan = |gram_source| {
            let params = FitParams { gram_source, ..self.params(1, channels, reuse) };
            spharm_solver::plan(&self.operator, channels, &params).ok()
        };
        let (without, with) = (plan(None), plan(Some(MomentGram::bytes(max_degree))));
        let fits = match (without, with) {
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

    /// As many surfaces as fit the budget with every block whole in memory; if that is none, as many as fit at all.
    fn surfaces_together(&self, surfaces: usize, channels: usize) -> Result<usize> {
        let plan = |together: usize| {
            let params = self.params(together, channels, surfaces > together);
            spharm_solver::plan(&self.operator, together * channels, &params)
        };
        let whole = |&together: &usize| plan(together).is_ok_and(|plan| plan.whole.iter().all(|&whole| whole));
        let most = surfaces.min(MOST_TOGETHER);
        if let Some(together) = (1..=most).rev().find(whole) {
            return Ok(together);
        }
        match (1..=most).rev().find(|&together| plan(together).is_ok()) {
            Some(together) => Ok(together),
            // Says what would be enough for one.
            None => Ok(plan(1).map(|_| 1)?),
        }
    }

    /// Each thread has sums of its own: on a node with many cores they may be what doesn't fit the budget.
    fn lower_threads(&mut self, channels: usize) {
        let asked = self.job.threads;
        let fits = |job: &Self| {
            let params = job.params(1, channels, false);
            spharm_solver::plan(&job.operator, channels, &params).is_ok()
        };
        while self.job.threads > 1 && !fits(self) {
            self.job.threads -= 1;
        }
        if self.job.threads < asked && fits(self) {
            self.job.console.note(format!("{} threads in place of {asked}, to keep to the memory", self.job.threads));
        }
    }

    fn check_limits(&self, fitter: &Fitter<'_>) -> Result<()> {
        let plan = fitter.plan();
        let blas = self.job.threads * spharm_solver::dense::RESERVED_PER_THREAD;
        let decoded = if self.operator.is_direct() { 0 } else { plan.basis };
        check_limits(plan.arrays + plan.work + plan.grams + plan.factors + blas + decoded, plan.basis)
    }

    fn say_plan(&self, fitter: &Fitter<'_>, surfaces: usize, together: usize) {
        let plan = fitter.plan();
        let blocks = fitter.blocks().len();
        self.job.console.note(format!(
            "{surfaces} of n = {}, L = {}: {} with {} pass(es) of {blocks} block(s), {together} at a time, {} of {} planned",
            self.operator.rows(),
            self.job.cli.max_degree,
            self.method.name(),
            self.method.passes(),
            Size(plan.total),
            Size(plan.budget),
        ));
        if !plan.whole.iter().all(|&whole| whole) {
            let twice = plan.whole.iter().filter(|&&whole| !whole).count();
            self.job.console.note(format!("{twice} block(s) don't fit the memory and are read again for each use"));
        }
    }
}
