//! Tests `freesurfer` on complete and broken subjects.

use std::path::PathBuf;

use serde_json::Value;
use spharm_model::Model;
use spharm_surface::Signal;
use spharm_surface::generate::{Cortex, cortex, icosphere};
use spharm_surface::io::{read_mesh, read_signal, write_mesh, write_signal};

use crate::common::{error_line, finish, succeed, text, tool};
use crate::first_users::OPTIONS;

/// A SUBJECTS_DIR with two subjects, of which the second has more vertices.
struct Subjects {
    folder: tempfile::TempDir,
}

impl Subjects {
    fn new() -> Self {
        let subjects = Self { folder: tempfile::tempdir().expect("a folder") };
        for (number, name) in ["bert", "ernie b."].into_iter().enumerate() {
            std::fs::create_dir_all(subjects.path(&format!("{name}/surf"))).expect("a folder");
            for (hemisphere, side) in [("lh", 0), ("rh", 1)] {
                let subdivisions = 3 + number as u32;
                let (surface, sphere) = cortex(&Cortex { subdivisions, variant: 2 * number as u64 + side });
                let write = |kind: &str, mesh| {
                    write_mesh(subjects.path(&format!("{name}/surf/{hemisphere}.{kind}")), mesh, &OPTIONS)
                        .expect("a mesh");
                };
                write("white", &surface);
                write("sphere.reg", &sphere);
                let thickness: Vec<f64> = sphere.vertices.iter().map(|p| 2.0 + p[0] * p[1]).collect();
                let path = subjects.path(&format!("{name}/surf/{hemisphere}.thickness"));
                write_signal(path, &Signal::new(thickness, sphere.vertices.len(), 1), &OPTIONS).expect("values");
            }
        }
        std::fs::create_dir_all(subjects.path("fsaverage5/surf")).expect("a folder");
        subjects
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join("subjects").join(name)
    }

    fn run(&self, arguments: &[&str]) -> std::process::Command {
        let mut command = tool("freesurfer");
        command.args(["subjects", "--max-degree", "5", "-o", "out", "--no-surface-distance"]).args(arguments);
        command.current_dir(self.folder.path());
        command
    }

    fn out(&self, name: &str) -> PathBuf {
        self.folder.path().join("out").join(name)
    }
}

#[test]
fn every_subject_is_fitted_on_its_own_sphere_and_seen_on_a_common_one() {
    let subjects = Subjects::new();
    let all = ["--surface", "white", "--signal", "thickness", "--evaluate-on", "icosphere:2", "-q"];
    succeed(&mut subjects.run(&all));
    for (name, vertices) in [("bert", 642), ("ernie b.", 2562)] {
        for hemisphere in ["lh", "rh"] {
            let id = format!("{name}.{hemisphere}.white");
            let model = Model::read(subjects.out(&format!("{id}.spharm.npz"))).expect("a model");
            assert_eq!(model.sphere.as_ref().map(|sphere| sphere.directions.len()), Some(vertices));
            assert_eq!(model.provenance.id, Some(id.clone()));
            let mesh = read_mesh(subjects.out(&format!("{id}.ico2.surf.gii"))).expect("a mesh");
            assert_eq!(mesh.faces, icosphere(2).faces);
            let values =
                read_signal(subjects.out(&format!("{name}.{hemisphere}.thickness.ico2.shape.gii"))).expect("values");
            // The values have degree 2, so the model is exact for any vertices.
            let sphere = icosphere(2);
            let off = values.values.iter().zip(&sphere.vertices).map(|(value, p)| value - 2.0 - p[0] * p[1]);
            assert!(off.fold(0.0f64, |most, off| most.max(off.abs())) < 1e-5);
        }
    }
    // The files record the anatomical structure, which Connectome Workbench requires.
    for (name, cortex) in [("bert.lh.white.ico2.surf", "CortexLeft"), ("bert.rh.thickness.ico2.shape", "CortexRight")] {
        let written = std::fs::read_to_string(subjects.out(&format!("{name}.gii"))).expect("a file");
        assert!(written.contains("AnatomicalStructurePrimary") && written.contains(cortex), "{name}");
    }
    assert!(!subjects.out("fsaverage5.lh.white.spharm.npz").exists());
    let again: Vec<&str> = all.iter().copied().chain(["--skip-existing"]).collect();
    assert!(succeed(&mut subjects.run(&again)).contains("nothing to do"));
    // A missing companion file of an existing model is made again.
    std::fs::remove_file(subjects.out("bert.lh.thickness.ico2.shape.gii")).expect("it is there");
    assert!(succeed(&mut subjects.run(&again)).contains("bert.lh.thickness"));
    assert!(subjects.out("bert.lh.thickness.ico2.shape.gii").exists());
}

#[test]
fn broken_subjects_are_named_and_stop_no_other() {
    let subjects = Subjects::new();
    // Create three faults: a missing sphere, another subject's sphere, and a mirrored sphere.
    std::fs::remove_file(subjects.path("bert/surf/rh.sphere.reg")).expect("it is there");
    let other = subjects.path("ernie b./surf/lh.sphere.reg");
    std::fs::copy(&other, subjects.path("bert/surf/lh.sphere.reg")).expect("copied");
    let right = subjects.path("ernie b./surf/rh.sphere.reg");
    let mut mirrored = read_mesh(&right).expect("a sphere");
    mirrored.vertices.iter_mut().for_each(|p| p[0] = -p[0]);
    write_mesh(&right, &mirrored, &OPTIONS).expect("a sphere");
    let all = ["--surface", "white", "--signal", "thickness", "--report", "r.json"];
    let output = finish(&mut subjects.run(&all));
    assert!(error_line(&output).contains("6 of 8 surfaces failed"), "{}", text(&output));
    let report: Value =
        serde_json::from_slice(&std::fs::read(subjects.folder.path().join("r.json")).expect("a report")).expect("JSON");
    let error = |id: &str| {
        let failed = report["failed"].as_array().expect("a list").iter().find(|failed| failed["id"] == id);
        failed.unwrap_or_else(|| panic!("{id} failed: {report}"))["error"].to_string()
    };
    assert!(error("bert.rh.white").contains("rh.sphere.reg"));
    assert!(error("bert.lh.thickness").contains("642") && error("bert.lh.white").contains("2562"));
    assert!(error("ernie b..rh.white").contains("reverses the orientation of the surface"), "{report}");
    assert!(error("ernie b..rh.thickness").contains("reverses the orientation of the surface"), "{report}");
    assert!(subjects.out("ernie b..lh.white.spharm.npz").exists());
}

/// Values of a hemisphere can't show whether the sphere belongs to the hemisphere, but the hemisphere's surfaces can:
/// the white surface or, if it is missing, another one.
#[test]
fn values_are_held_against_the_surfaces_of_their_hemisphere() {
    let subjects = Subjects::new();
    let bert = |name: &str| subjects.path(&format!("bert/surf/{name}"));
    let fit = ["--signal", "thickness", "--subject", "bert", "--hemi", "rh"];
    // Use the other hemisphere's sphere, which has the same number of vertices but different triangles.
    let mut other = read_mesh(bert("lh.sphere.reg")).expect("a sphere");
    other.faces.iter_mut().for_each(|face| *face = face.map(|vertex| (vertex + 1) % 642));
    std::fs::rename(bert("rh.white"), bert("rh.pial")).expect("moved");
    let good = std::fs::read(bert("rh.sphere.reg")).expect("a sphere");
    std::fs::remove_file(bert("rh.sphere.reg")).expect("it is there");
    write_mesh(bert("rh.sphere.reg"), &other, &OPTIONS).expect("a sphere");
    let output = finish(&mut subjects.run(&fit));
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        !output.status.success() && said.contains("rh.thickness: the sphere doesn't match the surface of these values"),
        "{said}"
    );
    std::fs::write(bert("rh.sphere.reg"), good).expect("a sphere");
    let mut mirrored = read_mesh(bert("rh.sphere.reg")).expect("a sphere");
    mirrored.vertices.iter_mut().for_each(|p| p[0] = -p[0]);
    std::fs::remove_file(bert("rh.sphere.reg")).expect("it is there");
    write_mesh(bert("rh.sphere.reg"), &mirrored, &OPTIONS).expect("a sphere");
    let output = finish(&mut subjects.run(&fit));
    assert!(error_line(&output).contains("1 of 1 surface"), "{}", text(&output));
    assert!(
        text(&output).contains("rh.thickness: ") && text(&output).contains("reverses the orientation of the surface"),
        "{}",
        text(&output)
    );
    assert!(!subjects.out("bert.rh.thickness.spharm.npz").exists());
    // For a truncated file, the error doesn't mention hemispheres.
    let bytes = std::fs::read(bert("lh.white")).expect("a surface");
    std::fs::write(bert("lh.white"), &bytes[..bytes.len() / 2]).expect("written");
    let output = finish(&mut subjects.run(&["--surface", "white", "--subject", "bert", "--hemi", "lh"]));
    assert!(!output.status.success() && !text(&output).contains("hemisphere"), "{}", text(&output));
}

#[test]
fn the_other_hemispheres_sphere_is_known_by_its_vertices() {
    let subjects = Subjects::new();
    let bert = |name: &str| subjects.path(&format!("bert/surf/{name}"));
    for kind in ["white", "sphere.reg"] {
        std::fs::copy(subjects.path(&format!("ernie b./surf/rh.{kind}")), bert(&format!("rh.{kind}"))).expect("copied");
    }
    std::fs::copy(bert("rh.sphere.reg"), bert("lh.sphere.reg")).expect("copied");
    let output = finish(&mut subjects.run(&["--surface", "white", "--subject", "bert", "--hemi", "lh"]));
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(said.contains("rh.white; is this the sphere of the other hemisphere?"), "{said}");
    let missing = finish(&mut subjects.run(&["--surface", "white", "--subject", "oscar"]));
    assert!(error_line(&missing).contains("oscar: no such subject"));
}

/// Writes a FreeSurfer label of the vertices for which `keep` is true.
pub(crate) fn write_label(path: &std::path::Path, vertices: &[[f64; 3]], keep: impl Fn(&[f64; 3]) -> bool) {
    let kept: Vec<String> = (0..vertices.len())
        .filter(|&v| keep(&vertices[v]))
        .map(|v| format!("{v}  {:.3}  {:.3}  {:.3} 0.000000\n", vertices[v][0], vertices[v][1], vertices[v][2]))
        .collect();
    std::fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
    let head = "#!ascii label  , from subject bert vox2ras=TkReg\n";
    std::fs::write(path, format!("{head}{}\n{}", kept.len(), kept.concat())).expect("a label");
}

/// Row 6 of the problems of first-time users: values on the medial wall aren't a thickness, so the model ignores them
/// and extrapolates from the cortex's edge.
#[test]
fn values_outside_of_the_cortex_are_continued_from_its_edge() {
    let subjects = Subjects::new();
    let bert = |name: &str| subjects.path(&format!("bert/{name}"));
    let sphere = read_mesh(bert("surf/lh.sphere.reg")).expect("a sphere");
    let inside = |p: &[f64; 3]| p[0] / (p[0] * p[0] + p[1] * p[1] + p[2] * p[2]).sqrt() < 0.8;
    write_label(&bert("label/lh.cortex.label"), &sphere.vertices, inside);
    // Values are 2.5 on the cortex, and zero or missing on the medial wall.
    let write = |name: &str, wall: f64| {
        let value = |p: &[f64; 3]| if inside(p) { 2.5 } else { wall };
        let values = Signal::new(sphere.vertices.iter().map(value).collect(), sphere.vertices.len(), 1);
        write_signal(bert(&format!("surf/lh.{name}")), &values, &OPTIONS).expect("values");
    };
    write("wall", 0.0);
    let fit = |more: &[&str]| {
        let mut fit = subjects.run(&["--signal", "wall", "--subject", "bert", "--hemi", "lh", "--evaluate-on"]);
        fit.arg("icosphere:3").args(more);
        fit
    };
    let range = || {
        let found = read_signal(subjects.out("bert.lh.wall.ico3.shape.gii")).expect("values").values;
        let [low, high] = [f64::min, f64::max].map(|of| found.iter().copied().reduce(of).expect("values"));
        high - low
    };
    let output = finish(&mut fit(&[]));
    assert!(output.status.success() && !text(&output).contains("warning"), "{}", text(&output));
    // The model is constant up to GIfTI's single precision, so no zero of the wall was read.
    assert!(range() < 1e-5, "{}", range());
    let model = Model::read(subjects.out("bert.lh.wall.spharm.npz")).expect("a model");
    assert!(model.provenance.region.is_some_and(|region| region.path.ends_with("lh.cortex.label")));
    assert!(succeed(&mut fit(&["--skip-existing"])).contains("nothing to do"));
    let output = finish(&mut fit(&["--skip-existing", "--mask", "none"]));
    assert!(text(&output).contains("region") && !output.status.success(), "{}", text(&output));
    succeed(&mut fit(&["--force", "--mask", "none"]));
    assert!(range() > 1.0, "the zeros are fitted where that is asked for: {}", range());
    // Another label can be given by its name.
    write_label(&bert("label/lh.small.label"), &sphere.vertices, |p| inside(p) && p[1] > 0.0);
    succeed(&mut fit(&["--force", "--mask", "small"]));
    let output = finish(&mut fit(&["--force", "--mask", "absent"]));
    let expected =
        "lh.absent.label: no such file; --mask absent expects the labels lh.absent.label and rh.absent.label";
    assert!(text(&output).contains(expected), "{}", text(&output));
    write_label(&bert("label/lh.other.label"), &[[0.0; 3]; 900], |_| true);
    let output = finish(&mut fit(&["--force", "--mask", "other"]));
    assert!(text(&output).contains("expected vertex numbers below 642"), "{}", text(&output));
    // Without a label, all values are read, and a note says so.
    std::fs::remove_file(bert("label/lh.cortex.label")).expect("it is there");
    let output = finish(&mut fit(&["--force"]));
    assert!(
        output.status.success() && text(&output).contains("no label/?h.cortex.label for bert lh"),
        "{}",
        text(&output)
    );
}

/// A non-finite value within the cortex is an error: it isn't extrapolated.
#[test]
fn infinite_values_inside_of_the_cortex_are_refused() {
    let subjects = Subjects::new();
    let bert = |name: &str| subjects.path(&format!("bert/{name}"));
    let sphere = read_mesh(bert("surf/lh.sphere.reg")).expect("a sphere");
    let inside = |p: &[f64; 3]| p[0] < 0.0;
    write_label(&bert("label/lh.cortex.label"), &sphere.vertices, inside);
    let at = sphere.vertices.iter().position(inside).expect("a vertex of the cortex");
    let mut values = vec![2.5; sphere.vertices.len()];
    let mut fit = |name: &str, value: f64| {
        values[at] = value;
        // FreeSurfer's curv format, big-endian: a magic number, number of vertices, number of faces, values per vertex,
        // the values.
        let mut bytes = vec![255; 3];
        [values.len() as u32, sphere.faces.len() as u32, 1].iter().for_each(|n| bytes.extend(n.to_be_bytes()));
        values.iter().for_each(|value| bytes.extend((*value as f32).to_be_bytes()));
        std::fs::write(bert(&format!("surf/lh.{name}")), bytes).expect("values");
        finish(&mut subjects.run(&["--signal", name, "--subject", "bert", "--hemi", "lh"]))
    };
    let output = fit("wide", f64::INFINITY);
    assert!(!output.status.success() && text(&output).contains("finite"), "{}", text(&output));
    assert!(!subjects.out("bert.lh.wide.spharm.npz").exists());
    // A missing value (NaN) gets weight 0.
    let output = fit("missing", f64::NAN);
    assert!(output.status.success(), "{}", text(&output));
}

/// Problem of first-time users, row 5: subjects that recon-all didn't finish are listed before the fits.
#[test]
fn subjects_that_recon_all_did_not_finish_are_named_before_the_fits() {
    let subjects = Subjects::new();
    for name in ["sub-04/mri", "sub-07/scripts", ".cache"] {
        std::fs::create_dir_all(subjects.path(name)).expect("a folder");
    }
    std::fs::write(subjects.path("README"), "not a subject").expect("a file");
    let dry = ["--surface", "white", "--hemi", "lh", "--dry-run", "--report", "dry.json"];
    let output = finish(&mut subjects.run(&dry));
    let said = text(&output);
    assert!(
        output.status.success() && said.contains("skipped 2 folders without a folder `surf`: sub-04, sub-07"),
        "{said}"
    );
    // One subject has an empty surface, the other has another subject's sphere.
    std::fs::write(subjects.path("bert/surf/lh.white"), "").expect("a file");
    let sphere = subjects.path("bert/surf/lh.sphere.reg");
    std::fs::copy(&sphere, subjects.path("ernie b./surf/lh.sphere.reg")).expect("copied");
    let output = finish(&mut subjects.run(&dry));
    let said = text(&output);
    assert!(!output.status.success() && said.contains("2 surfaces would fail"), "{said}");
    assert!(said.contains("bert.lh.white: ") && said.contains("the file is empty"), "{said}");
    assert!(said.contains("2562 vertices, ") && said.contains("sphere.reg has 642"), "{said}");
}

/// Problem of first-time users, row 24: models are evaluated at the vertices of another subject's spheres, each
/// hemisphere at its own.
#[test]
fn models_are_evaluated_on_the_spheres_of_a_subject() {
    let subjects = Subjects::new();
    for hemi in ["lh", "rh"] {
        for name in ["white", "sphere.reg"] {
            let file = |subject: &str| subjects.path(&format!("{subject}/surf/{hemi}.{name}"));
            std::fs::copy(file("ernie b."), file("fsaverage5")).expect("a copy");
        }
    }
    let evaluated = |on: &str| finish(&mut subjects.run(&["--surface", "white", "--force", "--evaluate-on", on]));
    let read = |name: &str| read_mesh(subjects.out(name)).expect("a mesh").vertices;
    let output = evaluated("fsaverage5");
    assert!(output.status.success(), "{}", text(&output));
    let by_name = ["lh", "rh"].map(|hemi| read(&format!("bert.{hemi}.white.fsaverage5.surf.gii")));
    for (hemi, found) in ["lh", "rh"].iter().zip(&by_name) {
        let model = Model::read(subjects.out(&format!("bert.{hemi}.white.spharm.npz"))).expect("a model");
        let sphere =
            spharm_surface::read_sphere(subjects.path(&format!("fsaverage5/surf/{hemi}.sphere.reg"))).expect("one");
        let expected = model.reconstruct(&sphere, 5).expect("a surface").vertices;
        assert_eq!(found.len(), expected.len());
        let far = found.iter().zip(&expected).flat_map(|(a, b)| (0..3).map(|k| (a[k] - b[k]).abs()));
        assert!(far.fold(0.0, f64::max) < 1e-4, "GIfTI has single precision");
    }
    let output = evaluated("subjects/fsaverage5/surf/rh.sphere.reg");
    assert!(output.status.success(), "{}", text(&output));
    assert_eq!(["lh", "rh"].map(|hemi| read(&format!("bert.{hemi}.white.fsaverage5.surf.gii"))), by_name);
    // The same sphere, given by its path in the folder of its subject.
    let mut within = tool("freesurfer");
    within.args(["..", "--subject", "bert", "--surface", "white", "--max-degree", "5", "--no-surface-distance", "-q"]);
    within.args(["--evaluate-on", "surf/rh.sphere.reg", "-o", "../../within"]).current_dir(subjects.path("fsaverage5"));
    succeed(&mut within);
    assert!(subjects.path("../within/bert.lh.white.fsaverage5.surf.gii").is_file());
    // File names in BIDS also state the hemisphere.
    let copy = |hemi: &str, name: &str| {
        let from = subjects.path(&format!("fsaverage5/surf/{hemi}.sphere.reg"));
        std::fs::copy(from, subjects.path(&format!("../{name}"))).expect("a copy");
    };
    copy("lh", "avg_hemi-L_sphere");
    let output = evaluated("avg_hemi-L_sphere");
    assert!(error_line(&output).contains("found no avg_hemi-R_sphere"), "{}", text(&output));
    copy("rh", "avg_hemi-R_sphere");
    assert!(evaluated("avg_hemi-L_sphere").status.success());
    assert_eq!(["lh", "rh"].map(|hemi| read(&format!("bert.{hemi}.white.avg_sphere.surf.gii"))), by_name);
    let output = evaluated("fsaverage6");
    assert!(
        !output.status.success() && error_line(&output).contains("found no subjects/fsaverage6/surf/lh.sphere.reg")
    );
    std::fs::remove_file(subjects.path("fsaverage5/surf/lh.sphere.reg")).expect("a file");
    let output = evaluated("subjects/fsaverage5/surf/rh.sphere.reg");
    assert!(error_line(&output).contains("the sphere of the other hemisphere"), "{}", text(&output));
}
