//! Healy's way: the surface resampled to a Gauss-Legendre grid, and analysis by exact quadrature.
//!
//! On L + 1 Gauss-Legendre rings of 2 L + 2 azimuths the coefficients of a function of degree L are sums of its values there
//! times weights, without any solving. What it fits is the surface between the vertices, linear over the sphere's
//! triangles, in place of the vertices alone: it neither sees nor minimises the distances there. D. M. Healy et al., "FFTs
//! for the 2-sphere", J. Fourier Anal. Appl. 9 (2003).

use std::sync::atomic::AtomicBool;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use spharm_cli::console::Unit;
use spharm_harmonics::{Directions, gauss_legendre};
use spharm_solver::SolverError;
use spharm_solver::report::Residual;
use spharm_surface::Mesh;
use spharm_surface::sphere_locator::SphereLocator;
use spharm_transform::{FINEST, Transform, TransformParams};

use crate::job::{Job, Solved};
use crate::outputs::Item;
use crate::report::{BatchReport, Fitted};

/// Fits all items by quadrature.
pub(crate) fn run(job: &mut Job<'_>, items: &[Item], cancel: &AtomicBool) -> Result<(Vec<Fitted>, Vec<BatchReport>)> {
    if job.sphere.faces.is_empty() {
        bail!("--method quadrature needs triangles, and {} has none; give a sphere mesh", job.sphere.path.display());
    }
    let max_degree = job.cli.max_degree;
    let queue = job.queue(items)?;
    let mark = Instant::now();
    let sphere = Mesh::new(job.sphere.directions.as_slice().to_vec(), job.sphere.faces.clone());
    let locator = SphereLocator::new(&sphere).with_context(|| job.sphere.path.display().to_string())?;
    let (grid, weights) = grid(max_degree)?;
    let params = TransformParams { max_degree, accuracy: FINEST, channels: 6 };
    let analysis = Transform::new(&grid, &params)?;
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
        let mut values = locator
            .interpolate(targets.view(), grid.as_slice())
            .with_context(|| job.sphere.path.display().to_string())?;
        for (mut row, weight) in values.rows_mut().into_iter().zip(&weights) {
            row *= *weight;
        }
        let coefficients = analysis.adjoint_synthesis(values.view())?;
        let residual = &targets - &vertices.synthesis(coefficients.view())?;
        let residuals = batch.groups.iter().map(|group| {
            let squares = residual.slice(ndarray::s![.., group.clone()]);
            let squares: Vec<f64> = squares.rows().into_iter().map(|row| row.dot(&row)).collect();
            let mean_square = squares.iter().sum::<f64>() / squares.len() as f64;
            Residual { mean_square, max_square: squares.into_iter().fold(0.0, f64::max) }
        });
        let residuals: Vec<Residual> = residuals.collect();
        progress.add(batch.groups.len() as u64);
        Ok(Solved {
            coefficients,
            sweeps: vec![(false, residuals.clone())],
            standard_errors: None,
            report: BatchReport::Quadrature { max_degree, grid: [max_degree + 1, 2 * max_degree + 2], residuals },
        })
    })?;
    job.seconds = seconds;
    Ok(fits)
}

/// Directions of the grid, ring after ring, and their weights for integrals over the sphere.
fn grid(max_degree: usize) -> Result<(Directions, Vec<f64>)> {
    let rings = gauss_legendre(max_degree + 1);
    let around = 2 * max_degree + 2;
    let (mut vectors, mut weights) = (Vec::new(), Vec::new());
    for j in 0..rings.len() {
        for k in 0..around {
            let (sine, cosine) = (std::f64::consts::TAU * k as f64 / around as f64).sin_cos();
            vectors.push([rings.sines[j] * cosine, rings.sines[j] * sine, rings.cosines[j]]);
            weights.push(rings.weights[j] * std::f64::consts::TAU / around as f64);
        }
    }
    Ok((Directions::from_vertices(&vectors)?, weights))
}
