//! Runs the complete pipeline through the program: sphere to basis to coefficients to surface.

use std::path::{Path, PathBuf};

use serde_json::Value;
use spharm_model::Model;
use spharm_surface::generate::icosphere;
use spharm_surface::io::{WriteOptions, read_mesh, read_signal, write_mesh};
use spharm_surface::metrics;

use crate::common::{fail, succeed, tool};

/// A folder with a generated cortex of 642 vertices, its sphere, and the basis to degree 12.
pub(crate) struct Study {
    folder: tempfile::TempDir,
}

impl Study {
    pub(crate) fn new() -> Self {
        let study = Self { folder: tempfile::tempdir().unwrap() };
        for variant in 0..4 {
            let surface = study.path(&format!("s{variant}.surf.gii"));
            let mut generate = tool("generate");
            generate
                .args(["--subdivisions", "3", "--double", "--variant", &variant.to_string(), "--surface"])
                .arg(surface);
            succeed(generate.arg("--sphere").arg(study.path("sphere.surf.gii")).arg("--force"));
        }
        succeed(&mut study.build(12));
        study
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub(crate) fn build(&self, max_degree: usize) -> std::process::Command {
        let mut command = tool("basis-build");
        command.arg("--sphere").arg(self.path("sphere.surf.gii")).arg("--store").arg(self.path("store"));
        command.args(["-q", "--chunk-rows", "104", "--max-degree", &max_degree.to_string()]);
        command
    }

    /// Returns a `fit` of the named files in this folder.
    pub(crate) fn fit(&self, surfaces: &[&str], arguments: &[&str]) -> std::process::Command {
        let mut command = tool("fit");
        command.arg("--sphere").arg(self.path("sphere.surf.gii")).arg("--store").arg(self.path("store"));
        command.args(["-q", "--surface"]).args(surfaces.iter().map(|name| self.path(name))).args(arguments);
        command
    }

    /// Fits into `output` in this folder and returns the report.
    pub(crate) fn report(&self, surfaces: &[&str], output: &str, arguments: &[&str]) -> Value {
        let mut command = self.fit(surfaces, arguments);
        let text = succeed(command.arg("--json").arg("-o").arg(self.path(output)));
        serde_json::from_str(&text).expect("the report is JSON")
    }

    fn model(&self, name: &str) -> Model {
        Model::read(self.path(name)).unwrap()
    }
}

fn close(a: &Model, b: &Model, relative: f64) {
    let (a, b) = (a.coefficients.values(), b.coefficients.values());
    assert_eq!(a.dim(), b.dim());
    let norm = b.iter().map(|b| b * b).sum::<f64>().sqrt();
    let difference = (a - b).iter().map(|d| d * d).sum::<f64>().sqrt();
    assert!(difference <= relative * norm, "{} of {norm}", difference);
}

#[test]
fn a_fit_reconstructs_to_the_distances_that_it_reports() {
    let study = Study::new();
    let report = study.report(&["s0.surf.gii"], "m.spharm.npz", &["--max-degree", "12", "--passes", "3"]);
    let last = &report["surfaces"][0]["passes"][2];
    let output = study.path("back.surf.gii");
    let model = study.path("m.spharm.npz");
    succeed(tool("reconstruct").arg("--model").arg(&model).arg("--double").arg("-o").arg(&output));
    let compared = succeed(tool("compare").arg(study.path("s0.surf.gii")).arg(&output).arg("--json"));
    let compared: Value = serde_json::from_str(&compared).unwrap();
    for measure in ["msd", "xsd", "msd_raw", "xsd_raw"] {
        let (found, expected) = (compared[measure].as_f64().unwrap(), last[measure].as_f64().unwrap());
        assert!((found / expected - 1.0).abs() < 1e-9, "{measure}: {found}, reported {expected}");
    }
    assert!(last["msd"].as_f64() < report["surfaces"][0]["passes"][0]["msd"].as_f64());
    // Write the error as values and colours on a mesh.
    let ply = study.path("error.ply");
    succeed(tool("compare").arg(study.path("s0.surf.gii")).arg(&output).arg("-o").arg(&ply));
    let header = String::from_utf8_lossy(&std::fs::read(&ply).unwrap()).into_owned();
    assert!(header.contains("property float distance") && header.contains("property uchar red"));
    // Meshes with different triangles have surface distances, but no vertexwise distances.
    let other = study.path("other.obj");
    write_mesh(&other, &icosphere(2), &WriteOptions::default()).unwrap();
    for (path, vertexwise) in [(&output, true), (&other, false)] {
        let mut compare = tool("compare");
        compare.arg(study.path("s0.surf.gii")).arg(path).args(["--surface-distance", "--json", "--samples", "5000"]);
        let compared: Value = serde_json::from_str(&succeed(&mut compare)).unwrap();
        assert_eq!(compared["msd"].is_number(), vertexwise);
        let surfaces = &compared["surface_distance"];
        let [mean, rms, most] = ["mean", "rms", "hausdorff"].map(|name| surfaces[name].as_f64().unwrap());
        assert!(0.0 < mean && mean < rms && rms < most, "{surfaces}");
        // The distance of a point to the other surface is at most its distance to the corresponding vertex.
        assert!(!vertexwise || rms * rms < compared["msd_raw"].as_f64().unwrap());
    }
}

/// With p passes and granularity g: (1, infinity) is NLSF, (p, 1) is MIRF, (1, 1) is SIRF. IRF converges to NLSF for
/// every granularity.
#[test]
fn the_methods_are_special_cases_of_each_other() {
    let study = Study::new();
    let degree = ["--max-degree", "12"];
    let fit = |output: &str, more: &[&str]| {
        study.report(&["s0.surf.gii"], output, &[&degree[..], more].concat());
        study.model(output)
    };
    let nlsf = fit("nlsf.npz", &["--method", "nlsf"]);
    close(&fit("inf.npz", &["--granularity", "inf"]), &nlsf, 1e-12);
    close(&fit("sirf.npz", &["--method", "sirf"]), &fit("g1.npz", &["--granularity", "1"]), 0.0);
    let mirf = fit("mirf.npz", &["--method", "mirf", "--passes", "3"]);
    close(&mirf, &fit("g1p3.npz", &["--granularity", "1", "--passes", "3"]), 0.0);
    close(&fit("irf.npz", &["--granularity", "30", "--passes", "40"]), &nlsf, 1e-10);
    // SIRF whose first block ends at degree L is also the full least squares.
    close(&fit("s12.npz", &["--method", "sirf", "--start-degree", "12"]), &nlsf, 1e-12);
}

#[test]
fn a_batch_gives_what_each_gives_alone_and_lists_name_surfaces() {
    let study = Study::new();
    std::fs::write(study.path("list.txt"), "# subjects\ns1.surf.gii\n\ns2.surf.gii\n").unwrap();
    let list = format!("@{}", study.path("list.txt").display());
    let arguments = ["--max-degree", "12", "--passes", "2"];
    let mut command = study.fit(&["s0.surf.gii"], &[]);
    succeed(command.arg(list).args(arguments).arg("-o").arg(study.path("models")));
    for name in ["s0", "s1", "s2"] {
        study.report(&[&format!("{name}.surf.gii")], &format!("{name}.npz"), &arguments);
        close(&study.model(&format!("models/{name}.spharm.npz")), &study.model(&format!("{name}.npz")), 1e-13);
    }
    // One sweep can't hold this number of surfaces: later sweeps use the factors of the first.
    let names: Vec<String> = (0..130).map(|copy| format!("copy{copy}.surf.gii")).collect();
    for name in &names {
        std::fs::copy(study.path("s1.surf.gii"), study.path(name)).unwrap();
    }
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let report = study.report(&names, "many", &arguments);
    let batches = report["batches"].as_array().unwrap();
    assert_eq!(batches.len(), 2);
    let ids = batches.iter().flat_map(|batch| batch["ids"].as_array().unwrap());
    let ids: Vec<&str> = ids.filter_map(Value::as_str).collect();
    assert!(ids.iter().zip(0..130).all(|(id, copy)| *id == format!("copy{copy}")) && ids.len() == 130, "{ids:?}");
    assert!(batches[1]["sweeps"][0]["residuals"].as_array().unwrap().len() < 130, "{}", batches[1]);
    for name in ["copy0", "copy127", "copy128", "copy129"] {
        close(&study.model(&format!("many/{name}.spharm.npz")), &study.model("s1.npz"), 1e-13);
    }
}

/// Returns the smallest budget, in MiB, that the error states.
fn smallest(study: &Study, surfaces: &[&str], arguments: &[&str]) -> u64 {
    let error = fail(study.fit(surfaces, arguments).args(["--memory", "1MiB"]).arg("-o").arg(study.path("none")));
    let (_, rest) = error.split_once("at least ").expect("states the smallest budget");
    rest.split_once(" MiB").expect("in MiB").0.parse().expect("a number")
}

#[test]
fn the_smallest_budget_that_is_named_works_and_one_below_does_not() {
    let study = Study::new();
    for more in [&["--granularity", "1"][..], &["--granularity", "100"], &["--method", "nlsf"]] {
        let arguments = [&["--max-degree", "12"], more].concat();
        let least = smallest(&study, &["s0.surf.gii"], &arguments);
        let tight = format!("{least}MiB");
        study.report(&["s0.surf.gii"], "tight.npz", &[&arguments[..], &["--memory", &tight, "--force"]].concat());
        study.report(&["s0.surf.gii"], "wide.npz", &[&arguments[..], &["--force"]].concat());
        close(&study.model("tight.npz"), &study.model("wide.npz"), 1e-12);
        let below = format!("{}MiB", least - 1);
        fail(study.fit(&["s0.surf.gii"], &arguments).args(["--memory", &below]).arg("-o").arg(study.path("n.npz")));
    }
}

#[test]
fn the_same_threads_give_the_same_bits_and_others_agree_to_rounding() {
    let study = Study::new();
    let fit = |output: &str, threads: &str| {
        study.report(&["s0.surf.gii"], output, &["--max-degree", "12", "--passes", "2", "--threads", threads]);
        std::fs::read(study.path(output)).unwrap()
    };
    assert_eq!(fit("a.npz", "2"), fit("b.npz", "2"), "models are the same byte for byte");
    fit("c.npz", "1");
    close(&study.model("c.npz"), &study.model("a.npz"), 1e-13);
    fit("d.npz", "5");
    close(&study.model("d.npz"), &study.model("a.npz"), 1e-13);
}

#[test]
fn codecs_and_scalar_types_give_the_same_fit_within_their_digits() {
    let study = Study::new();
    let arguments = ["--max-degree", "12", "--passes", "2"];
    study.report(&["s0.surf.gii"], "raw.npz", &arguments);
    for (dtype, codec, relative) in [("f64", "zstd", 0.0), ("f32", "none", 1e-6), ("f32", "zstd", 1e-6)] {
        let store = study.path(&format!("{dtype}{codec}"));
        let mut build = tool("basis-build");
        build.arg("--sphere").arg(study.path("sphere.surf.gii")).arg("--store").arg(&store);
        succeed(build.args(["-q", "--max-degree", "12", "--dtype", dtype, "--codec", codec, "--chunk-rows", "104"]));
        let mut fit = tool("fit");
        fit.arg("--sphere").arg(study.path("sphere.surf.gii")).arg("--store").arg(&store).args(arguments);
        fit.arg("--surface").arg(study.path("s0.surf.gii")).args(["-q", "--verify", "--force", "--json"]);
        let report = succeed(fit.arg("-o").arg(study.path("other.npz")));
        close(&study.model("other.npz"), &study.model("raw.npz"), relative);
        // Moments give the Gram matrix of exact harmonics, so they aren't used for a basis in f32.
        let report: Value = serde_json::from_str(&report).unwrap();
        let from_moments = report["batches"][0]["memory"]["grams"].as_u64().unwrap() > 0;
        assert_eq!(from_moments, dtype == "f64", "{report}");
    }
}

#[test]
fn accelerated_fits_end_at_the_least_squares() {
    let study = Study::new();
    study.report(&["s0.surf.gii"], "nlsf.npz", &["--max-degree", "12", "--method", "nlsf", "--memory", "512MiB"]);
    for more in [&["--granularity", "30"][..], &["--method", "mirf"]] {
        let arguments = [&["--max-degree", "12", "--accelerate", "--passes", "60", "--force"], more].concat();
        let report = study.report(&["s0.surf.gii", "s1.surf.gii"], "", &arguments);
        assert_eq!(report["batches"][0]["accelerated"], true);
        assert!(report["surfaces"][0]["passes"].as_array().unwrap().len() < 30, "it ends early");
        close(&study.model("s0.spharm.npz"), &study.model("nlsf.npz"), 1e-10);
    }
}

#[test]
fn signals_are_fitted_like_coordinates() {
    let study = Study::new();
    let mesh = read_mesh(study.path("s0.surf.gii")).unwrap();
    let rows: Vec<String> = mesh.vertices.iter().map(|[x, y, z]| format!("{x:?},{y:?},{z:?}\n")).collect();
    std::fs::write(study.path("xyz.csv"), rows.concat()).unwrap();
    let arguments = ["--max-degree", "10", "--passes", "2"];
    study.report(&["s0.surf.gii"], "mesh.npz", &arguments);
    let report = study.report(&["xyz.csv"], "signal.npz", &arguments);
    assert_eq!(study.model("signal.npz").coefficients, study.model("mesh.npz").coefficients);
    assert!(report["surfaces"][0]["passes"][0]["msd"].is_null(), "a signal has no bounding box");
    let output = study.path("back.csv");
    succeed(tool("reconstruct").arg("--model").arg(study.path("signal.npz")).arg("-o").arg(&output));
    let back = read_signal(&output).unwrap();
    assert_eq!((back.vertices, back.channels), (642, 3));
}

#[test]
fn weights_count_like_repeated_vertices() {
    let study = Study::new();
    // A vertex of weight 0 is ignored: moving it changes nothing.
    let mut mesh = read_mesh(study.path("s0.surf.gii")).unwrap();
    mesh.vertices[17] = [1e3, -1e3, 1e3];
    write_mesh(study.path("moved.surf.gii"), &mesh, &WriteOptions { overwrite: false, double: true }).unwrap();
    let weights: Vec<String> =
        (0..642).map(|i| format!("{}\n", if i == 17 { 0.0 } else { 1.0 + 0.5 * f64::from(i % 3) })).collect();
    std::fs::write(study.path("weights.csv"), weights.concat()).unwrap();
    let file = study.path("weights.csv");
    let arguments = ["--max-degree", "12", "--weights", file.to_str().unwrap()];
    study.report(&["s0.surf.gii"], "a.npz", &arguments);
    study.report(&["moved.surf.gii"], "b.npz", &arguments);
    close(&study.model("b.npz"), &study.model("a.npz"), 1e-11);
    // The areas of an icosphere's vertices are nearly equal, so area weights change the model a little.
    study.report(&["s0.surf.gii"], "area.npz", &["--max-degree", "12", "--weights", "area"]);
    study.report(&["s0.surf.gii"], "uniform.npz", &["--max-degree", "12"]);
    close(&study.model("area.npz"), &study.model("uniform.npz"), 0.05);
    assert_ne!(study.model("area.npz").coefficients, study.model("uniform.npz").coefficients);
}

#[test]
fn more_functions_than_vertices_give_the_solution_of_least_norm() {
    let study = Study::new();
    succeed(&mut study.build(27)); // 784 functions on 642 vertices
    let output = study.path("m.npz");
    let run = study
        .fit(&["s0.surf.gii"], &["--max-degree", "27", "--method", "nlsf", "--memory", "1GiB"])
        .arg("-o")
        .arg(&output)
        .output()
        .unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    assert!(String::from_utf8_lossy(&run.stderr).contains("rank 642 of 784"), "the rank is reported");
    let model = Model::read(&output).unwrap();
    // The model passes through the vertices, and its coefficients are of the order of the surface's size.
    let back = study.path("back.surf.gii");
    succeed(tool("reconstruct").arg("--model").arg(&output).arg("--double").arg("-o").arg(&back));
    let found = metrics::compare(&read_mesh(study.path("s0.surf.gii")).unwrap(), &read_mesh(&back).unwrap()).unwrap();
    assert!(found.xsd < 1e-20, "{}", found.xsd);
    assert!(model.coefficients.values().iter().all(|a| a.abs() < 1e3));
}

#[test]
fn models_are_evaluated_to_any_degree_on_any_sphere() {
    let study = Study::new();
    study.report(&["s0.surf.gii"], "m.npz", &["--max-degree", "12", "--passes", "4"]);
    let reconstruct = |name: &str, arguments: &[&str]| {
        let output = study.path(name);
        let mut command = tool("reconstruct");
        succeed(command.arg("--model").arg(study.path("m.npz")).args(arguments).args(["--double", "-o"]).arg(&output));
        read_mesh(&output).unwrap()
    };
    let original = reconstruct("o.ply", &["--original"]);
    let sphere = study.path("sphere.surf.gii");
    assert_eq!(reconstruct("s.ply", &["--sphere", sphere.to_str().unwrap()]).vertices, original.vertices);
    // The first vertices of an icosphere of 5 subdivisions are those of the icosphere of 3.
    let fine = reconstruct("i.ply", &["--icosphere", "5"]);
    assert_eq!(fine.vertices.len(), 10242);
    for (a, b) in fine.vertices.iter().zip(&original.vertices) {
        assert!((0..3).all(|c| (a[c] - b[c]).abs() < 1e-10));
    }
    let centre = reconstruct("c.ply", &["--degree", "0"]);
    assert!(centre.vertices.iter().all(|v| v == &centre.vertices[0]), "degree 0 is a point");
    let error =
        fail(tool("reconstruct").arg("--model").arg(study.path("m.npz")).args(["--degree", "13", "-o", "x.ply"]));
    assert!(error.contains("exceeds the model's degree 12"), "{error}");
}

#[test]
fn outputs_are_kept_unless_force_is_given() {
    let study = Study::new();
    let arguments = ["--max-degree", "6"];
    study.report(&["s0.surf.gii"], "m.npz", &arguments);
    let before = std::fs::read(study.path("m.npz")).unwrap();
    let again_with = |surface: &str, more: &[&str]| {
        let mut command = study.fit(&[surface], &arguments);
        command.args(more).arg("-o").arg(study.path("m.npz"));
        command
    };
    let again = |more: &[&str]| again_with("s1.surf.gii", more);
    let error = fail(&mut again(&[]));
    assert!(error.contains("the output exists") && error.contains("--force"), "{error}");
    // With --skip-existing, an existing model of another surface is refused.
    assert!(fail(&mut again(&["--skip-existing"])).contains("s0.surf.gii, not from"));
    assert!(succeed(&mut again_with("s0.surf.gii", &["--skip-existing"])).contains("nothing to do"));
    assert_eq!(std::fs::read(study.path("m.npz")).unwrap(), before);
    succeed(&mut again(&["--force"]));
    assert_ne!(std::fs::read(study.path("m.npz")).unwrap(), before);
}

/// A model opens in NumPy with the documented contents.
#[test]
fn models_open_in_numpy() {
    let Some(python) = std::env::var_os("SPHARM_PYTHON") else {
        eprintln!("skipped: no NumPy here (SPHARM_PYTHON is not set; ./run test sets it)");
        return;
    };
    let study = Study::new();
    study.report(&["s0.surf.gii"], "m.npz", &["--max-degree", "6"]);
    let script = "import sys, json, numpy as np\n\
        m = np.load(sys.argv[1])\n\
        assert m['coefficients'].shape == (49, 3) and m['coefficients'].dtype == np.float64\n\
        assert int(m['max_degree']) == 6 and len(str(m['scheme_key'])) == 64\n\
        assert m['faces'].shape == (1280, 3) and m['directions'].shape == (642, 3)\n\
        assert str(m['convention']).startswith('real orthonormal')\n\
        assert json.loads(str(m['provenance']))['method'] == 'irf'\n\
        print(repr(float(m['coefficients'][0, 1])))";
    let printed = succeed(std::process::Command::new(python).args(["-c", script]).arg(study.path("m.npz")));
    let expected = study.model("m.npz").coefficients.values()[[0, 1]];
    assert_eq!(printed.trim().parse::<f64>().unwrap(), expected);
}

/// Reports contain the fields on which scripts rely.
#[test]
fn reports_have_what_was_promised() {
    let study = Study::new();
    let report =
        study.report(&["s0.surf.gii"], "m.npz", &["--max-degree", "12", "--passes", "2", "--granularity", "50"]);
    let batch = &report["batches"][0];
    assert_eq!((&report["granularity"], &batch["passes"], &batch["method"]), (&50.into(), &2.into(), &"irf".into()));
    let blocks = batch["blocks"].as_array().unwrap();
    assert_eq!(blocks.iter().map(|b| b["columns"].as_u64().unwrap()).sum::<u64>(), 169);
    assert!(blocks.iter().all(|b| b["rank"] == b["columns"] && b["condition"].as_f64().unwrap() >= 1.0));
    let read: u64 = batch["sweeps"].as_array().unwrap().iter().map(|s| s["bytes_read"].as_u64().unwrap()).sum();
    assert_eq!(read, 2 * 642 * 169 * 8, "each byte of the basis once a pass");
    for name in ["read", "plan", "solve", "write", "total"] {
        assert!(report["seconds"][name].as_f64().unwrap() >= 0.0, "{name}");
    }
    assert!(report["memory"]["peak_resident"].as_u64().unwrap() > 1 << 20);
}

/// Returns the sorted names of the files in a folder, to detect leftovers.
pub(crate) fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .unwrap()
        .map(|item| item.unwrap().file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}
