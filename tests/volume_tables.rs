//! Tests `volumes`: many labels, one table, and no lost results if a label is bad.

use std::path::PathBuf;
use std::process::Command;

use spharm_model::Model;

use crate::common::{error_line, finish, succeed, text, tool};
use crate::volumes::write_volume;

struct Site(tempfile::TempDir);

impl Site {
    /// Creates two volumes with balls, a plate at the border and a label in two pieces; and a malformed volume.
    fn new() -> Self {
        let site = Self(tempfile::tempdir().expect("a folder"));
        std::fs::create_dir(site.path("in")).expect("a folder");
        write_volume(&site.path("in/a.nii"), |[x, y, z]| match () {
            () if x * x + y * y + z * z < 30.0 => 17,
            () if z < -6.0 => 53,
            () if z > 6.0 && x.abs() > 1.0 => 60,
            () => 0,
        });
        write_volume(&site.path("in/b.nii"), |[x, y, z]| if x * x + y * y + z * z < 20.0 { 17 } else { 0 });
        std::fs::write(site.path("in/c.nii"), b"no volume").expect("written");
        site
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn run(&self, arguments: &[&str]) -> Command {
        let mut command = tool("volumes");
        command.current_dir(self.0.path()).args(arguments).args(["--max-degree", "5", "-o", "out"]);
        command
    }

    /// Returns the rows of the table, with cells by column name.
    fn table(&self) -> Vec<std::collections::HashMap<String, String>> {
        self.rows("out/volumes.tsv", '\t')
    }

    fn rows(&self, file: &str, mark: char) -> Vec<std::collections::HashMap<String, String>> {
        let text = std::fs::read_to_string(self.path(file)).expect("a table");
        let mut lines = text.lines().map(|line| line.split(mark).map(str::to_owned).collect::<Vec<_>>());
        let head = lines.next().expect("a head");
        assert!(head.last().is_some_and(|name| name == "power_5"));
        lines.map(|row| head.iter().cloned().zip(row).collect()).collect()
    }
}

#[test]
fn every_label_is_a_model_and_a_row() {
    let site = Site::new();
    let output = finish(&mut site.run(&["in"]));
    let error = error_line(&output);
    assert!(error.contains("out/volumes.tsv: 2 of 5 rows failed"), "{error}");
    // Label 60 also touches the border, but has no model.
    let cut: Vec<String> = text(&output).lines().filter(|line| line.contains("border")).map(str::to_owned).collect();
    let [cut] = &cut[..] else { panic!("{cut:?}") };
    assert!(cut.starts_with("warning: in/a.nii label 53 touches the border") && cut.contains("--skip-border"), "{cut}");
    let rows = site.table();
    let row = |file: &str, label: &str| {
        let found = rows.iter().find(|row| row["file"] == format!("in/{file}.nii") && row["label"] == label);
        found.unwrap_or_else(|| panic!("{file} {label}")).clone()
    };
    assert_eq!(rows.len(), 5);
    let states = [("a", "17", "fitted", "no"), ("a", "53", "fitted", "yes"), ("b", "17", "fitted", "no")];
    for (file, label, state, border) in states {
        let row = row(file, label);
        assert_eq!((row["state"].as_str(), row["border"].as_str(), row["error"].as_str()), (state, border, "n/a"));
        let number = |name: &str| row[name].parse::<f64>().expect("a number");
        assert!((number("volume") / number("voxels") - 1.0).abs() < 0.25, "{row:?}");
        assert!(number("residual") > 0.0 && number("residual") < 1.0 && number("power_1") > 0.1, "{row:?}");
        let model = Model::read(site.path(&row["model"])).expect("a model");
        assert_eq!(model.provenance.input.expect("an input").label, label.parse().ok());
        // The middle of the volume is at 7.5 mm, and the plate is below it.
        let [x, y, z] = ["centroid_x", "centroid_y", "centroid_z"].map(number);
        let expected = if label == "53" { 0.5 } else { 7.5 };
        assert!([x - 7.5, y - 7.5, z - expected].iter().all(|off| off.abs() < 0.5), "{row:?}");
    }
    let pieces = row("a", "60");
    assert!(pieces["state"] == "failed" && pieces["error"].contains("2 pieces") && pieces["error"].contains("--fix"));
    let none = row("c", "n/a");
    assert!(none["state"] == "failed" && none["error"].contains("c.nii") && none["voxels"] == "n/a");

    // A second run replaces nothing without a flag; --skip-existing keeps existing models.
    assert!(error_line(&finish(&mut site.run(&["in"]))).contains("the file exists; give --skip-existing to resume"));
    let before = std::fs::read(site.path("out/a.17.spharm.npz")).expect("a model");
    let output = finish(&mut site.run(&["in/a.nii", "in/b.nii", "--fix", "--skip-existing", "-q"]));
    assert!(text(&output).contains("4 models, 1 repaired, 0 failed"), "{}", text(&output));
    let loss = text(&output).lines().find(|line| line.contains("warning: in/a.nii label 60: ")).map(str::to_owned);
    assert!(loss.is_some_and(|line| line.contains(" % of the label)")), "{}", text(&output));
    let states: Vec<String> = site.table().iter().map(|row| row["state"].clone()).collect();
    assert_eq!(states, ["kept", "kept", "fitted", "kept"], "{:?}", site.table());
    let repairs: Vec<String> = site.table().iter().map(|row| row["repair"].clone()).collect();
    assert_eq!(repairs[..2], ["none", "none"]);
    assert!(repairs[2].starts_with("1 piece dropped (") && repairs[2].contains(" voxels)"), "{repairs:?}");
    assert_eq!(std::fs::read(site.path("out/a.17.spharm.npz")).expect("a model"), before);
    // A run for fewer labels keeps the rows of the other labels; a run to another degree is refused and changes
    // nothing.
    let rows = site.table();
    succeed(&mut site.run(&["in/b.nii", "--label", "17", "--skip-existing"]));
    assert_eq!(site.table().len(), rows.len());
    let table = std::fs::read(site.path("out/volumes.tsv")).expect("a table");
    let mut other = tool("volumes");
    other.current_dir(site.0.path()).args(["in/a.nii", "--max-degree", "4", "-o", "out", "--skip-existing"]);
    assert!(error_line(&finish(&mut other)).contains("found those of degree 5; give --force"));
    assert_eq!(std::fs::read(site.path("out/volumes.tsv")).expect("a table"), table);
    let said = succeed(&mut site.run(&["in/b.nii", "--label", "17", "--force"]));
    assert!(said.contains("1 model, 0 failed"), "{said}");
}

#[test]
fn chosen_labels_that_are_not_there_are_rows_too() {
    let site = Site::new();
    let output = finish(&mut site.run(&["in/a.nii", "in/b.nii", "--label", "17", "53", "-q"]));
    assert_eq!(output.status.code(), Some(1), "{}", text(&output));
    let rows: Vec<String> = site.table().iter().map(|row| format!("{} {}", row["label"], row["state"])).collect();
    assert_eq!(rows, ["17 fitted", "53 fitted", "17 fitted", "53 failed"]);
    assert!(site.table()[3]["error"].contains("no voxel has label 53"), "{:?}", site.table()[3]);
    assert_eq!(site.table()[3]["border"], "n/a");
}

#[test]
fn a_table_without_a_model_is_no_obstacle_and_a_label_is_one_row() {
    let site = Site::new();
    write_volume(&site.path("in/torus.nii"), |[x, y, z]| {
        let ring = (x * x + y * y).sqrt() - 5.0;
        if ring * ring + z * z < 4.0 { 4 } else { 0 }
    });
    assert_eq!(finish(&mut site.run(&["in/torus.nii"])).status.code(), Some(1));
    succeed(&mut site.run(&["in/torus.nii", "--label", "4", "4", "--cut-handles"]));
    let [row] = &site.table()[..] else { panic!("one row: {:?}", site.table()) };
    assert_eq!((row["state"].as_str(), row["repair"].as_str()), ("fitted", "1 handle cut"));
    // The table reads the repair from the model's provenance.
    succeed(&mut site.run(&["in/torus.nii", "--cut-handles", "--skip-existing"]));
    assert_eq!((site.table()[0]["state"].as_str(), site.table()[0]["repair"].as_str()), ("kept", "1 handle cut"));
    succeed(&mut site.run(&["in/torus.nii", "--fix", "--force"]));
    let repair = &site.table()[0]["repair"];
    assert!(repair.starts_with("1 handle removed ("), "{repair}");
}

#[test]
fn large_changes_of_the_volume_are_warned_of() {
    let site = Site::new();
    let square = |[x, y, z]: [f64; 3]| x * x + y * y + z * z;
    write_volume(&site.path("in/shell.nii"), |at| u8::from((16.0..42.0).contains(&square(at))));
    write_volume(&site.path("in/torus.nii"), |[x, y, z]| u8::from((x.hypot(y) - 5.0).powi(2) + z * z < 4.0));
    write_volume(&site.path("in/one.nii"), |at| u8::from(at == [0.5; 3]));
    let warned = |name: &str, option: &str| {
        let file = format!("in/{name}.nii");
        succeed_with_warnings(&mut site.run(&[file.as_str(), option, "--force", "-q"]))
    };
    let shell = warned("shell", "--fix");
    assert!(shell.contains("warning: in/shell.nii label 1: the volume was repaired: 1 cavity filled ("), "{shell}");
    assert!(shell.contains(" % of the label)"), "{shell}");
    let torus = warned("torus", "--cut-handles");
    assert!(torus.contains("warning: in/torus.nii label 1: the model has a volume of "), "{torus}");
    assert!(torus.contains("before its handles were cut, the label's surface had a volume of 384.0 (+"), "{torus}");
    let one = warned("one", "--fix");
    assert!(one.contains("biases volume, area and sphericity; the label is too small for a shape model"), "{one}");
}

#[test]
fn labels_of_two_files_with_one_name_are_told_apart() {
    let site = Site::new();
    std::fs::create_dir(site.path("other")).expect("a folder");
    std::fs::copy(site.path("in/b.nii"), site.path("other/b.nii")).expect("a copy");
    let output = finish(&mut site.run(&["in/b.nii", "other/b.nii"]));
    let said = text(&output);
    assert!(said.contains("is the model of another file, in/b.nii; give --name-template '{parent}.{stem}'"), "{said}");
    succeed(&mut site.run(&["in/b.nii", "other/b.nii", "--name-template", "{parent}.{stem}", "--force"]));
    assert!(site.path("out/other.b.17.spharm.npz").exists());
}

#[test]
fn a_volume_given_by_two_paths_is_one_volume() {
    let site = Site::new();
    succeed(&mut site.run(&["in/b.nii", "./in/b.nii"]));
    assert_eq!(site.table().len(), 1);
}

/// An array file has no voxel size, so --voxel-size is needed.
#[test]
fn voxel_sizes_are_given_where_files_have_none() {
    let site = Site::new();
    let header = "{'descr': '|u1', 'fortran_order': True, 'shape': (10, 10, 10), }\n";
    let inside = |x: f64| (1.5..7.5).contains(&x);
    let voxel = |i: usize| u8::from([i % 10, i / 10 % 10, i / 100].iter().all(|&x| inside(x as f64)));
    let values: Vec<u8> = (0..1000).map(voxel).collect();
    let file = [&b"\x93NUMPY\x01\x00"[..], &(header.len() as u16).to_le_bytes(), header.as_bytes(), &values].concat();
    std::fs::write(site.path("cube.npy"), file).expect("written");
    let output = finish(&mut site.run(&["cube.npy"]));
    assert!(
        text(&output).contains("doesn't record the voxel size; give the voxel size with --voxel-size X,Y,Z"),
        "{}",
        text(&output)
    );
    succeed(&mut site.run(&["cube.npy", "--voxel-size", "0.5,1,2", "--force"]));
    let [row] = &site.table()[..] else { panic!("one row") };
    let volume: f64 = row["volume"].parse().expect("a number");
    assert!((volume / 216.0 - 1.0).abs() < 0.1, "{volume}");
    assert_eq!(finish(&mut site.run(&["cube.npy", "--voxel-size", "0.5,1"])).status.code(), Some(2));
    // The axes of an array may be z, y and x; the size stays that along x, y and z.
    let wide = "{'descr': '|u1', 'fortran_order': False, 'shape': (6, 7, 9), }\n";
    let voxel =
        |i: usize| u8::from((1..5).contains(&(i / 63)) && (1..6).contains(&(i / 9 % 7)) && (1..8).contains(&(i % 9)));
    let values: Vec<u8> = (0..6 * 7 * 9).map(voxel).collect();
    let file = [&b"\x93NUMPY\x01\x00"[..], &(wide.len() as u16).to_le_bytes(), wide.as_bytes(), &values].concat();
    std::fs::write(site.path("wide.npy"), file).expect("written");
    let size = ["wide.npy", "--voxel-size", "0.5,1,2", "--table", "wide.tsv"];
    let centroid = |axes: &str| {
        succeed(site.run(&size).args(["--axes", axes, "--force"]));
        let rows = site.rows("wide.tsv", '\t');
        ["centroid_x", "centroid_y", "centroid_z"].map(|name| rows[0][name].parse::<f64>().expect("a number"))
    };
    let near = |found: [f64; 3], expected: [f64; 3]| found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 0.2);
    assert!(near(centroid("xyz"), [1.25, 3.0, 8.0]) && near(centroid("zyx"), [2.0, 3.0, 5.0]));
    let provenance = Model::read(site.path("out/wide.1.spharm.npz")).expect("a model").provenance;
    assert_eq!(provenance.axes.as_deref(), Some("zyx"));
    let again = ["wide.npy", "--voxel-size", "0.5,1,2", "--table", "again.tsv", "--skip-existing"];
    let other = text(&finish(&mut site.run(&again)));
    assert!(other.contains("fitted with other settings: axes zyx, not xyz"), "{other}");
    succeed(site.run(&again).args(["--axes", "zyx"]));
    let fixed = text(&finish(&mut site.run(&["in/b.nii", "--axes", "zyx", "--table", "fixed.tsv"])));
    assert!(fixed.contains("in/b.nii: expected axes in the order xyz") && fixed.contains("omit --axes"), "{fixed}");
    assert_eq!(finish(&mut site.run(&["wide.npy", "--axes", "xzy", "--table", "no.tsv"])).status.code(), Some(2));
    // `fit` accepts array files with --voxel-size as well.
    let mut fit = tool("fit");
    fit.current_dir(site.0.path()).args(["--surface", "cube.npy", "--voxel-size", "0.5,1,2", "--max-degree", "4"]);
    succeed(fit.args(["-o", "fit"]));
}

fn succeed_with_warnings(command: &mut Command) -> String {
    let output = finish(command);
    assert!(output.status.success(), "{}", text(&output));
    text(&output)
}

#[test]
fn small_labels_and_those_at_the_border_are_skipped() {
    let site = Site::new();
    let arguments = ["in/a.nii", "in/b.nii", "--label", "17", "53", "--min-voxels", "500", "--skip-border"];
    // Label 17 has about 690 voxels in a and 370 in b. Label 53 touches the border in a, and doesn't exist in b.
    let output = finish(&mut site.run(&arguments));
    assert!(text(&output).contains("1 model, 2 skipped, 1 failed"), "{}", text(&output));
    assert!(!text(&output).contains("touches the border"), "{}", text(&output));
    let rows = site.table();
    let states: Vec<&str> = rows.iter().map(|row| row["state"].as_str()).collect();
    assert_eq!(states, ["fitted", "skipped", "skipped", "failed"], "{rows:?}");
    assert_eq!(rows[1]["error"], "at the border of the volume");
    assert!(rows[2]["error"].ends_with("voxels, fewer than --min-voxels 500"), "{:?}", rows[2]);
    assert!(!site.path("out/b.17.spharm.npz").exists());
    // Without the options, existing models are kept and the missing ones are added, in a table with commas.
    succeed(&mut site.run(&["in/a.nii", "--label", "17", "--table", "t.csv", "--skip-existing"]));
    succeed(&mut site.run(&["in/b.nii", "--table", "t.csv", "--skip-existing"]));
    let rows = site.rows("t.csv", ',');
    let found: Vec<[&str; 2]> = rows.iter().map(|row| ["file", "state"].map(|name| row[name].as_str())).collect();
    assert_eq!(found, [["in/b.nii", "fitted"], ["in/a.nii", "kept"]]);
    // A warning names an existing model whose label is skipped.
    let output = succeed_with_warnings(&mut site.run(&["in/b.nii", "--min-voxels", "500", "--table", "u.tsv"]));
    assert!(output.contains("out/b.17.spharm.npz exists; delete this file"), "{output}");
}

#[test]
fn models_are_drawn_in_the_colour_of_a_column() {
    let site = Site::new();
    let fit = ["in/a.nii", "in/b.nii", "--label", "17", "53", "--min-voxels", "300"];
    finish(&mut site.run(&fit));
    let picture = |more: &[&str]| {
        let mut command = tool("picture");
        command.current_dir(site.0.path()).args(["out", "--size", "64", "--force", "-o", "p.png"]).args(more);
        command
    };
    let size = || {
        let png = std::fs::read(site.path("p.png")).expect("a picture");
        [16, 20].map(|at| u32::from_be_bytes(png[at..at + 4].try_into().expect("four bytes")))
    };
    assert!(succeed(&mut picture(&[])).contains("3 panels"));
    assert_eq!(size(), [3 * 64, 64]);
    succeed(&mut picture(&["--fit-each", "--columns", "2", "--colour-by", "out/volumes.tsv:sphericity"]));
    let [width, height] = size();
    assert!(width == 128 && height > 128, "a colour bar beneath two rows: {width} x {height}");
    // Another range of numbers gives other colours.
    let pixels = |range: &str| {
        succeed(&mut picture(&["--centre", "--colour-by", "out/volumes.tsv:voxels", "--range", range]));
        std::fs::read(site.path("p.png")).expect("a picture")
    };
    assert!(pixels("0,1000") != pixels("0,2000"));
    for (column, said) in [("shape", "no column \"shape\""), ("repair", "expected a number")] {
        let output = finish(&mut picture(&["--centre", "--colour-by", &format!("out/volumes.tsv:{column}")]));
        assert!(!output.status.success() && text(&output).contains(said), "{}", text(&output));
    }
}
