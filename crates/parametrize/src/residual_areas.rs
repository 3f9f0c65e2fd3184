//! Residual-adaptive areas: a higher sampling density where a model of a given degree has its residual.
//!
//! A model of degree L resolves pi / L wherever on the sphere, so its residual is largest where the surface bends
//! sharply, or is meshed more finely than its area on the sphere allows for. A map with more area there and less elsewhere
//! has less error (P. Sander, S. Gortler, J. Snyder, H. Hoppe, "Signal-specialized parametrization", EGRW 2002). Here a
//! fit shows where: its least squares over the current map leaves a residual at each vertex, and the target areas of
//! triangles are multiplied by exp (s g), with g the residual's size, smoothed a little over neighbours, less its mean.

use ndarray::Array2;
use spharm_harmonics::Directions;
use spharm_monitor::{Monitor, OnlyCancel};
use spharm_solver::MatrixFreeOperator;
use spharm_solver::lsq::NormalEquations;
use spharm_solver::lsq::cg::{self, CgParams};
use spharm_transform::TransformParams;

use crate::domain::Domain;
use crate::error::ParametrizeError;
use crate::geometry::{Vec3, add, norm, scale};

/// Highest degree that is chosen unasked.
const MAX_DEFAULT_DEGREE: usize = 100;

/// Vertices per basis function, by default and at least: where a model nearly interpolates, its residual means little.
const PER_FUNCTION: [f64; 2] = [2.0, 1.5];

/// The largest excess of residual that counts: areas must not explode where a few vertices are far off.
const MAX_EXCESS: f64 = 8.0;

/// Rounds of averaging over neighbours.
const ROUNDS: usize = 2;

/// Most iterations of the least squares: where residuals are large shows long before the coefficients have settled.
const ITERATIONS: usize = 500;

/// The degree that areas adapt to: `asked`, but no more than `vertices` determine well.
pub(crate) fn degree_for(vertices: usize, asked: Option<usize>) -> usize {
    let most = |per: f64| ((vertices as f64 / per).sqrt() as usize).saturating_sub(1);
    asked.map_or(most(PER_FUNCTION[0]).min(MAX_DEFAULT_DEGREE), |degree| degree.min(most(PER_FUNCTION[1])))
}

/// Residual of a SPHARM fit over a map.
pub(crate) struct Residual {
    /// Root mean square of the distance between a vertex and its model, on the surface of area 4 pi.
    pub(crate) rms: f64,
    /// For each triangle, its residual less the mean over triangles, over their standard deviation, cut at
    /// [`MAX_EXCESS`].
    pub(crate) excess: Vec<f64>,
}

/// Fits a model of a degree over a map.
pub(crate) fn residual(
    domain: &Domain,
    map: &[Vec3],
    degree: usize,
    monitor: &dyn Monitor,
) -> Result<Residual, ParametrizeError> {
    let directions = Directions::from_vertices(map).map_err(spharm_solver::SolverError::from)?;
    monitor.check()?;
    let transform = TransformParams { max_degree: degree, accuracy: 1e-6, ..TransformParams::default() };
    let operator = MatrixFreeOperator::new(&directions, &transform)?;
    let equations = NormalEquations { operator: &operator, weights: None, penalty: None };
    let params = CgParams { tolerance: 1e-4, max_iterations: ITERATIONS, ..CgParams::default() };
    let centre = domain.positions.iter().fold([0.0; 3], |sum, p| add(sum, *p));
    let centre = scale(centre, 1.0 / map.len() as f64);
    let targets = Array2::from_shape_fn((map.len(), 3), |(v, k)| domain.positions[v][k] - centre[k]);
    let fit = cg::solve(&equations, &targets, &equations.diagonal(), &params, &OnlyCancel(monitor));
    // Whichever of the two crates it stopped in.
    monitor.check()?;
    let fit = fit?;

    let mut sizes: Vec<f64> = fit.residual.rows().into_iter().map(|row| norm([row[0], row[1], row[2]])).collect();
    let rms = (sizes.iter().map(|e| e * e).sum::<f64>() / sizes.len() as f64).sqrt();
    average(&domain.faces, &mut sizes);
    let of = |face: &[u32; 3]| face.iter().map(|&v| sizes[v as usize]).sum::<f64>();
    let mut excess: Vec<f64> = domain.faces.iter().map(of).collect();
    normalise(&mut excess);
    Ok(Residual { rms, excess })
}

/// Replaces each value by the mean of itself and its neighbours' mean, a few times.
fn average(faces: &[[u32; 3]], values: &mut [f64]) {
    let mut valence = vec![0.0; values.len()];
    faces.iter().flatten().for_each(|&v| valence[v as usize] += 1.0);
    for _ in 0..ROUNDS {
        let mut sum = vec![0.0; values.len()];
        for &[a, b, c] in faces {
            for (v, w) in [(a, b), (b, c), (c, a)] {
                sum[v as usize] += values[w as usize];
            }
        }
        values.iter_mut().zip(&sum).zip(&valence).for_each(|((value, sum), n)| *value = 0.5 * (*value + sum / n));
    }
}

/// To a mean of zero and a root mean square of one, nearly: larger values than [`MAX_EXCESS`] are cut.
pub(crate) fn normalise(values: &mut [f64]) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let spread = (values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / count).sqrt().max(f64::MIN_POSITIVE);
    values.iter_mut().for_each(|x| *x = ((*x - mean) / spread).min(MAX_EXCESS));
}

/// Target areas of triangles: the surface's times exp (strength * excess), scaled to the sum 4 pi.
pub(crate) fn adapted(areas: &[f64], excess: &[f64], strength: f64) -> Vec<f64> {
    let mut adapted: Vec<f64> = areas.iter().zip(excess).map(|(area, g)| area * (strength * g).exp()).collect();
    let factor = 4.0 * std::f64::consts::PI / adapted.iter().sum::<f64>();
    adapted.iter_mut().for_each(|area| *area *= factor);
    adapted
}
