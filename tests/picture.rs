//! Figures of studies: sides, and sizes on paper. Colours by a column of a table.

use spharm_surface::generate::icosphere;
use spharm_surface::io::{WriteOptions, write_mesh};

use crate::common::{finish, succeed, text, tool};

const STUDY: &str = r#"
title = "Figures"
output = "out"
[subjects]
table = "meshes/study.csv"
[fit]
max_degree = 4
[[test]]
name = "bump"
effect = "group"
"#;

#[test]
fn figures_of_studies_have_all_sides_and_legible_text_on_the_width_of_a_page() {
    let site = tempfile::tempdir().expect("a folder");
    succeed(tool("generate").args(["--study", "meshes", "--subjects", "6", "-q"]).current_dir(site.path()));
    std::fs::write(site.path().join("study.toml"), STUDY).expect("a file");
    let commands = succeed(tool("study").args(["study.toml", "--dry-run"]).current_dir(site.path()));
    let pictures: Vec<&str> = commands.lines().filter(|line| line.starts_with("spharm picture ")).collect();
    assert_eq!(pictures.len(), 2, "a PNG and an SVG: {commands}");
    let all = "--view left right top bottom front back --";
    assert!(pictures.iter().all(|line| line.contains(all)), "{pictures:?}");

    // Draw a subject with the figure's settings.
    let settings = pictures[0].split_once("--view").and_then(|(_, rest)| rest.split_once("-o")).expect("settings").0;
    let mut drawing = tool("picture");
    drawing.args(["meshes/a01.ply", "-o", "a.svg", "--view"]).args(settings.split_whitespace());
    assert!(succeed(drawing.current_dir(site.path())).contains("6 panels"));
    let svg = std::fs::read_to_string(site.path().join("a.svg")).expect("a picture");
    let width = svg.split_once(" width=\"").and_then(|(_, rest)| rest.split_once("mm\"")).expect("a width in mm").0;
    assert!((178.0..=180.0).contains(&width.parse::<f64>().expect("a number")), "{width} mm");
    let sizes = svg.split("font-size=\"").skip(1).filter_map(|rest| rest.split_once('"'));
    let sizes: Vec<f64> = sizes.map(|(size, _)| size.parse().expect("a number")).collect();
    assert!(sizes.len() >= 6 && sizes.iter().all(|size| size * 72.0 / 300.0 >= 7.0), "{sizes:?}");
}

/// The models of each time of a series have the same names, so the table of another time also has their rows.
#[test]
fn a_table_of_other_files_of_the_same_names_gives_a_warning() {
    let site = tempfile::tempdir().expect("a folder");
    for folder in ["early", "late"] {
        std::fs::create_dir(site.path().join(folder)).expect("a folder");
        let path = site.path().join(folder).join("a.ply");
        write_mesh(path, &icosphere(1), &WriteOptions::default()).expect("a surface");
    }
    let warned = |cell: &str, table: &str| {
        std::fs::write(site.path().join(table), format!("model\tsize\n{cell}\t3\n")).expect("a table");
        let mut drawing = tool("picture");
        drawing.args(["late/a.ply", "--size", "64", "--force", "-o", "a.png", "--colour-by", &format!("{table}:size")]);
        let output = finish(drawing.current_dir(site.path()));
        assert!(output.status.success(), "{}", text(&output));
        let expected =
            format!("paths in 1 of 1 rows lead to other files of the same names, such as {cell} for late/a.ply;");
        text(&output).contains(&expected)
    };
    assert!(warned("early/a.ply", "early/t.tsv"), "relative to the current folder");
    assert!(warned("a.ply", "early/t.tsv"), "relative to the table");
    for (cell, table) in
        [("late/a.ply", "early/t.tsv"), ("a.ply", "late/t.tsv"), ("a", "early/t.tsv"), ("gone/a.ply", "t.tsv")]
    {
        assert!(!warned(cell, table), "{cell} in {table}");
    }
}
