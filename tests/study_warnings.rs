//! Warnings of a study about subjects that are far from the others, duplicate files, and poses.

use std::fs;
use std::path::Path;
use std::process::Output;

use spharm_surface::io::{WriteOptions, read_mesh, write_mesh};

use crate::common::{error_line, fail, finish, succeed, text, tool};

const STUDY: &str = r#"
output = "out"
[subjects]
table = "meshes/study.csv"
[fit]
max_degree = 4
# By angles, the default of joint, the sphericity of one of these bodies is flagged at this degree.
arguments = ["--area", "0.8"]
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

/// Spoils two subjects: a03 gets a wrong unit, and a02 the mesh of b01.
fn spoil(site: &Path) {
    let meshes = site.join("meshes");
    scale(&meshes.join("a03.ply"), 10.0);
    fs::copy(meshes.join("b01.ply"), meshes.join("a02.ply")).expect("a copy");
}

/// Returns id, state and flags of each subject in the table of the quality control.
fn checked(site: &Path) -> Vec<(String, String, String)> {
    let table = fs::read_to_string(site.join("out/quality.tsv")).expect("a table");
    let row = |line: &str| {
        let mut cells = line.split('\t').map(str::to_owned);
        let mut next = || cells.next().expect("a cell");
        (next(), next(), next())
    };
    table.lines().skip(1).map(row).collect()
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
    assert!(text(&run(site.path())).contains("quality control: no subject flagged, see out/quality.tsv"));
    for (id, state, why) in checked(site.path()) {
        assert!(state == "ok" && why.is_empty(), "a study without faults: {id}: {why}");
    }
    assert!(fs::read_dir(site.path().join("out/thumbnails")).expect("pictures").count() == 10);

    spoil(site.path());
    let output = run(site.path());
    let (terminal, _) = warnings(site.path(), &output);
    let found = checked(site.path());
    let (id, state, why) = &found[0];
    assert_eq!((id.as_str(), state.as_str()), ("a03", "flagged"), "the worst is the first: {found:?}");
    for said in [
        "volume ",
        "area ",
        "distance from the mean ",
        "robust z ",
        "another unit: about 10 times",
        "mode 1 is mostly due to",
    ] {
        assert!(why.contains(said), "{said}: {why}");
    }
    let flagged: Vec<&str> =
        found.iter().filter(|(_, state, _)| state == "flagged").map(|(id, ..)| id.as_str()).collect();
    assert_eq!(flagged.len(), 3, "{found:?}");
    for (id, other) in [("a02", "b01"), ("b01", "a02")] {
        let (.., why) = found.iter().find(|(of, ..)| of == id).expect("it is listed");
        assert_eq!(*why, format!("same input as {other}"));
    }
    // The terminal and the page show the same flags in the same order.
    let page = fs::read_to_string(site.path().join("out/report.html")).expect("a page");
    for (id, _, why) in found.iter().take(3) {
        assert!(terminal.contains(&format!("{id}: {why}")), "{id}: {why}: {terminal:?}");
        // The page has each reason on its own line.
        assert!(why.split("; ").all(|reason| page.contains(reason)), "{id}: {why}");
    }
    assert!(page.contains("10 subjects: 3 flagged.") && page.matches("<figure class=\"flagged\"").count() == 3);
    let control = page.find("id=\"quality-control\"").expect("a section");
    assert!(control < page.find("id=\"items\"").expect("items"), "it is the first section");
    // Without changes, a second run gives the same page.
    run(site.path());
    assert!(page == fs::read_to_string(site.path().join("out/report.html")).expect("a page"));
}

#[test]
fn a_strict_study_stops_at_a_flag_and_excluded_subjects_are_left_out() {
    let site = site("joint");
    spoil(site.path());
    let error = fail(tool("study").args(["study.toml", "--strict"]).current_dir(site.path()));
    assert!(error.contains("quality.tsv: 3 subjects flagged") && error.contains("`exclude`"), "{error}");
    assert!(!site.path().join("out/tests").exists() && !site.path().join("out/report.html").exists());
    // Results of a run without --strict are removed when a strict run stops.
    run(site.path());
    assert!(site.path().join("out/tests/bump/test.csv").exists() && site.path().join("out/report.html").exists());
    fail(tool("study").args(["study.toml", "--strict"]).current_dir(site.path()));
    for name in ["tests/bump/test.csv", "report.html", "methods.md", "provenance.json"] {
        assert!(!site.path().join("out").join(name).exists(), "{name}");
    }

    let accepted = ["b01", "b03"].map(|id| format!("{{ id = \"{id}\", reason = \"looked at\" }}")).join(", ");
    let exclude = "exclude = [{ id = \"a03\", reason = \"in tenths of mm\" }, \"a02\"]";
    let exclude = &format!("{exclude}\naccept = [{accepted}]\n[fit]");
    let study = fs::read_to_string(site.path().join("study.toml")).expect("the study").replace("[fit]", exclude);
    fs::write(site.path().join("study.toml"), study).expect("the study");
    let output = finish(tool("study").args(["study.toml", "--strict"]).current_dir(site.path()));
    let said = text(&output);
    assert!(output.status.success() && said.contains("page: "), "{said}");
    let found = checked(site.path());
    assert!(found.contains(&("a03".to_owned(), "excluded".to_owned(), "in tenths of mm".to_owned())), "{found:?}");
    assert!(found.contains(&("a02".to_owned(), "excluded".to_owned(), String::new())), "{found:?}");
    let page = fs::read_to_string(site.path().join("out/report.html")).expect("a page");
    assert!(page.contains("2 excluded.") && page.contains("in tenths of mm"));
    assert!(page.contains("1 accepted") && page.contains("accepted: looked at"));
    // Without a02, which had the same mesh, b01 has no flag.
    let remained = "1 subject remained in the group regardless of flags from the quality control (b03: looked at)";
    let methods = fs::read_to_string(site.path().join("out/methods.md")).expect("a paragraph");
    assert!(methods.contains(remained), "{methods}");
    assert!(said.contains("b01 is accepted but not flagged") && !said.contains("b03 is accepted"), "{said}");

    // The results equal those of a table without the two excluded subjects.
    let results = fs::read(site.path().join("out/tests/bump/test.csv")).expect("a result");
    let table = fs::read_to_string(site.path().join("meshes/study.csv")).expect("a table");
    let table: Vec<&str> = table.lines().filter(|line| !line.starts_with("a02") && !line.starts_with("a03")).collect();
    fs::write(site.path().join("meshes/study.csv"), table.join("\n") + "\n").expect("a table");
    fs::write(site.path().join("study.toml"), STUDY.replace("METHOD", "joint")).expect("a file");
    run(site.path());
    assert!(results == fs::read(site.path().join("out/tests/bump/test.csv")).expect("a result"));
}

#[test]
fn exclusions_that_cannot_be_are_refused() {
    let site = site("joint");
    let study = STUDY.replace("METHOD", "joint");
    let all: Vec<String> = (1..=5).flat_map(|k| [format!("\"a{k:02}\""), format!("\"b{k:02}\"")]).collect();
    for (exclude, expected) in [
        ("[\"a3\"]".to_owned(), "no subject \"a3\"; did you mean \"a03\"?"),
        ("[\"a03\", \"a03\"]".to_owned(), "\"a03\" is listed twice"),
        ("\"a03\"".to_owned(), "found a value of type string"),
        ("[{ id = \"a03\", reason = \"\" }]".to_owned(), "found a table that lacks the id or the reason"),
        ("[{ id = \"a03\", why = \"x\" }]".to_owned(), "`exclude` in [subjects]: expected a list, such as"),
        (format!("[{}]", all[..8].join(", ")), "expected 3 subjects or more, found 2 (8 subjects excluded)"),
        (
            "[{ id = \"b01\", reason = \"moved\" }, \"b02\", \"b03\", \"b04\", \"b05\"]".to_owned(),
            "test \"bump\": no subject with group \"b\" is left of the 5 subjects in the table; excluded: b01 (moved), \
             b02, b03 and 2 more; keep or repair some of them, or change the test",
        ),
    ] {
        let text = study.replace("[fit]", &format!("exclude = {exclude}\n[fit]"));
        fs::write(site.path().join("study.toml"), text).expect("a file");
        let error = fail(tool("study").arg("study.toml").current_dir(site.path()));
        assert!(error.contains(expected), "{exclude}: {error}");
        assert!(!site.path().join("out").exists());
    }
}

#[test]
fn a_group_of_which_no_subject_is_left_is_named_with_the_reasons() {
    let site = site("joint");
    let study = STUDY.replace("METHOD", "joint");
    let run = |text: &str, more: &[&str]| {
        fs::write(site.path().join("study.toml"), text).expect("a file");
        finish(tool("study").args(["study.toml", "--threads", "2"]).args(more).current_dir(site.path()))
    };
    // Of three groups, one may be excluded, unless the test names it.
    let table = fs::read_to_string(site.path().join("meshes/study.csv")).expect("a table");
    let third = table.replace("b04.ply,b", "b04.ply,c").replace("b05.ply,b", "b05.ply,c");
    fs::write(site.path().join("meshes/study.csv"), third).expect("a table");
    let without = study.replace("[fit]", "exclude = [\"b04\", \"b05\"]\n[fit]");
    let output = run(&without, &["--dry-run"]);
    assert!(output.status.success(), "{}", text(&output));
    for named in ["levels = [\"a\", \"b\", \"c\"]", "contrast = \"a - 1/2 b - 1/2 c\""] {
        let error = error_line(&run(&without.replace("permutations", &format!("{named}\npermutations")), &[]));
        assert!(
            error.contains("no subject with group \"c\" is left of the 2 subjects in the table; excluded: b04, b05;"),
            "{error}"
        );
    }
    fs::write(site.path().join("meshes/study.csv"), table).expect("a table");
    // Failures are found before the models are aligned.
    for id in ["b02", "b03", "b04", "b05"] {
        fs::write(site.path().join(format!("meshes/{id}.ply")), "ply\nnot a mesh\n").expect("a file");
    }
    let output = run(&study.replace("[fit]", "exclude = [{ id = \"b01\", reason = \"moved\" }]\n[fit]"), &[]);
    let error = error_line(&output);
    for said in [
        "study.toml: test \"bump\": no subject with group \"b\" is left of the 5 subjects in the table; excluded: \
         b01 (moved); failed: b02 (",
        "meshes/b02.ply: ",
        " and 1 more; keep or repair some of them",
    ] {
        assert!(error.contains(said), "{said}: {error}");
    }
    assert!(site.path().join("out/models/a01.spharm.npz").exists() && !site.path().join("out/aligned").exists());
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
    run(site.path());
    let found = checked(site.path());
    for (id, expected) in [("a01", "a04, b02"), ("a04", "a01, b02"), ("b02", "a01, a04")] {
        let (.., why) = found.iter().find(|(of, ..)| of == id).expect("it is listed");
        assert!(why.contains(&format!("same model as {expected}")), "{id}: {why}");
    }
}
