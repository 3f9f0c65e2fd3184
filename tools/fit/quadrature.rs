//! Quadrature on a resampled grid, surface by surface.

use std::ops::Range;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use spharm_cli::console::Unit;
use spharm_solver::SolverError;
use spharm_solver::report::Residual;
use spharm_surface::Mesh;
use spharm_surface::quadrature::Quadrature;
use spharm_transform::{FINEST, Transform, TransformParams};

use super::job::{Job, Solved};
use super::outputs::Item;
use super::report::{BatchReport, Fitted};

/// Fits all items by quadrature.
pub(crate) fn run(job: &mut Job<'_>, items: &[Item], cancel: &AtomicBool) -> Result<(Vec<Fitted>, Vec<BatchReport>)> {
    if job.sphere.faces.is_empty() {
        bail!("--method quadrature needs triangles, and {} has none; give a sphere mesh", job.sphere.name().display());
    }
    let max_degree = job.cli.max_degree;
    let queue = job.queue(items)?;
    let mark = Instant::now();
    let sphere = Mesh::new(job.sphere.directions.as_slice().to_vec(), job.sphere.faces.clone());
    let quadrature = Quadrature::new(&sphere, max_degree).with_context(|| job.sphere.name().display().to_string())?;
    let params = TransformParams { max_degree, accuracy: FINEST, channels: 6 };
    let vertices = Transform::new(&job.sphere.directions, &params)?;
    job.seconds.plan += mark.elapsed().as_secs_f64();
    let mut seconds = job.seconds;
    let progress = job.console.progress("fit", items.len() as u64, Unit::Count("surfaces"));
    let channels = queue.channels();
    let fits = job.each_batch(queue, channels, &mut seconds, |batch| {
        if cancel.load(std::sync::atomic::Ordering::Relaxed) {
            return Err(SolverError::Interrupted.into());
        }
        let targets = batch.side_by_side();
        let coefficients = quadrature.fit(targets.view()).with_context(|| job.sphere.name().display().to_string())?;
        let residual = &targets - &vertices.synthesis(coefficients.view())?;
        let of = |group: &Range<usize>| Residual::of(residual.slice(ndarray::s![.., group.clone()]));
        let residuals: Vec<Residual> = batch.groups.iter().map(of).collect();
        progress.add(batch.groups.len() as u64);
        Ok(Solved {
            coefficients,
            sweeps: vec![(false, residuals.clone())],
            standard_errors: None,
            report: BatchReport::Quadrature { max_degree, grid: quadrature.grid(), residuals },
        })
    })?;
    job.seconds = seconds;
    Ok(fits)
}
