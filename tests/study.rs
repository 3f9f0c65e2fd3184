//! Runs a study from its file to its page: stages, reruns, interruptions, bad files.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::common::{fail, finish, succeed, text, times, tool, wait};

const STUDY: &str = r#"
title = "Bump <b>"
output = "out"
[subjects]
table = "meshes/study.csv"
[fit]
max_degree = 4
[modes]
count = 3
[quality]
surfaces = false
[[test]]
name = "bump"
effect = "group"
levels = ["b", "a"]
permutations = 20
"#;

/// Creates a folder with the meshes of six subjects and a study file for them.
fn site() -> tempfile::TempDir {
    let site = tempfile::tempdir().expect("a folder");
    let mut generate = tool("generate");
    generate.args(["--study", "meshes", "--subjects", "6", "-q"]).current_dir(site.path());
    succeed(&mut generate);
    fs::write(site.path().join("study.toml"), STUDY).expect("a file");
    site
}

fn study(site: &Path, more: &[&str]) -> std::process::Command {
    let mut command = tool("study");
    command.arg("study.toml").args(more).args(["--threads", "2"]).current_dir(site);
    command
}

/// Returns all outputs of a study, except status files, which contain times.
fn made(site: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    fn list(folder: &Path, files: &mut BTreeMap<PathBuf, Vec<u8>>) {
        for entry in fs::read_dir(folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                list(&path, files);
            } else {
                files.insert(path.clone(), fs::read(&path).expect("a file"));
            }
        }
    }
    let (out, mut files) = (site.join("out"), BTreeMap::new());
    list(&out, &mut files);
    let relative = |path: PathBuf| path.strip_prefix(&out).expect("in it").to_owned();
    files
        .into_iter()
        .map(|(path, bytes)| (relative(path), bytes))
        .filter(|(path, _)| !path.starts_with("status"))
        .collect()
}

/// Returns the outcome of each stage, from the table that is printed at the end.
fn stages(stdout: &str) -> BTreeMap<String, String> {
    let table = stdout.rsplit_once("stage ").expect("a table of stages").1;
    let row = |line: &str| {
        let (stage, rest) = line.split_once("  ")?;
        let state = ["done", "up to date"].into_iter().find(|state| rest.trim_start().starts_with(state))?;
        Some((stage.trim().to_owned(), state.to_owned()))
    };
    table.lines().filter_map(row).collect()
}

#[test]
fn the_methods_count_surfaces_and_blocks_if_a_subject_has_several_rows() {
    let site = site();
    let table = site.path().join("meshes/study.csv");
    let rows = fs::read_to_string(&table).expect("a table");
    let with_child = |line: &str| match line.strip_prefix(['a', 'b']) {
        Some(rest) => format!("{line},c{}\n", &rest[..2]),
        None => format!("{line},child\n"),
    };
    fs::write(&table, rows.lines().map(with_child).collect::<String>()).expect("a table");
    let text = STUDY.replace("surfaces = false", "surfaces = true\nplain = false") + "blocks = \"child\"\n";
    fs::write(site.path().join("study.toml"), text).expect("a file");
    succeed(&mut study(site.path(), &[]));
    let quality = fs::read_to_string(site.path().join("out/quality/correspond.json")).expect("a report");
    let quality: serde_json::Value = serde_json::from_str(&quality).expect("JSON");
    assert!(quality["surface_generalisation"]["values"].is_array(), "distances between surfaces: {quality}");
    let methods = fs::read_to_string(site.path().join("out/methods.md")).expect("a paragraph");
    assert!(methods.starts_with("6 surfaces in 3 blocks (levels of child) were modelled by"), "{methods}");
}

#[test]
fn a_study_is_made_once_and_after_a_change_only_what_depends_on_it() {
    let site = site();
    let first = stages(&succeed(&mut study(site.path(), &[])));
    let names = "check correspond describe fit measure modes picture.bump.png picture.bump.svg plain quality quality.plain report test.bump";
    assert_eq!(first.keys().map(String::as_str).collect::<Vec<_>>().join(" "), names);
    assert!(first.values().all(|state| state == "done"), "{first:?}");
    let all = made(site.path());
    for name in [
        "models/a01.spharm.npz",
        "group/b03.spharm.npz",
        "tests/bump/p-fwe.shape.gii",
        "figures/bump.png",
        "figures/bump.svg",
    ] {
        assert!(all.contains_key(Path::new(name)), "{name}");
    }
    let page = String::from_utf8(all[Path::new("report.html")].clone()).expect("UTF-8");
    assert!(page.contains("Bump &lt;b&gt;") && !page.contains("<b>"), "the title is text");
    for said in ["group: b - a", "6: 3 b, 3 a", "4 degrees of freedom", "20, all of them", "Accounted for"] {
        assert!(page.contains(said), "the page says what was tested: {said}");
    }

    let again = stages(&succeed(&mut study(site.path(), &[])));
    assert!(again.iter().all(|(stage, state)| stage == "fit" || state == "up to date"), "{again:?}");
    assert!(made(site.path()) == all, "the same bytes");

    fs::write(site.path().join("study.toml"), STUDY.replace("count = 3", "count = 2")).expect("a file");
    let changed = stages(&succeed(&mut study(site.path(), &[])));
    let done: Vec<&str> =
        changed.iter().filter(|(_, state)| *state == "done").map(|(stage, _)| stage.as_str()).collect();
    assert_eq!(done, ["check", "fit", "modes", "report", "test.bump"]);

    // Change one subject's surface, and remove another subject from the table.
    let table = site.path().join("meshes/study.csv");
    let without = fs::read_to_string(&table).expect("a table").replace("a03,a03.ply,a\n", "");
    fs::write(&table, without).expect("a table");
    fs::copy(site.path().join("meshes/a03.ply"), site.path().join("meshes/a01.ply")).expect("a copy");
    fs::write(site.path().join("study.toml"), STUDY).expect("a file");
    succeed(&mut study(site.path(), &[]));
    let now = made(site.path());
    assert!(!now.contains_key(Path::new("group/a03.spharm.npz")), "nothing is left of who has left");
    assert_ne!(now[Path::new("models/a01.spharm.npz")], all[Path::new("models/a01.spharm.npz")]);
    assert_eq!(now[Path::new("models/a02.spharm.npz")], all[Path::new("models/a02.spharm.npz")]);
}

#[test]
fn a_study_that_is_killed_is_continued_to_the_same_bytes() {
    let whole = site();
    succeed(&mut study(whole.path(), &[]));
    let killed = site();
    let mut interrupted = 0;
    for moment in 0..times(5) {
        let mut child = study(killed.path(), &["-q"])
            .stdout(std::process::Stdio::piped())
            .stderr(std::process::Stdio::piped())
            .spawn()
            .expect("it starts");
        std::thread::sleep(Duration::from_millis(40 + 170 * (moment as u64 * 7 % 20)));
        child.kill().expect("it can be killed");
        interrupted += usize::from(!wait(child).status.success());
    }
    assert!(interrupted > 0, "the moments are in the study");
    succeed(&mut study(killed.path(), &[]));
    let (expected, found) = (made(whole.path()), made(killed.path()));
    let names = |files: &BTreeMap<PathBuf, Vec<u8>>| {
        files.keys().filter(|path| !path.starts_with(".study")).cloned().collect::<Vec<_>>()
    };
    assert_eq!(names(&found), names(&expected));
    // These files contain times, so their bytes differ.
    let timed = |name: &PathBuf| name.ends_with("group.json") || name.starts_with("quality");
    for name in names(&expected).into_iter().filter(|name| !timed(name)) {
        assert!(found[&name] == expected[&name], "{}", name.display());
    }
}

#[test]
fn a_subject_that_fails_is_named_and_the_others_make_the_study() {
    let site = site();
    fs::write(site.path().join("meshes/b02.ply"), "ply\nnot a mesh\n").expect("a file");
    let output = finish(&mut study(site.path(), &[]));
    assert_eq!(output.status.code(), Some(1), "{}", text(&output));
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(stderr.contains("warning: b02: ") && stderr.contains("1 subject of 6 failed"), "{stderr}");
    let found = made(site.path());
    assert!(found.contains_key(Path::new("report.html")) && !found.contains_key(Path::new("group/b02.spharm.npz")));
    assert!(String::from_utf8_lossy(&found[Path::new(".study/subjects.tsv")]).contains("b02\tfailed\t"));
    let methods = String::from_utf8_lossy(&found[Path::new("methods.md")]);
    assert!(
        methods.contains("of 5 subjects") && methods.contains("1 subject could not be modelled (b02)"),
        "{methods}"
    );
    // A subject that fails again is no difference.
    let mut again = tool("study");
    again.args(["--again", "out/provenance.json"]).current_dir(site.path());
    let output = finish(&mut again);
    let printed = text(&output);
    assert!(printed.contains("warning: b02: ") && printed.contains("1 subject of 6 failed"), "{printed}");
    assert!(output.status.success() && printed.contains("identical to the recorded results"), "{printed}");
}

#[test]
fn shards_fit_their_subjects_and_a_last_call_does_the_rest() {
    let site = site();
    for shard in ["0/2", "1/2"] {
        let stdout = succeed(&mut study(site.path(), &["--shard", shard]));
        assert_eq!(stages(&stdout).len(), 1, "{stdout}");
    }
    assert_eq!(made(site.path()).keys().filter(|path| path.ends_with("a01.spharm.npz")).count(), 1);
    let commands = succeed(&mut study(site.path(), &["--dry-run"]));
    assert_eq!(commands.lines().count(), 13, "{commands}");
    assert!(commands.lines().all(|line| line.starts_with("spharm ")), "{commands}");
    succeed(&mut study(site.path(), &[]));
    assert!(made(site.path()).contains_key(Path::new("report.html")));
}

#[test]
fn studies_that_are_none_are_refused_in_words() {
    let site = site();
    let mut init = tool("study");
    init.args(["init", "mine.toml"]).current_dir(site.path());
    succeed(&mut init);
    let mut again = tool("study");
    again.args(["init", "mine.toml"]).current_dir(site.path());
    assert!(fail(&mut again).contains("mine.toml"));
    for (from, to, expected) in [
        ("max_degree", "max_degre", "did you mean `max_degree`?"),
        ("effect = \"group\"", "effect = \"site\"", "has no column \"site\"; its columns are group"),
        ("meshes/study.csv", "meshes/other.csv", "other.csv"),
        ("max_degree = 4", "max_degree = ", "line "),
    ] {
        assert!(STUDY.contains(from), "{from}");
        fs::write(site.path().join("study.toml"), STUDY.replace(from, to)).expect("a file");
        let line = fail(&mut study(site.path(), &[]));
        assert!(line.contains(expected) && line.contains("study.toml") || from.contains("study.csv"), "{line}");
    }
    assert!(!site.path().join("out").exists(), "nothing is made of a bad study");
}
