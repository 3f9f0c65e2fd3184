//! Adapts the triangles' target areas on the sphere to the residual of a fit: triangles get more area where a model of
//! a given degree has a large residual.
//!
//! A model of degree L resolves details of the size pi / L, everywhere on the sphere. The model's residual is therefore
//! largest where the surface bends sharply, or where a part of the surface has too small an area on the sphere for its
//! details. A map with more area where the residual is large, and less area elsewhere, gives a smaller error (P.
//! Sander, S. Gortler, J. Snyder, H. Hoppe, "Signal-specialized parametrization", EGRW 2002). Here a least-squares fit
//! over the current map gives a residual on each triangle. Each triangle's target area is multiplied by exp (s g), with
//! s a step length. The number g is the size of the residual on the triangle, smoothed slightly over neighbours, minus
//! its mean, in units of its standard deviation.

use std::ops::Range;

use ndarray::Array2;
use spharm_harmonics::Directions;
use spharm_monitor::{Monitor, OnlyCancel};
use spharm_solver::MatrixFreeOperator;
use spharm_solver::lsq::NormalEquations;
use spharm_solver::lsq::cg::{self, CgParams};
use spharm_surface::samples::SphereSampling;
use spharm_transform::TransformParams;

use crate::domain::Domain;
use crate::error::ParametrizeError;
use crate::geometry::{Vec3, add, scale};

/// Largest default degree of the model.
const MAX_DEFAULT_DEGREE: usize = 100;

/// Number of vertices per basis function of the model whose residual is used: the default, and the minimum. With fewer
/// vertices, a model nearly interpolates the vertices, and its residual is meaningless.
const PER_FUNCTION: [f64; 2] = [2.0, 1.5];

/// Upper limit of [`Residual::excess`]. Larger values are reduced to this limit, so that the triangles around a few
/// vertices far from the model don't get excessive areas.
const MAX_EXCESS: f64 = 8.0;

/// Number of rounds in which residuals are averaged over neighbouring triangles.
const ROUNDS: usize = 2;

/// Largest number of iterations of the least-squares solver. With samples over the entire surface, a few iterations
/// suffice.
const ITERATIONS: usize = 100;

/// Returns the degree of the model: `asked` or the default, but at most the largest degree that the given number of
/// vertices determines well.
pub(crate) fn degree_for(vertices: usize, asked: Option<usize>) -> usize {
    let most = |per: f64| ((vertices as f64 / per).sqrt() as usize).saturating_sub(1);
    asked.map_or(most(PER_FUNCTION[0]).min(MAX_DEFAULT_DEGREE), |degree| degree.min(most(PER_FUNCTION[1])))
}

/// The degree is lowered until there are at most this number of samples per triangle on average. The limit applies only
/// if there are more than [`FEW_SAMPLES`] samples. In meshes with many triangles, typical triangles have 3 samples
/// each.
const MOST_SAMPLES: usize = 16;

/// The limit [`MOST_SAMPLES`] isn't applied if there are at most this number of samples in all.
const FEW_SAMPLES: usize = 1_000_000;

/// Residual of a SPHARM fit over the current map.
pub(crate) struct Residual {
    /// Root mean square distance between the surface, scaled to area 4 pi, and its model.
    pub(crate) rms: f64,
    /// For each triangle, the residual minus the mean over triangles, divided by the standard deviation, at most
    /// [`MAX_EXCESS`].
    pub(crate) excess: Vec<f64>,
}

/// Fits a model of the given degree to the surface over a map, and returns the model's residual.
pub(crate) fn residual(
    domain: &Domain,
    map: &[Vec3],
    degree: usize,
    monitor: &dyn Monitor,
) -> Result<Residual, ParametrizeError> {
    let directions = Directions::from_vertices(map).map_err(spharm_solver::SolverError::from)?;
    monitor.check()?;
    let (sampling, degree) = sampling(&directions, &domain.faces, degree)?;
    let all = 0..domain.faces.len();
    let samples = sampling.at(&directions, all.clone())?;
    let transform = TransformParams { max_degree: degree, accuracy: 1e-6, ..TransformParams::default() };
    let operator = MatrixFreeOperator::new(&samples.directions, &transform)?;
    let equations = NormalEquations { operator: &operator, weights: Some(&samples.weights), penalty: None };
    let params = CgParams { tolerance: 1e-4, max_iterations: ITERATIONS, ..CgParams::default() };
    // Positions are relative to the centre, so that the tolerance doesn't depend on the surface's position.
    let centre = domain.positions.iter().fold([0.0; 3], |sum, p| add(sum, *p));
    let centre = scale(centre, 1.0 / map.len() as f64);
    let positions = Array2::from_shape_fn((map.len(), 3), |(v, k)| domain.positions[v][k] - centre[k]);
    let targets = sampling.interpolate(positions.view(), all);
    let fit = cg::solve(&equations, &targets, &equations.diagonal(), &params, &OnlyCancel(monitor));
    // After a cancellation `fit` may contain the error of another crate, so the monitor is checked first.
    monitor.check()?;
    let fit = fit?;

    let squares: Vec<f64> = fit.residual.rows().into_iter().map(|row| row.dot(&row)).collect();
    // Averages the squared residual over the part of the sphere that a triangle occupies. The fitted function maps this
    // part, projected onto a plane, linearly to the triangle on the surface. The average is therefore nearly the mean
    // over the surface's triangle.
    let mean_square = |samples_of: Range<usize>| {
        let weight: f64 = samples.weights[samples_of.clone()].iter().sum();
        let sum: f64 = samples_of.map(|i| samples.weights[i] * squares[i]).sum();
        sum / weight.max(f64::MIN_POSITIVE)
    };
    let squares: Vec<f64> = sampling.of_triangles().map(mean_square).collect();
    let total: f64 = domain.areas.iter().sum();
    let rms = (squares.iter().zip(&domain.areas).map(|(square, area)| square * area).sum::<f64>() / total).sqrt();
    let mut excess: Vec<f64> = squares.into_iter().map(f64::sqrt).collect();
    average(&domain.faces, map.len(), &mut excess);
    normalise(&mut excess);
    Ok(Residual { rms, excess })
}

/// Returns a sampling for a model of the given degree, and the degree. The degree is lowered if long thin triangles on
/// the sphere would lead to more than [`MOST_SAMPLES`] samples per triangle.
fn sampling(
    directions: &Directions,
    faces: &[[u32; 3]],
    mut degree: usize,
) -> Result<(SphereSampling, usize), ParametrizeError> {
    loop {
        let sampling = SphereSampling::for_degree(directions, faces, degree)?;
        let samples = sampling.samples(0..faces.len());
        if degree <= 2 || samples <= (MOST_SAMPLES * faces.len()).max(FEW_SAMPLES) {
            return Ok((sampling, degree));
        }
        degree = (degree * 3 / 4).max(2);
    }
}

/// Smooths the triangles' values, [`ROUNDS`] times: averages them over the triangles at each vertex, then over each
/// triangle's vertices.
fn average(faces: &[[u32; 3]], vertices: usize, values: &mut [f64]) {
    let mut valence = vec![0.0; vertices];
    faces.iter().flatten().for_each(|&v| valence[v as usize] += 1.0);
    for _ in 0..ROUNDS {
        let mut sums = vec![0.0; vertices];
        for (face, value) in faces.iter().zip(&*values) {
            face.iter().for_each(|&v| sums[v as usize] += value);
        }
        for (face, value) in faces.iter().zip(&mut *values) {
            *value = face.iter().map(|&v| sums[v as usize] / valence[v as usize]).sum::<f64>() / 3.0;
        }
    }
}

/// Shifts and scales values to mean zero and root mean square one, then reduces values above [`MAX_EXCESS`] to this
/// limit.
fn normalise(values: &mut [f64]) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let spread = (values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / count).sqrt().max(f64::MIN_POSITIVE);
    values.iter_mut().for_each(|x| *x = ((*x - mean) / spread).min(MAX_EXCESS));
}

/// Returns the triangles' target areas: `areas` times exp (`factors`), scaled to sum to 4 pi.
pub(crate) fn adapted(areas: &[f64], factors: &[f64]) -> Vec<f64> {
    let mut adapted: Vec<f64> = areas.iter().zip(factors).map(|(area, factor)| area * factor.exp()).collect();
    let factor = 4.0 * std::f64::consts::PI / adapted.iter().sum::<f64>();
    adapted.iter_mut().for_each(|area| *area *= factor);
    adapted
}
