//! Errors that are found before a study runs, and removal of files from its earlier runs.

use std::fs;
use std::path::Path;
use std::process::Command;

use crate::common::{error_line, fail, finish, succeed, text, tool};

const STUDY: &str = r#"
output = "out"
[subjects]
table = "meshes/study.csv"
[fit]
max_degree = 3
[modes]
count = 2
[quality]
surfaces = false
[[test]]
name = "bump"
effect = "group"
permutations = 0
"#;

/// Creates a folder with the meshes of six subjects and a study file for them.
fn site() -> tempfile::TempDir {
    let site = tempfile::tempdir().expect("a folder");
    let mut generate = tool("generate");
    generate.args(["--study", "meshes", "--subjects", "6", "-q"]).current_dir(site.path());
    succeed(&mut generate);
    write(site.path(), "study.toml", STUDY);
    site
}

fn write(site: &Path, name: &str, text: &str) {
    fs::write(site.join(name), text).expect("a file");
}

fn study(site: &Path) -> Command {
    let mut command = tool("study");
    command.args(["study.toml", "--threads", "2"]).current_dir(site);
    command
}

#[test]
fn what_would_fail_after_the_fits_is_refused_before_them() {
    let site = site();
    let table = fs::read_to_string(site.path().join("meshes/study.csv")).expect("a table");
    let ages = |of: &dyn Fn(usize) -> String| -> String {
        let lines = table.lines().enumerate();
        lines.map(|(k, line)| if k == 0 { format!("{line},age\n") } else { format!("{line},{}\n", of(k)) }).collect()
    };
    let number = |k: usize| (60 + k * k % 7).to_string();
    let but = |cell: &'static str| move |k: usize| if k == 3 { cell.to_owned() } else { number(k) };
    let with_age = STUDY.replace("permutations", "covariates = [\"age\"]\npermutations");
    for (study_text, table, expected) in [
        (
            &with_age,
            ages(&but("n/a")),
            "a03: column \"age\": expected a value, found \"n/a\"; remove the subject from the table",
        ),
        (&with_age, ages(&but("NaN")), "found \"NaN\""),
        (&with_age, ages(&but("")), "a03: column \"age\": expected a value, found nothing"),
        (&with_age, ages(&|k| if k > 3 { "2".to_owned() } else { "1".to_owned() }), "age"),
        (
            &STUDY.to_owned(),
            table.replace("a02.ply,a", "a02.ply,NA"),
            "a02: column \"group\": expected a value, found \"NA\"",
        ),
        (&STUDY.to_owned(), table.replace(".ply,b", ".ply,a"), "expected two levels or more"),
        (
            &STUDY.replace("effect", "levels = [\"b\"]\neffect"),
            table.clone(),
            "column \"group\": expected an order of all levels (a, b), found b",
        ),
        (&STUDY.replace("effect", "levels = [\"a\", \"c\"]\neffect"), table.clone(), "column \"group\""),
        (
            &STUDY.to_owned(),
            table.lines().take(3).map(|line| format!("{line}\n")).collect(),
            "expected 3 subjects or more, found 2",
        ),
        (
            &STUDY.replace("[modes]", "[align]\nmethod = \"fixed\"\n[modes]"),
            table.clone(),
            "needs spheres that correspond",
        ),
        (&STUDY.replace("[modes]", "[align]\nmethod = \"jiont\"\n[modes]"), table.clone(), "`method`: expected"),
        (
            &STUDY.replace("[modes]", "arguments = [\"--denois\"]\n[modes]"),
            table.clone(),
            "`arguments` in [fit]: unexpected argument '--denois'",
        ),
        (
            &STUDY.to_owned(),
            table.replace("id,surface,group", "id,surface,Sphere"),
            "unknown column \"Sphere\"; rename the column to sphere",
        ),
    ] {
        write(site.path(), "study.toml", study_text);
        write(site.path(), "meshes/study.csv", &table);
        let line = fail(&mut study(site.path()));
        assert!(line.contains(expected) && line.matches("error:").count() == 1, "{line}");
    }
    assert!(!site.path().join("out").exists(), "nothing is made of them");
}

#[test]
fn a_study_file_is_made_for_a_table() {
    let site = site();
    let init = |more: &[&str]| {
        let mut init = tool("study");
        init.args(["init", "mine.toml", "--table", "meshes/study.csv"]).args(more).current_dir(site.path());
        init
    };
    succeed(&mut init(&[]));
    assert!(fail(&mut init(&[])).contains("--force"));
    succeed(&mut init(&["--force"]));
    let mut dry = tool("study");
    let commands = succeed(dry.args(["mine.toml", "--dry-run"]).current_dir(site.path()));
    assert!(commands.starts_with("spharm fit --manifest meshes/study.csv"), "{commands}");
}

#[test]
fn damaged_models_are_made_again_and_nothing_is_left_of_what_has_gone() {
    let site = site();
    let at = |name: &str| site.path().join("out").join(name);
    let first = finish(&mut study(site.path()));
    assert!(first.status.success(), "{}", text(&first));
    assert!(!text(&first).contains("don't correspond"), "the study aligns them: {}", text(&first));
    let good = fs::read(at("models/a03.spharm.npz")).expect("a model");
    let measures = fs::read_to_string(at("measures.csv")).expect("a table");
    assert!(measures.lines().nth(1).is_some_and(|line| line.starts_with("a01,")), "{measures}");

    // Create a damaged model, leftovers of a killed process, files of another program, a removed subject, a broken
    // surface, and a removed test.
    fs::write(at("models/a03.spharm.npz"), &good[..100]).expect("a file");
    for name in ["models/.spharm.abcdef.tmp", ".study/.spharm.abcdef.tmp", "models/notes.txt", "tests/bump/notes.txt"] {
        fs::write(at(name), "x").expect("a file");
    }
    let table = fs::read_to_string(site.path().join("meshes/study.csv")).expect("a table");
    write(site.path(), "meshes/study.csv", &table.replace("b03,b03.ply,b\n", ""));
    write(site.path(), "meshes/b02.ply", "ply\nnot a mesh\n");
    write(site.path(), "study.toml", &STUDY[..STUDY.find("[[test]]").expect("a test")]);
    let output = finish(&mut study(site.path()));
    assert!(error_line(&output).contains("1 subject of 5 failed"), "{}", text(&output));
    assert!(text(&output).contains("a03: the model was damaged"), "{}", text(&output));
    assert_eq!(fs::read(at("models/a03.spharm.npz")).expect("a model"), good);
    for gone in [
        "models/b03.spharm.npz",
        "models/b03.sphere.surf.gii",
        "models/b02.spharm.npz",
        "group/b03.spharm.npz",
        "group/members/b03.json",
        "plain/b03.spharm.npz",
        "tests/bump/p.shape.gii",
        "figures/bump.png",
        "models/.spharm.abcdef.tmp",
        ".study/.spharm.abcdef.tmp",
    ] {
        assert!(!at(gone).exists(), "{gone}");
    }
    assert!(at("models/notes.txt").exists() && at("tests/bump/notes.txt").exists(), "somebody else's");
    let mut status = tool("status");
    let counts = succeed(status.args(["out/status", "--json"]).current_dir(site.path()));
    let counts: serde_json::Value = serde_json::from_str(&counts).expect("JSON");
    assert_eq!((&counts["all"], &counts["failed"]), (&5.into(), &1.into()), "{counts}");
}

#[test]
fn files_that_no_run_has_written_are_replaced_only_with_force() {
    let site = site();
    write(site.path(), "study.toml", &STUDY.replace("output = \"out\"", "output = \".\""));
    fs::create_dir_all(site.path().join("group")).expect("a folder");
    fs::create_dir_all(site.path().join("tests/bump")).expect("a folder");
    for name in ["report.html", "methods.md", "group/notes.txt"] {
        write(site.path(), name, "mine");
    }
    let refused = |arguments: &[&str]| {
        let error = fail(study(site.path()).args(arguments));
        assert!(error.contains("found group, methods.md, report.html but no records of an earlier run"), "{error}");
    };
    refused(&["--dry-run"]);
    refused(&[]);
    refused(&["--shard", "0/2"]);
    assert_eq!(fs::read_to_string(site.path().join("report.html")).expect("a file"), "mine");
    assert!(!site.path().join(".study").exists() && !site.path().join("models").exists());
    succeed(study(site.path()).arg("--force"));
    assert_ne!(fs::read_to_string(site.path().join("report.html")).expect("a file"), "mine");
    // Once the study has run, the files are its own.
    succeed(&mut study(site.path()));
    succeed(study(site.path()).arg("--dry-run"));
}

#[test]
fn a_row_whose_model_was_deleted_is_not_done() {
    let site = site();
    let mut fit = tool("fit");
    fit.args(["--manifest", "meshes/study.csv", "--max-degree", "2", "-o", "models", "--status", "s.tsv", "-q"]);
    succeed(fit.args(["--no-surface-distance"]).current_dir(site.path()));
    fs::remove_file(site.path().join("models/b01.spharm.npz")).expect("it is there");
    let mut status = tool("status");
    status.args(["s.tsv", "--manifest", "meshes/study.csv", "--failed", "rest.csv"]).current_dir(site.path());
    let said = succeed(&mut status);
    assert!(said.lines().any(|line| line.split_whitespace().eq(["gone", "1"])), "{said}");
    assert!(said.lines().any(|line| line.split_whitespace().eq(["done", "5"])), "{said}");
    let rest = fs::read_to_string(site.path().join("rest.csv")).expect("a table");
    assert_eq!(rest, "id,surface,group\nb01,meshes/b01.ply,b\n".replace("meshes/", &rest_folder(&rest)));
}

/// Returns the folder of the paths in a table of remaining rows. The paths are absolute if the table is in another
/// folder.
fn rest_folder(rest: &str) -> String {
    let path = rest.lines().nth(1).and_then(|line| line.split(',').nth(1)).unwrap_or_default();
    path.trim_end_matches("b01.ply").to_owned()
}

/// Rows 12 and 44 of the problems of first-time users: the report of a study as JSON, and maps by angles for `joint`.
#[test]
fn a_study_prints_one_json_report() {
    let site = site();
    let printed = succeed(study(site.path()).args(["--json", "-q"]));
    let report: serde_json::Value = serde_json::from_str(&printed).expect("JSON and nothing else");
    assert_eq!(report["tool"], "study");
    assert_eq!((&report["subjects"], &report["failed"]), (&6.into(), &serde_json::json!([])));
    assert_eq!(report["stages"][0]["stage"], "fit");
    assert!(report["page"].as_str().is_some_and(|page| site.path().join(page).is_file()));
    assert_eq!(report["tests"][0]["tested"], "a - b");
    assert!(report["tests"][0]["summary"]["p"]["least"].is_f64() && report["tests"][0]["peak"]["vertex"].is_u64());
    // A failure is shown in the report and in the exit status.
    write(site.path(), "meshes/a03.ply", "nothing");
    let output = finish(study(site.path()).args(["--json", "-q"]));
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert!(output.status.code() == Some(1) && report["failed"][0]["id"] == "a03", "{}", text(&output));
    write(site.path(), "study.toml", &STUDY.replace("[modes]", "[align]\nmethod = \"joint\"\n[modes]"));
    let commands = text(&finish(study(site.path()).arg("--dry-run")));
    assert!(commands.contains("--update --area 0\n"), "{commands}");
    let given = STUDY.replace("max_degree = 3", "max_degree = 3\narguments = [\"--area\", \"0.5\"]");
    write(site.path(), "study.toml", &given.replace("[modes]", "[align]\nmethod = \"joint\"\n[modes]"));
    let commands = text(&finish(study(site.path()).arg("--dry-run")));
    assert!(commands.contains("--update --area 0.5\n"), "{commands}");
}
