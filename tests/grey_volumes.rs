//! Volumes of grey values and probabilities: `fit`, `volumes`, `parametrize`, `shape correspond` and `study` read them.

use std::fs;
use std::path::Path;

use ndarray::Array3;
use ndarray_npy::{ReadNpyExt, WriteNpyExt};
use spharm::Model;

use crate::common::{fail, finish, succeed, text, tool};

/// Writes 16^3 voxels with the distance from the surface of a ball about (7.4, 7.7, 7.2): 0.5 at the surface, more
/// inside.
fn write_distance(path: &Path, radius: f32, range: [f32; 2]) {
    let inside = |(x, y, z): (usize, usize, usize)| {
        let square = (x as f32 - 7.4).powi(2) + (y as f32 - 7.7).powi(2) + (z as f32 - 7.2).powi(2);
        (radius - square.sqrt() + 0.5).clamp(range[0], range[1])
    };
    Array3::from_shape_fn((16, 16, 16), inside).write_npy(fs::File::create(path).unwrap()).unwrap();
}

/// Writes the approximate fraction of each voxel that lies inside the ball.
fn write_ball(path: &Path, radius: f32) {
    write_distance(path, radius, [0.0, 1.0]);
}

fn volume(model: &Path) -> f64 {
    let coefficients = Model::read(model).unwrap().coefficients;
    let area = std::f64::consts::PI * 4.0;
    // The functions of degree 1 are sqrt(3 / 4 pi) times x, y and z. A ball contains no other functions, so its volume
    // is that of the ellipsoid with these axes.
    let axes = (1..4).map(|row| coefficients.values().row(row).iter().map(|x| x * x).sum::<f64>().sqrt());
    area / 3.0 * axes.map(|axis| axis * (3.0 / area).sqrt()).product::<f64>()
}

#[test]
fn grey_values_and_probabilities_become_models() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_ball(&at("p.npy"), 5.2);
    write_distance(&at("d.npy"), 5.2, [-20.0, 20.0]);
    let run = |arguments: &[&str]| {
        let mut command = tool(arguments[0]);
        command.args(&arguments[1..]).args(["--voxel-size", "1,1,1"]).current_dir(folder.path());
        command
    };
    let refused = fail(&mut run(&["fit", "p.npy", "--max-degree", "6", "-o", "x.spharm.npz"]));
    assert!(refused.contains("p.npy: expected 32-bit integers") && refused.contains("--threshold LEVEL"), "{refused}");
    succeed(&mut run(&["fit", "p.npy", "--probability", "--max-degree", "6", "-o", "half.spharm.npz"]));
    succeed(&mut run(&["fit", "d.npy", "--threshold", "0.5", "--max-degree", "6", "-o", "same.spharm.npz"]));
    succeed(&mut run(&["fit", "d.npy", "--threshold", "0.9", "--max-degree", "6", "-o", "high.spharm.npz"]));
    let ball = |radius: f64| 4.0 / 3.0 * std::f64::consts::PI * radius.powi(3);
    for (name, radius, accuracy) in [("half", 5.2, 0.01), ("same", 5.2, 0.02), ("high", 4.8, 0.02)] {
        let found = volume(&at(&format!("{name}.spharm.npz")));
        assert!((found / ball(radius) - 1.0).abs() < accuracy, "{name}: {found} {}", ball(radius));
    }
    let provenance = Model::read(at("high.spharm.npz")).unwrap().provenance;
    assert_eq!((provenance.threshold, provenance.probability), (Some(0.9), false));
    assert!(Model::read(at("half.spharm.npz")).unwrap().provenance.probability);

    // An existing model at another level is refused.
    let other =
        run(&["fit", "d.npy", "--threshold", "0.8", "--max-degree", "6", "-o", "high.spharm.npz", "--skip-existing"]);
    let other = fail(&mut { other });
    assert!(other.contains("values grey values from 0.9, not grey values from 0.8"), "{other}");

    let table = ["volumes", "p.npy", "--probability", "--max-degree", "6", "-o", "cells"];
    let json: serde_json::Value = serde_json::from_str(&succeed(run(&table).arg("--json"))).unwrap();
    let row = &json["rows"][0];
    assert_eq!((&json["tool"], &row["state"], &row["label"]), (&"volumes".into(), &"fitted".into(), &1.into()));
    assert!((row["volume"].as_f64().unwrap() / ball(5.2) - 1.0).abs() < 0.01 && row["power"][5].is_f64(), "{row}");
    let half = |name: &str| Model::read(at(name)).unwrap().coefficients.values().clone();
    assert_eq!(half("cells/p.1.spharm.npz"), half("half.spharm.npz"));
    succeed(&mut run(&["parametrize", "p.npy", "--threshold", "0.9", "-o", "s.surf.gii", "--surface-output", "m.ply"]));
}

#[test]
fn unusable_values_and_arguments_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_ball(&at("p.npy"), 5.2);
    Array3::from_elem((4, 4, 4), 1.4_f64).write_npy(fs::File::create(at("above.npy")).unwrap()).unwrap();
    let refused = |arguments: &[&str]| {
        let mut command = tool("fit");
        command.args(arguments).args(["--max-degree", "6", "-o", "x.spharm.npz"]).current_dir(folder.path());
        let output = finish(&mut command);
        assert!(!output.status.success(), "{arguments:?}");
        text(&output)
    };
    let size = ["--voxel-size", "1,1,1"];
    for (arguments, expected) in [
        (
            &["above.npy", "--probability"][..],
            "above.npy: expected probabilities from 0 to 1, found 1.400 (voxel 0 of the file",
        ),
        (
            &["p.npy", "--threshold", "7"],
            "values both below and above the threshold, found values from 0 to 1.000, all below the threshold 7",
        ),
        (&["p.npy", "--threshold", "-1"], "all at or above the threshold -1"),
        (&["p.npy", "--threshold", "inf"], "expected a number"),
        (&["p.npy", "--threshold", "0.5", "--probability"], "cannot be used with"),
        (&["p.npy", "--threshold", "0.5", "--smooth-radius", "9"], "expected 0.25 to 4 voxels"),
        (
            &["p.npy", "--probability", "--label-surface", "voxels", "--smooth-radius", "1"],
            "--smooth-radius can only be used with --label-surface smooth",
        ),
    ] {
        let found = refused(&[arguments, &size].concat());
        assert!(found.contains(expected), "{arguments:?}: {found}");
    }
    fs::write(at("m.off"), "OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n").unwrap();
    let mesh = refused(&["m.off", "--threshold", "0.5"]);
    assert!(
        mesh.contains("m.off: --label, --channel, --time, --voxel-size, --axes, --threshold and --probability are"),
        "{mesh}"
    );
}

#[test]
fn a_study_of_probabilities_passes_them_to_all_stages() {
    let folder = tempfile::tempdir().unwrap();
    let site = folder.path();
    let ids = ["s1", "s2", "s3", "s4"];
    for (k, id) in ids.into_iter().enumerate() {
        write_ball(&site.join(format!("{id}.npy")), 4.6 + 0.3 * k as f32);
    }
    // Add a speck beside the last body. --fix removes the speck, both for the fit and for the group.
    let mut speck = Array3::<f32>::read_npy(fs::File::open(site.join("s4.npy")).unwrap()).unwrap();
    speck[[0, 0, 0]] = 0.9;
    speck.write_npy(fs::File::create(site.join("s4.npy")).unwrap()).unwrap();
    let rows: String = ids.iter().map(|id| format!("{id},{id}.npy\n")).collect();
    fs::write(site.join("table.csv"), format!("id,surface\n{rows}")).unwrap();
    let study = "output = \"out\"\n[subjects]\ntable = \"table.csv\"\n[fit]\nmax_degree = 6\n\
                 arguments = [\"--probability\", \"--voxel-size\", \"1,1,1\", \"--fix\"]\n\
                 [align]\nmethod = \"correspond\"\n[quality]\nplain = false\nsurfaces = false\n";
    fs::write(site.join("study.toml"), study).unwrap();
    let output = finish(tool("study").args(["study.toml", "--threads", "2"]).current_dir(site));
    assert!(output.status.success(), "{}", text(&output));
    for id in ids {
        let [own, in_group] =
            ["models", "group"].map(|folder| volume(&site.join(format!("out/{folder}/{id}.spharm.npz"))));
        assert!((in_group / own - 1.0).abs() < 0.01, "{id}: {own} {in_group}");
    }
    let methods = fs::read_to_string(site.join("out/methods.md")).unwrap();
    assert!(methods.contains("with a probability of 0.5 or more; the enclosed volume was the sum"), "{methods}");
}
