//! Warnings of a study about subjects that are far from the others, duplicate files, and poses.

use std::fs;
use std::path::Path;
use std::process::Output;

use spharm_surface::io::{WriteOptions, read_mesh, write_mesh};

use crate::common::{finish, succeed, text, tool};

const STUDY: &str = r#"
output = "out"
[subjects]
table = "meshes/study.csv"
[fit]
max_degree = 4
[align]
method = "METHOD"
[modes]
count = 2
[[test]]
name = "bump"
effect = "group"
permutations = 20
"#;

/// Creates a folder with the meshes of ten subjects and a study file for them.
fn site(method: &str) -> tempfile::TempDir {
    let site = tempfile::tempdir().expect("a folder");
    succeed(tool("generate").args(["--study", "meshes", "--subjects", "10", "-q"]).current_dir(site.path()));
    fs::write(site.path().join("study.toml"), STUDY.replace("METHOD", method)).expect("a file");
    site
}

fn scale(path: &Path, factor: f64) {
    let mut mesh = read_mesh(path).expect("a mesh");
    mesh.vertices.iter_mut().for_each(|vertex| vertex.iter_mut().for_each(|x| *x *= factor));
    write_mesh(path, &mesh, &WriteOptions { overwrite: true, ..WriteOptions::default() }).expect("it is written");
}

fn run(site: &Path) -> Output {
    let output = finish(tool("study").args(["study.toml", "--threads", "2"]).current_dir(site));
    assert!(output.status.success(), "{}", text(&output));
    output
}

/// Returns the warnings printed on the terminal after the table of stages, and the warnings of the page.
fn warnings(site: &Path, output: &Output) -> (Vec<String>, Vec<String>) {
    let stderr = String::from_utf8_lossy(&output.stderr);
    let ends = stderr.lines().filter_map(|line| line.strip_prefix("warning: ")).map(str::to_owned).collect();
    let page = fs::read_to_string(site.join("out/report.html")).expect("a page");
    let section = page.split_once("<section class=\"warnings\"").and_then(|(_, rest)| rest.split_once("</section>"));
    let items = section.map_or(Vec::new(), |(section, _)| section.lines().map(str::to_owned).collect::<Vec<_>>());
    let item = |line: String| Some(line.strip_prefix("<li><bdi>")?.strip_suffix("</bdi></li>")?.replace("&#39;", "'"));
    (ends, items.into_iter().filter_map(item).collect())
}

#[test]
fn a_wrong_unit_and_a_file_under_two_ids_are_named_at_the_end_and_on_the_page() {
    let site = site("joint");
    let clean = run(site.path());
    let (_, page) = warnings(site.path(), &clean);
    let named = page.iter().find(|warning| warning.contains("far from") || warning.contains("are equal,"));
    assert_eq!(named, None, "a study without faults");

    let meshes = site.path().join("meshes");
    scale(&meshes.join("a03.ply"), 10.0);
    fs::copy(meshes.join("b01.ply"), meshes.join("a02.ply")).expect("a copy");
    let output = run(site.path());
    let (terminal, page) = warnings(site.path(), &output);
    let far = page.iter().find(|warning| warning.starts_with("a03: far from the other subjects: volume "));
    let far = far.unwrap_or_else(|| panic!("{page:?}"));
    for said in ["area ", "distance from the mean ", "robust z ", "check its surface, its units and its label"] {
        assert!(far.contains(said), "{far}");
    }
    assert!(page.iter().any(|warning| warning.starts_with("a02, b01: these inputs are equal")), "{page:?}");
    assert_eq!(page.iter().filter(|warning| warning.contains("a02, b01")).count(), 1, "once: {page:?}");
    assert!(!page.iter().any(|warning| warning.starts_with("b0")), "the others are near: {page:?}");
    for warning in &page {
        assert!(terminal.contains(warning), "{warning}: {terminal:?}");
    }
    // Without changes, a second run gives the same page and the same warnings.
    let before = fs::read(site.path().join("out/report.html")).expect("a page");
    let (_, again) = warnings(site.path(), &run(site.path()));
    assert_eq!(again, page);
    assert!(before == fs::read(site.path().join("out/report.html")).expect("a page"));
}

#[test]
fn models_that_are_equal_are_named_where_their_files_are_not() {
    let site = site("joint");
    let meshes = site.path().join("meshes");
    let mesh = read_mesh(meshes.join("a01.ply")).expect("a mesh");
    // Two subjects get the same mesh in other formats.
    write_mesh(meshes.join("a04.obj"), &mesh, &WriteOptions::default()).expect("it is written");
    write_mesh(meshes.join("b02.off"), &mesh, &WriteOptions::default()).expect("it is written");
    let table = fs::read_to_string(meshes.join("study.csv")).expect("a table");
    let table = table.replace("a04.ply", "a04.obj").replace("b02.ply", "b02.off");
    fs::write(meshes.join("study.csv"), table).expect("a table");
    let (terminal, page) = warnings(site.path(), &run(site.path()));
    let expected = "a01, a04, b02: these models are equal";
    for (place, found) in [("page", page), ("terminal", terminal)] {
        assert!(found.iter().any(|warning| warning.starts_with(expected)), "{place}: {found:?}");
    }
}
