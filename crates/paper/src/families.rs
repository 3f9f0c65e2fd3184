//! Compares least squares at the vertices with Healy's quadrature on a grid to which the surface is resampled. The
//! paper by Shen and Chung leaves this comparison for future work.

use std::time::Instant;

use anyhow::{Context, Result};
use ndarray::{Array2, ArrayView2};
use spharm::Quadrature;
use spharm_harmonics::basis_size;
use spharm_solver::lsq::Stop;
use spharm_solver::{
    GramMatrix, LsqParams, LsqSolver, MatrixFreeOperator, Operator, ResidualNorms, moment_gram, moment_gram_bytes,
};
use spharm_surface::Mesh;
use spharm_transform::{Transform, TransformParams};

use crate::bench::{Bench, Measured};
use crate::extent::Extent;
use crate::published::Quality;
use crate::surfaces::Surface;

/// Results of least squares and quadrature for one surface and one degree.
#[derive(Debug)]
pub(crate) struct Family {
    pub(crate) surface: String,
    pub(crate) vertices: usize,
    pub(crate) max_degree: usize,
    pub(crate) least_squares: Measured,
    /// Whether the least-squares iteration reached its tolerance.
    pub(crate) converged: bool,
    pub(crate) quadrature: Measured,
}

/// Relative accuracy of the transforms, as in the command `spharm fit`.
const ACCURACY: f64 = 1e-12;

pub(crate) fn families(bench: &Bench<'_>, extent: &Extent, surface: &Surface) -> Result<Vec<Family>> {
    extent.families.iter().map(|&max_degree| family(bench, surface, max_degree)).collect()
}

fn family(bench: &Bench<'_>, surface: &Surface, max_degree: usize) -> Result<Family> {
    bench.note(format!("{}: least squares and quadrature to degree {max_degree}", surface.name));
    let n = surface.vertices.len();
    let targets = ArrayView2::from_shape((n, 3), surface.vertices.as_flattened())?.to_owned();
    let transform = TransformParams { max_degree, accuracy: ACCURACY, channels: 3 };

    let started = Instant::now();
    let operator = MatrixFreeOperator::new(&surface.directions, &transform)?;
    let make_gram = || {
        let gram = moment_gram(&surface.directions, None, max_degree)?;
        Ok(Box::new(gram) as Box<dyn GramMatrix>)
    };
    let arrays = 8 * 3 * (4 * n + 8 * basis_size(max_degree));
    let held = bench.held + arrays + Transform::bytes(&transform, n, 3)? + moment_gram_bytes(n, max_degree)?;
    let params = LsqParams { memory: bench.memory, held, threads: bench.threads, ..LsqParams::default() };
    let mut solver = LsqSolver::new(&operator, Some(&make_gram), params)?;
    let group = 0..3;
    let fit = solver.fit(&targets, std::slice::from_ref(&group), bench.monitor)?;
    let seconds = started.elapsed().as_secs_f64();
    let least_squares = Measured { quality: quality(&fit.residual, surface.scale), seconds };

    let started = Instant::now();
    let sphere = Mesh::new(surface.directions.as_slice().to_vec(), surface.faces.clone());
    let coefficients = Quadrature::new(&sphere, max_degree)
        .and_then(|quadrature| quadrature.fit(targets.view()))
        .with_context(|| surface.name.clone())?;
    let seconds = started.elapsed().as_secs_f64();
    let residual = &targets - &operator.apply(coefficients.view())?;
    let quadrature = Measured { quality: quality(&residual, surface.scale), seconds };

    let converged = fit.report.stop == Stop::Converged;
    Ok(Family { surface: surface.name.clone(), vertices: n, max_degree, least_squares, converged, quadrature })
}

fn quality(residual: &Array2<f64>, scale: f64) -> Quality {
    let ResidualNorms { mean_square, max_square } = ResidualNorms::of(residual.view());
    Quality { msd: mean_square / (scale * scale), xsd: max_square / (scale * scale) }
}
