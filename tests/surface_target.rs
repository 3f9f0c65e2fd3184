//! Tests fits of surfaces, as opposed to fits of their vertices.

use ndarray::{Array1, Array2, Axis, concatenate, s};
use serde_json::Value;
use spharm::{
    Error, FitParams, Kind, Model, Objective, Preconditioner, Signal, Smoothness, Sphere, Target, fit, fit_many,
};
use spharm_monitor::Silent;
use spharm_surface::Mesh;
use spharm_surface::generate::{Cortex, SplitMix64, cortex, icosphere};
use spharm_surface::geometry::solid_angle;

use crate::common::{fail, succeed, tool};
use crate::full_least_squares::report_of;
use crate::pipeline::Study;

/// Returns the least squares over the entire sphere, from many times more samples than the fit takes and with an
/// explicit basis: each triangle is divided into 24^2 similar ones, with a sample at each centre weighted by its solid
/// angle. The normal equations are solved by Gaussian elimination.
fn by_midpoints(surface: &Mesh, sphere: &Sphere, max_degree: usize) -> Array2<f64> {
    const CUTS: u32 = 24;
    let unit = sphere.directions.as_slice();
    let at = |corners: [[f64; 3]; 3], weights: [f64; 3]| {
        [0, 1, 2].map(|k| (0..3).map(|i| weights[i] * corners[i][k]).sum::<f64>())
    };
    let barycentric = |i: u32, j: u32| {
        let (u, v) = (f64::from(i) / f64::from(CUTS), f64::from(j) / f64::from(CUTS));
        [1.0 - u - v, u, v]
    };
    let (mut places, mut targets, mut weights) = (Vec::new(), Vec::new(), Vec::new());
    for face in &sphere.faces {
        let (on_sphere, on_surface) = (face.map(|v| unit[v as usize]), face.map(|v| surface.vertices[v as usize]));
        for i in 0..CUTS {
            for j in 0..CUTS - i {
                let upright = [(i, j), (i + 1, j), (i, j + 1)];
                let turned = [(i + 1, j + 1), (i, j + 1), (i + 1, j)];
                for piece in [Some(upright), (i + j + 1 < CUTS).then_some(turned)].into_iter().flatten() {
                    let corners = piece.map(|(i, j)| barycentric(i, j));
                    let centre = [0, 1, 2].map(|k| corners.iter().map(|corner| corner[k]).sum::<f64>() / 3.0);
                    places.push(at(on_sphere, centre));
                    targets.push(at(on_surface, centre));
                    weights.push(solid_angle(corners.map(|corner| at(on_sphere, corner))));
                }
            }
        }
    }
    let directions = spharm::Directions::from_vertices(&places).unwrap();
    let columns = (max_degree + 1).pow(2);
    let basis = spharm::harmonics::synthesis(&directions, Array2::eye(columns).view()).unwrap();
    let weighted = &basis * &Array1::from_vec(weights).insert_axis(Axis(1));
    // Solve the normal equations by elimination on the augmented matrix, without pivoting, because the matrix is
    // nearly the identity.
    let functions = concatenate![Axis(1), basis, ndarray::arr2(&targets)];
    let mut rows = weighted.t().dot(&functions);
    for k in 0..columns {
        let pivot = rows.row(k).to_owned() / rows[[k, k]];
        for other in 0..columns {
            let factor = rows[[other, k]];
            if other != k {
                rows.row_mut(other).scaled_add(-factor, &pivot);
            }
        }
        rows.row_mut(k).assign(&pivot);
    }
    rows.slice(ndarray::s![.., columns..]).to_owned()
}

#[test]
fn a_fit_minimises_the_integral_over_the_sphere() {
    let (surface, sphere) = cortex(&Cortex { subdivisions: 2, variant: 1 });
    let sphere = Sphere::from_mesh(&sphere).unwrap();
    let found = fit(&sphere, &surface, &FitParams::lsq(6)).unwrap();
    let expected = by_midpoints(&surface, &sphere, 6);
    let largest = expected.iter().fold(0.0f64, |most, x| most.max(x.abs()));
    let off = (found.coefficients.values() - &expected).iter().fold(0.0f64, |most, x| most.max(x.abs()));
    // The remaining difference is the midpoint rule's error, of second order in a 24th of an edge.
    assert!(off < 2e-4 * largest, "{off:e} of {largest:e}");
    // The least squares at the vertices gives a different model.
    let vertices = fit(&sphere, &surface, &FitParams::lsq(6).with_objective(Objective::Vertices)).unwrap();
    assert!((vertices.coefficients.values() - &expected).iter().any(|x| x.abs() > 1e-2 * largest));
}

/// If the vertices don't determine a model of this degree, a fit of the surface still stays near the surface
/// everywhere.
#[test]
fn more_functions_than_vertices_are_no_difficulty() {
    let (surface, sphere) = cortex(&Cortex { subdivisions: 2, variant: 0 });
    let sphere = Sphere::from_mesh(&sphere).unwrap();
    let [at, twice] = [8, 30].map(|degree| {
        let report = fit(&sphere, &surface, &FitParams::lsq(degree)).unwrap().report;
        assert!(report.warnings.is_empty(), "{:?}", report.warnings);
        report.surface_distance.unwrap()
    });
    assert!(twice.rms < 0.5 * at.rms && twice.hausdorff < at.hausdorff, "{at:?} {twice:?}");
}

#[test]
fn signals_are_of_the_vertices_unless_asked_for() {
    let sphere = Sphere::icosphere(2);
    let values: Vec<f64> = sphere.directions.as_slice().iter().map(|p| (3.0 * p[0]).sin() + p[1] * p[2]).collect();
    let signal = Signal::new(values, 162, 1);
    let with = |objective| fit(&sphere, &signal, &FitParams::lsq(6).with_objective(objective)).unwrap();
    let (default, vertices, surface) = (with(Objective::Default), with(Objective::Vertices), with(Objective::Surface));
    assert_eq!(default.coefficients, vertices.coefficients);
    assert_eq!(surface.report.settings.objective, Objective::Surface);
    let off =
        (surface.coefficients.values() - vertices.coefficients.values()).iter().fold(0.0f64, |m, x| m.max(x.abs()));
    assert!(1e-4 < off && off < 0.2, "linear on triangles is another function: {off}");
}

/// A setting never turns a fit of the surface into one of the vertices.
#[test]
fn settings_leave_the_objective_as_it_is() {
    let (surface, sphere) = cortex(&Cortex { subdivisions: 3, variant: 0 });
    let sphere = Sphere::from_mesh(&sphere).unwrap();
    let objective = |params: FitParams| fit(&sphere, &surface, &params).unwrap().report.settings.objective;
    let lsq = FitParams::lsq(6);
    assert_eq!(objective(lsq.clone()), Objective::Surface);
    let signal = Signal::new(vec![0.5; 642], 642, 1);
    for params in [
        lsq.clone().with_hold_out(0.1),
        lsq.clone().with_standard_errors(true),
        lsq.clone().with_smoothness(Smoothness::Auto),
        lsq.clone().with_preconditioner(Preconditioner::Density),
        lsq.clone().with_preconditioner(Preconditioner::Factor),
    ] {
        assert_eq!(objective(params.clone()), Objective::Surface);
        assert_eq!(objective(params.clone().with_objective(Objective::Vertices)), Objective::Vertices);
        assert_eq!(fit(&sphere, &signal, &params).unwrap().report.settings.objective, Objective::Vertices);
    }
    let in_store = lsq.clone().with_objective(Objective::Surface).with_store(std::path::PathBuf::from("store"));
    assert!(matches!(fit(&sphere, &surface, &in_store), Err(Error::Setting { what: "store", .. })));
    let bare = Sphere::from_directions(sphere.directions.clone());
    let without = fit(&bare, &surface, &lsq).unwrap().report;
    assert_eq!((without.settings.objective, without.surface_distance), (Objective::Vertices, None));
}

/// Returns the surface of degree 5 fitted to a cortex, with independent noise of size `sigma` added to its vertices.
fn noisy(sphere: &Sphere, clean: &Mesh, sigma: f64, seed: u64) -> Mesh {
    let mut random = SplitMix64::new(seed);
    // The sum of twelve uniform numbers has the variance 1.
    let mut normal = || (0..12).map(|_| random.between(-0.5, 0.5)).sum::<f64>();
    let vertices = clean.vertices.iter().map(|p| p.map(|x| x + sigma * normal())).collect();
    assert_eq!(clean.vertices.len(), sphere.directions.len());
    Mesh::new(vertices, clean.faces.clone())
}

/// Standard errors equal the spread of coefficients over surfaces that differ only in their noise.
#[test]
fn standard_errors_of_surfaces_are_the_spread_of_repeated_fits() {
    // The noise is far larger than the surface's distance from its triangles, 0.1.
    const SIGMA: f64 = 1.0;
    const REPEATS: u64 = 60;
    let (surface, sphere) = cortex(&Cortex { subdivisions: 3, variant: 0 });
    let sphere = Sphere::from_mesh(&sphere).unwrap();
    let clean = fit(&sphere, &surface, &FitParams::lsq(5)).unwrap().into_model(sphere.clone());
    let clean = clean.reconstruct(&sphere, 5).unwrap();
    let params = FitParams::lsq(8).with_surface_distance(false);
    let (mut sum, mut squares) = (Array2::<f64>::zeros((81, 3)), Array2::<f64>::zeros((81, 3)));
    for seed in 0..REPEATS {
        let fit = fit(&sphere, &noisy(&sphere, &clean, SIGMA, seed), &params).unwrap();
        sum += fit.coefficients.values();
        squares += &fit.coefficients.values().map(|x| x * x);
    }
    let count = REPEATS as f64;
    let spread = (squares - sum.map(|x| x * x) / count) / (count - 1.0);
    let with = params.with_standard_errors(true);
    let errors = fit(&sphere, &noisy(&sphere, &clean, SIGMA, 99), &with).unwrap().standard_errors.unwrap();
    // Compare standard errors and spread by blocks of degrees. The mean of some hundred variances of 59 degrees of
    // freedom has an error of 2 %, and so has the mean of as many estimates from 256 fits; sigma has an error of 2 %.
    for rows in [0..9, 9..36, 36..81] {
        let mean = |all: &Array2<f64>| all.slice(s![rows.clone(), ..]).mean().unwrap();
        let ratio = (mean(&errors.map(|x| x * x)) / mean(&spread)).sqrt();
        assert!((0.9..1.1).contains(&ratio), "degrees of rows {rows:?}: {ratio}");
    }
}

/// Cross-validation finds a penalty that brings a noisy surface closer to the truth, within a few percent of the best.
#[test]
fn the_smoothness_of_a_surface_is_near_the_best() {
    let (surface, sphere) = cortex(&Cortex { subdivisions: 3, variant: 0 });
    let sphere = Sphere::from_mesh(&sphere).unwrap();
    let clean = fit(&sphere, &surface, &FitParams::lsq(5)).unwrap().into_model(sphere.clone());
    let clean = clean.reconstruct(&sphere, 5).unwrap();
    let noisy = noisy(&sphere, &clean, 0.3, 1);
    let error = |smoothness: Smoothness| {
        let fit = fit(&sphere, &noisy, &FitParams::lsq(14).with_smoothness(smoothness)).unwrap();
        let chosen = fit.report.smoothness;
        let model = fit.into_model(sphere.clone()).reconstruct(&sphere, 14).unwrap();
        let square = |(a, b): (&[f64; 3], &[f64; 3])| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>();
        let mean = model.vertices.iter().zip(&clean.vertices).map(square).sum::<f64>() / 642.0;
        (mean.sqrt(), chosen)
    };
    let (found, chosen) = error(Smoothness::Auto);
    let (plain, _) = error(Smoothness::Fixed(0.0));
    let best =
        (-8..6).map(|e| error(Smoothness::Fixed(10f64.powf(f64::from(e) / 2.0))).0).fold(f64::INFINITY, f64::min);
    assert!(chosen > 0.0 && found < 0.9 * plain && found < 1.1 * best, "{found} with {chosen:e}; {plain}, {best}");
}

/// Held-out vertices take no part in the fit, and on a smooth surface are nearly as close to it as the others.
#[test]
fn vertices_of_surfaces_are_held_out() {
    let (surface, sphere) = cortex(&Cortex { subdivisions: 4, variant: 0 });
    let sphere = Sphere::from_mesh(&sphere).unwrap();
    let report = fit(&sphere, &surface, &FitParams::lsq(12).with_hold_out(0.1)).unwrap().report;
    let held_out = report.held_out.expect("vertices were held out");
    assert!((200..320).contains(&held_out.vertices), "{}", held_out.vertices);
    let ratio = (held_out.held_out.msd_raw / held_out.seen.msd_raw).sqrt();
    assert!((0.8..1.5).contains(&ratio), "{ratio}");
}

/// Surfaces and signals in one call are fitted as if each were fitted in a separate call.
#[test]
fn surfaces_and_signals_go_together() {
    let (surface, sphere) = cortex(&Cortex { subdivisions: 2, variant: 0 });
    let sphere = Sphere::from_mesh(&sphere).unwrap();
    let mesh = Target::from_mesh(&surface, &sphere).unwrap();
    let signal = Signal::new(surface.vertices.iter().map(|p| p[2]).collect(), 162, 1);
    let signal = Target::from_signal(signal, &sphere).unwrap();
    let order = [&mesh, &signal, &signal, &mesh, &mesh];
    let params = FitParams::lsq(7);
    let read = |number: usize| Ok::<_, spharm::Error>(order[number].clone());
    let done = |number: usize, fit: spharm::Fit| Ok((number, fit.coefficients));
    let (found, report) = fit_many(&sphere, order.len(), &read, &params, &done, &Silent).unwrap();
    assert_eq!(report.batches.len(), 3);
    for (place, (number, coefficients)) in found.into_iter().enumerate() {
        assert_eq!(place, number);
        let alone = fit(&sphere, order[number], &params).unwrap().coefficients;
        let off = (coefficients.values() - alone.values()).iter().fold(0.0f64, |most, x| most.max(x.abs()));
        assert!(off < 1e-10, "{number}: {off:e}");
    }
}

/// Weights of the vertices are interpolated linearly on each triangle for a fit of the surface, and don't change the
/// meaning of a penalty.
#[test]
fn weights_say_what_counts() {
    let (surface, sphere) = cortex(&Cortex { subdivisions: 3, variant: 0 });
    let sphere = Sphere::from_mesh(&sphere).unwrap();
    let upper: Vec<f64> = sphere.directions.as_slice().iter().map(|p| if p[2] > 0.0 { 1.0 } else { 0.01 }).collect();
    let weights = spharm::Weights::Values { name: "upper".to_owned(), values: upper };
    let params = FitParams::lsq(5);
    let [even, uneven] = [params.clone(), params.with_weights(weights)].map(|params| {
        let model = Model::new(sphere.clone(), fit(&sphere, &surface, &params).unwrap(), Kind::Surface);
        let back = model.reconstruct(&sphere, 5).unwrap();
        let pairs = surface.vertices.iter().zip(&back.vertices).zip(sphere.directions.as_slice());
        let squares =
            pairs.filter(|(_, p)| p[2] > 0.1).map(|((a, b), _)| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>());
        squares.sum::<f64>()
    });
    assert!(uneven < 0.8 * even, "{uneven} {even}");
}

#[test]
fn a_model_says_what_was_fitted_and_another_target_is_another_model() {
    let study = Study::new();
    let fit = |arguments: &[&str]| {
        let mut command = tool("fit");
        command.arg("--sphere").arg(study.path("sphere.surf.gii")).arg("--surface").arg(study.path("s0.surf.gii"));
        command.args(["-q", "--max-degree", "8", "-o"]).arg(study.path("m.npz")).args(arguments);
        command
    };
    let report: Value = report_of(fit(&[]).arg("--json"));
    let distance = &report["surfaces"][0]["surface_distance"];
    let of = |name: &str| distance[name].as_f64().unwrap();
    let scale = report["surfaces"][0]["scale"].as_f64().unwrap();
    assert!(
        (of("rms_raw") / of("rms") / scale - 1.0).abs() < 1e-12 && of("hausdorff") > of("percentile95"),
        "{distance}"
    );
    let model = Model::read(study.path("m.npz")).unwrap();
    assert_eq!(model.provenance.settings.unwrap().objective.as_deref(), Some("surface"));
    succeed(&mut fit(&["--skip-existing"]));
    succeed(&mut fit(&["--skip-existing", "--objective", "surface"]));
    let refused = fail(&mut fit(&["--skip-existing", "--objective", "vertices"]));
    assert!(refused.contains("objective surface, not vertices"), "{refused}");
    let quick: Value = report_of(&mut fit(&["--force", "--no-surface-distance", "--json"]));
    assert!(quick["surfaces"][0]["surface_distance"].is_null());
}

/// A fit of an icosphere over itself reproduces the sphere, so distances are those of flat triangles from the sphere.
#[test]
fn a_sphere_is_its_own_model() {
    let mesh = icosphere(5);
    let sphere = Sphere::from_mesh(&mesh).unwrap();
    let distance = fit(&sphere, &mesh, &FitParams::lsq(20)).unwrap().report.surface_distance.unwrap();
    // The distance is the sagitta of the triangles: half the square of their circumradius, which is an edge of 0.039
    // divided by sqrt 3.
    assert!(distance.hausdorff_raw < 2.6e-4, "{distance:?}");
}

/// The distances between a surface and its model don't depend on the position of the surface.
#[test]
fn distances_far_from_the_origin_are_those_at_the_origin() {
    let ball = icosphere(3);
    let sphere = Sphere::from_mesh(&ball).unwrap();
    let found = |by: f64| {
        let place = |[x, y, z]: [f64; 3]| {
            let radius = 1.0 + 0.1 * x * y + 0.2 * z * z;
            [x, y, z].map(|coordinate| coordinate * radius + by)
        };
        let surface = ball.with_vertices(ball.vertices.iter().copied().map(place).collect());
        fit(&sphere, &surface, &FitParams::lsq(6)).unwrap().report.surface_distance.unwrap()
    };
    let near = found(0.0);
    for by in [1e6, 1e7] {
        let far = found(by);
        assert!((far.rms_raw / near.rms_raw - 1.0).abs() < 0.01, "{by}: {near:?} {far:?}");
        assert!((far.hausdorff_raw / near.hausdorff_raw - 1.0).abs() < 0.01, "{by}: {near:?} {far:?}");
    }
}
