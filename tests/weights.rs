//! Vertices of weight 0: no method reads their values, and they don't affect the model.

use spharm::generate::icosphere;
use spharm::{Error, FitParams, FitWarning, Mesh, Objective, Signal, Smoothness, Sphere, Weights, fit};

use crate::common::{fail, succeed, tool};
use crate::pipeline::Study;

const AXES: [f64; 3] = [30.0, 20.0, 10.0];

/// Returns an ellipsoid of 2,562 vertices and its sphere.
fn ellipsoid() -> (Mesh, Sphere) {
    let ball = icosphere(4);
    let surface = ball.with_vertices(ball.vertices.iter().map(|v| [0, 1, 2].map(|k| AXES[k] * v[k])).collect());
    (surface, Sphere::from_mesh(&ball).unwrap())
}

/// Returns whether a vertex is in a cap of about 20 vertices.
fn is_bad(vertex: [f64; 3]) -> bool {
    vertex[2] > 0.985
}

fn spoilt(surface: &Mesh, sphere: &Sphere, by: f64) -> Mesh {
    let mut spoilt = surface.clone();
    for (position, direction) in spoilt.vertices.iter_mut().zip(sphere.directions.as_slice()) {
        if is_bad(*direction) {
            *position = position.map(|x| x + by);
        }
    }
    spoilt
}

fn weights(sphere: &Sphere, of_bad: f64) -> Weights {
    let values = sphere.directions.as_slice().iter().map(|&v| if is_bad(v) { of_bad } else { 1.0 }).collect();
    Weights::Values { name: "some".to_owned(), values }
}

fn largest(values: impl IntoIterator<Item = f64>) -> f64 {
    values.into_iter().fold(0.0, |most: f64, x| most.max(x.abs()))
}

#[test]
fn values_of_weight_zero_are_never_read() {
    let (surface, sphere) = ellipsoid();
    let bad = sphere.directions.as_slice().iter().filter(|v| is_bad(**v)).count();
    assert!((15..40).contains(&bad), "{bad}");
    let lsq = FitParams::lsq(4).with_weights(weights(&sphere, 0.0));
    let vertices = lsq.clone().with_objective(Objective::Vertices);
    for (name, params) in [
        ("surface", lsq.clone()),
        ("denoised", lsq.clone().with_denoise(true)),
        ("smooth", lsq.clone().with_smoothness(Smoothness::Fixed(0.01))),
        ("little memory", lsq.clone().with_memory(40 << 20)),
        ("vertices", vertices.clone()),
        ("vertices, denoised", vertices.clone().with_denoise(true)),
        ("held out", vertices.clone().with_hold_out(0.1)),
        ("errors", vertices.clone().with_standard_errors(true)),
    ] {
        let right = fit(&sphere, &surface, &params).unwrap();
        // The ellipsoid has degree 1; the model is a little smaller, because triangles lie inside the ellipsoid.
        let mut off = right.coefficients.values().to_owned();
        let unit = (4.0 * std::f64::consts::PI / 3.0_f64).sqrt();
        for (row, k) in [(3, 0), (1, 1), (2, 2)] {
            off[[row, k]] -= unit * AXES[k];
        }
        assert!(largest(off) < 0.4, "{name}");
        for by in [100.0, -1e9, f64::NAN, f64::INFINITY] {
            let found = fit(&sphere, &spoilt(&surface, &sphere, by), &params).unwrap();
            assert_eq!(found.coefficients, right.coefficients, "{name} {by}");
            let (a, b) = (&found.report, &right.report);
            assert_eq!((a.msd, a.xsd, a.scale), (b.msd, b.xsd, b.scale), "{name} {by}");
            assert_eq!(a.surface_distance, b.surface_distance, "{name} {by}");
            assert!(a.surface_distance.is_none_or(|distance| distance.hausdorff_raw < 1.0), "{name}: {a:?}");
            let sigma = |report: &spharm::FitReport| report.denoise.iter().map(|of| of.noise.sigma).collect::<Vec<_>>();
            assert_eq!(sigma(a), sigma(b), "{name} {by}");
            if let (Some(a), Some(b)) = (&a.held_out, &b.held_out) {
                assert_eq!((a.held_out, a.seen), (b.held_out, b.seen), "{name} {by}");
            }
        }
    }
    // With weight 1, bad values are refused, and the error names the vertex.
    let params = lsq.with_weights(Weights::Uniform);
    let error = fit(&sphere, &spoilt(&surface, &sphere, f64::NAN), &params).unwrap_err();
    assert!(error.to_string().contains("the surface") && error.to_string().contains("NaN at vertex"), "{error}");
    let gap = |v: &[f64; 3]| if is_bad(*v) { f64::NAN } else { v[0] };
    let signal = Signal::new(sphere.directions.as_slice().iter().map(gap).collect(), 2562, 1);
    assert!(fit(&sphere, &signal, &params).is_err());
    let found = fit(&sphere, &signal, &vertices).unwrap().coefficients;
    assert!((found.values()[[3, 0]] - (4.0 * std::f64::consts::PI / 3.0_f64).sqrt()).abs() < 1e-9);
}

/// As a weight approaches 0, the model approaches that of weight 0.
#[test]
fn weights_fade_to_zero_without_a_jump() {
    let (surface, sphere) = ellipsoid();
    let surface = spoilt(&surface, &sphere, 100.0);
    for objective in [Objective::Surface, Objective::Vertices] {
        let of = |weight: f64| {
            let params = FitParams::lsq(4).with_objective(objective).with_weights(weights(&sphere, weight));
            fit(&sphere, &surface, &params).unwrap().coefficients.values().to_owned()
        };
        let none = of(0.0);
        let off = |weight: f64| largest(&of(weight) - &none);
        assert!(
            off(1e-12) < 1e-8 && off(1e-6) < 1e-2 && off(1e-3) > 1e-3,
            "{:e} {:e} {:e}",
            off(1e-12),
            off(1e-6),
            off(1e-3)
        );
    }
}

#[test]
fn weights_that_leave_no_triangle_are_refused() {
    let (surface, sphere) = ellipsoid();
    // Only the twelve corners of the icosahedron have a weight. No triangle has three of them, so no triangle is left.
    let values = (0..2562).map(|vertex| f64::from(vertex < 12)).collect();
    let params = FitParams::lsq(2).with_weights(Weights::Values { name: "few".to_owned(), values });
    let error = fit(&sphere, &surface, &params).unwrap_err();
    assert!(matches!(error, Error::NoTriangle { .. }) && error.to_string().starts_with("few: "), "{error}");
    let params = params.with_objective(Objective::Vertices);
    assert!(fit(&sphere, &surface, &params).is_ok());
}

fn without_store(study: &Study, surface: &str, arguments: &[&str]) -> std::process::Command {
    let mut fit = tool("fit");
    fit.arg("--sphere").arg(study.path("sphere.surf.gii")).arg("--surface").arg(study.path(surface)).arg("-q");
    fit.args(arguments);
    fit
}

/// A warning is given for standard errors with area weights, but not with uniform weights.
#[test]
fn standard_errors_by_areas_are_warned_of() {
    let (surface, sphere) = ellipsoid();
    for (weights, warned) in [(Weights::Area, true), (Weights::Uniform, false)] {
        let params =
            FitParams::lsq(4).with_objective(Objective::Vertices).with_standard_errors(true).with_weights(weights);
        let warnings = fit(&sphere, &surface, &params).unwrap().report.warnings;
        assert_eq!(warnings.contains(&FitWarning::AreaErrors), warned, "{warnings:?}");
    }
}

/// Tests `--mask`, `--weights` with zeros, and both options with a method over a store.
#[test]
fn the_program_reads_no_masked_vertex_of_a_surface() {
    let study = Study::new();
    let column = |name: &str, values: &dyn Fn(usize) -> f64| {
        let text: String = (0..642).map(|vertex| format!("{}\n", values(vertex))).collect();
        std::fs::write(study.path(name), text).unwrap();
    };
    column("mask.csv", &|vertex| f64::from(vertex >= 30));
    let mut mesh = spharm::io::read_mesh(study.path("s0.surf.gii")).unwrap();
    mesh.vertices[..30].iter_mut().for_each(|position| *position = position.map(|x| x - 1e3));
    spharm::io::write_mesh(
        study.path("wild.surf.gii"),
        &mesh,
        &spharm::io::WriteOptions { overwrite: false, double: true },
    )
    .unwrap();
    let model = |surface: &str, arguments: &[&str]| {
        let out = study.path("m.spharm.npz");
        let arguments = [&["--max-degree", "6", "--force", "-o", out.to_str().unwrap()], arguments].concat();
        let over_store = arguments.contains(&"irf") || arguments.contains(&"nlsf");
        succeed(&mut if over_store {
            study.fit(&[surface], &arguments)
        } else {
            without_store(&study, surface, &arguments)
        });
        spharm::Model::read(&out).unwrap().coefficients.values().to_owned()
    };
    let mask = study.path("mask.csv").display().to_string();
    for arguments in [
        &["--mask", &mask][..],
        &["--weights", &mask],
        &["--weights", "area", "--mask", &mask],
        &["--method", "irf", "--mask", &mask],
        &["--method", "nlsf", "--weights", &mask],
    ] {
        let (right, wild) = (model("s0.surf.gii", arguments), model("wild.surf.gii", arguments));
        let scale = largest(right.iter().copied());
        assert!(largest(&right - &wild) < 1e-6 * scale, "{arguments:?}: {:e}", largest(&right - &wild));
    }
    column("none.csv", &|_| 0.0);
    let none = study.path("none.csv").display().to_string();
    let error = fail(&mut study.fit(&["s0.surf.gii"], &["--max-degree", "4", "--mask", &none, "-o", "m.npz"]));
    assert!(error.contains("all vertices are excluded by the mask"), "{error}");
}
