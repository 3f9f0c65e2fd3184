//! Fits whole surfaces by the full least squares, which minimises the integral over the sphere of the squared distance.
//!
//! A mesh over a sphere is linear on each triangle, and each triangle is sampled as densely as the degree requires. The
//! fit uses only sums over these samples ([`SurfaceSums`]). With solid angles as weights, the normal matrix is nearly a
//! multiple of the identity, so a handful of iterations suffice. The iterations use a grid of the size that the degree
//! requires. A surface with a seam needs more iterations, about 60 at L = 60.

use std::ops::Range;
use std::time::Instant;

use ndarray::{Array2, ArrayView2, Axis, s};
use rayon::prelude::*;
use spharm_harmonics::{Directions, basis_size};
use spharm_monitor::{Level, Monitor};
use spharm_solver::lsq::{LsqReport, MomentProblem, solve_moments, solve_moments_of_groups};
use spharm_solver::{LsqParams, ResidualNorms};
use spharm_transform::{MomentGram, Transform};

use super::batches::{Batch, PerTarget, Run, Solved};
use super::denoise::{Denoiser, merge, set_columns};
use super::job::Job;
use super::lsq_plan::{Sizes, transform};
use super::shared::{NestedMonitor, converged, counted, in_batches, merge_reports, note_solution, strategy};
use super::surface_plan::SurfacePlan;
use super::surface_sums::SurfaceSums;
use crate::assess::{ModelSurface, ReadSurface};
use crate::report::{BatchReport, Denoised};
use crate::{Error, FitParams, FitWarning, Smoothness, defaults};

/// Fits the next targets as surfaces. Stops before the first target that must be fitted at its vertices.
pub(crate) fn run<T: Send, E: From<Error> + Send>(run: &mut Run<'_, T, E>) -> Result<(), E> {
    let (monitor, channels, count) = (run.monitor, run.channels(), run.count - run.results.len());
    let mark = Instant::now();
    let job = &run.job;
    let sizes = Sizes {
        vertices: job.sphere.directions.len(),
        faces: job.sphere.faces.len(),
        max_degree: job.params.max_degree,
        channels,
        denoise: job.params.denoise,
    };
    // If a smoothness is chosen for each surface, surfaces are fitted one at a time.
    let most = if job.params.smoothness == Smoothness::Auto { channels } else { defaults::MOST_COLUMNS };
    let most = (most / channels).clamp(1, count.max(1));
    let plan = SurfacePlan::new(sizes, job.memory, most)?;
    let mut sums = SurfaceSums::new(job)?;
    let plan = sums.use_nodal_sums(plan, most, count > 1, &NestedMonitor(monitor))?;
    let samples = sums.samples();
    let fitter = Fitter::new(job, &plan, sums)?;
    let needed = plan.needed(plan.together).div_ceil(1 << 20);
    let text = format_args!(
        "{} with {} vertices, degree {}: least squares over {} samples of the surface{}, {needed} of {} MiB of memory \
         planned",
        counted(count, "target", "targets"),
        sizes.vertices,
        sizes.max_degree,
        samples,
        in_batches(count, plan.together),
        plan.budget >> 20,
    );
    monitor.note(Level::Info, text);
    note_fine_degree(sizes.vertices, sizes.max_degree, monitor);
    run.readers = plan.readers(job.threads);
    run.seconds.plan += mark.elapsed().as_secs_f64();
    let fit_noise = |noise: &Array2<f64>| fitter.fit_noise(noise, &NestedMonitor(monitor));
    let denoiser = job.params.denoise.then(|| Denoiser::new(job, plan.together * channels, monitor, fit_noise));
    let denoiser = denoiser.transpose()?;
    run.each_batch(plan.together * channels, |job, batch| {
        let solved = fitter.fit(batch, denoiser.as_ref().map(|denoiser| (denoiser, job)), monitor)?;
        monitor.step(batch.groups.len() as u64);
        Ok(solved)
    })
}

/// Tells the user if a model of the degree has more coefficients per coordinate than its surface has vertices.
fn note_fine_degree(vertices: usize, max_degree: usize, monitor: &dyn Monitor) {
    let functions = (max_degree + 1).pow(2);
    if functions > vertices {
        let text = format_args!(
            "degree {max_degree} has {functions} coefficients per coordinate, but the surface has {vertices} vertices: \
             degrees above {} only follow the edges of the triangles",
            vertices.isqrt().saturating_sub(1),
        );
        monitor.note(Level::Info, text);
    }
}

/// Returns the directions of the vertices, followed by the directions of the triangle centres at which models are
/// assessed.
fn places(job: &Job<'_>) -> Result<Directions, Error> {
    let mut places = job.sphere.directions.as_slice().to_vec();
    if let Some(off_vertex) = &job.off_vertex {
        places.extend_from_slice(off_vertex.centres().as_slice());
    }
    Ok(Directions::from_unit_vectors(places)?)
}

/// Data shared by the fits of all surfaces over one sphere.
pub(super) struct Fitter<'a> {
    pub(super) params: &'a FitParams,
    sums: SurfaceSums<'a>,
    /// Evaluates models at the vertices, for the mean and maximum squared distance there, and at the centres of some
    /// triangles. The values at the vertices come first.
    evaluation: Transform,
    /// Number of columns of coefficients that are evaluated together.
    evaluated: usize,
    model_surface: Option<ModelSurface>,
    /// Triangles of each surface that are compared with its model.
    surface: ReadSurface,
    /// Marks vertices whose values aren't read.
    unread: Option<Vec<bool>>,
    /// Number of vertices with nonzero weight.
    pub(super) vertices_with_weight: usize,
    pub(super) solver: LsqParams,
}

impl<'a> Fitter<'a> {
    fn new(job: &Job<'a>, plan: &SurfacePlan, sums: SurfaceSums<'a>) -> Result<Self, Error> {
        let (sphere, params) = (job.sphere, job.params);
        let max_degree = params.max_degree;
        let held = plan.needed(plan.together) + sums.kept_bytes();
        let spare = plan.budget.saturating_sub(held);
        let evaluated = plan.evaluated(plan.together);
        let level =
            if params.surface_distance { ModelSurface::level(max_degree, sphere.faces.len(), spare) } else { None };
        Ok(Self {
            params,
            sums,
            evaluation: Transform::new(&places(job)?, &transform(max_degree, evaluated))?,
            evaluated,
            model_surface: level.map(|level| ModelSurface::new(max_degree, level)).transpose()?,
            surface: ReadSurface::new(sphere, job.unread.as_deref()),
            unread: job.unread.clone(),
            vertices_with_weight: job.vertices_with_weight(),
            solver: LsqParams {
                smoothness: match params.smoothness {
                    Smoothness::Fixed(smoothness) => job.fixed_smoothness(smoothness),
                    Smoothness::Default | Smoothness::Auto => 0.0,
                },
                strategy: strategy(params.preconditioner),
                tolerance: params.tolerance,
                max_iterations: params.max_iterations,
                memory: plan.budget,
                held,
                gram_bytes: MomentGram::bytes(max_degree),
                threads: job.threads,
                ..LsqParams::default()
            },
        })
    }

    fn fit(
        &self,
        batch: &Batch,
        denoiser: Option<(&Denoiser, &Job<'_>)>,
        monitor: &dyn Monitor,
    ) -> Result<Solved, Error> {
        let within = NestedMonitor(monitor);
        let started = Instant::now();
        let targets: Vec<(Range<usize>, ArrayView2<'_, f64>)> = batch.targets().collect();
        let problem = self.problem(&targets, &within)?;
        let mut solver = self.solver.clone();
        let mut gcv = None;
        if self.params.smoothness == Smoothness::Auto
            && let Some((_, target)) = targets.first()
        {
            let found = self.choose_smoothness(*target, monitor)?;
            solver.smoothness = found.smoothness;
            gcv = Some(found);
        }
        // Each surface is solved to its own optimality, so that its model doesn't depend on the other surfaces in the
        // batch.
        let fits = solve_moments_of_groups(&problem, &batch.groups, &solver, &within)?;
        let mut coefficients = Array2::zeros((basis_size(self.params.max_degree), batch.columns()));
        let mut reports = Vec::new();
        for (fit, group) in fits.into_iter().zip(&batch.groups) {
            set_columns(&mut coefficients, group, fit.coefficients.values().view());
            reports.push(fit.report);
        }
        let mut standard_errors = self.params.standard_errors.then(|| Array2::zeros(coefficients.dim()));
        let mut denoised = Vec::new();
        if let Some(denoiser) = denoiser {
            let results = (&mut coefficients, &mut standard_errors);
            denoised = self.denoise(denoiser, batch, &problem, results, &mut reports, &within)?;
        } else if let Some(errors) = &mut standard_errors {
            // The residuals of all targets are collected first, because the fits of noise that estimate standard errors
            // are made once for all targets.
            let mut residual = Array2::zeros((self.vertices(), batch.columns()));
            for (group, target) in &targets {
                let (of_target, _) = self.residual(*target, coefficients.slice(s![.., group.clone()]))?;
                residual.slice_mut(s![.., group.clone()]).assign(&of_target);
            }
            *errors = self.standard_errors(&solver, &residual, monitor)?;
        }
        let warnings_of = |report: &LsqReport| FitWarning::of_lsq(report, self.params.tolerance, None);
        let per_target: Vec<PerTarget> = reports
            .iter()
            .map(|report| PerTarget { optimality: Some(report.optimality), warnings: warnings_of(report) })
            .collect();
        per_target.iter().try_for_each(|of_target| converged(self.params, &of_target.warnings).map(drop))?;
        let mut report = reports.into_iter().reduce(merge_reports).expect("each batch has a target");
        report.seconds.total = started.elapsed().as_secs_f64();
        note_solution(&report, monitor);
        let (residuals, at_centres) = self.assess(&targets, coefficients.view())?;
        let surface_distances = match &self.model_surface {
            Some(model) => batch.surface_distances(model, coefficients.view(), &self.surface, monitor)?,
            None => Vec::new(),
        };
        Ok(Solved {
            coefficients,
            sweeps: vec![(false, residuals)],
            standard_errors,
            denoised,
            surface_distances,
            warnings: Vec::new(),
            per_target,
            at_centres,
            report: BatchReport::LeastSquares { report, gcv },
        })
    }

    /// Returns the norms of the targets' residuals, and the values of each model at the centres of some triangles
    /// (centres x channels). Each target is given with its columns in the batch.
    fn assess(
        &self,
        targets: &[(Range<usize>, ArrayView2<'_, f64>)],
        coefficients: ArrayView2<'_, f64>,
    ) -> Result<(Vec<ResidualNorms>, Vec<Array2<f64>>), Error> {
        let mut assessed = Vec::with_capacity(targets.len());
        let mut rest = targets;
        while !rest.is_empty() {
            // Take as many columns as planned, even if targets differ in their number of channels.
            let fits = |count: &usize| rest[count - 1].0.end - rest[0].0.start <= self.evaluated;
            let count = (1..=rest.len()).rev().find(fits).unwrap_or(1);
            let (some, others) = rest.split_at(count);
            rest = others;
            let columns = some[0].0.start..some[some.len() - 1].0.end;
            let model = self.evaluation.synthesis(coefficients.slice(s![.., columns.clone()]))?;
            assessed.par_extend(some.par_iter().map(|(group, target)| {
                let own = model.slice(s![.., group.start - columns.start..group.end - columns.start]);
                let (vertices, centres) = own.split_at(Axis(0), target.nrows());
                (ResidualNorms::without((target - &vertices).view(), self.unread.as_deref()), centres.to_owned())
            }));
        }
        Ok(assessed.into_iter().unzip())
    }

    /// Returns a target's residual at the vertices, and the model's values at the centres of some triangles, both with
    /// one column per channel.
    fn residual(
        &self,
        target: ArrayView2<'_, f64>,
        coefficients: ArrayView2<'_, f64>,
    ) -> Result<(Array2<f64>, Array2<f64>), Error> {
        let model = self.evaluation.synthesis(coefficients)?;
        let (vertices, centres) = model.view().split_at(Axis(0), target.nrows());
        Ok((&target - &vertices, centres.to_owned()))
    }

    /// Fits noise at the vertices (vertices x channels). Noise is interpolated linearly on each triangle, as targets
    /// are. Returns the coefficients, and the residual at the vertices.
    fn fit_noise(&self, noise: &Array2<f64>, monitor: &dyn Monitor) -> Result<(Array2<f64>, Array2<f64>), Error> {
        let problem = self.problem(&[(0..noise.ncols(), noise.view())], monitor)?;
        let columns: Vec<Range<usize>> = (0..noise.ncols()).map(|column| column..column + 1).collect();
        let fits = solve_moments_of_groups(&problem, &columns, &self.solver, monitor)?;
        let mut coefficients = Array2::zeros((basis_size(self.params.max_degree), noise.ncols()));
        for (fit, column) in fits.iter().zip(&columns) {
            set_columns(&mut coefficients, column, fit.coefficients.values().view());
        }
        let (residual, _) = self.residual(noise.view(), coefficients.view())?;
        Ok((coefficients, residual))
    }

    /// Replaces the plain fits of a batch by penalised fits. If standard errors were requested, replaces them by those
    /// of the penalised fits. Returns the removed noise.
    fn denoise(
        &self,
        (denoiser, job): (&Denoiser, &Job<'_>),
        batch: &Batch,
        problem: &MomentProblem,
        (coefficients, standard_errors): (&mut Array2<f64>, &mut Option<Array2<f64>>),
        reports: &mut [LsqReport],
        monitor: &dyn Monitor,
    ) -> Result<Vec<Vec<Denoised>>, Error> {
        let mut denoised = Vec::new();
        for (((group, target), parts), report) in batch.targets().zip(batch.parts()).zip(reports) {
            let (residual, _) = self.residual(target, coefficients.slice(s![.., group.clone()]))?;
            let mut of_target = Vec::new();
            for part in parts {
                let of_group = part.start - group.start..part.end - group.start;
                let plain = coefficients.slice(s![.., part.clone()]);
                let found = denoiser.denoise(plain, residual.slice(s![.., of_group.clone()]));
                let params = LsqParams { penalty: Some(found.penalty.clone()), ..self.solver.clone() };
                let fit = solve_moments(&problem.of_columns(part.clone()), &params, false, monitor)?;
                set_columns(coefficients, &part, fit.coefficients.values().view());
                if let Some(errors) = standard_errors.as_mut() {
                    let target = target.slice(s![.., of_group.clone()]);
                    let (residual, _) = self.residual(target, coefficients.slice(s![.., part.clone()]))?;
                    let of_part = self.standard_errors(&params, &residual, monitor)?;
                    set_columns(errors, &part, found.with_uncertain_gains(of_part).view());
                }
                merge(report, fit.report);
                of_target.push(denoiser.assess(job, target.slice(s![.., of_group]), found, monitor)?);
            }
            denoised.push(of_target);
        }
        Ok(denoised)
    }

    /// Returns the number of vertices.
    pub(super) fn vertices(&self) -> usize {
        self.sums.vertices()
    }

    /// Returns the weights of the vertices, if there are any.
    pub(super) fn weights(&self) -> Option<&[f64]> {
        self.sums.weights()
    }

    /// Returns the number of columns of coefficients that are evaluated together.
    pub(super) fn evaluated(&self) -> usize {
        self.evaluated
    }

    /// Evaluates the models with the given coefficients at the vertices, followed by the centres of some triangles.
    pub(super) fn evaluate(&self, coefficients: ArrayView2<'_, f64>) -> Result<Array2<f64>, Error> {
        Ok(self.evaluation.synthesis(coefficients)?)
    }

    /// Returns the normal equations for the given targets. Each target is given with its columns in the batch.
    pub(super) fn problem(
        &self,
        targets: &[(Range<usize>, ArrayView2<'_, f64>)],
        monitor: &dyn Monitor,
    ) -> Result<MomentProblem, Error> {
        Ok(MomentProblem::new(&self.sums.of(targets, monitor)?, self.params.max_degree)?)
    }

    /// Returns the normal equations for the given targets, with `more` added to the right-hand sides.
    pub(super) fn problem_plus(
        &self,
        targets: &[(Range<usize>, ArrayView2<'_, f64>)],
        more: &Array2<f64>,
        monitor: &dyn Monitor,
    ) -> Result<MomentProblem, Error> {
        let mut sums = self.sums.of(targets, monitor)?;
        sums.right_sides += more;
        Ok(MomentProblem::new(&sums, self.params.max_degree)?)
    }
}
