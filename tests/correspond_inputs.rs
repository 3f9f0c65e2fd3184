//! Groups brought into correspondence with further inputs besides surfaces: guiding landmarks, signals, labels of
//! volumes.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;
use spharm_model::Model;
use spharm_surface::Signal;
use spharm_surface::io::landmarks::Landmarks;
use spharm_surface::io::{WriteOptions, read_mesh, write_signal};

use crate::common::{fail, finish, succeed, text, tool};
use crate::volumes::write_volume;

/// Creates four boxes with growing bumps, and their landmarks.
fn boxes() -> tempfile::TempDir {
    let site = tempfile::tempdir().expect("a folder");
    let group = ["--group", "growing-bump", "--members", "4", "--subdivisions", "4", "--output-dir", "in", "-q"];
    succeed(tool("generate").args(group).current_dir(site.path()));
    site
}

/// Writes a signal, the closeness of each vertex to the first landmark, for a generated member in the folder `in`.
/// Returns the file, which is beside the member's mesh.
pub(crate) fn near_landmark(site: &Path, name: &str) -> String {
    let mesh = read_mesh(site.join(format!("in/{name}.ply"))).expect("a mesh");
    let mark = Landmarks::read(site.join(format!("in/{name}.json"))).expect("landmarks").points[0];
    let square = |v: &[f64; 3]| (0..3).map(|k| (v[k] - mark[k]).powi(2)).sum::<f64>();
    let values = mesh.vertices.iter().map(|v| (-square(v) / 20.0).exp()).collect();
    let signal = Signal { vertices: mesh.vertices.len(), channels: 1, values };
    let file = format!("in/{name}.near.shape.gii");
    write_signal(site.join(&file), &signal, &WriteOptions::default()).expect("written");
    file
}

fn correspond(site: &Path, inputs: &[&str], more: &[&str]) -> Command {
    let mut command = tool("shape");
    command.arg("correspond").args(inputs).args(["--max-degree", "6", "--subdivisions", "3", "-q", "--json"]);
    command.args(more).current_dir(site);
    command
}

const BOXES: [&str; 4] = ["in/s01.ply", "in/s02.ply", "in/s03.ply", "in/s04.ply"];

fn json(output: &str) -> Value {
    serde_json::from_str(output).expect("JSON")
}

fn sum(values: &Value) -> f64 {
    values.as_array().expect("numbers").iter().map(|value| value.as_f64().expect("a number")).sum()
}

#[test]
fn new_members_are_scaled_if_the_groups_members_were() {
    let site = boxes();
    let add = |group: &str, more: &[&str]| {
        let mut command = tool("shape");
        command.args(["correspond", "in/s04.ply", "--to", group, "-q", "-o"]).arg(format!("{group}-added"));
        command.args(more).current_dir(site.path());
        command
    };
    for (group, scale) in [("scaled", &["--scale"][..]), ("own", &[])] {
        let settings = [&["-o", group, "--no-refinement", "--rounds", "1"], scale].concat();
        succeed(&mut correspond(site.path(), &BOXES[..3], &settings));
        succeed(&mut add(group, &[]));
        let record = fs::read_to_string(site.path().join(format!("{group}-added/members/s04.json"))).expect("a record");
        let scaled = json(&record)["to_group"]["scale"] != 1.0;
        assert_eq!(scaled, !scale.is_empty(), "{record}");
    }
    fs::remove_dir_all(site.path().join("own-added")).expect("removed");
    let output = finish(&mut add("own", &["--scale"]));
    assert_eq!(output.status.code(), Some(2), "{}", text(&output));
    assert!(text(&output).contains("keep their own sizes"), "{}", text(&output));
    assert!(!site.path().join("own-added").exists());
}

#[test]
fn landmarks_that_guide_stay_together() {
    let site = boxes();
    let group = |more: &[&str]| {
        let marked = [&["--landmarks", "in", "-o", "group", "--force"], more].concat();
        json(&succeed(&mut correspond(site.path(), &BOXES, &marked)))["landmarks"].clone()
    };
    let (alone, guided) = (group(&[]), group(&["--guide", "--template", "in/s02.ply"]));
    assert!(alone["guide"].is_null());
    let (before, after) = (alone["mean"].as_f64().expect("a number"), guided["mean"].as_f64().expect("a number"));
    assert!(after < 0.5 * before, "{before} {after}");
    // Landmarks used as guides have smaller errors than landmarks excluded from guiding, whose errors are about as
    // large as without any guides.
    let (guide, count) = (&guided["guide"], guided["names"].as_array().map_or(0, Vec::len) as f64);
    assert!(sum(&guide["guided"]) < 0.5 * sum(&guide["left_out"]), "{guide}");
    assert!(sum(&guide["left_out"]) / count < 2.0 * before, "{guide} {before}");
    let wrong = |more: &[&str]| {
        let output = finish(&mut correspond(site.path(), &BOXES, &[&["-o", "none"], more].concat()));
        assert!(!output.status.success() && !site.path().join("none").exists());
        text(&output)
    };
    assert!(wrong(&["--guide"]).contains("--guide needs landmarks"));
    fs::copy(site.path().join("in/s01.ply"), site.path().join("other.ply")).expect("a copy");
    let error = wrong(&["--guide", "--landmarks", "in", "--template", "other.ply"]);
    assert!(error.contains("other.ply: with --guide, the template must be one of the surfaces"), "{error}");
}

#[test]
fn swapped_landmarks_are_named() {
    let site = boxes();
    let marks = site.path().join("marks");
    fs::create_dir(&marks).expect("a folder");
    for name in ["s01", "s02", "s03", "s04"] {
        let mut text = fs::read_to_string(site.path().join(format!("in/{name}.json"))).expect("landmarks");
        if name == "s03" {
            let [first, second] = ["corner-000", "corner-111"];
            text = text.replace(first, "other").replace(second, first).replace("other", second);
        }
        fs::write(marks.join(format!("{name}.json")), text).expect("landmarks");
    }
    let warnings = |more: &[&str]| {
        let arguments = [&["-o", "group", "--force"], more].concat();
        json(&succeed(&mut correspond(site.path(), &BOXES, &arguments)))["warnings"].to_string()
    };
    let once = ["--no-refinement", "--rounds", "1"];
    assert!(!warnings(&[&["--landmarks", "in"][..], &once].concat()).contains("swapped"));
    let guided = [&["--guide", "--template", "in/s03.ply"][..], &once].concat();
    for more in [&once[..], &["--guide", "--template", "in/s01.ply"], &guided] {
        let found = warnings(&[&["--landmarks", "marks"][..], more].concat());
        assert!(found.contains("s03: the landmarks corner-000 and corner-111 seem to be swapped"), "{more:?}: {found}");
    }
    // In a group of three, the landmarks are compared without usual places.
    let three = |marks: &str| {
        let more = ["--guide", "--template", "in/s01.ply", "--landmarks", marks, "-o", "three", "--force"];
        json(&succeed(&mut correspond(site.path(), &BOXES[..3], &more)))["warnings"].to_string()
    };
    let (sound, wrong) = (three("in"), three("marks"));
    assert!(!sound.contains("swapped") && !sound.contains("landmarks far"), "{sound}");
    let named = "the landmarks corner-000 and corner-111 seem to be swapped, on this surface or on another";
    assert!(wrong.contains(named), "{wrong}");
}

#[test]
fn landmarks_in_another_unit_do_not_guide() {
    let site = boxes();
    let marks = site.path().join("marks");
    fs::create_dir(&marks).expect("a folder");
    for name in ["s01", "s02", "s03", "s04"] {
        let mut own = Landmarks::read(site.path().join(format!("in/{name}.json"))).expect("landmarks");
        if name == "s02" {
            own.points.iter_mut().flatten().for_each(|x| *x *= 0.001);
        }
        own.write(marks.join(format!("{name}.csv")), false).expect("written");
    }
    let output = finish(&mut correspond(site.path(), &BOXES, &["--landmarks", "marks", "--guide", "-o", "none"]));
    let error = text(&output);
    assert!(!output.status.success() && !site.path().join("none").exists(), "{error}");
    assert!(error.contains("in/s02.ply: landmarks that guide a registration must lie near the surface"), "{error}");
    assert!(error.contains("multiplied by 1000, the landmarks lie on the surface"), "{error}");
    // Without guiding, the unit is only a warning.
    let arguments = ["--landmarks", "marks", "--no-refinement", "-o", "group"];
    let found = json(&succeed(&mut correspond(site.path(), &BOXES, &arguments)))["warnings"].to_string();
    assert!(found.contains("s02.csv: landmarks far from the surface: "), "{found}");
    assert!(found.contains("; multiplied by 1000, the landmarks lie on the surface"), "{found}");
    // Names in another spelling are named with their file.
    let text_of = fs::read_to_string(marks.join("s02.csv")).expect("landmarks");
    fs::write(marks.join("s02.csv"), text_of.to_uppercase()).expect("landmarks");
    let error = text(&finish(&mut correspond(site.path(), &BOXES, &["--landmarks", "marks", "-o", "none"])));
    assert!(error.contains("s02.csv has CORNER-000 instead of corner-000"), "{error}");
}

#[test]
fn signals_are_found_beside_the_surfaces_or_in_a_table() {
    let site = boxes();
    let mut table = String::from("id\tsurface\theight\n");
    for name in ["s01", "s02", "s03", "s04"] {
        let file = near_landmark(site.path(), name);
        table += &format!("{name}\tin/{name}.ply\t{file}\n");
    }
    fs::write(site.path().join("table.tsv"), table).expect("a table");
    let with = |inputs: &[&str], output: &str, signal: &str| {
        let more = ["-o", output, "--with", signal];
        succeed(&mut correspond(site.path(), inputs, &more));
        fs::read(site.path().join(output).join("s03.spharm.npz")).expect("a model")
    };
    let beside = with(&BOXES, "a", "{stem}.near.shape.gii:0.3");
    assert!(beside == with(&["--table", "table.tsv"], "b", "height:0.3"));
    assert!(beside != with(&BOXES, "c", "{stem}.near.shape.gii"));
    let wrong = |signal: &str| {
        let output = finish(&mut correspond(site.path(), &BOXES, &["-o", "none", "--with", signal]));
        assert!(!output.status.success() && !site.path().join("none").exists());
        text(&output)
    };
    assert!(wrong("height").contains("in/height: no such file"), "{}", wrong("height"));
    assert!(wrong("{stem}.near.shape.gii:-1").contains("a weight above 0"));
    // A signal with another number of vertices is refused with the surface's name.
    fs::copy(site.path().join("in/s01.near.shape.gii"), site.path().join("in/s03.near.shape.gii")).expect("a copy");
    let short = Signal { vertices: 3, channels: 1, values: vec![0.0, 1.0, 2.0] };
    let overwrite = WriteOptions { overwrite: true, ..WriteOptions::default() };
    write_signal(site.path().join("in/s03.near.shape.gii"), &short, &overwrite).expect("written");
    let error = wrong("{stem}.near.shape.gii");
    assert!(error.contains("in/s03.ply") && error.contains("found 3 values for"), "{error}");
}

#[test]
fn labels_of_volumes_correspond_without_their_steps() {
    let site = tempfile::tempdir().expect("a folder");
    let semiaxes: Vec<[f64; 3]> = (0..4).map(|k| [6.5, 4.6 + 0.2 * f64::from(k), 3.6]).collect();
    let paths: Vec<PathBuf> = (0..4).map(|k| site.path().join(format!("s{k}.nii"))).collect();
    for (path, [a, b, c]) in paths.iter().zip(&semiaxes) {
        // Label 1 is an ellipsoid, and label 2 lies beside it.
        write_volume(path, |[x, y, z]| {
            let inside = (x / a).powi(2) + (y / b).powi(2) + (z / c).powi(2) < 1.0;
            if x < -7.0 { 2 } else { u8::from(inside) }
        });
    }
    // Two of the headers have no sform; their voxel sizes give the same positions.
    for path in &paths[1..3] {
        let mut bytes = fs::read(path).expect("a volume");
        bytes[254] = 0;
        fs::write(path, bytes).expect("written");
    }
    let names: Vec<&str> = paths.iter().map(|path| path.to_str().expect("text")).collect();
    let output = finish(&mut correspond(site.path(), &names, &["-o", "group", "--label", "1"]));
    assert!(output.status.success(), "{}", text(&output));
    let printed = String::from_utf8_lossy(&output.stderr);
    assert_eq!(printed.matches("neither an sform").count(), 1, "{printed}");
    assert!(printed.contains("2 volumes, ") && printed.contains("s2.nii: the header has neither"), "{printed}");
    fs::copy(&paths[1], site.path().join("new.nii")).expect("a copy");
    let add = ["correspond", "new.nii", "--to", "group", "--label", "1", "-o", "added", "-q", "--json"];
    let added = json(&succeed(tool("shape").args(add).current_dir(site.path())));
    let warned = |text: &Value| text.as_str().is_some_and(|text| text.starts_with("new.nii: the header has neither"));
    assert!(added["warnings"].as_array().is_some_and(|warnings| warnings.iter().any(warned)), "{added}");
    for (k, [a, b, c]) in semiaxes.iter().enumerate() {
        let model = Model::read(site.path().join(format!("group/s{k}.spharm.npz"))).expect("a model");
        let measures =
            spharm_shape::measure(&model.coefficients, &Default::default(), &spharm_monitor::Silent).expect("measures");
        // Expected area of the ellipsoid by Thomsen's formula, which is accurate to about 1 %.
        let terms = [a * b, a * c, b * c].map(|product| product.powf(1.6075));
        let area = 4.0 * std::f64::consts::PI * (terms.iter().sum::<f64>() / 3.0).powf(1.0 / 1.6075);
        assert!((measures.area / area - 1.0).abs() < 0.04, "{k}: {} {area}", measures.area);
    }
    let error = fail(&mut correspond(site.path(), &names, &["-o", "none"]));
    assert!(error.contains("s0.nii") && error.contains("1 (") && error.contains("--label"), "{error}");
    let table: String = std::iter::once("id\tsurface\tlabel\n".to_owned())
        .chain((0..4).map(|k| format!("m{k}\ts{k}.nii\t1\n")))
        .collect();
    fs::write(site.path().join("table.tsv"), table).expect("a table");
    succeed(&mut correspond(site.path(), &["--table", "table.tsv"], &["-o", "tabled"]));
    let read = |name: &str| fs::read(site.path().join(name)).expect("places");
    assert_eq!(read("tabled/places/m2.npz"), read("group/places/s2.npz"));
}

#[test]
fn places_that_only_a_cut_has_made_count_for_nothing() {
    let site = tempfile::tempdir().expect("a folder");
    let group = ["--group", "tori", "--members", "4", "--subdivisions", "4", "--output-dir", "in", "-q"];
    succeed(tool("generate").args(group).current_dir(site.path()));
    let found = json(&succeed(&mut correspond(site.path(), &BOXES, &["-o", "group"])));
    assert!(found["masked"].as_u64().expect("a number") > 0, "{found}");
    let models = ["s01", "s02", "s03", "s04"].map(|name| format!("group/{name}.spharm.npz"));
    let quality = |more: &[&str]| {
        let mut command = tool("shape");
        command.arg("quality").args(&models).args([
            "--icosphere",
            "4",
            "--bands",
            "0",
            "--no-surfaces",
            "--json",
            "-q",
        ]);
        json(&succeed(command.args(more).current_dir(site.path())))["variance"].as_f64().expect("a number")
    };
    let (all, kept) = (quality(&[]), quality(&["--mask", "group/group.json"]));
    assert!((kept / all - 1.0).abs() > 1e-4, "{all} {kept}");
    let mut command = tool("shape");
    command.arg("quality").args(&models).args(["--mask", "group/places/s01.npz"]).current_dir(site.path());
    assert!(fail(&mut command).contains("s01.npz"));
}
