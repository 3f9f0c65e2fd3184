//! Measures the quality of groups whose correspondence is known, through the program.

use std::fs;
use std::path::Path;

use serde_json::Value;

use crate::common::{error_line, fail, finish, succeed, text, tool};

/// Writes ellipsoids with two varying semi-axes, and their models.
fn site() -> tempfile::TempDir {
    let site = tempfile::tempdir().expect("a folder");
    let group =
        ["--group", "ellipsoids", "--members", "5", "--subdivisions", "3", "--upright", "--output-dir", "group"];
    succeed(tool("generate").args(group).current_dir(site.path()));
    let meshes: Vec<String> = (1..=5).map(|number| format!("group/s0{number}.ply")).collect();
    let fit = ["--max-degree", "5", "-q", "--threads", "2", "-o", "models", "--surface"];
    succeed(tool("fit").args(fit).args(meshes).current_dir(site.path()));
    // Align the models to the frames of their ellipsoids, in which the group is upright.
    succeed(tool("shape").args(["align", "models", "--group", "-q", "-o", "aligned"]).current_dir(site.path()));
    site
}

fn quality(site: &Path, arguments: &[&str]) -> std::process::Command {
    let mut command = tool("shape");
    command.arg("quality").args(arguments).args(["--icosphere", "2", "--samples", "50"]).current_dir(site);
    command
}

#[test]
fn groups_come_with_their_truth() {
    let site = site();
    let folder = site.path().join("group");
    let truth = fs::read_to_string(folder.join("truth.csv")).expect("the truth");
    let rows: Vec<Vec<&str>> = truth.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!(rows[0][..5], ["id", "surface", "landmarks", "a", "b"]);
    assert_eq!(rows.len(), 6);
    for row in &rows[1..] {
        let axes: Vec<f64> = row[3..5].iter().map(|cell| cell.parse().expect("a number")).collect();
        assert!((17.0..23.0).contains(&axes[0]) && (10.0..14.0).contains(&axes[1]), "{row:?}");
        let places: Value =
            serde_json::from_str(&fs::read_to_string(folder.join(row[2])).expect("a file")).expect("JSON");
        let end = places.as_array().expect("a list").iter().find(|place| place["id"] == "x1").expect("an end");
        assert!((end["coordinates"][0].as_f64().expect("a number") - axes[0]).abs() < 1e-9);
    }
    let again = ["--group", "ellipsoids", "--members", "5", "--output-dir", "group"];
    let refused = finish(tool("generate").args(again).current_dir(site.path()));
    assert!(error_line(&refused).contains("exists"), "{}", text(&refused));
    for bad in [
        &["--group", "cubes", "--output-dir", "x"][..],
        &["--group", "rods"],
        &["--members", "3", "--surface", "x.ply"],
    ] {
        assert!(!finish(tool("generate").args(bad).current_dir(site.path())).status.success(), "{bad:?}");
    }
}

#[test]
fn quality_is_measured_written_and_drawn() {
    let site = site();
    let site = site.path();
    let arguments =
        ["aligned", "--landmarks", "group", "--bands", "5", "-o", "q.json", "--curves", "q.png", "--threads", "2"];
    let table = succeed(&mut quality(site, &arguments));
    assert!(table.contains("generalisation (surface)") && table.contains("compactness"), "{table}");
    let found: Value = serde_json::from_str(&fs::read_to_string(site.join("q.json")).expect("a file")).expect("JSON");
    for measure in ["compactness", "generalisation", "specificity", "surface_generalisation"] {
        for part in ["values", "low", "high"] {
            assert_eq!(found[measure][part].as_array().map(Vec::len), Some(4), "{measure} {part}");
        }
    }
    // In the ellipsoids' frames equal directions are nearly equal places, so two parameters give two modes.
    assert!(found["compactness"]["values"][1].as_f64().expect("a number") > 0.9, "{found}");
    let marks = &found["landmarks"];
    assert_eq!(marks["names"].as_array().map(Vec::len), Some(10));
    assert!(marks["mean"].as_f64().expect("a number") < 1.0, "{marks}");
    assert_eq!(&fs::read(site.join("q.png")).expect("a picture")[1..4], b"PNG");
    // Another number of threads gives the same bits, except for the time.
    let again = ["aligned", "--landmarks", "group", "--bands", "5", "-o", "r.json", "--threads", "1"];
    succeed(&mut quality(site, &again));
    let other: Value = serde_json::from_str(&fs::read_to_string(site.join("r.json")).expect("a file")).expect("JSON");
    for measure in ["variances", "generalisation", "specificity", "surface_specificity", "landmarks"] {
        assert_eq!(found[measure], other[measure], "{measure}");
    }
    assert!(fail(&mut quality(site, &arguments)).contains("exists"));
}

#[test]
fn landmarks_that_do_not_fit_are_said() {
    let site = site();
    let site = site.path();
    let run = |landmarks: &[&str]| {
        let all = [&["aligned", "--no-surfaces", "--bands", "0", "--json", "--landmarks"][..], landmarks].concat();
        finish(&mut quality(site, &all))
    };
    let output = run(&["group/s01.json", "group/s02.json"]);
    assert!(error_line(&output).contains("5 models, found 2"), "{}", text(&output));
    fs::write(site.join("group/s03.json"), r#"[{"id": "x1", "coordinates": [1, 2, 300]}]"#).expect("a file");
    let output = run(&["group"]);
    let found: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(found["landmarks"]["names"], serde_json::json!(["x1"]));
    let warnings = found["warnings"].to_string();
    assert!(warnings.contains("landmarks far from the surface"), "{warnings}");
    // One line names the file without these landmarks, not the four files that have them.
    assert_eq!(warnings.matches("are left out for all surfaces").count(), 1, "{warnings}");
    assert!(warnings.contains("s03.json: lacks ") && !warnings.contains("other files lack"), "{warnings}");
    fs::remove_file(site.join("group/s03.json")).expect("removed");
    let output = run(&["group"]);
    assert!(error_line(&output).contains("no landmarks for s03"), "{}", text(&output));
}
