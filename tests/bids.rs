//! The BIDS app: derivative datasets of FreeSurfer's and sMRIPrep's subjects, and missing files in them.

use std::fs;
use std::path::Path;

use ndarray_npy::ReadNpyExt;
use serde_json::Value;
use spharm_model::Model;
use spharm_surface::io::{read_mesh, read_signal};

use crate::common::{error_line, fail, finish, succeed, text, tool};
use crate::store::namespace;

/// Writes a subject's hemispheres in FreeSurfer's layout.
fn freesurfer(subjects: &Path, subject: &str, hemispheres: &[&str], variant: u64) {
    let folder = subjects.join(subject).join("surf");
    fs::create_dir_all(&folder).expect("a folder");
    for hemisphere in hemispheres {
        let file = |name: &str| folder.join(format!("{hemisphere}.{name}"));
        let mut generate = tool("generate");
        generate.args(["--subdivisions", "3", "-q", "--variant", &variant.to_string()]);
        succeed(generate.arg("--surface").arg(file("pial")).arg("--sphere").arg(file("sphere.reg")));
    }
}

fn bids(site: &Path, arguments: &[&str]) -> std::process::Command {
    let mut command = tool("bids");
    command.current_dir(site).args(["data", "out"]).args(arguments).args(["--threads", "2", "-q"]);
    command
}

#[test]
fn a_study_of_freesurfer_s_subjects_becomes_a_derivative_dataset() {
    let site = tempfile::tempdir().expect("a folder");
    let subjects = site.path().join("data/derivatives/freesurfer");
    for (variant, subject) in ["sub-01", "sub-02", "sub-03"].into_iter().enumerate() {
        freesurfer(&subjects, subject, &["lh", "rh"], variant as u64);
    }
    let participant = ["participant", "--max-degree", "6", "--icosphere", "2"];
    succeed(&mut bids(site.path(), &participant));
    let at = |name: &str| site.path().join("out").join(name);
    let stem = |name: &str| at(&format!("sub-02/anat/sub-02_hemi-R_{name}"));
    let model = Model::read(stem("desc-spharm_pial.npz")).expect("a model");
    assert_eq!(model.coefficients.max_degree(), 6);
    let sidecar: Value =
        serde_json::from_str(&fs::read_to_string(stem("desc-spharm_pial.json")).expect("a file")).expect("JSON");
    assert_eq!(sidecar["MaximalDegree"], 6);
    assert!(sidecar["Sources"][0].as_str().expect("a path").ends_with("sub-02/surf/rh.pial"), "{sidecar}");
    let evaluated = read_mesh(stem("space-icosphere2_den-162_desc-spharm_pial.surf.gii")).expect("a mesh");
    assert_eq!(evaluated.vertices.len(), 162);
    let error = read_signal(stem("desc-spharmerror_pial.shape.gii")).expect("a map").values;
    let surface = read_mesh(subjects.join("sub-02/surf/rh.pial")).expect("a mesh");
    let fitted = model.reconstruct_original(6).expect("a mesh").mesh;
    for ((found, a), b) in error.iter().zip(&surface.vertices).zip(&fitted.vertices) {
        let expected = (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt();
        assert!((found - expected).abs() < 1e-5 * (1.0 + expected));
    }
    assert_eq!(fs::read_to_string(stem("desc-spharmpial_spectrum.tsv")).expect("a table").lines().count(), 7);
    assert!(at("sub-03.html").exists());
    let description = fs::read_to_string(at("dataset_description.json")).expect("a file");
    let description: Value = serde_json::from_str(&description).expect("JSON");
    assert_eq!(
        (&description["DatasetType"], &description["GeneratedBy"][0]["Name"]),
        (&"derivative".into(), &"spharm".into())
    );
    let participants = fs::read_to_string(at("participants.tsv")).expect("a table");
    assert_eq!(participants, "participant_id\nsub-01\nsub-02\nsub-03\n");

    // A second run for one subject changes nothing.
    let before = fs::read(stem("desc-spharm_pial.npz")).expect("a file");
    let one: Vec<&str> = participant.iter().copied().chain(["--participant-label", "02"]).collect();
    succeed(&mut bids(site.path(), &one));
    assert_eq!(fs::read(stem("desc-spharm_pial.npz")).expect("a file"), before);
    assert_eq!(fs::read_to_string(at("participants.tsv")).expect("a table"), participants);

    succeed(&mut bids(site.path(), &["group"]));
    let file = fs::File::open(at("group_hemi-L_pial_models.npz")).expect("a file");
    let mut arrays = zip::ZipArchive::new(file).expect("an archive");
    let array = arrays.by_name("coefficients.npy").expect("an array");
    let coefficients = ndarray::Array3::<f64>::read_npy(array).expect("numbers");
    assert_eq!(coefficients.dim(), (3, 49, 3));
    let third = Model::read(at("sub-03/anat/sub-03_hemi-L_desc-spharm_pial.npz")).expect("a model");
    assert_eq!(coefficients.index_axis(ndarray::Axis(0), 2), third.coefficients.values());
    assert!(at("group.html").exists() && at("group_hemi-R_pial.shape-model.npz").exists());
    // A run with another degree or icosphere belongs to another dataset and is refused without --force.
    for other in [["--max-degree", "5", "--icosphere", "2"], ["--max-degree", "6", "--icosphere", "1"]] {
        let arguments: Vec<&str> = ["participant", "--no-pages"].iter().chain(&other).copied().collect();
        assert!(fail(&mut bids(site.path(), &arguments)).contains("--force"), "{other:?}");
        assert_eq!(fs::read(stem("desc-spharm_pial.npz")).expect("a file"), before);
    }
    let forced = ["participant", "--no-pages", "--max-degree", "5", "--icosphere", "1", "--force"];
    succeed(&mut bids(site.path(), &forced));
    assert!(!stem("space-icosphere2_den-162_desc-spharm_pial.surf.gii").exists());
    let evaluated = fs::read_to_string(stem("space-icosphere1_den-42_desc-spharm_pial.surf.gii")).expect("a mesh");
    assert!(evaluated.contains("CortexRight"));
    let status = fs::read_to_string(at("group_status.tsv")).expect("a table");
    assert_eq!(status.lines().filter(|line| line.contains("\tdone\t")).count(), 6, "{status}");
}

#[test]
fn what_is_missing_is_said_and_costs_nobody_else_s_model() {
    let site = tempfile::tempdir().expect("a folder");
    let line = fail(&mut bids(site.path(), &["participant"]));
    assert!(line.contains("derivatives/smriprep"), "{line}");
    let subjects = site.path().join("data/sourcedata/freesurfer");
    freesurfer(&subjects, "sub-a", &["lh", "rh"], 0);
    freesurfer(&subjects, "sub-b", &["lh"], 1);
    fs::write(subjects.join("sub-a/surf/rh.pial"), "broken").expect("a file");
    let output =
        finish(&mut bids(site.path(), &["participant", "--max-degree", "4", "--icosphere", "1", "--no-pages"]));
    let line = error_line(&output);
    assert!(line.contains("2 surfaces could not be fitted"), "{line}");
    assert!(
        text(&output).contains("sub-b: found no surface hemi-R pial with a registered sphere"),
        "{}",
        text(&output)
    );
    for (subject, hemisphere, there) in [("a", "L", true), ("a", "R", false), ("b", "L", true), ("b", "R", false)] {
        let name = format!("out/sub-{subject}/anat/sub-{subject}_hemi-{hemisphere}_desc-spharm_pial.npz");
        assert_eq!(site.path().join(&name).exists(), there, "{name}");
    }
    // The group's table has the outcomes of both subjects.
    let group = finish(&mut bids(site.path(), &["group", "--no-pages"]));
    let status = fs::read_to_string(site.path().join("out/group_status.tsv")).expect("a table");
    assert!(status.contains("sub-a_hemi-R_pial\tfailed") && status.contains("sub-b_hemi-R_pial\tfailed"), "{status}");
    assert!(text(&group).contains("2 surfaces without a model"), "{}", text(&group));
    assert!(
        text(&group).contains("hemi-L pial: modes of variation need at least 3 models, found 2 models"),
        "{}",
        text(&group)
    );
    for (arguments, expected) in [
        (&["participant", "--participant-label", "c"][..], "no folder sub-c"),
        (&["participant", "--participant-label", "../a"][..], "letters and digits"),
        (&["participant", "--freesurfer", "nowhere"][..], "nowhere"),
    ] {
        let line = fail(&mut bids(site.path(), arguments));
        assert!(line.contains(expected), "{line}");
    }
    fs::write(site.path().join("out/dataset_description.json"), r#"{"Name": "raw data"}"#).expect("a file");
    let line = fail(&mut bids(site.path(), &["participant", "--max-degree", "4"]));
    assert!(line.contains("expected a dataset made by spharm"), "{line}");
}

#[test]
fn a_full_disk_is_said_to_be_one() {
    if !namespace::entered("bids::a_full_disk_is_said_to_be_one") {
        return;
    }
    let site = tempfile::tempdir().expect("a folder");
    freesurfer(&site.path().join("data/sourcedata/freesurfer"), "sub-a", &["lh", "rh"], 0);
    let out = site.path().join("out");
    fs::create_dir(&out).expect("a folder");
    for files in [2, 5, 6, 7, 8, 9, 10, 12, 14, 17] {
        namespace::mount(&out, 64 << 20);
        namespace::remount(&out, &format!("nr_inodes={files}"));
        let line =
            fail(&mut bids(site.path(), &["participant", "--max-degree", "2", "--icosphere", "0", "--no-pages"]));
        assert!(line.contains("No space left"), "{files} files: {line}");
        namespace::unmount(&out);
    }
}

#[test]
fn surfaces_of_smriprep_are_taken_with_their_sessions() {
    let site = tempfile::tempdir().expect("a folder");
    let folder = site.path().join("data/derivatives/smriprep/sub-01/ses-x/anat");
    fs::create_dir_all(&folder).expect("a folder");
    let file = |name: &str| folder.join(format!("sub-01_ses-x_hemi-L_{name}.surf.gii"));
    let mut generate = tool("generate");
    generate.args(["--subdivisions", "3", "-q"]);
    succeed(generate.arg("--surface").arg(file("pial")).arg("--sphere").arg(file("space-fsaverage_desc-reg_sphere")));
    // A surface in another space must not be taken for the subject's native one.
    fs::copy(file("pial"), file("space-fsLR_den-32k_pial")).expect("a copy");
    let arguments = ["participant", "--hemi", "L", "--max-degree", "5", "--icosphere", "1", "--no-pages"];
    succeed(&mut bids(site.path(), &arguments));
    let model = site.path().join("out/sub-01/ses-x/anat/sub-01_ses-x_hemi-L_desc-spharm_pial.npz");
    assert_eq!(Model::read(model).expect("a model").coefficients.max_degree(), 5);
}
