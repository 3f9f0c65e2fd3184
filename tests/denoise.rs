//! Tests the removal of noise in fits, through the library and the program.

use ndarray::Array2;
use spharm::{Error, FitParams, FitWarning, Kind, Model, Objective, Signal, Smoothness, SolverError, Sphere, fit};
use spharm_harmonics::{Directions, synthesis};
use spharm_surface::Mesh;
use spharm_surface::generate::{Cortex, SplitMix64, cortex};
use spharm_surface::io::{WriteOptions, write_mesh};

use crate::common::{fail, finish, tool};
use crate::full_least_squares::report_of;

const DEGREE: usize = 24;

/// Returns a normally distributed value by the Box-Muller method.
fn normal(random: &mut SplitMix64) -> f64 {
    let radius = (-2.0 * random.between(1e-300, 1.0).ln()).sqrt();
    radius * (std::f64::consts::TAU * random.between(0.0, 1.0)).cos()
}

/// Returns a folded surface that a model of the degree describes exactly, the same surface with noise, and their
/// sphere.
fn surfaces(sigma: f64) -> (Mesh, Mesh, Sphere) {
    let (surface, sphere) = cortex(&Cortex { subdivisions: 4, variant: 0 });
    let sphere = Sphere::from_mesh(&sphere).unwrap();
    let plain = fit(&sphere, &surface, &FitParams::lsq(14).with_objective(Objective::Vertices)).unwrap();
    let clean = Model::new(sphere.clone(), plain, Kind::Surface).reconstruct(&sphere, 14).unwrap();
    let mut random = SplitMix64::new(3);
    let mut noisy = clean.clone();
    noisy.vertices.iter_mut().flatten().for_each(|value| *value += sigma * normal(&mut random));
    (clean, noisy, sphere)
}

/// Returns the mean squared distance at the vertices.
fn error(clean: &Mesh, sphere: &Sphere, found: spharm::Fit) -> f64 {
    let model = Model::new(sphere.clone(), found, Kind::Surface).reconstruct(sphere, DEGREE).unwrap();
    let differences = clean.vertices.iter().zip(&model.vertices).flat_map(|(a, b)| [0, 1, 2].map(|k| a[k] - b[k]));
    differences.map(|d| d * d).sum::<f64>() / clean.vertices.len() as f64
}

#[test]
fn noise_is_removed_from_vertices_and_from_surfaces() {
    let size = {
        let (clean, ..) = surfaces(0.0);
        spharm::metrics::bounding_box_scale(&clean.vertices).unwrap()
    };
    let sigma = 0.02 * size;
    let (clean, noisy, sphere) = surfaces(sigma);
    for objective in [Objective::Vertices, Objective::Surface] {
        let params = FitParams::lsq(DEGREE).with_objective(objective).with_surface_distance(false).with_threads(1);
        let denoise = params.clone().with_denoise(true);
        let plain = error(&clean, &sphere, fit(&sphere, &noisy, &params).unwrap());
        let found = fit(&sphere, &noisy, &denoise).unwrap();
        let removed = &found.report.denoise[..];
        assert_eq!(removed.len(), 1, "the coordinates share their noise");
        let noise = &removed[0].noise;
        assert!((noise.sigma / sigma - 1.0).abs() < 0.03, "{objective:?}: {} of {sigma}", noise.sigma);
        assert!(noise.gain.len() == DEGREE + 1 && noise.gain[0] == 1.0 && noise.gain[DEGREE] < 0.2);
        assert!(noise.gain.windows(2).all(|pair| pair[0] >= pair[1] && pair[1] >= 0.0));
        assert!(noise.degrees_of_freedom < 0.6 * 625.0, "{}", noise.degrees_of_freedom);
        assert!(found.report.warnings.is_empty(), "{:?}", found.report.warnings);
        let again = fit(&sphere, &noisy, &denoise.with_threads(3)).unwrap();
        assert_eq!(again.coefficients, found.coefficients, "{objective:?}: the same bits for any number of threads");
        let denoised = error(&clean, &sphere, found);
        assert!(denoised < 0.6 * plain, "{objective:?}: {denoised:e} {plain:e}");
    }
}

/// Standard errors contain the uncertainty of the gains, which are estimated: a gain of 0 doesn't mean that the
/// coefficients are known to be 0.
#[test]
fn intervals_of_a_denoised_fit_contain_the_coefficients() {
    for (objective, subdivisions, draws) in [(Objective::Vertices, 4, 16), (Objective::Surface, 3, 4)] {
        let sphere = Sphere::icosphere(subdivisions);
        let mut random = SplitMix64::new(11);
        let known =
            Array2::from_shape_fn((121, draws), |(k, _)| normal(&mut random) / (1.0 + k.isqrt() as f64).powi(3));
        let clean = synthesis(&sphere.directions, known.view()).unwrap();
        let values: Vec<f64> = clean.iter().map(|value| value + 0.3 * normal(&mut random)).collect();
        let signal = Signal::new(values, clean.nrows(), draws);
        let params = FitParams::lsq(10).with_objective(objective).with_surface_distance(false);
        let found = fit(&sphere, &signal, &params.with_denoise(true).with_standard_errors(true)).unwrap();
        assert!(found.report.denoise.iter().any(|removed| removed.noise.gain[10] == 0.0));
        let errors = found.standard_errors.unwrap();
        let ratios: Vec<f64> =
            (found.coefficients.values() - &known).iter().zip(&errors).map(|(d, e)| d.abs() / e).collect();
        let inside = ratios.iter().filter(|ratio| **ratio < 1.96).count() as f64 / ratios.len() as f64;
        let largest = ratios.iter().copied().fold(0.0, f64::max);
        assert!(inside > 0.92 && largest < 6.0, "{objective:?}: {inside} of the intervals, {largest}");
    }
}

/// The solver's rounding errors, which are relative to the values, are neither noise nor detail.
#[test]
fn rounding_is_not_taken_for_detail() {
    for seed in 0..8 {
        let mut random = SplitMix64::new(seed);
        let mut places = Sphere::icosphere(3).directions.as_slice().to_vec();
        for place in &mut places {
            *place = place.map(|value| value + 0.012 * normal(&mut random));
            let length = place.iter().map(|value| value * value).sum::<f64>().sqrt();
            *place = place.map(|value| value / length);
        }
        let sphere = Sphere::from_directions(Directions::from_unit_vectors(places).unwrap());
        for (constant, slope) in [(2.5, 0.0), (1e9, 1e-6), (0.0, 1.0)] {
            let values: Vec<f64> = sphere.directions.as_slice().iter().map(|u| constant + slope * u[0]).collect();
            let signal = Signal::new(values, sphere.directions.len(), 1);
            let found = fit(&sphere, &signal, &FitParams::lsq(10).with_denoise(true)).unwrap();
            let warned = found.report.warnings.iter().any(|warning| matches!(warning, FitWarning::Detail { .. }));
            assert!(!warned, "{constant} {slope}, seed {seed}: {:?}", found.report.denoise);
        }
    }
}

/// Each channel of a signal has its own noise level, in its own unit.
#[test]
fn channels_of_a_signal_are_denoised_apart() {
    let sphere = Sphere::icosphere(4);
    let mut random = SplitMix64::new(5);
    let rows: Vec<[f64; 2]> = sphere.directions.as_slice().iter().map(|u| [u[2].powi(3), 1e6 * u[0] * u[1]]).collect();
    let sigmas = [0.1, 2e5];
    let values: Vec<f64> =
        rows.iter().flat_map(|row| [0, 1].map(|k| row[k] + sigmas[k] * normal(&mut random))).collect();
    let signal = Signal::new(values, rows.len(), 2);
    let params = FitParams::lsq(12).with_denoise(true).with_standard_errors(true);
    let found = fit(&sphere, &signal, &params).unwrap();
    assert_eq!(found.report.denoise.len(), 2);
    for (removed, sigma) in found.report.denoise.iter().zip(sigmas) {
        assert!((removed.noise.sigma / sigma - 1.0).abs() < 0.04, "{} {sigma}", removed.noise.sigma);
    }
    // Damped coefficients have a smaller standard error, in spite of the uncertainty of their gain. The signal x y has
    // degree 2 and isn't damped.
    let errors = found.standard_errors.unwrap();
    assert!(errors[[160, 1]] < 0.6 * errors[[4, 1]], "{} {}", errors[[160, 1]], errors[[4, 1]]);
    let squares =
        |values: &Array2<f64>, from: usize| values.rows().into_iter().skip(from).map(|r| r[1] * r[1]).sum::<f64>();
    let plain = fit(&sphere, &signal, &FitParams::lsq(12)).unwrap();
    let (before, after) = (squares(plain.coefficients.values(), 9), squares(found.coefficients.values(), 9));
    assert!(after < 0.2 * before, "{after:e} {before:e}");
}

#[test]
fn detail_beyond_the_degree_is_warned_of() {
    let (surface, sphere) = cortex(&Cortex { subdivisions: 4, variant: 0 });
    let sphere = Sphere::from_mesh(&sphere).unwrap();
    let params = FitParams::lsq(8).with_denoise(true).with_surface_distance(false);
    for objective in [Objective::Vertices, Objective::Surface] {
        let found = fit(&sphere, &surface, &params.clone().with_objective(objective)).unwrap();
        let warned = found.report.warnings.iter().any(|warning| matches!(warning, FitWarning::Detail { .. }));
        assert!(warned, "{objective:?}: {:?}", found.report.denoise);
    }
}

#[test]
fn what_does_not_go_with_it_is_refused() {
    let (_, noisy, sphere) = surfaces(0.1);
    let denoise = FitParams::lsq(DEGREE).with_denoise(true);
    for smoothness in [Smoothness::Auto, Smoothness::Fixed(1e-3)] {
        let refused = fit(&sphere, &noisy, &denoise.clone().with_smoothness(smoothness)).unwrap_err();
        assert!(matches!(refused, Error::Setting { what: "denoise", .. }), "{refused}");
    }
    for method in [spharm::Method::Quadrature, spharm::Method::irf()] {
        let params = denoise.clone().with_method(method).with_store(std::path::PathBuf::from("nowhere"));
        let refused = fit(&sphere, &noisy, &params).unwrap_err();
        assert!(matches!(refused, Error::Setting { what: "denoise", .. }), "{refused}");
    }
    // A fit of 2,562 vertices with 2,601 coefficients leaves no residual from which to estimate noise.
    for objective in [Objective::Vertices, Objective::Surface] {
        let refused = fit(&sphere, &noisy, &denoise.clone().with_objective(objective).with_max_degree(50)).unwrap_err();
        let few = matches!(refused, Error::Solver(SolverError::NoResidual { rows: 2562, columns: 2601 }));
        assert!(few, "{refused}");
    }
}

#[test]
fn the_program_reports_what_it_removed() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let (_, noisy, sphere) = surfaces(0.1);
    let double = WriteOptions { double: true, ..WriteOptions::default() };
    write_mesh(path("noisy.ply"), &noisy, &double).unwrap();
    let ball = Mesh::new(sphere.directions.as_slice().to_vec(), sphere.faces.clone());
    write_mesh(path("sphere.ply"), &ball, &double).unwrap();
    let command = |arguments: &[&str]| {
        let mut command = tool("fit");
        command.arg("--surface").arg(path("noisy.ply")).arg("--sphere").arg(path("sphere.ply"));
        command.args(["-q", "--denoise", "-o"]).arg(path("model.npz")).args(arguments);
        command
    };
    let report = report_of(&mut command(&["--max-degree", "12", "--json"]));
    let removed = &report["surfaces"][0]["denoise"][0];
    assert!(removed["sigma"].as_f64().unwrap() > 0.0 && removed["degrees_of_freedom"].as_f64().unwrap() < 169.0);
    assert_eq!(removed["gain"].as_array().unwrap().len(), 13);
    // With --skip-existing, a plain fit refuses the model of a denoised fit.
    finish(&mut command(&["--max-degree", "12", "--skip-existing"]));
    let mut plain = tool("fit");
    plain.arg("--surface").arg(path("noisy.ply")).arg("--sphere").arg(path("sphere.ply"));
    plain.args(["-q", "--max-degree", "12", "--skip-existing", "-o"]).arg(path("model.npz"));
    let refused = fail(&mut plain);
    assert!(refused.contains("smoothness denoise, not default"), "{refused}");
    let few = fail(&mut command(&["--max-degree", "50", "--force"]));
    assert!(few.contains("2562 vertices and 2601 coefficients"), "{few}");
}
