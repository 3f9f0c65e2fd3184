//! Compares fits of real surfaces with results computed by other programs.

use std::path::Path;
use std::sync::{Mutex, PoisonError};

use serde_json::Value;
use spharm_model::Model;
use spharm_surface::io::read_signal;

use crate::common::{reference, shared, succeed, tool};

/// Runs a fit and returns its report.
fn report(store: &Path, sphere: &Path, surface: &Path, arguments: &[&str]) -> Value {
    let folder = store.parent().expect("a folder");
    let mut command = tool("fit");
    command.args(["--store".as_ref(), store.as_os_str(), "--sphere".as_ref(), sphere.as_os_str()]);
    command.args(["--surface".as_ref(), surface.as_os_str(), "-o".as_ref(), folder.join("m.spharm.npz").as_os_str()]);
    let text = succeed(command.args(["--json", "--force", "--coefficients-csv", "-q"]).args(arguments));
    serde_json::from_str(&text).expect("the report is JSON")
}

fn build(store: &Path, sphere: &Path, max_degree: usize) {
    let mut command = tool("basis-build");
    command.args(["--store".as_ref(), store.as_os_str(), "--sphere".as_ref(), sphere.as_os_str()]);
    succeed(command.args(["-q", "--max-degree", &max_degree.to_string()]));
}

/// Lock of the tests that write a store of degree 100: only one such store may be on disk at a time, because each takes
/// gigabytes.
static DISK: Mutex<()> = Mutex::new(());

/// Checks a surface against every irf and sirf line of its shared reference.
fn meets_shared_reference(name: &str) {
    let Some(reference) = shared("reference.json") else { return };
    let (Some(sphere), Some(surface)) =
        (shared(&format!("{name}.sphere.surf.gii")), shared(&format!("{name}.surf.gii")))
    else {
        return;
    };
    let reference: Value = serde_json::from_slice(&std::fs::read(reference).unwrap()).unwrap();
    let _disk = DISK.lock().unwrap_or_else(PoisonError::into_inner);
    meets_reference(name, (&sphere, &surface), &reference[name], &[1, 100, 200, 400], &[10, 20, 60, 100]);
}

/// Compares fits with every irf and sirf line of a reference, msd to a relative 1e-6 and xsd to 1e-4: IRF for blocks
/// of these granularities, and SIRF for these degrees.
fn meets_reference(
    name: &str,
    (sphere, surface): (&Path, &Path),
    reference: &Value,
    granularities: &[usize],
    degrees: &[usize],
) {
    let lines = reference["results"].as_object().expect("results");
    let top = reference["L"].as_u64().expect("a degree") as usize;
    let folder = tempfile::tempdir().unwrap();
    let store = folder.path().join("store");
    build(&store, sphere, top);
    let mut met = 0;
    let mut check = |line: &str, pass: &Value| {
        let Some(expected) = lines.get(line) else { return };
        for (measure, tolerance) in [("msd", 1e-6), ("xsd", 1e-4)] {
            let (found, expected) = (pass[measure].as_f64().unwrap(), expected[measure].as_f64().unwrap());
            assert!((found / expected - 1.0).abs() <= tolerance, "{name}, {line}: {measure} {found}, not {expected}");
        }
        met += 1;
    };
    for g in granularities {
        let arguments = ["--max-degree", &top.to_string(), "--passes", "8", "--granularity", &g.to_string()];
        let report = report(&store, sphere, surface, &arguments);
        for p in 1..=8 {
            check(&format!("irf p={p} g={g} L={top}"), &report["surfaces"][0]["passes"][p - 1]);
        }
    }
    for degree in degrees {
        let arguments = ["--method", "sirf", "--max-degree", &degree.to_string()];
        let report = report(&store, sphere, surface, &arguments);
        check(&format!("sirf L={degree}"), &report["surfaces"][0]["passes"][0]);
    }
    let wanted = lines.keys().filter(|line| line.contains("irf")).count();
    assert_eq!(met, wanted, "every irf and sirf line was met: {:?}", lines.keys());
}

#[test]
fn the_cortex_meets_every_line_of_the_reference() {
    meets_shared_reference("cort40962");
}

#[test]
fn the_head_meets_every_line_of_the_reference() {
    meets_shared_reference("head27618");
}

/// Checks IRF, SIRF and least squares of an unevenly sampled body against the reference that is part of the repository.
#[test]
fn a_body_meets_every_line_of_its_reference() {
    let [sphere, surface, results] = ["sphere.surf.gii", "surface.surf.gii", "reference.json"].map(reference);
    let results: Value = serde_json::from_slice(&std::fs::read(results).unwrap()).unwrap();
    meets_reference("body", (&sphere, &surface), &results, &[1, 40, 150], &[5, 10, 20]);
    let expected = &results["results"]["least-squares L=20"];
    for method in [&["--method", "nlsf"][..], &["--method", "lsq", "--objective", "vertices", "--strict"]] {
        let folder = tempfile::tempdir().unwrap();
        let store = folder.path().join("store");
        build(&store, &sphere, 20);
        let report = report(&store, &sphere, &surface, &[method, &["--max-degree", "20"]].concat());
        for (measure, tolerance) in [("msd", 1e-6), ("xsd", 1e-4)] {
            let found = report["surfaces"][0]["passes"][0][measure].as_f64().unwrap();
            let expected = expected[measure].as_f64().unwrap();
            assert!((found / expected - 1.0).abs() <= tolerance, "{method:?}: {measure} {found}, not {expected}");
        }
    }
}

/// A fit of the earth's magnetic field, evaluated by another program, gives the published coefficients of the field.
#[test]
fn least_squares_of_a_field_equals_published_coefficients() {
    const DEGREE: usize = 13;
    let folder = tempfile::tempdir().unwrap();
    let model = folder.path().join("field.spharm.npz");
    let mut fit = tool("fit");
    fit.arg("--sphere").arg(reference("igrf_directions.csv")).arg("--surface").arg(reference("igrf_field.csv"));
    succeed(fit.args(["--max-degree", &DEGREE.to_string(), "-q", "-o"]).arg(&model));
    let found = Model::read(&model).unwrap().coefficients;
    let published = read_signal(reference("igrf.csv")).unwrap();
    assert_eq!((published.vertices, published.channels), (DEGREE * (DEGREE + 3) / 2, 4));
    for row in published.values.chunks(4) {
        let (n, m) = (row[0] as usize, row[1] as usize);
        // Convert from the gradient of the potential at the reference radius, in Schmidt's semi-normalisation.
        let factor = (n + 1) as f64 * (4.0 * std::f64::consts::PI / (2 * n + 1) as f64).sqrt();
        for (value, order) in [(row[2], n + m), (row[3], n - m)].into_iter().take(1 + usize::from(m > 0)) {
            let ours = found.values()[[n * n + order, 0]] / factor;
            // The published coefficients, up to 29,405 nT, are given to hundredths of a nT.
            assert!((ours - value).abs() < 1e-6, "degree {n}, order {m}: {ours}, not {value}");
        }
    }
    assert!(found.values()[[0, 0]].abs() < 1e-6, "no monopole");
}

/// The least squares of three hippocampi at degree 15 equal the coefficients published by the hippocampi's authors.
#[test]
fn full_least_squares_equals_published_coefficients() {
    for name in ["hippo_a01_l", "hippo_a02_l", "hippo_a03_l"] {
        let files = [format!("{name}.sphere.obj"), format!("{name}.obj"), format!("{name}.degree15.fvec.csv")];
        let [Some(sphere), Some(surface), Some(published)] = files.map(|file| shared(&file)) else { return };
        let folder = tempfile::tempdir().unwrap();
        let store = folder.path().join("store");
        build(&store, &sphere, 15);
        report(&store, &sphere, &surface, &["--method", "nlsf", "--max-degree", "15"]);
        let ours = read_signal(folder.path().join("m.spharm.csv")).unwrap();
        let theirs = read_signal(&published).unwrap();
        assert_eq!((ours.vertices, ours.channels), (256, 8));
        let coefficients =
            |values: &[f64]| -> Vec<f64> { values.chunks(8).flat_map(|row| row[2..].to_vec()).collect() };
        let (ours, theirs) = (coefficients(&ours.values), coefficients(&theirs.values));
        let difference: f64 = ours.iter().zip(&theirs).map(|(a, b)| (a - b) * (a - b)).sum();
        let norm: f64 = theirs.iter().map(|b| b * b).sum();
        assert!((difference / norm).sqrt() <= 1e-10, "{name}: {}", (difference / norm).sqrt());
    }
}
