//! The full least squares by fast transforms, without a basis.

use std::sync::atomic::AtomicBool;

use anyhow::{Result, bail};
use spharm_cli::console::Unit;
use spharm_cli::size::Size;
use spharm_harmonics::basis_size;
use spharm_solver::MatrixFreeOperator;
use spharm_solver::cholesky::{GramSource, StoredFactor};
use spharm_solver::lsq::cg::Stop;
use spharm_solver::lsq::{LsqEvent, LsqParams, LsqReport, LsqSolver, Way, choose_smoothness, moment_gram};
use spharm_store::factor::{factors, open_factor};
use spharm_store::{FactorSpec, Scalar, SchemeKey, WeightsHash};
use spharm_transform::{Transform, TransformParams};

use super::job::{Job, Solved};
use super::outputs::Item;
use super::report::{BatchReport, Fitted};
use super::{Cli, PreconditionerName, Smoothness};

/// Columns of a batch, at most: they share what a transform and a factor cost, and more share no more.
const MOST_COLUMNS: usize = 96;
/// Accuracy of the transforms: theirs, not the fit's, is what the residual's last digits are.
const ACCURACY: f64 = 1e-12;

/// Fits all items by least squares.
pub(crate) fn run(job: &mut Job<'_>, items: &[Item], cancel: &AtomicBool) -> Result<(Vec<Fitted>, Vec<BatchReport>)> {
    let cli = job.cli;
    let max_degree = cli.max_degree;
    let queue = job.queue(items)?;
    let channels = queue.channels();
    let smoothness = fixed_smoothness(job);
    if smoothness > 0.0 && cli.smoothness.is_none() {
        job.console.note(format!("smoothness {smoothness:.2e} holds the model between the vertices; 0 for none"));
    }
    let automatic = matches!(cli.smoothness, Some(Smoothness::Auto));
    // A smoothness of its own for each surface.
    let most = if automatic { 1 } else { (MOST_COLUMNS / channels).clamp(1, items.len()) };
    let memory = Budget::new(job, channels)?;
    let together = (1..=most).rev().find(|&together| memory.needed(together) <= memory.budget).unwrap_or(1);
    let n = job.sphere.directions.len();
    job.console.note(format!(
        "{} of n = {n}, L = {max_degree}: least squares, matrix-free, {together} at a time, {} of {} planned",
        items.len(),
        Size(memory.needed(together)),
        Size(memory.budget),
    ));
    let params = TransformParams { max_degree, accuracy: ACCURACY, channels: memory.group };
    let operator = MatrixFreeOperator::new(&job.sphere.directions, &params)?;
    let stored = stored_factor(job, memory.budget.saturating_sub(memory.needed(together)))?;
    let weights = job.weights.clone();
    let make_gram = || {
        let gram = moment_gram(&job.sphere.directions, weights.as_deref(), max_degree)?;
        Ok(Box::new(gram) as Box<dyn GramSource>)
    };
    let base = LsqParams {
        weights: weights.clone(),
        smoothness,
        way: way(cli),
        areas: matches!(cli.preconditioner, PreconditionerName::Density).then(|| areas(job)).transpose()?,
        tolerance: cli.tolerance,
        max_iterations: cli.max_iterations,
        memory: memory.budget,
        held: memory.needed(together),
        threads: job.threads,
    };
    let solver = |params: LsqParams| {
        let solver = LsqSolver::new(&operator, Some(&make_gram), params);
        solver.map(|solver| match &stored {
            Some(factor) if !automatic => solver.with_factor(factor),
            _ => solver,
        })
    };
    let mut shared = solver(base.clone())?;
    let mut seconds = job.seconds;
    let progress = job.console.progress("fit", items.len() as u64, Unit::Count("surfaces"));
    let fits = job.each_batch(queue, together * channels, &mut seconds, |batch| {
        let targets = batch.side_by_side();
        let mut of_its_own;
        let mut gcv = None;
        let solver = if automatic {
            let tell = |done: usize, of: usize| progress.say(format!("smoothness: {done} of {of} values"));
            let chosen = choose_smoothness(&operator, weights.as_deref(), &targets, cancel, &tell)?;
            of_its_own = solver(LsqParams { smoothness: chosen.smoothness, ..base.clone() })?;
            gcv = Some(chosen);
            &mut of_its_own
        } else {
            &mut shared
        };
        let tell = |event: LsqEvent| match event {
            LsqEvent::Step(step, optimality) => progress.say(format!("iteration {step}, optimality {optimality:.1e}")),
            LsqEvent::Factor(flops) => progress.say(format!("factor, {:.1e} flops", flops)),
            _ => {}
        };
        let fit = solver.fit(&targets, &batch.groups, cancel, &tell)?;
        let standard_errors =
            if cli.stderr { Some(solver.standard_errors(&fit.residual, cancel, &tell)?) } else { None };
        progress.add(batch.groups.len() as u64);
        say(job, &fit.report)?;
        Ok(Solved {
            coefficients: fit.coefficients.values().to_owned(),
            sweeps: vec![(false, fit.report.residuals.clone())],
            standard_errors,
            report: BatchReport::LeastSquares { report: fit.report, gcv },
        })
    })?;
    job.seconds = seconds;
    Ok(fits)
}

/// Of a surface that came without a sphere, the penalty at the highest degree in relation to what the vertices weigh
/// there. Large triangles leave a model open between their corners; this holds it, and adds some per cent to the msd.
const HOLD: f64 = 0.01;
/// Lower degrees have wavelengths that no triangle leaves open.
const HOLD_FROM: usize = 8;

fn fixed_smoothness(job: &Job<'_>) -> f64 {
    match job.cli.smoothness {
        Some(Smoothness::Lambda(lambda)) => lambda,
        None if job.cli.sphere.is_none() && job.cli.max_degree >= HOLD_FROM => {
            let n = job.sphere.directions.len() as f64;
            let (weight, degree) = (job.weights.as_ref().map_or(n, |w| w.iter().sum()), job.cli.max_degree as f64);
            HOLD * weight / (4.0 * std::f64::consts::PI) / (degree * (degree + 1.0)).powi(2)
        }
        _ => 0.0,
    }
}

fn way(cli: &Cli) -> Way {
    match cli.preconditioner {
        PreconditionerName::Auto => Way::Auto,
        PreconditionerName::None => Way::Plain,
        PreconditionerName::Density => Way::Density,
        PreconditionerName::LowDegrees => Way::LowDegrees(cli.low_degrees.unwrap_or(20)),
        PreconditionerName::Factor => Way::Factor,
    }
}

fn areas(job: &Job<'_>) -> Result<Vec<f64>> {
    if job.sphere.faces.is_empty() {
        bail!("--preconditioner density needs triangles, and {} has none", job.sphere.name().display());
    }
    Ok(job.sphere.areas())
}

/// The scheme's factor in the store, where there is one that belongs to this fit.
fn stored_factor(job: &Job<'_>, memory: usize) -> Result<Option<StoredFactor>> {
    let Some(store) = &job.cli.store else { return Ok(None) };
    let mut refused = None;
    // Of the scheme with either scalar type of its basis.
    for scalar in [Scalar::F64, Scalar::F32] {
        let spec = FactorSpec {
            key: SchemeKey::of(&job.sphere.directions, scalar),
            rows: job.sphere.directions.len(),
            max_degree: job.cli.max_degree,
            weights: WeightsHash::of(job.weights.as_deref()),
            smoothness: fixed_smoothness(job),
        };
        // Of most schemes there is a folder for one of them, or for none.
        if !store.join(spec.key.to_string()).exists() || factors(store, spec.key)?.is_empty() {
            continue;
        }
        match open_factor(store, &spec, None) {
            Ok(file) => {
                job.console.note(format!("factor {}", file.path().display()));
                return Ok(Some(StoredFactor::new(file, memory, job.threads)));
            }
            Err(error) => refused = Some(error),
        }
    }
    match refused {
        Some(error) => job.console.warn(format!("{error}; solving without it")),
        None => job.console.note(format!("{}: no factor of this scheme; solving without one", store.display())),
    }
    Ok(None)
}

/// What is worth a warning, and, with --strict, a failure.
fn say(job: &Job<'_>, report: &LsqReport) -> Result<()> {
    let singular = report.shift > 0.0;
    if singular {
        let breaks = report.breaks_at.map_or(String::new(), |[column, degree]| {
            format!("; the Gram matrix breaks at column {column}, of degree {degree}")
        });
        job.console.warn(format!(
            "degree {} isn't determined by this sampling{breaks}; took the solution of least norm, {:.3e}, to optimality {:.1e}",
            report.max_degree, report.norm, report.optimality
        ));
    }
    let functions = basis_size(report.max_degree);
    if job.cli.sphere.is_none() && job.cli.smoothness.is_none() && report.rows < functions {
        job.console.warn(format!(
            "{} vertices don't determine {functions} coefficients, smoothness chose among them; degrees to {} suit this mesh",
            report.rows,
            (report.rows as f64 / 1.5).sqrt() as usize - 1
        ));
    }
    for note in &report.notes {
        job.console.warn(note);
    }
    if report.stop != Stop::Converged && !singular {
        let text = format!(
            "the iteration ended at optimality {:.1e}, not {:.1e}, after {} steps; the best solution so far was taken",
            report.optimality,
            job.cli.tolerance,
            report.iterations + report.refinements
        );
        if job.cli.strict {
            bail!("{text} (--strict)");
        }
        job.console.warn(text);
    }
    job.console.detail(format!(
        "{} iterations, {} refinements ({}), optimality {:.1e}, condition {:.1e}, {:.3} s",
        report.iterations,
        report.refinements,
        report.preconditioner,
        report.optimality,
        report.condition,
        report.seconds.total
    ));
    Ok(())
}

/// What a fit takes beside a factor.
struct Budget {
    budget: usize,
    /// Channels of a transform at a time.
    group: usize,
    fixed: usize,
    /// A surface's columns in all the arrays.
    each: usize,
}

impl Budget {
    fn new(job: &Job<'_>, channels: usize) -> Result<Self> {
        let (n, k) = (job.sphere.directions.len(), basis_size(job.cli.max_degree));
        let budget = job.memory();
        let group = channels.clamp(1, 3);
        let params = |group| TransformParams { max_degree: job.cli.max_degree, accuracy: ACCURACY, channels: group };
        // Targets and residual, and the samples between; the vectors of conjugate gradients.
        let each = 8 * channels * (4 * n + 8 * k);
        let fixed =
            |group: usize| Ok::<_, anyhow::Error>(job.held(1, channels) + Transform::bytes(&params(group), n, group)?);
        let mut found = Self { budget, group, fixed: fixed(group)?, each };
        while found.group > 1 && found.needed(1) > budget {
            found.group -= 1;
            found.fixed = fixed(found.group)?;
        }
        if found.needed(1) > budget {
            bail!(
                "--memory {} is too small for this fit; the smallest that works is {}MiB",
                Size(budget),
                found.needed(1).div_ceil(1 << 20)
            );
        }
        Ok(found)
    }

    fn needed(&self, together: usize) -> usize {
        self.fixed + together * self.each
    }
}
