//! Problems that first-time users found: names of outputs, resumed runs, leftovers.

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;
use spharm_model::Model;
use spharm_surface::Mesh;
use spharm_surface::generate::{Cortex, cortex, icosphere};
use spharm_surface::io::{WriteOptions, read_mesh, write_mesh};

use crate::common::{fail, finish, succeed, text, tool};
use crate::pipeline::names;

pub(crate) const OPTIONS: WriteOptions = WriteOptions { overwrite: true, double: true };

/// Subjects whose files have the same names in different folders, on one sphere.
pub(crate) struct Subjects {
    folder: tempfile::TempDir,
}

impl Subjects {
    pub(crate) fn new(count: u32) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        write_mesh(folder.path().join("sphere.ply"), &icosphere(3), &OPTIONS).expect("a sphere");
        for variant in 1..=count {
            let surf = folder.path().join(format!("sub-{variant:02}/surf"));
            std::fs::create_dir_all(&surf).expect("a folder");
            let (surface, _) = cortex(&Cortex { subdivisions: 3, variant: variant.into() });
            write_mesh(surf.join("lh.pial.ply"), &surface, &OPTIONS).expect("a surface");
        }
        Self { folder }
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub(crate) fn surface(&self, subject: u32) -> PathBuf {
        self.path(&format!("sub-{subject:02}/surf/lh.pial.ply"))
    }

    /// Returns a `fit` of some subjects into the folder `out`.
    pub(crate) fn fit(&self, subjects: &[u32], arguments: &[&str]) -> Command {
        let mut fit = tool("fit");
        fit.arg("--sphere").arg(self.path("sphere.ply")).arg("--surface");
        fit.args(subjects.iter().map(|&subject| self.surface(subject)));
        fit.args(["--max-degree", "6", "-q", "-o"]).arg(self.path("out")).args(arguments);
        fit
    }

    fn model(&self, name: &str) -> Model {
        Model::read(self.path("out").join(name)).expect("a model")
    }
}

/// Runs a command that must succeed and returns its stderr.
pub(crate) fn errors(command: &mut Command) -> String {
    let output = finish(command);
    assert!(output.status.success(), "{}", text(&output));
    String::from_utf8_lossy(&output.stderr).into_owned()
}

const BY_SUBJECT: [&str; 2] = ["--name-template", "{parent2}.{stem}"];

#[test]
fn a_model_of_another_input_is_not_taken_for_ones_own() {
    let subjects = Subjects::new(2);
    succeed(&mut subjects.fit(&[1], &["--skip-existing"]));
    let before = subjects.model("lh.pial.spharm.npz");
    let error = fail(&mut subjects.fit(&[2], &["--skip-existing"]));
    assert!(
        error.contains("sub-01/surf/lh.pial.ply, not from") && error.contains("sub-02/surf/lh.pial.ply"),
        "{error}"
    );
    assert!(error.contains("--name-template '{parent2}.{stem}'"), "{error}");
    assert_eq!(subjects.model("lh.pial.spharm.npz"), before);
    let good = std::fs::read(subjects.path("sub-02/surf/lh.pial.ply")).expect("a mesh");
    std::fs::write(subjects.path("sub-02/surf/lh.pial.ply"), "ply\n").expect("a damaged mesh");
    let output = finish(&mut subjects.fit(&[2], &["--force"]));
    assert!(!output.status.success() && !text(&output).contains("replaces"), "{}", text(&output));
    std::fs::write(subjects.path("sub-02/surf/lh.pial.ply"), good).expect("a mesh");
    // A folder of this name prevents the table from being written.
    std::fs::create_dir(subjects.path("out/lh.pial.spharm.csv")).expect("a folder");
    let output = finish(&mut subjects.fit(&[2], &["--force", "--coefficients-csv"]));
    assert!(!output.status.success() && !text(&output).contains("replaces"), "{}", text(&output));
    std::fs::remove_dir(subjects.path("out/lh.pial.spharm.csv")).expect("it is removed");
    let warnings = errors(&mut subjects.fit(&[2], &["--force"]));
    assert!(warnings.contains("replaces the model of") && warnings.contains("sub-01"), "{warnings}");
    assert_ne!(subjects.model("lh.pial.spharm.npz").coefficients, before.coefficients);
    // Replacing a model of the same input gives no warning.
    assert!(!errors(&mut subjects.fit(&[2], &["--force"])).contains("replaces"));
}

#[test]
fn names_depend_on_the_input_alone() {
    let subjects = Subjects::new(3);
    let error = fail(&mut subjects.fit(&[1, 2], &[]));
    assert!(error.contains("would both be written to") && error.contains("'{parent2}.{stem}'"), "{error}");
    assert!(!subjects.path("out").exists());
    succeed(&mut subjects.fit(&[1, 2], &BY_SUBJECT));
    succeed(&mut subjects.fit(&[3], &BY_SUBJECT));
    let expected = [1, 2, 3].map(|subject| format!("sub-0{subject}.lh.pial.spharm.npz"));
    assert_eq!(names(&subjects.path("out")), expected);
    let again = succeed(subjects.fit(&[1, 2, 3], &BY_SUBJECT).arg("--skip-existing"));
    assert!(again.contains("nothing to do"), "{again}");
}

#[test]
fn a_model_with_other_settings_is_not_taken_for_the_one_asked_for() {
    let subjects = Subjects::new(1);
    let weights: String = (0..642).map(|row| format!("{}\n", 1 + row % 2)).collect();
    std::fs::write(subjects.path("weights.csv"), weights).expect("weights");
    let weights = subjects.path("weights.csv");
    let usual = ["--smoothness", "1e-7"];
    succeed(&mut subjects.fit(&[1], &usual));
    for (arguments, difference) in [
        (&["--max-degree", "8"][..], "max-degree 6, not 8"),
        (&["--smoothness", "2e-7"], "smoothness 0.0000001, not 0.0000002"),
        (&["--weights", weights.to_str().expect("UTF-8")], "weights uniform, not"),
        (&["--hold-out", "0.1"], "hold-out none, not 0.1"),
        (&["--tolerance", "1e-6"], "tolerance"),
    ] {
        let replaced = |flag: &str| !arguments.contains(&flag);
        // Omit the usual value of a flag that the case sets, because a flag can't be given twice.
        let mut command = tool("fit");
        command.arg("--sphere").arg(subjects.path("sphere.ply")).arg("--surface").arg(subjects.surface(1));
        command.args(["-q", "--skip-existing", "-o"]).arg(subjects.path("out"));
        if replaced("--max-degree") {
            command.args(["--max-degree", "6"]);
        }
        if replaced("--smoothness") {
            command.args(usual);
        }
        let error = fail(command.args(arguments));
        assert!(error.contains(difference) && error.contains("--force"), "{error}");
    }
    let again = succeed(subjects.fit(&[1], &usual).arg("--skip-existing"));
    assert!(again.contains("nothing to do"), "{again}");
    // A model over another sphere has other settings.
    let turned = icosphere(3);
    let turned = turned.with_vertices(turned.vertices.iter().map(|&[x, y, z]| [y, z, x]).collect());
    write_mesh(subjects.path("sphere.ply"), &turned, &OPTIONS).expect("a sphere");
    let error = fail(subjects.fit(&[1], &usual).arg("--skip-existing"));
    assert!(error.contains("sphere "), "{error}");
}

#[test]
fn a_file_beside_the_model_that_is_missing_is_made() {
    let subjects = Subjects::new(1);
    succeed(&mut subjects.fit(&[1], &[]));
    let before = std::fs::read(subjects.path("out/lh.pial.spharm.npz")).expect("a model");
    succeed(&mut subjects.fit(&[1], &["--skip-existing", "--coefficients-csv"]));
    assert_eq!(names(&subjects.path("out")), ["lh.pial.spharm.csv", "lh.pial.spharm.npz"]);
    assert_eq!(std::fs::read(subjects.path("out/lh.pial.spharm.npz")).expect("a model"), before);
}

#[test]
fn a_sphere_that_a_broken_off_fit_left_is_used_again() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name);
    let (surface, _) = cortex(&Cortex { subdivisions: 3, variant: 0 });
    write_mesh(path("s.ply"), &surface, &OPTIONS).expect("a mesh");
    let fit = || {
        let mut fit = tool("fit");
        fit.arg("--surface").arg(path("s.ply")).args(["--max-degree", "8", "--skip-existing", "-o"]).arg(path("out"));
        fit
    };
    succeed(&mut fit());
    let model = std::fs::read(path("out/s.spharm.npz")).expect("a model");
    std::fs::remove_file(path("out/s.spharm.npz")).expect("it is there");
    let said = errors(&mut fit());
    assert!(said.contains("s.sphere.surf.gii: reusing the sphere"), "{said}");
    assert_eq!(std::fs::read(path("out/s.spharm.npz")).expect("a model"), model);
    // A sphere without a record of its input belongs to another program, and is refused.
    write_mesh(path("out/s.sphere.surf.gii"), &icosphere(3), &OPTIONS).expect("a sphere");
    std::fs::remove_file(path("out/s.spharm.npz")).expect("it is there");
    let error = fail(&mut fit());
    assert!(error.contains("s.sphere.surf.gii") && error.contains("wasn't made from"), "{error}");
    assert_eq!(read_mesh(path("out/s.sphere.surf.gii")).expect("a sphere").vertices, icosphere(3).vertices);
}

/// `--area` limits the distortion of maps: the maps of a group should differ by no more than its surfaces do.
#[test]
fn what_a_map_may_give_away_of_its_areas_is_a_setting() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name);
    let (surface, _) = cortex(&Cortex { subdivisions: 3, variant: 0 });
    write_mesh(path("s.ply"), &surface, &OPTIONS).expect("a mesh");
    let fit = |options: &[&str]| {
        let mut fit = tool("fit");
        fit.arg("--surface").arg(path("s.ply")).args(["--max-degree", "8", "-q", "-o"]).arg(path("out")).args(options);
        fit
    };
    let area = |options: &[&str]| {
        let report: serde_json::Value = serde_json::from_str(&succeed(&mut fit(options))).expect("JSON");
        report["surfaces"][0]["parametrization"]["quality"]["area_rms"].as_f64().expect("a number")
    };
    let usual = area(&["--json"]);
    let even = area(&["--json", "--force", "--area", "0"]);
    assert!(even < 0.05 && even < 0.5 * usual, "{even} {usual}");
    let error = fail(&mut fit(&["--skip-existing"]));
    assert!(error.contains("area 0, not the default"), "{error}");
    assert!(succeed(&mut fit(&["--skip-existing", "--area", "0"])).contains("nothing to do"));
    let error = fail(&mut fit(&["--force", "--area", "1.5"]));
    assert!(error.contains("area") && error.contains("0 to 1"), "{error}");
}

#[test]
fn a_sphere_off_its_centre_is_refused_where_that_is_asked_for() {
    let subjects = Subjects::new(1);
    let sphere = icosphere(3);
    let moved = sphere.with_vertices(sphere.vertices.iter().map(|&[x, y, z]| [x + 0.2, y, z]).collect());
    write_mesh(subjects.path("sphere.ply"), &moved, &OPTIONS).expect("a sphere");
    let error = fail(&mut subjects.fit(&[1], &["--strict"]));
    assert!(error.contains("sphere.ply") && error.contains("% apart"), "{error}");
    assert!(errors(&mut subjects.fit(&[1], &[])).contains("% apart"));
}

#[test]
fn several_surfaces_mapped_apart_are_noted_not_to_correspond() {
    let subjects = Subjects::new(2);
    let fit = |subjects: &Subjects, count: u32| {
        let mut fit = tool("fit");
        fit.arg("--surface").args((1..=count).map(|subject| subjects.surface(subject))).args(BY_SUBJECT);
        errors(fit.args(["--max-degree", "4", "--force", "-o"]).arg(subjects.path("out")))
    };
    assert!(fit(&subjects, 2).contains("don't correspond"));
    assert!(!fit(&subjects, 1).contains("don't correspond"));
}

#[test]
fn too_little_memory_is_refused_before_the_mapping() {
    let folder = tempfile::tempdir().expect("a folder");
    let (surface, _) = cortex(&Cortex { subdivisions: 3, variant: 0 });
    write_mesh(folder.path().join("s.ply"), &surface, &OPTIONS).expect("a mesh");
    let mut fit = tool("fit");
    fit.arg("--surface").arg(folder.path().join("s.ply")).args(["--max-degree", "8", "--memory", "4MiB", "-v", "-o"]);
    let output = finish(fit.arg(folder.path().join("out")));
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(
        stderr.contains("a memory budget of 4MiB is too small")
            && stderr.contains("MiB are needed; give a budget with --memory"),
        "{stderr}"
    );
    assert!(!stderr.contains("coarse to fine") && !folder.path().join("out").exists(), "{stderr}");
}

#[test]
fn the_report_gets_its_folder_and_the_table_names_the_models() {
    let subjects = Subjects::new(2);
    let report = subjects.path("new/report.json");
    let mut fit = subjects.fit(&[1, 2], &BY_SUBJECT);
    let table = succeed(fit.arg("--report").arg(&report));
    for name in ["sub-01.lh.pial", "sub-02.lh.pial"] {
        assert!(table.lines().any(|line| line.starts_with(name)), "{table}");
    }
    let report: Value = serde_json::from_slice(&std::fs::read(report).expect("a report")).expect("JSON");
    assert_eq!(report["surfaces"][1]["name"], "sub-02.lh.pial");
    // A report whose path can't be written is refused before the fit.
    let mut fit = subjects.fit(&[1, 2], &BY_SUBJECT);
    fail(fit.arg("--force").arg("--report").arg(subjects.path("sphere.ply/report.json")));
}

#[test]
fn an_output_is_a_model_or_a_folder() {
    let subjects = Subjects::new(1);
    let fit = |output: &str| {
        let mut fit = tool("fit");
        fit.arg("--sphere").arg(subjects.path("sphere.ply")).arg("--surface").arg(subjects.surface(1));
        fit.args(["--max-degree", "4", "-q", "-o"]).arg(Path::new(&subjects.path(output)));
        fit
    };
    let error = fail(&mut fit("m/sub-01.csv"));
    assert!(error.contains("sub-01.csv") && error.contains(".npz"), "{error}");
    succeed(&mut fit("v1.2"));
    assert!(subjects.path("v1.2/lh.pial.spharm.npz").exists());
}

/// Models are compared where meshes are, by surface distance; a mesh in place of a model is named, with the verb that
/// makes a model of it.
#[test]
fn models_of_separate_maps_are_compared_by_their_surfaces() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    // The same surface with its vertices in two orders, so that it is mapped in two ways.
    let mesh = cortex(&Cortex { subdivisions: 3, variant: 0 }).0;
    let count = mesh.vertices.len();
    let vertices: Vec<[f64; 3]> = (0..count).map(|v| mesh.vertices[(v * 5 + 7) % count]).collect();
    let mut number = vec![0; count];
    (0..count).for_each(|v| number[(v * 5 + 7) % count] = v as u32);
    let faces = mesh.faces.iter().rev().map(|&[a, b, c]| [b, c, a].map(|v| number[v as usize])).collect();
    write_mesh(at("a.ply"), &mesh, &OPTIONS).unwrap();
    write_mesh(at("b.ply"), &Mesh::new(vertices, faces), &OPTIONS).unwrap();
    for name in ["a", "b"] {
        let mut fit = tool("fit");
        fit.arg("--surface").arg(at(&format!("{name}.ply"))).args(["-q", "--max-degree", "15", "-o"]);
        succeed(fit.arg(at(&format!("{name}.spharm.npz"))));
    }
    let models = ["a.spharm.npz", "b.spharm.npz"].map(at);
    let output = finish(tool("compare").args(&models).arg("--json"));
    assert!(output.status.success() && text(&output).contains("mapped separately"), "{}", text(&output));
    let found: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert!(found["msd"].is_null() && found["surface_distance"]["rms"].is_number(), "{found}");
    let same = finish(tool("compare").args([&models[0], &models[0]]).arg("--json"));
    let same: Value = serde_json::from_slice(&same.stdout).expect("JSON");
    assert_eq!(same["msd"], 0.0, "{same}");
}

#[test]
fn models_are_compared_and_meshes_are_not_taken_for_models() {
    let subjects = Subjects::new(1);
    succeed(&mut subjects.fit(&[1], &[]));
    let (surface, model) = (subjects.surface(1), subjects.path("out/lh.pial.spharm.npz"));
    let compare = |first: &Path, second: &Path| {
        let output = finish(tool("compare").args([first, second]).arg("--json"));
        assert!(output.status.success(), "{}", text(&output));
        serde_json::from_slice::<Value>(&output.stdout).expect("JSON")
    };
    let both = compare(&surface, &model);
    let distance = both["surface_distance"]["rms"].as_f64().expect("a number");
    // The model of degree 6 of a folded surface leaves detail out.
    assert!(distance > 1e-3 && both["msd"].is_null(), "{both}");
    assert!(compare(&model, &model)["surface_distance"]["hausdorff"].as_f64().expect("a number") < 1e-12);
    let error = fail(tool("shape").args(["compress", "--tolerance", "0.01", "-o", "x.sphz"]).arg(&surface));
    assert!(
        error.contains("this file is a mesh; make a model with `spharm fit --surface ")
            && error.ends_with("--max-degree L`"),
        "{error}"
    );
}
