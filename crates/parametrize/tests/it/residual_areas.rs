//! Tests that area distortion is spent while it lowers the error of a fit, and never beyond the allowed amount.

use ndarray::Array2;
use spharm_harmonics::Directions;
use spharm_monitor::Silent;
use spharm_parametrize::{CaldParams, Parametrization, cald};
use spharm_solver::MatrixFreeOperator;
use spharm_solver::lsq::NormalEquations;
use spharm_solver::lsq::cg::{self, CgParams};
use spharm_surface::Mesh;
use spharm_surface::generate::{Cortex, cortex, icosphere};
use spharm_transform::TransformParams;

fn with(mesh: &Mesh, area: f64, degree: usize) -> Parametrization {
    cald(mesh, &CaldParams { area, degree: Some(degree), ..CaldParams::default() }, &Silent).unwrap()
}

/// Returns the mean squared distance between the vertices and a least-squares fit of a degree.
fn msd(map: &Parametrization, degree: usize) -> f64 {
    let directions = Directions::from_vertices(&map.sphere.vertices).unwrap();
    let transform = TransformParams { max_degree: degree, ..TransformParams::default() };
    let operator = MatrixFreeOperator::new(&directions, &transform).unwrap();
    let vertices = &map.surface.vertices;
    let targets = Array2::from_shape_fn((vertices.len(), 3), |(v, k)| vertices[v][k]);
    let equations = NormalEquations { operator: &operator, weights: None, penalty: None };
    let params = CgParams { tolerance: 1e-8, ..CgParams::default() };
    let fit = cg::solve(&equations, &targets, &equations.diagonal(), &params, &Silent).unwrap();
    fit.residual.iter().map(|r| r * r).sum::<f64>() / vertices.len() as f64
}

#[test]
fn a_fit_gains_by_room_for_detail() {
    let (mesh, _) = cortex(&Cortex { subdivisions: 4, variant: 1 });
    let degree = 36;
    let [equal, some, more] = [0.04, 0.1, 0.25].map(|area| {
        let found = with(&mesh, area, degree);
        assert!(found.report.quality.area_rms <= 1.01 * area, "{area}: {:?}", found.report);
        msd(&found, degree)
    });
    assert!(some < 0.8 * equal && more < 0.9 * some, "{equal:e} {some:e} {more:e}");
}

#[test]
fn what_a_model_represents_exactly_needs_no_room() {
    let sphere = icosphere(4);
    let long = sphere.with_vertices(sphere.vertices.iter().map(|&[x, y, z]| [x, y, 1.2 * z]).collect());
    let found = with(&long, 0.25, 20);
    // An ellipsoid's residual is negligible, so area distortion is only spent on lower shape distortion.
    let quality = &found.report.quality;
    assert!(quality.area_rms < 0.05, "{:?}", found.report);
}
