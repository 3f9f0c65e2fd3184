//! Fits targets at their vertices by the full least squares, using fast transforms instead of a stored basis.

use std::ops::Range;
use std::sync::{Arc, Mutex, Once, PoisonError};
use std::time::Instant;

use ndarray::{Array2, s};
use spharm_harmonics::basis_size;
use spharm_monitor::{Level, Monitor};
use spharm_solver::lsq::{Gcv, LsqFit, LsqReport, MakeGram, MakeMoments, PROBES, moment_accuracy, moments_pay};
use spharm_solver::{
    DeferredOperator, GramMatrix, LsqParams, LsqSolver, MatrixFreeOperator, Operator, ResidualNorms, StoredFactor,
    moment_gram, moment_gram_bytes, moment_normal,
};
use spharm_store::WeightsHash;

use super::batches::{Batch, PerTarget, Run, Solved};
use super::by_channel::{merge_channels, merge_searches};
use super::denoise::{Denoiser, merge, set_columns};
use super::job::Job;
use super::lsq_plan::{LsqPlan, Sizes, transform};
use super::planned::KeptMoments;
use super::shared::{NestedMonitor, allowed, check_auto, converged, counted, in_batches, note_solution, strategy};
use super::stored_factor::stored_factor;
use crate::report::{BatchReport, Denoised};
use crate::{Error, FitParams, FitWarning, Smoothness, Weights, defaults};

/// Fits the next targets at their vertices. Returns when no target is left, or at the first target that is fitted as a
/// surface (`Objective::Surface`), which `surface::run` fits.
pub(crate) fn run<T: Send, E: From<Error> + Send>(run: &mut Run<'_, T, E>) -> Result<(), E> {
    let (monitor, channels, count) = (run.monitor, run.channels(), run.count - run.results.len());
    let mark = Instant::now();
    let job = &run.job;
    let (params, directions) = (job.params, &job.sphere.directions);
    let smoothness = smoothness(job, monitor);
    let automatic = params.smoothness == Smoothness::Auto;
    if automatic {
        check_auto(job.vertices_with_weight(), params.max_degree)?;
    }
    // A batch has a single target if each target has its own smoothness.
    let most = if automatic { 1 } else { (defaults::MOST_COLUMNS / channels).clamp(1, count.max(1)) };
    let (plan, together) = plan(job, channels, most)?;
    note_plan(job, &plan, count, together, monitor);
    let transform = transform(params.max_degree, plan.channels_at_a_time);
    let n = directions.len();
    // The search for a smoothness fits additional columns. `moment_bytes` has no result if the moments can't be
    // computed; their size is then treated as infinite.
    let columns = together * channels + if automatic { PROBES } else { 0 };
    let moment_bytes = MatrixFreeOperator::moment_bytes(&transform, n, columns, job.threads);
    let moment_bytes = moment_bytes.unwrap_or(usize::MAX);
    // A planned sphere already has transforms, and keeps the moments of its last weights for later fits. Without a
    // planned sphere, the transforms for the fit and those for the moments are planned together if that saves time and
    // memory suffices.
    let shared = job.planned.is_none()
        && moments_pay(n, params.max_degree, together * channels, params.tolerance)
        && moment_bytes <= plan.spare(together);
    let weights = job.weights.clone();
    let planned = job.planned.map(|planned| (planned, WeightsHash::of(weights.as_deref())));
    let accuracy = moment_accuracy(params.tolerance);
    let kept = planned.and_then(|(planned, weights)| planned.moments(weights, accuracy));
    let planned_now =
        shared.then(|| MatrixFreeOperator::with_moments(directions, &transform)).transpose().map_err(Error::from)?;
    let transforms = job.planned.map(|planned| planned.operator()).or(planned_now.as_ref());
    let deferred = DeferredOperator::new(directions, &transform);
    let operator: &dyn Operator = transforms.map_or(&deferred, |operator| operator);
    let mut warnings = Vec::new();
    if params.standard_errors && params.weights == Weights::Area {
        warnings.push(FitWarning::AreaErrors);
    }
    // Reserve `moment_bytes` for the solver.
    let of_moments = if moment_bytes <= plan.spare(together) { moment_bytes } else { 0 };
    let spare = plan.spare(together) - of_moments;
    let stored = stored_factor(job, smoothness, spare, &mut warnings, monitor)?;
    let make_gram = || {
        let gram = moment_gram(directions, weights.as_deref(), params.max_degree)?;
        Ok(Box::new(gram) as Box<dyn GramMatrix>)
    };
    // Moments are computed once, and shared with the solvers of single targets.
    let moments = Mutex::new(None);
    let make_moments = |accuracy: f64, targets: Option<&Array2<f64>>| {
        let mut moments = moments.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(made) = &*moments {
            return Ok((Arc::clone(made), None));
        }
        let weights = weights.as_deref();
        let (made, right_sides) = match (planned, &planned_now) {
            (Some((planned, hash)), _) => (planned.make_moments(weights, hash, accuracy)?, None),
            (None, Some(operator)) => {
                let (made, right_sides) = operator.moments(directions, weights, accuracy, targets)?;
                (Arc::new(made), right_sides)
            }
            (None, None) => (Arc::new(moment_normal(directions, weights, params.max_degree, accuracy)?), None),
        };
        *moments = Some(made.clone());
        Ok((made, right_sides))
    };
    let equations = Equations {
        params,
        operator,
        make_gram: &make_gram,
        make_moments: &make_moments,
        kept,
        stored: stored.as_ref().filter(|_| !automatic),
        noted: Once::new(),
        solver: solver_params(job, smoothness, &plan, together, moment_bytes),
        warnings,
        smooth_by_default: job.smooth_by_default().then(|| job.vertices_with_weight()),
        monitor,
    };
    let readers = plan.readers(together, of_moments, job.threads);
    // One solver, with its factor, is used for all batches, unless each target has its own smoothness.
    let mut shared = equations.solver(equations.solver.clone())?;
    let fit_noise = |noise: &Array2<f64>| {
        let columns = 0..noise.ncols();
        let fit = shared.fit(noise, std::slice::from_ref(&columns), &NestedMonitor(monitor))?;
        Ok((fit.coefficients.values().to_owned(), fit.residual))
    };
    let denoiser =
        job.params.denoise.then(|| Denoiser::new(job, together * channels, monitor, fit_noise)).transpose()?;
    run.readers = readers;
    run.seconds.plan += mark.elapsed().as_secs_f64();
    let columns = if automatic { 1 } else { together * channels };
    run.each_batch(columns, |job, batch| {
        let solved = if automatic {
            equations.choose_and_solve(batch)
        } else {
            equations.solve(&mut shared, batch, denoiser.as_ref().map(|denoiser| (denoiser, job)), None)
        };
        monitor.step(batch.groups.len() as u64);
        solved
    })
}

/// The normal equations shared by all batches.
struct Equations<'a> {
    params: &'a FitParams,
    operator: &'a dyn Operator,
    make_gram: &'a MakeGram<'a>,
    make_moments: &'a MakeMoments<'a>,
    /// Moments that an earlier fit on the same planned sphere computed.
    kept: Option<KeptMoments>,
    stored: Option<&'a StoredFactor>,
    /// Ensures that the note about the use of the stored factor is shown only once.
    noted: Once,
    solver: LsqParams,
    /// Warnings that apply to every fit.
    warnings: Vec<FitWarning>,
    /// Number of vertices with nonzero weight if the smoothness is the default of a parametrised sphere, else `None`.
    smooth_by_default: Option<usize>,
    monitor: &'a dyn Monitor,
}

/// Standard errors of the coefficients, if requested, and the noise removed from each target: one entry per surface or
/// per channel.
type Removed = (Option<Array2<f64>>, Vec<Vec<Denoised>>);

impl<'a> Equations<'a> {
    /// Returns a solver that works with any penalty, since it doesn't use a factor from the store.
    fn unfactored(&self, params: LsqParams) -> Result<LsqSolver<'a>, Error> {
        let solver = LsqSolver::new(self.operator, Some(self.make_gram), params)?;
        let solver = solver.with_limits(&allowed).with_moments(self.make_moments);
        Ok(match &self.kept {
            Some(kept) => solver.with_made_moments(kept.normal.clone(), kept.accuracy),
            None => solver,
        })
    }

    fn solver(&self, params: LsqParams) -> Result<LsqSolver<'a>, Error> {
        let solver = self.unfactored(params)?;
        Ok(match self.stored {
            Some(factor) => solver.with_factor(factor),
            None => solver,
        })
    }

    /// Fits a target with the smoothness that cross-validation chooses for it, or for each channel of a signal.
    fn choose_and_solve(&self, batch: &Batch) -> Result<Solved, Error> {
        let targets = batch.side_by_side();
        let parts = batch.parts().next().unwrap_or_default();
        if parts.len() > 1 {
            return self.choose_by_channel(&targets, &parts);
        }
        let mut solver = self.unfactored(self.solver.clone())?;
        let chosen = solver.choose_smoothness(&targets, &NestedMonitor(self.monitor))?;
        solver.set_smoothness(chosen.smoothness)?;
        self.solve(&mut solver, batch, None, Some(chosen))
    }

    /// Fits the channels of a signal (vertices x channels), each channel with its own smoothness.
    fn choose_by_channel(&self, targets: &Array2<f64>, parts: &[Range<usize>]) -> Result<Solved, Error> {
        let within = NestedMonitor(self.monitor);
        let mut coefficients = Array2::<f64>::zeros((basis_size(self.params.max_degree), targets.ncols()));
        let mut standard_errors = self.params.standard_errors.then(|| Array2::zeros(coefficients.dim()));
        let mut residual = Array2::<f64>::zeros(targets.dim());
        let (mut merged, mut searches) = (None, Vec::new());
        for part in parts {
            let (own, group) = (targets.slice(s![.., part.clone()]).to_owned(), 0..part.len());
            let mut solver = self.unfactored(self.solver.clone())?;
            let chosen = solver.choose_smoothness(&own, &within)?;
            solver.set_smoothness(chosen.smoothness)?;
            let fit = solver.fit(&own, &[group], &within)?;
            if let Some(all) = &mut standard_errors {
                set_columns(all, part, solver.standard_errors(&fit.residual, &within)?.view());
            }
            set_columns(&mut coefficients, part, fit.coefficients.values().view());
            set_columns(&mut residual, part, fit.residual.view());
            merged = Some(merge_channels(merged, fit.report));
            searches.push(chosen);
        }
        let mut report = merged.expect("the signal has channels");
        report.residuals = vec![ResidualNorms::without(residual.view(), self.solver.unread.as_deref())];
        self.finish(coefficients, (standard_errors, Vec::new()), report, merge_searches(searches))
    }

    fn solve(
        &self,
        solver: &mut LsqSolver<'a>,
        batch: &Batch,
        denoiser: Option<(&Denoiser, &Job<'_>)>,
        gcv: Option<Gcv>,
    ) -> Result<Solved, Error> {
        let within = NestedMonitor(self.monitor);
        let targets = batch.side_by_side();
        let LsqFit { coefficients, residual, mut report } = solver.fit(&targets, &batch.groups, &within)?;
        let mut coefficients = coefficients.values().to_owned();
        let (mut standard_errors, mut denoised) = (None, Vec::new());
        match denoiser {
            Some(denoiser) => {
                let plain = Plain { batch, targets: &targets, residual };
                (standard_errors, denoised) = self.denoise(denoiser, plain, &mut coefficients, &mut report)?;
            }
            None if self.params.standard_errors => {
                standard_errors = Some(solver.standard_errors(&residual, &within)?);
            }
            None => {}
        }
        self.finish(coefficients, (standard_errors, denoised), report, gcv)
    }

    /// Returns the solution of a batch, with its warnings.
    fn finish(
        &self,
        coefficients: Array2<f64>,
        (standard_errors, denoised): Removed,
        report: LsqReport,
        gcv: Option<Gcv>,
    ) -> Result<Solved, Error> {
        let mut warnings = self.warnings.clone();
        let mut of_lsq = FitWarning::of_lsq(&report, self.params.tolerance, self.smooth_by_default);
        // Denoising removes the noise that the plain fit amplifies, so the warning about amplified noise is omitted.
        of_lsq.retain(|warning| denoised.is_empty() || !matches!(warning, FitWarning::Amplified { .. }));
        warnings.extend(of_lsq);
        converged(self.params, &warnings)?;
        note_solution(&report, self.monitor);
        super::shared::note_factor(&report, self.stored, &self.noted, self.monitor);
        let of_target = |&optimality: &f64| PerTarget { optimality: Some(optimality), warnings: Vec::new() };
        Ok(Solved {
            coefficients,
            sweeps: vec![(false, report.residuals.clone())],
            standard_errors,
            denoised,
            surface_distances: Vec::new(),
            warnings,
            per_target: report.optimalities.iter().map(of_target).collect(),
            at_centres: Vec::new(),
            report: BatchReport::LeastSquares { report, gcv },
        })
    }

    /// Replaces the plain fits of a batch by penalised fits. Returns the standard errors, if requested, and the
    /// removed noise.
    fn denoise(
        &self,
        (denoiser, job): (&Denoiser, &Job<'_>),
        plain: Plain<'_>,
        coefficients: &mut Array2<f64>,
        report: &mut LsqReport,
    ) -> Result<Removed, Error> {
        let (within, mut residual, started) = (NestedMonitor(self.monitor), plain.residual, Instant::now());
        let mut standard_errors = self.params.standard_errors.then(|| Array2::zeros(coefficients.dim()));
        let mut denoised = Vec::new();
        for (target, parts) in plain.batch.parts().enumerate() {
            let mut of_target = Vec::new();
            for part in parts {
                let columns = s![.., part.clone()];
                let found = denoiser.denoise(coefficients.slice(columns), residual.slice(columns));
                let params = LsqParams { penalty: Some(found.penalty.clone()), ..self.solver.clone() };
                let mut solver = self.unfactored(params)?;
                let group = 0..part.len();
                let fit = solver.fit(&plain.targets.slice(columns).to_owned(), &[group], &within)?;
                if let Some(all) = &mut standard_errors {
                    let errors = solver.standard_errors(&fit.residual, &within)?;
                    set_columns(all, &part, found.with_uncertain_gains(errors).view());
                }
                set_columns(coefficients, &part, fit.coefficients.values().view());
                set_columns(&mut residual, &part, fit.residual.view());
                if let Some(optimality) = report.optimalities.get_mut(target) {
                    *optimality = optimality.max(fit.report.optimality);
                }
                merge(report, fit.report);
                of_target.push(denoiser.assess(job, plain.targets.slice(columns), found, &within)?);
            }
            denoised.push(of_target);
        }
        let unread = job.unread.as_deref();
        let of_group = |group: &Range<usize>| ResidualNorms::without(residual.slice(s![.., group.clone()]), unread);
        report.residuals = plain.batch.groups.iter().map(of_group).collect();
        report.seconds.total += started.elapsed().as_secs_f64();
        Ok((standard_errors, denoised))
    }
}

/// Targets and their residuals after the plain fit, both as arrays (vertices x channels).
struct Plain<'b> {
    batch: &'b Batch,
    targets: &'b Array2<f64>,
    residual: Array2<f64>,
}

/// Returns the memory plan and the number of targets that are fitted together, which is at most `most`.
fn plan(job: &Job<'_>, channels: usize, most: usize) -> Result<(LsqPlan, usize), Error> {
    let sizes = Sizes {
        vertices: job.sphere.directions.len(),
        faces: job.sphere.faces.len(),
        max_degree: job.params.max_degree,
        channels,
        denoise: job.params.denoise,
    };
    let plan = LsqPlan::new(sizes, job.memory)?;
    let together = (1..=most).rev().find(|&together| plan.needed(together) <= plan.budget).unwrap_or(1);
    Ok((plan, together))
}

fn note_plan(job: &Job<'_>, plan: &LsqPlan, count: usize, together: usize, monitor: &dyn Monitor) {
    let text = format_args!(
        "{} with {} vertices, degree {}: least squares, matrix-free{}, {} of {} MiB of memory planned",
        counted(count, "target", "targets"),
        job.sphere.directions.len(),
        job.params.max_degree,
        in_batches(count, together),
        plan.needed(together).div_ceil(1 << 20),
        plan.budget >> 20,
    );
    monitor.note(Level::Info, text);
}

fn solver_params(job: &Job<'_>, smoothness: f64, plan: &LsqPlan, together: usize, moment_bytes: usize) -> LsqParams {
    let params = job.params;
    LsqParams {
        weights: job.weights.clone(),
        unread: job.unread.clone(),
        smoothness,
        penalty: None,
        strategy: strategy(params.preconditioner),
        tolerance: params.tolerance,
        max_iterations: params.max_iterations,
        memory: plan.budget,
        held: plan.needed(together),
        // `moment_gram_bytes` has no result if the matrix can't be computed. The matrix then needs no memory.
        gram_bytes: moment_gram_bytes(job.sphere.directions.len(), params.max_degree).unwrap_or(0),
        moment_bytes,
        threads: job.threads,
    }
}

/// Returns the smoothness penalty of all targets, or 0 if a penalty is chosen for each target.
fn smoothness(job: &Job<'_>, monitor: &dyn Monitor) -> f64 {
    let smoothness = job.smoothness();
    if smoothness > 0.0 && job.smooth_by_default() {
        let text = format_args!("smoothness {smoothness:.2e} keeps the model from oscillating between the vertices");
        monitor.note(Level::Info, text);
    }
    smoothness
}
