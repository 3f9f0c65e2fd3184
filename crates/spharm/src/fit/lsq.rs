//! The full least squares by fast transforms, without a basis.

use std::fmt;

use spharm_monitor::{Level, Monitor, Stage};
use spharm_solver::lsq::choose_smoothness;
use spharm_solver::{GramMatrix, LsqParams, LsqSolver, MatrixFreeOperator, StoredFactor, Strategy, moment_gram};
use spharm_store::factor::{factors, open_factor};
use spharm_store::{FactorSpec, Scalar, SchemeKey, WeightsHash};

use super::batches::{Run, Solved};
use super::job::Job;
use super::lsq_plan::{LsqPlan, Sizes, transform};
use crate::report::BatchReport;
use crate::{Error, FitWarning, Preconditioner, Smoothness, defaults};

/// Fits all targets.
pub(crate) fn run<E: From<Error> + Send>(run: &mut Run<'_, E>) -> Result<(), E> {
    let (monitor, channels, count) = (run.monitor, run.channels(), run.count);
    let job = &run.job;
    let (params, n) = (job.params, job.sphere.directions.len());
    let smoothness = smoothness(job);
    if smoothness > 0.0 && params.smoothness == Smoothness::Default {
        let text = format_args!("smoothness {smoothness:.2e} holds the model between the vertices; 0 for none");
        monitor.note(Level::Info, text);
    }
    let automatic = params.smoothness == Smoothness::Auto;
    // With a smoothness of its own, each target is a batch.
    let most = if automatic { 1 } else { (defaults::MOST_COLUMNS / channels).clamp(1, count.max(1)) };
    let sizes = Sizes {
        vertices: n,
        faces: job.sphere.faces.len(),
        max_degree: params.max_degree,
        channels,
        threads: job.threads,
    };
    let plan = LsqPlan::new(sizes, job.memory)?;
    let together = (1..=most).rev().find(|&together| plan.needed(together) <= plan.budget).unwrap_or(1);
    monitor.note(
        Level::Info,
        format_args!(
            "{count} of n = {n}, L = {}: least squares, matrix-free, {together} at a time, {} of {} MiB planned",
            params.max_degree,
            plan.needed(together).div_ceil(1 << 20),
            plan.budget >> 20,
        ),
    );
    let transform = transform(params.max_degree, plan.channels_at_a_time);
    let operator = MatrixFreeOperator::new(&job.sphere.directions, &transform).map_err(Error::from)?;
    let mut warnings = Vec::new();
    let spare = plan.budget.saturating_sub(plan.needed(together));
    let stored = stored_factor(job, smoothness, spare, &mut warnings, monitor)?;
    let (directions, weights) = (&job.sphere.directions, job.weights.clone());
    let make_gram = || {
        let gram = moment_gram(directions, weights.as_deref(), params.max_degree)?;
        Ok(Box::new(gram) as Box<dyn GramMatrix>)
    };
    let base = LsqParams {
        weights: weights.clone(),
        smoothness,
        strategy: strategy(params.preconditioner),
        areas: matches!(params.preconditioner, Preconditioner::Density).then(|| areas(job)).transpose()?,
        tolerance: params.tolerance,
        max_iterations: params.max_iterations,
        memory: plan.budget,
        held: plan.needed(together),
        threads: job.threads,
    };
    let solver = |params: LsqParams| -> Result<LsqSolver<'_>, Error> {
        let solver = LsqSolver::new(&operator, Some(&make_gram), params)?;
        Ok(match &stored {
            Some(factor) if !automatic => solver.with_factor(factor),
            _ => solver,
        })
    };
    let mut shared = solver(base.clone())?;
    let by_default = params.smoothness == Smoothness::Default && job.sphere.parametrized;
    let within = Within(monitor);
    monitor.begin(Stage::counted("fit", "surfaces"), count as u64);
    run.each_batch(together * channels, |_, batch| {
        let targets = batch.side_by_side();
        let mut of_its_own;
        let mut gcv = None;
        let solver = if automatic {
            let chosen = choose_smoothness(&operator, weights.as_deref(), &targets, &within)?;
            of_its_own = solver(LsqParams { smoothness: chosen.smoothness, ..base.clone() })?;
            gcv = Some(chosen);
            &mut of_its_own
        } else {
            &mut shared
        };
        let fit = solver.fit(&targets, &batch.groups, &within)?;
        let standard_errors = match params.standard_errors {
            true => Some(solver.standard_errors(&fit.residual, &within)?),
            false => None,
        };
        monitor.step(batch.groups.len() as u64);
        let mut warnings = warnings.clone();
        warnings.extend(FitWarning::of_lsq(&fit.report, params.tolerance, by_default));
        if let (true, Some(missed)) =
            (params.strict, warnings.iter().find(|warning| matches!(warning, FitWarning::NotConverged { .. })))
        {
            return Err(Error::NotConverged(missed.clone()));
        }
        let report = &fit.report;
        let text = format_args!(
            "{} iterations, {} refinements ({}), optimality {:.1e}, condition {:.1e}, {:.3} s",
            report.iterations,
            report.refinements,
            report.preconditioner,
            report.optimality,
            report.condition,
            report.seconds.total
        );
        monitor.note(Level::Detail, text);
        Ok(Solved {
            coefficients: fit.coefficients.values().to_owned(),
            sweeps: vec![(false, fit.report.residuals.clone())],
            standard_errors,
            warnings,
            report: BatchReport::LeastSquares { report: fit.report, gcv },
        })
    })?;
    monitor.end();
    Ok(())
}

/// A monitor for one of several targets: its stages are shown as the status of the stage that counts targets.
struct Within<'a>(&'a dyn Monitor);

impl Monitor for Within<'_> {
    fn begin(&self, stage: Stage, _: u64) {
        self.0.note(Level::Status, format_args!("{}", stage.name));
    }

    fn note(&self, level: Level, text: fmt::Arguments<'_>) {
        self.0.note(level, text);
    }

    fn cancelled(&self) -> bool {
        self.0.cancelled()
    }
}

/// The penalty of all targets, where it isn't chosen for each.
fn smoothness(job: &Job<'_>) -> f64 {
    let n = job.sphere.directions.len();
    defaults::smoothness(job.params, job.sphere.parametrized, job.weights.as_deref(), n)
}

fn strategy(preconditioner: Preconditioner) -> Strategy {
    match preconditioner {
        Preconditioner::Auto => Strategy::Auto,
        Preconditioner::None => Strategy::Cg,
        Preconditioner::Density => Strategy::DensityCg,
        Preconditioner::LowDegrees(degree) => Strategy::LowDegreesCg(degree),
        Preconditioner::Factor => Strategy::Cholesky,
    }
}

fn areas(job: &Job<'_>) -> Result<Vec<f64>, Error> {
    if job.sphere.faces.is_empty() {
        let sphere = job.sphere.name().to_owned();
        return Err(Error::NeedsTriangles { what: "the density of the sampling", sphere });
    }
    Ok(job.sphere.areas())
}

/// The scheme's factor in the store, where there is one that belongs to this fit.
fn stored_factor(
    job: &Job<'_>,
    smoothness: f64,
    memory: usize,
    warnings: &mut Vec<FitWarning>,
    monitor: &dyn Monitor,
) -> Result<Option<StoredFactor>, Error> {
    let Some(store) = &job.params.store else { return Ok(None) };
    let mut refused = None;
    // Of the scheme with either scalar type of its basis.
    for scalar in [Scalar::F64, Scalar::F32] {
        let spec = FactorSpec {
            key: SchemeKey::of(&job.sphere.directions, scalar),
            rows: job.sphere.directions.len(),
            max_degree: job.params.max_degree,
            weights: WeightsHash::of(job.weights.as_deref()),
            smoothness,
        };
        // Of most schemes there is a folder for one of them, or for none.
        if !store.join(spec.key.to_string()).exists() || factors(store, spec.key)?.is_empty() {
            continue;
        }
        match open_factor(store, &spec, None) {
            Ok(file) => {
                monitor.note(Level::Info, format_args!("factor {}", file.path().display()));
                return Ok(Some(StoredFactor::new(file, memory, job.threads)));
            }
            Err(error) => refused = Some(error),
        }
    }
    match refused {
        Some(error) => warnings.push(FitWarning::FactorUnusable { reason: error.to_string() }),
        None => {
            let store = store.display();
            monitor.note(Level::Info, format_args!("{store}: no factor of this scheme; solving without one"));
        }
    }
    Ok(None)
}
