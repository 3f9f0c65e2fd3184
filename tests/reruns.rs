//! Repeated fits: which outputs are kept, replaced or refused.

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;
use spharm::Preparation;
use spharm::{FileRecord, FitParams, Model, Sphere, fit};
use spharm_cohort::files::{MadeOf, ModelFiles, Replace};
use spharm_cohort::rerun::{Decision, IfExists, Request};
use spharm_surface::generate::{Cortex, cortex};
use spharm_surface::io::{read_mesh, write_mesh};

use crate::common::{fail, succeed, tool};
use crate::first_users::{OPTIONS, Subjects, errors};
use crate::pipeline::{Study, names};

fn record(contents: &str) -> FileRecord {
    FileRecord { path: contents.to_owned(), bytes: 1, blake3: contents.repeat(64), ..FileRecord::default() }
}

/// Two cluster jobs write models of the same name; the model written first is kept.
#[test]
fn a_model_that_another_process_wrote_meanwhile_stays() {
    let folder = tempfile::tempdir().expect("a folder");
    let files = ModelFiles { model: folder.path().join("lh.spharm.npz") };
    let (surface, sphere) = cortex(&Cortex { subdivisions: 3, variant: 0 });
    let (sphere, params) = (Sphere::from_mesh(&sphere).expect("a sphere"), FitParams::lsq(4));
    let found = fit(&sphere, &surface, &params).expect("a fit");
    // The first job has written its table, but not yet its model.
    std::fs::write(files.csv(), "l,m").expect("a table");
    let [first, second] = ["a", "b"].map(record);
    let beside: [PathBuf; 1] = [files.csv()];
    let request = Request {
        id: None,
        input: &second,
        region: None,
        sphere: Some(&sphere),
        params: &params,
        preparation: Preparation::default(),
        output: &files.model,
        beside: &beside,
        if_exists: IfExists::Skip,
    };
    let decision = request.decide().expect("nothing is in the way");
    let Decision::Fit { replace, .. } = decision else { panic!("{decision:?}") };
    assert_eq!(replace, Replace { model: false, beside: true });
    let write = |input, replace| {
        let made_of = MadeOf { input: Some(input), ..MadeOf::default() };
        files.write(&sphere, &found, &made_of, true, replace)
    };
    write(&first, Replace::ALL).expect("the first's model");
    let table = std::fs::read(files.csv()).expect("a table");
    let error = write(&second, replace).expect_err("the model is there");
    assert!(error.to_string().contains("lh.spharm.npz"), "{error}");
    let model = Model::read(&files.model).expect("a model");
    assert_eq!(model.provenance.input, Some(first));
    assert_eq!(std::fs::read(files.csv()).expect("a table"), table);
}

/// Returns a `fit` of a surface that is first mapped to its own sphere.
fn map(surface: &Path, out: &Path, arguments: &[&str]) -> Command {
    let mut fit = tool("fit");
    fit.arg("--surface").arg(surface).arg("-o").arg(out).args(arguments);
    fit
}

#[test]
fn a_left_over_sphere_serves_its_own_input_and_degree_alone() {
    let subjects = Subjects::new(2);
    let (out, model, sphere) = (subjects.path("out"), "out/lh.pial.spharm.npz", "out/lh.pial.sphere.surf.gii");
    let rerun = |subject: u32, degree: &str, more: &[&str]| {
        let mut fit = map(&subjects.surface(subject), &out, &["--max-degree", degree]);
        fit.args(more);
        fit
    };
    succeed(&mut rerun(1, "4", &[]));
    std::fs::remove_file(subjects.path(model)).expect("it is there");
    let first = read_mesh(subjects.path(sphere)).expect("a sphere");
    // An existing sphere with the same triangles, but of another subject, is refused.
    let error = fail(&mut rerun(2, "4", &["--skip-existing"]));
    assert!(error.contains("lh.pial.sphere.surf.gii") && error.contains("sub-02"), "{error}");
    assert_eq!(read_mesh(subjects.path(sphere)).expect("a sphere"), first);
    // An existing sphere of the same surface, but mapped for another degree, is mapped again.
    assert!(errors(&mut rerun(1, "8", &["--skip-existing"])).contains("mapped by"));
    let again = std::fs::read(subjects.path(model)).expect("a model");
    succeed(&mut rerun(1, "8", &["--force"]));
    assert!(std::fs::read(subjects.path(model)).expect("a model") == again);
    succeed(&mut rerun(2, "4", &["--force"]));
}

#[test]
fn a_fit_that_fails_removes_the_files_that_it_made_and_no_others() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name);
    let (surface, _) = cortex(&Cortex { subdivisions: 3, variant: 0 });
    write_mesh(path("s.ply"), &surface, &OPTIONS).expect("a mesh");
    crate::volumes::write_volume(&path("cell.nii"), |at| u8::from(at.iter().all(|x| x.abs() < 4.0)));
    let fails = ["--max-degree", "8", "--strict", "--preconditioner", "none", "--max-iterations", "1"];
    for input in ["s.ply", "cell.nii"] {
        let error = fail(&mut map(&path(input), &path("out"), &fails));
        assert!(error.contains("optimality"), "{error}");
        assert!(names(&path("out")).is_empty(), "{:?}", names(&path("out")));
    }
    succeed(&mut map(&path("s.ply"), &path("out"), &["--max-degree", "8"]));
    std::fs::remove_file(path("out/s.spharm.npz")).expect("it is there");
    fail(map(&path("s.ply"), &path("out"), &fails).arg("--skip-existing"));
    assert_eq!(names(&path("out")), ["s.sphere.surf.gii"]);
}

#[test]
fn weights_and_the_settings_of_the_iteration_are_compared() {
    let subjects = Subjects::new(1);
    let weights = |name: &str, of: fn(u32) -> u32| {
        let text: String = (0..642).map(|row| format!("{}\n", of(row))).collect();
        std::fs::write(subjects.path(name), text).expect("weights");
    };
    let fit = |name: &str, more: &[&str]| {
        let mut fit = subjects.fit(&[1], &["--skip-existing", "--weights"]);
        fit.arg(subjects.path(name)).args(more);
        fit
    };
    weights("w.csv", |row| 1 + row % 2);
    succeed(&mut fit("w.csv", &[]));
    // The same weights file is given by another path.
    assert!(succeed(&mut fit("out/../w.csv", &[])).contains("nothing to do"));
    for (arguments, difference) in [
        (["--max-iterations", "7"], "max-iterations 3000, not 7"),
        (["--preconditioner", "density"], "preconditioner auto, not density"),
    ] {
        let error = fail(&mut fit("w.csv", &arguments));
        assert!(error.contains(difference), "{error}");
    }
    weights("w.csv", |row| 1 + row % 3);
    let error = fail(&mut fit("w.csv", &[]));
    assert!(error.contains("weights ") && error.contains("w.csv ("), "{error}");
}

#[test]
fn a_model_that_missed_the_tolerance_is_not_taken_where_that_is_an_error() {
    let subjects = Subjects::new(1);
    let fit = |more: &[&str]| {
        let mut fit = subjects.fit(&[1], &["--skip-existing", "--preconditioner", "none", "--max-iterations", "1"]);
        fit.args(more);
        fit
    };
    assert!(errors(&mut fit(&[])).contains("expected 1.0e-10"));
    assert!(succeed(&mut fit(&[])).contains("nothing to do"));
    let error = fail(&mut fit(&["--strict"]));
    assert!(error.contains("optimality ") && error.contains("not 1e-10"), "{error}");
}

#[test]
fn what_is_left_out_is_noted_and_reported() {
    let subjects = Subjects::new(2);
    let fit = |numbers: &[u32]| {
        let mut fit = tool("fit");
        fit.arg("--sphere").arg(subjects.path("sphere.ply")).arg("--surface");
        fit.args(numbers.iter().map(|&number| subjects.surface(number))).args(["--max-degree", "4", "--skip-existing"]);
        fit.args(["--name-template", "{parent2}", "-o"]).arg(subjects.path("out"));
        fit
    };
    let report = |numbers: &[u32]| -> Value {
        serde_json::from_str(&succeed(fit(numbers).arg("--json"))).expect("the report is JSON")
    };
    assert_eq!(report(&[1])["skipped"].as_array().map(Vec::len), Some(0));
    let both = report(&[1, 2]);
    assert_eq!(both["surfaces"].as_array().map(Vec::len), Some(1));
    let skipped = &both["skipped"][0];
    assert!(skipped["input"].as_str().is_some_and(|input| input.contains("sub-01")), "{skipped}");
    assert!(skipped["output"].as_str().is_some_and(|output| output.ends_with("sub-01.spharm.npz")), "{skipped}");
    assert_eq!(report(&[1, 2])["skipped"].as_array().map(Vec::len), Some(2));
    assert!(errors(&mut fit(&[1, 2])).contains("2 outputs exist and were skipped"));
}

/// The scalar type of the store is a setting, even without `--dtype`.
#[test]
fn a_store_of_another_precision_is_another_setting() {
    let study = Study::new();
    let fit = |more: &[&str]| {
        let mut fit = study.fit(&["s0.surf.gii"], &["--max-degree", "4"]);
        fit.args(more).arg("-o").arg(study.path("m.npz"));
        fit
    };
    succeed(&mut fit(&[]));
    assert!(succeed(&mut fit(&["--skip-existing"])).contains("nothing to do"));
    std::fs::remove_dir_all(study.path("store")).expect("removed");
    succeed(study.build(4).args(["--dtype", "f32"]));
    let error = fail(&mut fit(&["--skip-existing"]));
    assert!(error.contains("dtype f64, not f32"), "{error}");
    succeed(&mut fit(&["--update"]));
    assert!(succeed(&mut fit(&["--skip-existing"])).contains("nothing to do"));
}
