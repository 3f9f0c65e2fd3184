//! Tests the full least squares through `fit`: without a store, with a factor, with smoothness.

use std::path::Path;
use std::process::Command;

use ndarray::Array2;
use ndarray_npy::ReadNpyExt;
use serde_json::Value;
use spharm_harmonics::{Coefficients, Directions, basis_size};
use spharm_model::Model;
use spharm_surface::generate::{SplitMix64, icosphere};
use spharm_surface::io::{WriteOptions, read_mesh, write_mesh};
use spharm_surface::{Kind, Sphere};

use crate::common::{fail, finish, shared, succeed, text, tool};
use crate::pipeline::{Study, names};

pub(crate) const DEGREE: [&str; 2] = ["--max-degree", "12"];

/// Returns a `fit` of the vertices of a file of the study, without a store, to `m.npz`.
pub(crate) fn lsq(study: &Study, arguments: &[&str]) -> Command {
    let mut command = fit_alone(study, arguments);
    command.args(["--objective", "vertices"]);
    command
}

/// Returns a `fit` of a file of the study, without a store, to `m.npz`.
pub(crate) fn fit_alone(study: &Study, arguments: &[&str]) -> Command {
    let mut command = tool("fit");
    command.arg("--sphere").arg(study.path("sphere.surf.gii")).arg("--surface").arg(study.path("s0.surf.gii"));
    command.args(["-q", "-o"]).arg(study.path("m.npz")).args(arguments);
    command
}

/// Returns the report of a fit that replaces `m.npz`.
fn report(study: &Study, arguments: &[&str]) -> Value {
    report_of(lsq(study, arguments).args(["--json", "--force"]))
}

pub(crate) fn report_of(command: &mut Command) -> Value {
    serde_json::from_str(&succeed(command)).expect("the report is JSON")
}

fn model(study: &Study, name: &str) -> Array2<f64> {
    Model::read(study.path(name)).unwrap().coefficients.values().to_owned()
}

/// Returns the norm of the difference relative to the norm of `b`.
fn difference(a: &Array2<f64>, b: &Array2<f64>) -> f64 {
    let norm = |x: &Array2<f64>| x.iter().map(|x| x * x).sum::<f64>().sqrt();
    norm(&(a - b)) / norm(b)
}

fn msd(report: &Value) -> f64 {
    report["surfaces"][0]["passes"].as_array().unwrap().last().unwrap()["msd"].as_f64().unwrap()
}

fn meets(found: f64, expected: f64, relative: f64, what: &str) {
    assert!((found / expected - 1.0).abs() <= relative, "{what}: {found:e}, not {expected:e}");
}

/// Runs a command that must succeed and returns its stderr.
fn said(command: &mut Command) -> String {
    let output = finish(command);
    assert!(output.status.success(), "{}", text(&output));
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn without_a_store_fit_gives_the_full_least_squares() {
    let study = Study::new();
    for weights in ["uniform", "area"] {
        let arguments = [&DEGREE[..], &["--weights", weights]].concat();
        let nlsf = [&arguments[..], &["--method", "nlsf", "--force"]].concat();
        let full = study.report(&["s0.surf.gii"], "nlsf.npz", &nlsf);
        for way in ["auto", "none", "density", "factor"] {
            let ours = report(&study, &[&arguments[..], &["--preconditioner", way]].concat());
            assert_eq!((&ours["method"], &ours["store"]), (&"lsq".into(), &Value::Null));
            meets(msd(&ours), msd(&full), 1e-9, way);
            let off = difference(&model(&study, "m.npz"), &model(&study, "nlsf.npz"));
            assert!(off <= 1e-9, "{way}, {weights}: {off:e}");
            let batch = &ours["batches"][0];
            assert_eq!((&batch["stop"], batch["shift"].as_f64()), (&"converged".into(), Some(0.0)), "{batch}");
            // An icosphere is so even that dividing by its density gains nothing, so no preconditioner is chosen.
            assert_eq!(batch["preconditioner"], if way == "factor" { way } else { "none" }, "{batch}");
            assert!(batch["steps"].as_array().is_some_and(|steps| !steps.is_empty()), "{batch}");
            if way == "density" {
                assert_eq!(batch["products"], "moments", "{batch}");
            }
        }
    }
}

fn meets_reference(name: &str) {
    let Some(reference) = shared("reference.json") else { return };
    let (Some(sphere), Some(surface)) =
        (shared(&format!("{name}.sphere.surf.gii")), shared(&format!("{name}.surf.gii")))
    else {
        return;
    };
    let reference: Value = serde_json::from_slice(&std::fs::read(reference).unwrap()).unwrap();
    let expected = &reference[name]["results"]["least-squares L=100"];
    let folder = tempfile::tempdir().unwrap();
    let mut fit = tool("fit");
    fit.arg("--sphere").arg(sphere).arg("--surface").arg(surface).arg("-o").arg(folder.path());
    let report = report_of(fit.args(["-q", "--json", "--objective", "vertices", "--max-degree", "100", "--strict"]));
    for (measure, tolerance) in [("msd", 1e-6), ("xsd", 1e-4)] {
        let found = report["surfaces"][0]["passes"][0][measure].as_f64().unwrap();
        meets(found, expected[measure].as_f64().unwrap(), tolerance, &format!("{name}, {measure}"));
    }
}

#[test]
fn the_cortex_meets_the_least_squares_of_the_reference() {
    meets_reference("cort40962");
}

#[test]
fn the_head_meets_the_least_squares_of_the_reference() {
    meets_reference("head27618");
}

#[test]
fn the_factor_in_the_store_is_used_where_it_belongs_and_passed_over_where_it_does_not() {
    let study = Study::new();
    let nlsf = study.report(&["s0.surf.gii"], "nlsf.npz", &["--max-degree", "12", "--method", "nlsf"]);
    for dtype in ["f32", "f64"] {
        succeed(study.build(12).args(["--factor", "12", "--factor-dtype", dtype]));
        let arguments = ["--method", "lsq", "--preconditioner", "factor", "--max-degree", "12", "--force"];
        let ours = study.report(&["s0.surf.gii"], "m.npz", &arguments);
        assert_eq!(ours["batches"][0]["preconditioner"], "stored-factor");
        meets(msd(&ours), msd(&nlsf), 1e-9, dtype);
        let off = difference(&model(&study, "m.npz"), &model(&study, "nlsf.npz"));
        assert!(off <= 1e-9, "{dtype}: {off:e}");
    }
    // With many surfaces the stored factor is used without a flag, and each model equals the model of a separate fit.
    let surfaces: Vec<String> = (0..5).map(|i| format!("copy{i}.surf.gii")).collect();
    for (i, name) in surfaces.iter().enumerate() {
        std::fs::copy(study.path(&format!("s{}.surf.gii", i % 4)), study.path(name)).unwrap();
    }
    let list: Vec<&str> = surfaces.iter().map(String::as_str).collect();
    let many = study.report(&list, "models", &["--max-degree", "12", "--method", "lsq"]);
    assert_eq!(many["batches"][0]["preconditioner"], "stored-factor", "{many}");
    assert_eq!(many["surfaces"].as_array().unwrap().len(), 5);
    for name in ["copy0", "copy4"] {
        let off = difference(&model(&study, &format!("models/{name}.spharm.npz")), &model(&study, "nlsf.npz"));
        assert!(off <= 1e-9, "{name}: {off:e}");
    }
    // A stored factor of other equations isn't used: a warning says so, and the result is the same.
    let base = ["--method", "lsq", "--preconditioner", "factor", "--force"];
    let other = |arguments: &[&str]| {
        let mut command = study.fit(&["s0.surf.gii"], &[&base[..], arguments].concat());
        let warnings = said(command.arg("-o").arg(study.path("m.npz")));
        let report = study.report(&["s0.surf.gii"], "m.npz", &[&base[..], arguments].concat());
        (warnings, report["batches"][0]["preconditioner"].as_str().unwrap().to_owned())
    };
    for arguments in [
        &["--max-degree", "12", "--smoothness", "1e-3"][..],
        &["--max-degree", "12", "--weights", "area"],
        &["--max-degree", "11"],
        &["--max-degree", "12", "--hold-out", "0.1"],
    ] {
        let (warnings, preconditioner) = other(arguments);
        assert!(
            warnings.contains("warning: ") && warnings.contains("solving without this factor"),
            "{arguments:?} {warnings}"
        );
        assert_eq!(preconditioner, "factor", "{arguments:?}");
        let without = [&["--preconditioner", "none"], arguments].concat();
        let with = model(&study, "m.npz");
        report(&study, &without);
        assert!(difference(&with, &model(&study, "m.npz")) < 1e-8, "{arguments:?}");
    }
    // A factor stored for these equations is used.
    succeed(study.build(12).args(["--factor", "12", "--smoothness", "1e-3"]));
    let (warnings, preconditioner) = other(&["--max-degree", "12", "--smoothness", "1e-3"]);
    assert_eq!((warnings.as_str(), preconditioner.as_str()), ("", "stored-factor"));
}

#[test]
fn smoothness_holds_the_high_degrees_down_and_auto_chooses_it() {
    let study = Study::new();
    let roughness = |lambda: &str| {
        let report = report(&study, &["--max-degree", "12", "--smoothness", lambda]);
        let x = model(&study, "m.npz");
        let square = |k: usize| {
            let l = k.isqrt() as f64;
            (l * (l + 1.0)).powi(2) * x.row(k).dot(&x.row(k))
        };
        ((0..169).map(square).sum::<f64>(), report)
    };
    let (without, _) = roughness("0");
    let (with, report) = roughness("1e-3");
    assert!(with < without, "{with} {without}");
    assert_eq!(report["batches"][0]["smoothness"], 1e-3);
    let (most, _) = roughness("10");
    assert!(most < 0.1 * with, "{most} {with}");
    let (chosen, report) = roughness("auto");
    let batch = &report["batches"][0];
    let lambda = batch["smoothness"].as_f64().unwrap();
    assert!(lambda > 0.0 && batch["gcv"]["smoothness"] == batch["smoothness"], "{batch}");
    assert!(chosen <= without);
    // The chosen smoothness has the smallest score of those tried.
    let tried = batch["gcv"]["tried"].as_array().unwrap();
    let least = tried.iter().min_by(|a, b| a[1].as_f64().unwrap().total_cmp(&b[1].as_f64().unwrap())).unwrap();
    assert_eq!(least[0].as_f64(), Some(lambda));
    // A fit with this smoothness given explicitly has the same coefficients.
    let automatic = model(&study, "m.npz");
    roughness(&format!("{lambda:e}"));
    assert!(difference(&model(&study, "m.npz"), &automatic) < 1e-9);
}

#[test]
fn standard_errors_come_beside_the_model() {
    let study = Study::new();
    succeed(&mut lsq(&study, &["--max-degree", "12", "--stderr"]));
    let path = study.path("m.stderr.npy");
    let read = || Array2::<f64>::read_npy(std::fs::File::open(&path).unwrap()).unwrap();
    let errors = read();
    assert_eq!(errors.dim(), (169, 3));
    assert!(errors.iter().all(|e| *e > 0.0 && e.is_finite()));
    // A penalty reduces the standard errors.
    succeed(&mut lsq(&study, &["--max-degree", "12", "--stderr", "--force", "--smoothness", "0.01"]));
    let penalised = read();
    assert!(penalised.row(160).sum() < errors.row(160).sum());
    // Without a penalty, standard errors with more coefficients than vertices are refused.
    std::fs::remove_file(&path).unwrap();
    std::fs::remove_file(study.path("m.npz")).unwrap();
    let before = names(&study.path(""));
    let error = fail(&mut lsq(&study, &["--max-degree", "25", "--stderr"]));
    assert!(error.contains("642 vertices don't determine 676 coefficients"), "{error}");
    assert_eq!(names(&study.path("")), before);
    succeed(&mut lsq(&study, &["--max-degree", "25", "--stderr", "--smoothness", "0.01"]));
    assert!(read().iter().all(|e| *e > 0.0 && e.is_finite()));
}

#[test]
fn held_out_vertices_are_further_from_the_model_than_those_it_saw() {
    let study = Study::new();
    for arguments in [&["--method", "lsq"][..], &["--method", "irf", "--passes", "5"]] {
        let arguments = [&DEGREE[..], arguments, &["--hold-out", "0.1", "--force"]].concat();
        let report = study.report(&["s0.surf.gii"], "m.npz", &arguments);
        let held_out = &report["surfaces"][0]["held_out"];
        let vertices = held_out["vertices"].as_u64().unwrap();
        assert!((35..=95).contains(&vertices), "a tenth of 642: {held_out}");
        let of = |which: &str| held_out[which]["msd"].as_f64().unwrap();
        assert!(of("held_out") > of("seen") && of("seen") > 0.0, "{held_out}");
        // The msd over held-out and fitted vertices together is the msd over all vertices.
        let all = (of("held_out") * vertices as f64 + of("seen") * (642 - vertices) as f64) / 642.0;
        meets(all, msd(&report), 1e-9, "all");
    }
    let error = fail(&mut lsq(&study, &["--max-degree", "12", "--hold-out", "1e-9", "--force"]));
    assert!(error.contains("--hold-out 0.000000001") && error.contains("none of the 642 vertices"), "{error}");
}

#[test]
fn a_fit_that_does_not_reach_its_tolerance_warns_and_with_strict_fails() {
    let study = Study::new();
    let loose = report(&study, &["--max-degree", "12", "--tolerance", "1e-3", "--strict"]);
    let tight = report(&study, &["--max-degree", "12", "--strict"]);
    let of = |report: &Value, name: &str| report["batches"][0][name].as_f64().unwrap();
    assert!(of(&loose, "optimality") <= 1.5e-3 && of(&tight, "optimality") <= 1.5e-10);
    assert!(of(&loose, "iterations") < of(&tight, "iterations") && of(&loose, "optimality") > 1e-9);
    std::fs::remove_file(study.path("m.npz")).unwrap();
    let before = names(&study.path(""));
    let arguments = ["--max-degree", "12", "--max-iterations", "2", "--stderr", "--coefficients-csv"];
    let error = fail(lsq(&study, &arguments).arg("--strict"));
    assert!(error.contains("the solver did not converge: optimality") && error.contains("--strict"), "{error}");
    assert_eq!(names(&study.path("")), before, "nothing is written");
    let warnings = said(&mut lsq(&study, &arguments));
    assert!(warnings.contains("warning: the solver did not converge: optimality"), "{warnings}");
    assert!(warnings.contains("after 2 steps, expected 1.0e-10"), "{warnings}");
    assert_eq!(model(&study, "m.npz").dim(), (169, 3));
    let report = report(&study, &["--max-degree", "12", "--max-iterations", "2"]);
    assert_eq!(report["batches"][0]["stop"], "iteration-limit");
    assert!(msd(&report) > msd(&tight));
}

#[test]
fn more_coefficients_than_vertices_are_said_to_be_undetermined() {
    let study = Study::new();
    let command = &mut lsq(&study, &["--max-degree", "27"]);
    let warnings = said(command);
    assert!(warnings.contains("642 vertices don't determine 784 coefficients"), "{warnings}");
    assert!(warnings.contains("minimum norm"), "{warnings}");
    let report = report(&study, &["--max-degree", "27"]);
    assert!(msd(&report) < 1e-15, "{report}");
    let norm = report["batches"][0]["norm"].as_f64().unwrap();
    let x = model(&study, "m.npz");
    let largest = x.columns().into_iter().map(|c| c.dot(&c).sqrt()).fold(0.0, f64::max);
    meets(norm, largest, 1e-12, "norm");
    // The norm of the coefficients is of the same order of magnitude as the surface's size.
    assert!(norm < 10.0 * report["surfaces"][0]["scale"].as_f64().unwrap(), "{norm}");
}

/// A surface of degree 3 is approximated linearly between the vertices of ever finer spheres; the error falls with the
/// square of the edge length.
#[test]
fn quadrature_finds_a_surface_of_low_degree_to_the_error_of_interpolation() {
    let study = Study::new();
    succeed(&mut lsq(&study, &["--max-degree", "3"]));
    let mut known = Array2::zeros((169, 3));
    known.slice_mut(ndarray::s![..16, ..]).assign(&model(&study, "m.npz"));
    let mut errors = Vec::new();
    for subdivisions in [4, 5] {
        let (sphere, surface) = (study.path("fine.sphere.surf.gii"), study.path("fine.surf.gii"));
        let options = WriteOptions { overwrite: true, double: true };
        write_mesh(&sphere, &icosphere(subdivisions), &options).unwrap();
        let mut reconstruct = tool("reconstruct");
        reconstruct.arg("--model").arg(study.path("m.npz")).arg("-o").arg(&surface);
        succeed(reconstruct.args(["--double", "--force", "-q", "--icosphere", &subdivisions.to_string()]));
        let mut fit = tool("fit");
        fit.arg("--sphere").arg(&sphere).arg("--surface").arg(&surface).arg("-o").arg(study.path("q.npz"));
        let report = report_of(fit.args(["--method", "quadrature", "--max-degree", "12", "--json", "--force", "-q"]));
        assert_eq!(report["batches"][0]["grid"], serde_json::json!([13, 26]));
        errors.push(difference(&model(&study, "q.npz"), &known));
    }
    assert!(errors[1] < 2e-3, "{errors:?}");
    let ratio = errors[0] / errors[1];
    assert!(ratio > 3.3 && ratio < 4.7, "{errors:?}");
}

/// Samples evaluated by the fast transform equal those evaluated by direct sums.
#[test]
fn reconstruction_by_transform_is_that_of_direct_sums() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let sphere = icosphere(5);
    let k = basis_size(24);
    let values =
        Array2::from_shape_fn((k, 3), |(k, c)| ((k * 7 + c * 13) as f64 * 0.37).sin() / (1 + k.isqrt()) as f64);
    let write = |path: &Path, directions: &Directions, faces: &[[u32; 3]]| {
        let sphere = Sphere { faces: faces.to_vec(), ..Sphere::from_directions(directions.clone()) };
        let model = Model::new(sphere, Coefficients::new(values.clone()).unwrap(), Kind::Surface);
        model.write(path).unwrap();
    };
    let directions = Directions::from_vertices(&sphere.vertices).unwrap();
    write(&path("m.npz"), &directions, &sphere.faces);
    for (degree, where_) in [(24, &["--original"][..]), (17, &["--original"]), (24, &["--icosphere", "5"])] {
        let coefficients = values.slice(ndarray::s![..basis_size(degree), ..]);
        assert!(directions.len() * coefficients.nrows() > 3_000_000, "else it is the direct sum itself");
        let mut reconstruct = tool("reconstruct");
        reconstruct.arg("--model").arg(path("m.npz")).arg("-o").arg(path("r.surf.gii"));
        succeed(reconstruct.args(["--double", "--force", "-q", "--degree", &degree.to_string()]).args(where_));
        let expected = spharm_harmonics::synthesis(&directions, coefficients).unwrap();
        let found = read_mesh(path("r.surf.gii")).unwrap();
        assert_eq!(found.faces, sphere.faces);
        let largest = expected.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        for (found, expected) in found.vertices.iter().zip(expected.rows()) {
            let off = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(off <= 1e-11 * largest, "{off:e} of {largest}");
        }
    }
}

/// The tolerance is relative to the differences of the values, not to their distance from zero.
#[test]
fn values_far_from_zero_are_fitted_like_values_near_zero() {
    let mut random = SplitMix64::new(1);
    let places: Vec<[f64; 3]> = (0..600).map(|_| [0, 1, 2].map(|_| random.between(-1.0, 1.0))).collect();
    let sphere = Sphere::from_directions(Directions::from_vertices(&places).unwrap());
    let noise: Vec<f64> = places.iter().map(|_| random.between(-0.01, 0.01)).collect();
    let fitted = |offset: f64| {
        let value = |([x, y, z], noise): (&[f64; 3], &f64)| 0.3 * x * y + 0.2 * z * z + noise + offset;
        let values: Vec<f64> = sphere.directions.as_slice().iter().zip(&noise).map(value).collect();
        let fit = spharm::fit(&sphere, &spharm::Signal::new(values, 600, 1), &spharm::FitParams::lsq(6)).unwrap();
        let mut coefficients = fit.coefficients.values().to_owned();
        coefficients[[0, 0]] -= offset * (4.0 * std::f64::consts::PI).sqrt();
        coefficients
    };
    let near = fitted(0.0);
    for offset in [1e6, 1e8, -1e8] {
        let off = (fitted(offset) - &near).iter().fold(0.0, |most: f64, x| most.max(x.abs()));
        assert!(off < 1e-6, "{offset}: {off:e}");
    }
}
