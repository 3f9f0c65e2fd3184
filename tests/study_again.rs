//! Studies that are run again, from another folder, concurrently, or as a dry run; and tables of studies.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::common::{error_line, fail, finish, succeed, text, tool};
use crate::volumes::write_volume;

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

fn study(site: &Path, arguments: &[&str]) -> Command {
    let mut command = tool("study");
    command.args(arguments).args(["--threads", "2"]).current_dir(site);
    command
}

/// Returns files with their modification times, which change if a file is made again.
fn times(folder: &Path, files: &mut BTreeMap<PathBuf, std::time::SystemTime>) {
    for entry in fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            times(&path, files);
        } else {
            let time = fs::metadata(&path).and_then(|found| found.modified()).expect("a time");
            files.insert(path, time);
        }
    }
}

#[test]
fn a_study_is_the_same_from_another_folder() {
    let site = site();
    succeed(&mut study(site.path(), &["study.toml"]));
    let made = || {
        let mut files = BTreeMap::new();
        times(&site.path().join("out"), &mut files);
        files.retain(|path, _| !path.starts_with(site.path().join("out/status")));
        files
    };
    let before = made();
    let whole = site.path().join("study.toml").display().to_string();
    for (folder, file) in [(Path::new("/"), whole.as_str()), (&site.path().join("meshes"), "../study.toml")] {
        let said = succeed(&mut study(folder, &[file]));
        assert_eq!(said.matches("up to date").count(), 12, "{said}");
    }
    assert_eq!(made(), before);
    // The outputs of a removed test are also deleted if the study is run from another folder.
    write(site.path(), "study.toml", &STUDY[..STUDY.find("[[test]]").expect("a test")]);
    succeed(&mut study(Path::new("/"), &[&whole]));
    assert!(!site.path().join("out/figures/bump.png").exists() && !site.path().join("out/tests/bump").exists());
}

/// The reason of a failure names the file by its path from the study's folder, with a table and with a made manifest.
#[test]
fn a_failed_subject_is_no_difference_from_another_folder() {
    let site = site();
    let at = |name: &str| site.path().join(name);
    write(site.path(), "meshes/b02.ply", "ply\nnot a mesh\n");
    let joint = STUDY.replace("[modes]", "[align]\nmethod = \"joint\"\n[modes]");
    for study_text in [joint.clone(), joint.replace("[fit]", "exclude = [\"a02\"]\n[fit]")] {
        write(site.path(), "study.toml", &study_text);
        let output = finish(&mut study(site.path(), &["study.toml"]));
        assert!(text(&output).contains("1 subject of "), "{}", text(&output));
        let quality = fs::read_to_string(at("out/quality.tsv")).expect("a table");
        assert!(quality.contains("\nb02\tfailed\tmeshes/b02.ply: "), "{quality}");
        let whole = at("out/provenance.json").display().to_string();
        for (folder, record) in [(Path::new("/"), whole.as_str()), (&at("meshes"), "../out/provenance.json")] {
            let output = finish(&mut study(folder, &["--again", record]));
            let printed = text(&output);
            assert!(output.status.success() && printed.contains("identical to the recorded results"), "{printed}");
        }
    }
}

#[test]
fn a_study_runs_once_at_a_time() {
    let site = site();
    fs::create_dir_all(site.path().join("out/.study")).expect("a folder");
    let lock = fs::File::create(site.path().join("out/.study/.lock")).expect("a file");
    lock.try_lock().expect("it is free");
    for arguments in [&["study.toml"][..], &["study.toml", "--shard", "0/2"]] {
        let error = fail(&mut study(site.path(), arguments));
        assert!(error.contains("study.toml: the study is already running"), "{error}");
    }
    lock.unlock().expect("it is held");
    lock.try_lock_shared().expect("it is free");
    succeed(&mut study(site.path(), &["study.toml", "--shard", "0/2"]));
    assert!(fail(&mut study(site.path(), &["study.toml"])).contains("already running"));
    let output = finish(&mut study(site.path(), &["study.toml", "--shard", "5/3"]));
    assert!(output.status.code() == Some(2) && text(&output).contains("expected INDEX/COUNT, such as 0/10"));
}

#[test]
fn a_dry_run_of_a_study_looks_at_its_subjects() {
    let site = site();
    let dry = |text: &str| {
        write(site.path(), "study.toml", text);
        finish(&mut study(site.path(), &["study.toml", "--dry-run"]))
    };
    let good = dry(STUDY);
    assert!(good.status.success() && text(&good).contains("6 models, of which 0 exist"), "{}", text(&good));
    let high = STUDY.replace("max_degree = 3", "max_degree = 5000");
    let refused = dry(&high.replace("[modes]", "[align]\nmethod = \"joint\"\n[modes]"));
    assert!(error_line(&refused).contains("degree 5000 is above 2000"), "{}", text(&refused));
    // A value that a later stage would refuse is refused before the fits.
    let expected = "study.toml: correspond: invalid value '5000' for '--max-degree <L>': 5000 is not in 1..=1000";
    assert!(error_line(&dry(&high)).ends_with(expected), "{}", text(&dry(&high)));
    // With patterns there is no manifest on disk yet, so the dry run makes it in memory.
    let patterns = "table = \"meshes/ids.tsv\"\nsurface = \"meshes/{id}.ply\"";
    let table = fs::read_to_string(site.path().join("meshes/study.csv")).expect("a table");
    let ids = table.lines().map(|line| line.split(',').step_by(2).collect::<Vec<_>>().join("\t") + "\n");
    write(site.path(), "meshes/ids.tsv", &ids.collect::<String>());
    let by_pattern = STUDY.replace("table = \"meshes/study.csv\"", patterns);
    assert!(dry(&by_pattern).status.success());
    fs::remove_file(site.path().join("meshes/b02.ply")).expect("it is there");
    for text_of_study in [STUDY, &by_pattern] {
        let missing = dry(text_of_study);
        assert!(error_line(&missing).contains("1 of 6 surfaces would fail: b02"), "{}", text(&missing));
        assert!(text(&missing).contains("b02.ply: no such file"), "{}", text(&missing));
    }
    assert!(!site.path().join("out").exists(), "nothing is made");
    // All surfaces are missing, because their folder is renamed.
    fs::rename(site.path().join("meshes"), site.path().join("elsewhere")).expect("it is there");
    fs::create_dir(site.path().join("meshes")).expect("a folder");
    write(site.path(), "meshes/study.csv", &table);
    let error = error_line(&dry(STUDY));
    assert!(error.contains("6 of 6 surfaces would fail"), "{error}");
    let error = fail(&mut study(site.path(), &["study.toml"]));
    assert!(error.contains("expected 3 subjects or more that can be fitted, found 0; `spharm status "), "{error}");
}

#[test]
fn arguments_of_the_fit_count() {
    let site = tempfile::tempdir().expect("a folder");
    let radii = [16.0, 20.0, 25.0];
    for (name, radius) in ["a", "b", "c"].iter().zip(radii) {
        let ball = |[x, y, z]: [f64; 3]| u8::from(x * x + 0.8 * y * y + 0.7 * z * z < radius);
        write_volume(&site.path().join(format!("{name}.nii")), ball);
    }
    write(site.path(), "subjects.tsv", "id\tsurface\na\ta.nii\nb\tb.nii\nc\tc.nii\n");
    let of = |arguments: &str| {
        format!(
            "output = \"out\"\n[subjects]\ntable = \"subjects.tsv\"\n[fit]\nmax_degree = 3\narguments = [{arguments}]\n\
             [modes]\ncount = 1\n[quality]\nplain = false\nsurfaces = false\n"
        )
    };
    let volume = || -> f64 {
        let table = fs::read_to_string(site.path().join("out/measures.csv")).expect("a table");
        let mut rows = table.lines().map(|line| line.split(','));
        let column = rows.next().and_then(|mut head| head.position(|name| name == "volume")).expect("a column");
        rows.next().and_then(|mut row| row.nth(column)).and_then(|cell| cell.parse().ok()).expect("a number")
    };
    write(site.path(), "study.toml", &of(""));
    succeed(&mut study(site.path(), &["study.toml", "-q"]));
    let before = volume();
    write(site.path(), "study.toml", &of("\"--voxel-size\", \"3,3,3\""));
    succeed(&mut study(site.path(), &["study.toml", "-q"]));
    assert!((volume() / before - 27.0).abs() < 1e-6, "{} {before}", volume());
    assert!(succeed(&mut study(site.path(), &["study.toml", "-q"])).contains("up to date"));
}

#[test]
fn a_cell_that_is_no_number_among_numbers_is_refused() {
    let site = site();
    let table = fs::read_to_string(site.path().join("meshes/study.csv")).expect("a table");
    let with = |of: &dyn Fn(usize) -> String| -> String {
        let lines = table.lines().enumerate();
        lines.map(|(k, line)| format!("{line},{}\n", if k == 0 { "age".to_owned() } else { of(k) })).collect()
    };
    let with_age = STUDY.replace("permutations", "covariates = [\"age\"]\npermutations");
    write(site.path(), "study.toml", &with_age);
    for (cell, expected) in [
        ("None", "a03: column \"age\": expected a value, found \"None\""),
        ("null", "expected a value, found \"null\""),
        ("-", "expected a value, found \"-\""),
        ("?", "expected a value, found \"?\""),
        ("50y", "a03: column \"age\": expected a number, as in most rows, found \"50y\""),
        ("\"30,5\"", "a03: column \"age\": expected a number, as in most rows, found \"30,5\""),
    ] {
        let number = |k: usize| (60 + k * k % 7).to_string();
        write(site.path(), "meshes/study.csv", &with(&|k| if k == 3 { cell.to_owned() } else { number(k) }));
        let error = fail(&mut study(site.path(), &["study.toml"]));
        assert!(error.contains(expected), "{error}");
    }
    assert!(!site.path().join("out").exists());
    // The printed table, the written results and the page show that a covariate has levels.
    write(site.path(), "meshes/study.csv", &with(&|k| ["north", "south"][k % 2].to_owned()));
    let said = succeed(&mut study(site.path(), &["study.toml"]));
    assert!(said.contains("age (2 levels)"), "{said}");
    for file in ["out/tests/bump/test.json", "out/report.html"] {
        assert!(fs::read_to_string(site.path().join(file)).expect("a file").contains("age (2 levels)"), "{file}");
    }
}

#[test]
fn a_table_is_looked_at_before_a_study_is_made_for_it() {
    let site = site();
    write(site.path(), "twice.tsv", "id\tsurface\nx\ta.ply\nx\tb.ply\n");
    for (table, expected) in [("nope.tsv", "nope.tsv"), ("twice.tsv", "twice.tsv")] {
        let error = fail(&mut study_init(site.path(), table));
        assert!(error.contains(expected), "{error}");
    }
    assert!(!site.path().join("mine.toml").exists());
    succeed(&mut study_init(site.path(), "meshes/study.csv"));
}

fn study_init(site: &Path, table: &str) -> Command {
    let mut init = tool("study");
    init.args(["init", "mine.toml", "--table", table]).current_dir(site);
    init
}

/// A study is run again from its record alone, in a folder that was copied elsewhere, with the same results.
#[test]
fn a_study_is_run_again_from_its_provenance() {
    let site = tempfile::tempdir().expect("a folder");
    let at = |name: &str| site.path().join(name);
    succeed(tool("generate").args(["--study", "meshes", "--subjects", "6", "-q"]).current_dir(site.path()));
    let study = "output = \"out\"\n[subjects]\ntable = \"meshes/study.csv\"\nexclude = [{ id = \"a02\", reason = \"moved\" }]\n\
                 [fit]\nmax_degree = 4\n[align]\nmethod = \"joint\"\n[modes]\ncount = 2\n[[test]]\nname = \"bump\"\neffect = \"group\"\npermutations = 20\n";
    fs::write(at("study.toml"), study).expect("a study");
    fs::create_dir(at("out")).expect("a folder");
    fs::write(at("out/notes.csv"), "of somebody else\n").expect("a file");
    succeed(tool("study").args(["study.toml", "--threads", "2"]).current_dir(site.path()));
    let made: serde_json::Value =
        serde_json::from_str(&fs::read_to_string(at("out/provenance.json")).expect("a record")).expect("JSON");
    assert_eq!((made["threads"].as_u64(), made["excluded"]["a02"].as_str()), (Some(2), Some("moved")));
    assert_eq!(made["inputs"].as_array().map(Vec::len), Some(5));
    assert!(made["inputs"][0]["path"].as_str().is_some_and(|path| path.starts_with("meshes/")), "{}", made["inputs"]);
    let outputs = made["outputs"].as_object().expect("results");
    assert!(outputs.contains_key("models/a03.spharm.npz") && outputs.contains_key("tests/bump/summary.csv"));
    assert!(!outputs.contains_key("notes.csv") && !outputs.keys().any(|name| name.contains("a02")), "{outputs:?}");
    let commands = made["commands"].as_array().expect("commands").iter().filter_map(|command| command.as_str());
    let typed: Vec<&str> = commands.collect();
    assert!(typed[0].starts_with("spharm fit --manifest out/.study/manifest.tsv --output out/models"), "{typed:?}");
    let methods = fs::read_to_string(at("out/methods.md")).expect("a text");
    for said in
        ["surfaces of 5 subjects", "degree 4", "1 subject was excluded (a02: moved)", "- L. Shen and M. K. Chung"]
    {
        assert!(methods.contains(said), "{said}: {methods}");
    }
    let page = fs::read_to_string(at("out/report.html")).expect("a page");
    assert!(
        page.contains("<h2>Methods</h2>") && page.contains("spharm fit --manifest out/.study"),
        "the page says so too"
    );

    // The study's file isn't needed, and the folder may be elsewhere.
    fs::remove_file(at("study.toml")).expect("a file");
    let elsewhere = tempfile::tempdir().expect("a folder");
    let moved = elsewhere.path().join("moved");
    fs::rename(site.path(), &moved).expect("it is moved");
    let again = |more: &[&str]| {
        finish(tool("study").args(["--again", "moved/out/provenance.json"]).args(more).current_dir(elsewhere.path()))
    };
    let output = again(&[]);
    assert!(
        output.status.success() && text(&output).contains("identical to the recorded results"),
        "{}",
        text(&output)
    );
    assert!(moved.join("out-again/report.html").is_file());
    let output = again(&["--threads", "1", "--output", "other"]);
    assert!(elsewhere.path().join("other/report.html").is_file(), "{}", text(&output));

    let mesh = moved.join("meshes/a03.ply");
    let kept = fs::read(&mesh).expect("a mesh");
    fs::copy(moved.join("meshes/b01.ply"), &mesh).expect("a copy");
    let output = again(&[]);
    let expected = "the results can't be reproduced, because recorded inputs are missing or have changed (1 of 6 \
                    inputs); the first: meshes/a03.ply: the file has changed";
    assert!(!output.status.success() && text(&output).contains(expected), "{}", text(&output));
    fs::write(&mesh, kept).expect("a mesh");
    fs::write(moved.join("out/provenance.json"), "{}").expect("a file");
    assert!(text(&again(&[])).contains("expected a provenance.json written by `spharm study`"));
}
