//! Models, spheres and masks of both hemispheres in one call.

use std::fs;
use std::path::Path;

use serde_json::{Value, json};
use spharm_surface::generate::icosphere;
use spharm_surface::io::write_mesh;

use crate::common::{error_line, finish, succeed, text, tool};
use crate::first_users::OPTIONS;
use crate::freesurfer::write_label;
use crate::shape_means::{growing, test};

/// Creates models of ten subjects, of the left side in the folder `left` and of the right side in `right`; and a sphere
/// and a label of the right side.
fn site() -> tempfile::TempDir {
    site_of(["lh", "rh"])
}

/// Creates the same files, with other names of the sides in the names of the models.
fn site_of([left, right]: [&str; 2]) -> tempfile::TempDir {
    let site = growing();
    for (from, to, side) in [("year1", "left", left), ("year2", "right", right)] {
        fs::create_dir(site.path().join(to)).expect("a folder");
        for subject in 0..10 {
            let from = site.path().join(format!("{from}/s{subject}.spharm.npz"));
            fs::rename(from, site.path().join(format!("{to}/s{subject}_{side}.spharm.npz"))).expect("a model");
        }
    }
    let sphere = icosphere(2);
    write_mesh(site.path().join("rh.sphere.reg"), &sphere, &OPTIONS).expect("a sphere");
    write_label(&site.path().join("rh.cortex.label"), &sphere.vertices, |p| p[0] < 0.9);
    site
}

fn paired(site: &Path, right: &str, more: &[&str]) -> std::process::Output {
    let mut command = tool("shape");
    command.args(["test", "--a", "left", "--b", right, "--paired", "--permutations", "0", "-o", "test", "--force"]);
    finish(command.args(more).current_dir(site))
}

#[test]
fn left_and_right_models_are_compared_only_when_mirrored() {
    let site = site();
    let site = site.path();
    let sampling = ["--icosphere", "1"];
    let output = paired(site, "right", &sampling);
    let expected =
        "left/s0_lh.spharm.npz belongs to the left hemisphere, but right/s0_rh.spharm.npz belongs to the right";
    assert!(output.status.success() && text(&output).contains(expected), "{}", text(&output));
    succeed(tool("shape").args(["rotate", "right", "--mirror", "-o", "mirrored"]).current_dir(site));
    let output = paired(site, "mirrored", &sampling);
    assert!(output.status.success() && !text(&output).contains("hemisphere"), "{}", text(&output));
    let files = ["--sphere", "rh.sphere.reg", "--mask", "rh.cortex.label"];
    let said = text(&paired(site, "mirrored", &files));
    for file in ["rh.sphere.reg", "rh.cortex.label"] {
        let expected = format!(
            "{file}: this file belongs to the right hemisphere, but the model left/s0_lh.spharm.npz belongs to the left"
        );
        assert!(said.contains(&expected), "{said}");
    }
}

#[test]
fn letters_in_names_state_the_sides_of_pairs() {
    let site = site_of(["L", "R"]);
    let site = site.path();
    let sampling = ["--icosphere", "1"];
    let said = text(&paired(site, "right", &sampling));
    let expected =
        "left/s0_L.spharm.npz belongs to the left hemisphere, but right/s0_R.spharm.npz belongs to the right";
    assert!(said.contains(expected) && !said.contains("to join different subjects"), "{said}");
    succeed(tool("shape").args(["rotate", "right", "--mirror", "-o", "mirrored"]).current_dir(site));
    let output = paired(site, "mirrored", &sampling);
    assert!(output.status.success() && !text(&output).contains("hemisphere"), "{}", text(&output));
    // Groups may have names that end in letters.
    let groups = ["--a", "left", "--b", "right", "--permutations", "0", "-o", "groups"];
    let output = finish(&mut test(site, &groups));
    assert!(output.status.success() && !text(&output).contains("hemisphere"), "{}", text(&output));
}

#[test]
fn pairs_of_different_subjects_are_named() {
    let site = site_of(["L", "R"]);
    let site = site.path();
    let rows = |by: usize| -> String {
        let row = |s: usize| format!("s{s},left/s{s}_L.spharm.npz,right/s{}_R.spharm.npz\n", (s + by) % 10);
        (0..10).map(row).collect()
    };
    for (by, is_shifted) in [(0, false), (1, true)] {
        fs::write(site.join("t.csv"), format!("id,left,right\n{}", rows(by))).expect("a table");
        let columns = ["--table", "t.csv", "--model-column", "left", "--minus", "right", "--mean"];
        let said = text(&finish(test(site, &columns).args(["--permutations", "0", "-o", "t", "--force"])));
        assert_eq!(said.contains("10 of 10 pairs seem to join different subjects"), is_shifted, "{said}");
    }
    // Each side lacks a subject, so the sides have equally many models.
    fs::remove_file(site.join("left/s3_L.spharm.npz")).expect("removed");
    fs::remove_file(site.join("right/s6_R.spharm.npz")).expect("removed");
    let said = text(&paired(site, "right", &["--icosphere", "1"]));
    let expected = "3 of 9 pairs seem to join different subjects, judging by the names of the models: \
                    left/s4_L.spharm.npz with right/s3_R.spharm.npz, ";
    assert!(said.contains(expected), "{said}");
    let about: Value =
        serde_json::from_str(&fs::read_to_string(site.join("test/test.json")).expect("a description")).expect("JSON");
    assert_eq!((&about["pairs"][2], &about["pairs"][3]), (&json!(["s2_L", "s2_R"]), &json!(["s4_L", "s3_R"])));
    assert!(about["warnings"].to_string().contains("to join different subjects"), "{about}");
}

#[test]
fn a_label_of_freesurfer_needs_its_sphere() {
    let site = site();
    let output = paired(site.path(), "right", &["--icosphere", "2", "--mask", "rh.cortex.label"]);
    let error = error_line(&output);
    let expected = "rh.cortex.label: expected a mask for the 162 vertices of an icosphere of 2 subdivisions, found a \
                    FreeSurfer label";
    assert!(error.contains(expected) && error.contains("with --sphere"), "{error}");
}

#[test]
fn a_fit_warns_of_the_mask_of_the_other_hemisphere() {
    let site = tempfile::tempdir().expect("a folder");
    let site = site.path();
    let made = ["--subdivisions", "2", "--surface", "lh.white", "--sphere", "lh.sphere.reg", "-q"];
    succeed(tool("generate").args(made).current_dir(site));
    write_label(&site.join("rh.cortex.label"), &icosphere(2).vertices, |p| p[0] < 0.9);
    let files = ["--surface", "lh.white", "--sphere", "lh.sphere.reg", "--mask", "rh.cortex.label"];
    let fit = |more: &str| {
        let settings = ["--max-degree", "3", "-o", "lh.white.spharm.npz", "-q", more];
        finish(tool("fit").args(files).args(settings).current_dir(site))
    };
    let expected =
        "lh.white: this file belongs to the left hemisphere, but the mask rh.cortex.label belongs to the right";
    let error = error_line(&fit("--strict"));
    assert!(error.contains(expected), "{error}");
    let output = fit("--force");
    assert!(output.status.success() && text(&output).contains(expected), "{}", text(&output));
}

#[test]
fn a_reconstruction_has_the_hemisphere_of_its_model() {
    let site = site();
    let site = site.path();
    let run = |verb: &str, arguments: &[&str]| finish(tool(verb).args(arguments).current_dir(site));
    let made = run("generate", &["--subdivisions", "2", "--surface", "lh.white", "--sphere", "lh.sphere.reg", "-q"]);
    assert!(made.status.success(), "{}", text(&made));
    let settings = ["--sphere", "lh.sphere.reg", "--max-degree", "4", "-q"];
    let fitted = run("fit", &[&["--surface", "lh.white", "-o", "lh.white.spharm.npz"][..], &settings].concat());
    assert!(fitted.status.success(), "{}", text(&fitted));
    let mirrored = run("shape", &["rotate", "lh.white.spharm.npz", "--mirror", "-o", "image.spharm.npz"]);
    assert!(mirrored.status.success(), "{}", text(&mirrored));
    for (model, cortex) in [("lh.white.spharm.npz", "CortexLeft"), ("image.spharm.npz", "CortexRight")] {
        let output = run("reconstruct", &[model, "-o", "again.surf.gii", "--force"]);
        assert!(output.status.success() && !text(&output).contains("hemisphere"), "{}", text(&output));
        let written = fs::read_to_string(site.join("again.surf.gii")).expect("a surface");
        assert!(written.contains(cortex), "{model}");
    }
    let output = run("reconstruct", &["lh.white.spharm.npz", "--sphere", "rh.sphere.reg", "-o", "other.ply"]);
    let expected = "lh.white.spharm.npz: this file belongs to the left hemisphere, but the sphere belongs to the right";
    assert!(output.status.success() && text(&output).contains(expected), "{}", text(&output));
}
