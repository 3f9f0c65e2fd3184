//! Studies of signals on the subjects' surfaces.

use std::fs;
use std::path::Path;

use spharm_model::Model;
use spharm_surface::Signal;
use spharm_surface::generate::{Cortex, cortex};
use spharm_surface::io::{read_mesh, write_mesh, write_signal};

use crate::common::{error_line, finish, succeed, text, tool};
use crate::first_users::OPTIONS;
use crate::freesurfer::write_label;
use crate::shape_inference;

/// Value of x above which directions belong to the medial wall.
const WALL: f64 = 0.8;

const STUDY: &str = r#"
output = "out"
[subjects]
table = "participants.tsv"
id = "participant_id"
surface = "subjects/{id}/surf/lh.white"
sphere = "subjects/{id}/surf/lh.sphere.reg"
signal = "subjects/{id}/surf/lh.thickness"
[fit]
max_degree = 6
[modes]
count = 2
[[test]]
name = "thickness"
effect = "group"
signal = "value"
permutations = 100
"#;

/// Creates a SUBJECTS_DIR of eight subjects. The cortex is thicker by 1 in group a where y is positive; the medial wall
/// has zeros.
fn site() -> tempfile::TempDir {
    let site = tempfile::tempdir().expect("a folder");
    let mut table = "participant_id\tgroup\n".to_owned();
    for subject in 0..8 {
        let id = format!("s{subject}");
        let group = if subject < 4 { "a" } else { "b" };
        table += &format!("{id}\t{group}\n");
        let at = |name: &str| site.path().join("subjects").join(&id).join(name);
        fs::create_dir_all(at("surf")).expect("a folder");
        let (surface, sphere) = cortex(&Cortex { subdivisions: 3, variant: subject });
        write_mesh(at("surf/lh.white"), &surface, &OPTIONS).expect("a mesh");
        write_mesh(at("surf/lh.sphere.reg"), &sphere, &OPTIONS).expect("a mesh");
        let units: Vec<[f64; 3]> = sphere.vertices.iter().map(unit).collect();
        let thicker = if group == "a" { 1.0 } else { 0.0 };
        let of = |p: &[f64; 3]| match p[0] > WALL {
            true => 0.0,
            false => 2.5 + 0.01 * subject as f64 + if p[1] > 0.0 { thicker * p[1] } else { 0.0 },
        };
        let values: Vec<f64> = units.iter().map(of).collect();
        write_signal(at("surf/lh.thickness"), &Signal::new(values, units.len(), 1), &OPTIONS).expect("values");
        write_label(&at("label/lh.cortex.label"), &units, |p| p[0] <= WALL);
    }
    fs::write(site.path().join("participants.tsv"), table).expect("a table");
    fs::write(site.path().join("study.toml"), STUDY).expect("a study");
    site
}

fn unit(p: &[f64; 3]) -> [f64; 3] {
    let length = p.iter().map(|x| x * x).sum::<f64>().sqrt();
    p.map(|x| x / length)
}

fn study(site: &Path, more: &[&str]) -> std::process::Output {
    finish(tool("study").args(["study.toml", "--threads", "2"]).args(more).current_dir(site))
}

fn edit(site: &Path, from: &str, to: &str) {
    assert!(STUDY.contains(from), "{from}");
    fs::write(site.join("study.toml"), STUDY.replace(from, to)).expect("a study");
}

#[test]
fn spheres_of_the_other_hemisphere_are_named_at_the_end_and_on_the_page() {
    let site = site();
    let site = site.path();
    for subject in 0..8 {
        let at = |name: &str| site.join(format!("subjects/s{subject}/surf/{name}"));
        fs::copy(at("lh.sphere.reg"), at("rh.sphere.reg")).expect("a copy");
    }
    edit(site, "surf/lh.sphere.reg", "surf/rh.sphere.reg");
    let expected = "16 fits have a sphere or mask of the other hemisphere: s0 (rh.sphere.reg), s1 (rh.sphere.reg)";
    // The second run makes no fits, whose own warnings are missing then.
    for _ in 0..2 {
        let output = study(site, &[]);
        assert!(output.status.success() && text(&output).contains(expected), "{}", text(&output));
        assert!(fs::read_to_string(site.join("out/report.html")).expect("a page").contains(expected));
    }
}

#[test]
fn a_mask_of_the_other_hemisphere_for_all_surfaces_is_named_at_the_end() {
    let site = site();
    let site = site.path();
    let sphere = read_mesh(site.join("subjects/s0/surf/lh.sphere.reg")).expect("a sphere");
    let units: Vec<[f64; 3]> = sphere.vertices.iter().map(unit).collect();
    write_label(&site.join("rh.cortex.label"), &units, |p| p[0] <= 0.97);
    let arguments = r#"arguments = ["--sphere", "subjects/s0/surf/lh.sphere.reg", "--mask", "rh.cortex.label"]"#;
    edit(site, "max_degree = 6", &format!("max_degree = 6\n{arguments}"));
    let output = study(site, &[]);
    let expected = "8 fits have a sphere or mask of the other hemisphere: s0 (rh.cortex.label), s1 (rh.cortex.label)";
    assert!(output.status.success() && text(&output).contains(expected), "{}", text(&output));
}

fn map(site: &Path, name: &str) -> Vec<f64> {
    shape_inference::map(site, "out/tests/thickness", name)
}

#[test]
fn the_thickness_of_groups_is_tested_on_the_mean_surface() {
    let site = site();
    let site = site.path();
    let preview = study(site, &["--dry-run"]);
    assert!(text(&preview).contains(".study/signals.tsv") && preview.status.success(), "{}", text(&preview));
    let output = study(site, &[]);
    assert!(output.status.success(), "{}", text(&output));
    // The zeros of the medial wall weren't used, because the default mask is FreeSurfer's label of the cortex.
    let model = Model::read(site.join("out/signals/s0.spharm.npz")).expect("a model");
    assert!(model.provenance.region.is_some_and(|region| region.path.ends_with("lh.cortex.label")));
    let mean = read_mesh(site.join("out/tests/thickness/mean.surf.gii")).expect("the mean surface");
    assert_eq!(mean.meta.anatomical_structure_primary.as_deref(), Some("CortexLeft"));
    let directions = spharm::Sphere::icosphere(5).directions;
    let (effect, p) = (map(site, "effect"), map(site, "p"));
    assert_eq!((mean.vertices.len(), effect.len()), (directions.len(), directions.len()));
    let there = |y: f64| {
        (0..effect.len())
            .filter(|v| {
                let u = directions.as_slice()[*v];
                u[0] < 0.0 && (u[1] - y).abs() < 0.05
            })
            .collect::<Vec<_>>()
    };
    // The groups differ by 1, minus the trend of 0.04, at y = 1, and by the trend alone at y = -1.
    assert!(there(0.95).iter().all(|v| (effect[*v] - 0.91).abs() < 0.1 && p[*v] < 0.01));
    assert!(there(-0.95).iter().all(|v| (effect[*v] + 0.04).abs() < 0.1));
    let table = fs::read_to_string(site.join("out/tests/thickness/summary.csv")).expect("a table");
    assert!(table.starts_with("measure,n,mean,sd,n a,mean a,sd a,n b,") && table.contains("\nvolume,8,"), "{table}");
    let page = fs::read_to_string(site.join("out/report.html")).expect("a page");
    for shown in ["thickness: measures", "exchangeable errors", "sphericity", "value"] {
        assert!(page.contains(shown), "{shown}");
    }
    // A second run makes nothing again. After a change of a signal, the tests of values are made again, but not the
    // alignment.
    let state = |output: &str, stage: &str| {
        let line = output.lines().find(|line| line.split_whitespace().next() == Some(stage));
        line.is_some_and(|line| line.contains("up to date"))
    };
    let again = text(&study(site, &[]));
    assert!(state(&again, "test.thickness") && state(&again, "align"), "{again}");
    fs::copy(site.join("subjects/s1/surf/lh.thickness"), site.join("subjects/s0/surf/lh.thickness")).expect("a copy");
    let again = text(&study(site, &[]));
    assert!(state(&again, "align") && !state(&again, "test.thickness"), "{again}");
}

#[test]
fn models_of_signals_leave_with_the_signal() {
    let site = site();
    let site = site.path();
    assert!(study(site, &[]).status.success() && site.join("out/signals/s0.spharm.npz").is_file());
    fs::write(site.join("out/signals/notes.txt"), "mine").expect("a file");
    let (signal, value) = ("signal = \"subjects/{id}/surf/lh.thickness\"\n", "signal = \"value\"\n");
    fs::write(site.join("study.toml"), STUDY.replace(signal, "").replace(value, "")).expect("a study");
    let output = study(site, &[]);
    assert!(output.status.success() && text(&output).contains("removed 8 models of signals"), "{}", text(&output));
    let left: Vec<_> = fs::read_dir(site.join("out/signals")).expect("a folder").flatten().collect();
    assert_eq!(left.iter().map(|entry| entry.file_name()).collect::<Vec<_>>(), ["notes.txt"]);
}

#[test]
fn a_subject_without_its_signal_is_left_out_of_everything() {
    let site = site();
    let site = site.path();
    fs::remove_file(site.join("subjects/s3/surf/lh.thickness")).expect("a file");
    let output = study(site, &[]);
    assert!(!output.status.success() && text(&output).contains("warning: s3: "), "{}", text(&output));
    assert!(error_line(&output).contains("`spharm status out/signals/status` lists the failures"), "{}", text(&output));
    let table = fs::read_to_string(site.join("out/tests/thickness/summary.csv")).expect("a table");
    assert!(table.contains("\nvolume,7,"), "{table}");
    let subjects = fs::read_to_string(site.join("out/.study/subjects.tsv")).expect("a table");
    assert!(subjects.lines().any(|line| line.starts_with("s3\tfailed\t")), "{subjects}");
    assert!(site.join("out/models/s3.spharm.npz").is_file(), "the surface's model is good");
}

#[test]
fn tests_leave_out_the_medial_wall_of_a_given_sphere() {
    let site = site();
    let site = site.path();
    let keys =
        "signal = \"value\"\nsphere = \"subjects/s0/surf/lh.sphere.reg\"\nmask = \"subjects/s0/label/lh.cortex.label\"";
    let keys = format!("{keys}\nannotation = \"lh.halves.annot\"\ncluster = 0.01");
    edit(site, "signal = \"value\"", &keys);
    let sphere = read_mesh(site.join("subjects/s0/surf/lh.sphere.reg")).expect("a sphere");
    fs::write(site.join("lh.halves.annot"), halves(&sphere.vertices)).expect("an annotation");
    let output = study(site, &[]);
    assert!(output.status.success(), "{}", text(&output));
    let p = map(site, "p");
    assert_eq!(p.len(), sphere.vertices.len());
    for (p, vertex) in p.iter().zip(&sphere.vertices) {
        assert!((*p == 1.0) == (unit(vertex)[0] > WALL), "{p} at {vertex:?}");
    }
    // Groups differ where y is positive.
    let table = fs::read_to_string(site.join("out/tests/thickness/clusters.csv")).expect("a table");
    let mut lines = table.lines();
    assert!(lines.next().is_some_and(|header| header.ends_with(",statistic,effect,region,unit")), "{table}");
    assert!(
        lines.next().is_some_and(|first| first.starts_with("1,") && first.ends_with(",anterior,length^2")),
        "{table}"
    );
    let about = fs::read(site.join("out/tests/thickness/test.json")).expect("a description");
    let about: serde_json::Value = serde_json::from_slice(&about).expect("JSON");
    assert_eq!(about["peak"]["region"], "anterior");
    let peak = about["peak"]["vertex"].as_u64().expect("a vertex") as usize;
    assert!(unit(&sphere.vertices[peak])[1] > 0.5 && about["peak"]["position"].is_array(), "{about}");
}

/// Returns the bytes of an annotation with two regions: vertices with positive y, and all others.
fn halves(vertices: &[[f64; 3]]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut put = |number: usize| bytes.extend((number as i32).to_be_bytes());
    put(vertices.len());
    for (vertex, position) in vertices.iter().enumerate() {
        put(vertex);
        put(if position[1] > 0.0 { 1 } else { 2 });
    }
    [1, 2, 0].into_iter().for_each(&mut put);
    for (red, name) in [(1, "anterior"), (2, "posterior")] {
        bytes.extend((name.len() as i32).to_be_bytes());
        bytes.extend(name.bytes());
        [red, 0, 0, 0].into_iter().for_each(|number: i32| bytes.extend(number.to_be_bytes()));
    }
    bytes
}

#[test]
fn studies_of_signals_that_would_mislead_are_refused() {
    let site = site();
    let site = site.path();
    let signal = "signal = \"subjects/{id}/surf/lh.thickness\"\n";
    fs::write(site.join("short.csv"), "0\n1\n").expect("a mask");
    for (from, to, expected) in [
        (signal, "", "\"value\" needs `signal` in [subjects]"),
        (signal, "mask = \"x\"\n", "but no `signal` is given"),
        (
            "lh.thickness\"",
            "lh.thickness\"\nmask = \"lh.cortex.label\"",
            "a column of participants.tsv or a pattern with {id}",
        ),
        ("{id}/surf/lh.thickness", "s1/surf/lh.thickness", "expected a column of participants.tsv or a pattern"),
        ("[modes]", "[align]\nmethod = \"joint\"\n[modes]", "needs spheres that correspond"),
        ("permutations", "mask = \"nowhere\"\npermutations", "nowhere: no such file"),
        (
            "permutations",
            "sphere = \"subjects/s0/surf/lh.sphere.reg\"\nmask = \"short.csv\"\npermutations",
            "mask: short.csv: expected a mask for the 642 vertices of subjects/s0/surf/lh.sphere.reg, found one for 2; give",
        ),
        ("\"value\"", "\"values\"", "or \"value\", found \"values\""),
    ] {
        edit(site, from, to);
        let output = study(site, &[]);
        assert!(!output.status.success() && error_line(&output).contains(expected), "{to}: {}", text(&output));
    }
    assert!(!site.join("out").exists());
}

#[test]
fn a_mask_of_a_signal_is_refused_for_a_surface() {
    let site = site();
    let folder = site.path().join("subjects/s0");
    let row = "a\tsurf/lh.white\tsurf/lh.sphere.reg\tlabel/lh.cortex.label\n";
    fs::write(folder.join("rows.tsv"), format!("id\tsurface\tsphere\tsignal_mask\n{row}")).expect("a table");
    let fit = ["--manifest", "rows.tsv", "--max-degree", "3", "-o", "out"];
    let output = finish(tool("fit").args(fit).current_dir(&folder));
    assert!(!output.status.success() && text(&output).contains("this file is a surface"), "{}", text(&output));
    let row = row.replace("lh.white", "lh.thickness");
    fs::write(folder.join("rows.tsv"), format!("id\tsurface\tsphere\tsignal_mask\n{row}")).expect("a table");
    succeed(tool("fit").args(fit).current_dir(&folder));
}
