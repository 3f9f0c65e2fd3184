//! The full least squares over whole surfaces: the integral over the sphere of the squared distance.
//!
//! A mesh over a sphere is linear on each triangle, and [`SphereSampling`] samples all of them as densely as the degree needs.
//! The fit takes sums over these samples and nothing else ([`Accumulator`]): each run of triangles is sampled, added, and
//! forgotten, so that memory depends on the degree and not on the mesh. Solid angles as weights make the normal matrix nearly
//! a multiple of the identity, and a handful of iterations on a grid of the degree's own size suffices.

use std::ops::Range;
use std::time::Instant;

use ndarray::{Array2, ArrayView2, Axis, aview1, s};
use spharm_monitor::{Level, Monitor};
use spharm_solver::lsq::{MomentProblem, solve_moments};
use spharm_solver::{LsqParams, ResidualNorms};
use spharm_surface::Sphere;
use spharm_surface::samples::{SphereSamples, SphereSampling};
use spharm_transform::{Accumulator, MomentGram, SampleSums, Transform};

use super::batches::{Batch, Run, Solved};
use super::job::Job;
use super::lsq_plan::{Sizes, transform};
use super::shared::{Within, converged, note_solution, strategy};
use super::surface_plan::{RUN, SurfacePlan};
use crate::assess::ModelSurface;
use crate::report::BatchReport;
use crate::{Error, FitParams, FitWarning, Smoothness, defaults};

/// Fits targets as long as they are to be fitted as surfaces.
pub(crate) fn run<T: Send, E: From<Error> + Send>(run: &mut Run<'_, T, E>) -> Result<(), E> {
    let (monitor, channels, count) = (run.monitor, run.channels(), run.count - run.results.len());
    let mark = Instant::now();
    let job = &run.job;
    let sizes = Sizes {
        vertices: job.sphere.directions.len(),
        faces: job.sphere.faces.len(),
        max_degree: job.params.max_degree,
        channels,
    };
    let most = (defaults::MOST_COLUMNS / channels).clamp(1, count.max(1));
    let plan = SurfacePlan::new(sizes, job.memory, most)?;
    let fitter = Fitter::new(job, &plan)?;
    let needed = plan.needed(plan.together).div_ceil(1 << 20);
    let text = format_args!(
        "{count} of n = {}, L = {}: least squares over {} samples of the surface, {} at a time, {needed} of {} MiB planned",
        sizes.vertices,
        sizes.max_degree,
        fitter.sampling.samples(0..sizes.faces),
        plan.together,
        plan.budget >> 20,
    );
    monitor.note(Level::Info, text);
    run.readers = plan.readers(job.threads);
    run.seconds.plan += mark.elapsed().as_secs_f64();
    run.each_batch(plan.together * channels, |_, batch| {
        let solved = fitter.fit(batch, monitor)?;
        monitor.step(batch.groups.len() as u64);
        Ok(solved)
    })
}

/// What fits of surfaces over one sphere share.
struct Fitter<'a> {
    sphere: &'a Sphere,
    params: &'a FitParams,
    /// What the vertices count, (n).
    weights: Option<Vec<f64>>,
    sampling: SphereSampling,
    /// At the vertices, where msd and xsd are taken.
    vertices: Transform,
    model_surface: Option<ModelSurface>,
    solver: LsqParams,
}

impl<'a> Fitter<'a> {
    fn new(job: &Job<'a>, plan: &SurfacePlan) -> Result<Self, Error> {
        let (sphere, params) = (job.sphere, job.params);
        let max_degree = params.max_degree;
        if sphere.faces.is_empty() {
            return Err(Error::NeedsTriangles { what: "a fit of the surface", sphere: sphere.name().to_owned() });
        }
        let spare = plan.budget.saturating_sub(plan.needed(plan.together));
        let level =
            if params.surface_distance { ModelSurface::level(max_degree, sphere.faces.len(), spare) } else { None };
        Ok(Self {
            sphere,
            params,
            weights: job.weights.clone(),
            sampling: SphereSampling::for_degree(&sphere.directions, &sphere.faces, max_degree)?,
            vertices: Transform::new(&sphere.directions, &transform(max_degree, plan.sizes.channels))?,
            model_surface: level.map(|level| ModelSurface::new(max_degree, level)).transpose()?,
            solver: LsqParams {
                smoothness: match params.smoothness {
                    Smoothness::Fixed(smoothness) => smoothness,
                    Smoothness::Default | Smoothness::Auto => 0.0,
                },
                strategy: strategy(params.preconditioner),
                tolerance: params.tolerance,
                max_iterations: params.max_iterations,
                memory: plan.budget,
                held: plan.needed(plan.together),
                gram_bytes: MomentGram::bytes(max_degree),
                threads: job.threads,
                ..LsqParams::default()
            },
        })
    }

    fn fit(&self, batch: &Batch, monitor: &dyn Monitor) -> Result<Solved, Error> {
        let within = Within(monitor);
        let started = Instant::now();
        let sums = self.sums(batch, &within)?;
        let problem = MomentProblem::new(&sums, self.params.max_degree)?;
        drop(sums);
        let mut fit = solve_moments(&problem, &self.solver, false, &within)?;
        fit.report.seconds.total = started.elapsed().as_secs_f64();
        let warnings = FitWarning::of_lsq(&fit.report, self.params.tolerance, false);
        converged(self.params, &warnings)?;
        note_solution(&fit.report, monitor);
        let coefficients = fit.coefficients.values();
        let at_vertices = |(group, target): (Range<usize>, ArrayView2<'_, f64>)| -> Result<ResidualNorms, Error> {
            let model = self.vertices.synthesis(coefficients.slice(s![.., group]))?;
            Ok(ResidualNorms::of((&target - &model).view()))
        };
        let residuals = batch.targets().map(at_vertices).collect::<Result<Vec<_>, _>>()?;
        let surface_distances = match &self.model_surface {
            Some(model) => batch.surface_distances(model, coefficients.view(), self.sphere, monitor)?,
            None => Vec::new(),
        };
        Ok(Solved {
            coefficients: coefficients.to_owned(),
            sweeps: vec![(false, residuals)],
            standard_errors: None,
            surface_distances,
            warnings,
            report: BatchReport::LeastSquares { report: fit.report, gcv: None },
        })
    }

    /// Returns the sums of a batch over samples of all triangles. Weights are solid angles times what the vertices count,
    /// scaled to the sum that the vertices' weights have: a penalty then means the same for a surface as for its vertices.
    fn sums(&self, batch: &Batch, monitor: &dyn Monitor) -> Result<SampleSums, Error> {
        let mut sums = Accumulator::new(self.params.max_degree, batch.columns())?;
        for triangles in self.sampling.runs(RUN) {
            monitor.check()?;
            let SphereSamples { directions, mut weights } =
                self.sampling.at(&self.sphere.directions, triangles.clone())?;
            if let Some(of_vertices) = &self.weights {
                let column = aview1(of_vertices).insert_axis(Axis(1));
                let factors = self.sampling.interpolate(column, triangles.clone());
                weights.iter_mut().zip(&factors).for_each(|(weight, factor)| *weight *= factor);
            }
            let mut values = Array2::zeros((weights.len(), batch.columns()));
            for (group, target) in batch.targets() {
                values.slice_mut(s![.., group]).assign(&self.sampling.interpolate(target, triangles.clone()));
            }
            sums.add(directions.as_slice(), Some(&weights), values.view())?;
        }
        let mut sums = sums.finish()?.sums;
        let vertices = self.sphere.directions.len() as f64;
        let total = self.weights.as_ref().map_or(vertices, |weights| weights.iter().sum());
        let factor = total / sums.weight;
        let all = sums.moments.iter_mut().chain(&mut sums.right_sides).chain(&mut sums.squares);
        all.chain([&mut sums.weight]).for_each(|sum| *sum *= factor);
        Ok(sums)
    }
}
