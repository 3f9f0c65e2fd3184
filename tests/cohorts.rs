//! Tests cohorts through the program: manifests, shards, bad rows, kills, status.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use spharm_model::Model;
use spharm_surface::generate::{Cortex, cortex, icosphere};
use spharm_surface::io::write_mesh;

use crate::common::{error_line, fail, finish, succeed, text, tool, wait};
use crate::first_users::OPTIONS;

/// A folder with a sphere, surfaces and a manifest of the surfaces.
pub(crate) struct Study {
    folder: tempfile::TempDir,
}

impl Study {
    /// Creates subjects s0, s1, ... over one sphere.
    pub(crate) fn new(count: u64) -> Self {
        let study = Self { folder: tempfile::tempdir().expect("a folder") };
        write_mesh(study.path("sphere.ply"), &icosphere(3), &OPTIONS).expect("a sphere");
        let mut table = "id\tgroup\tsurface\tsphere\n".to_owned();
        for subject in 0..count {
            let (surface, _) = cortex(&Cortex { subdivisions: 3, variant: subject });
            write_mesh(study.path(&format!("s{subject}.ply")), &surface, &OPTIONS).expect("a surface");
            table += &format!("s{subject}\tg{}\ts{subject}.ply\tsphere.ply\n", subject % 2);
        }
        study.write("all.tsv", &table);
        study
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn write(&self, name: &str, text: &str) {
        std::fs::write(self.path(name), text).expect("written");
    }

    /// Returns a `fit` of a manifest into a folder.
    fn fit(&self, manifest: &str, out: &str, arguments: &[&str]) -> Command {
        let mut fit = tool("fit");
        fit.arg("--manifest").arg(self.path(manifest)).arg("-o").arg(self.path(out));
        fit.args(["--max-degree", "6", "-q"]).args(arguments).current_dir(self.folder.path());
        fit
    }

    fn status(&self, arguments: &[&str]) -> Value {
        let mut status = tool("status");
        status.args(arguments).arg("--json").current_dir(self.folder.path());
        serde_json::from_str(&succeed(&mut status)).expect("JSON")
    }

    fn models(&self, out: &str) -> BTreeMap<String, Vec<u8>> {
        models(&self.path(out))
    }
}

/// Returns the names and bytes of the models in a folder.
fn models(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries =
        std::fs::read_dir(folder).map(|entries| entries.map(|entry| entry.expect("an entry").path()).collect());
    let entries: Vec<PathBuf> = entries.unwrap_or_default();
    let named = entries.into_iter().filter(|path| path.extension().is_some_and(|ending| ending == "npz"));
    named
        .map(|path| {
            let name = path.file_name().expect("a name").to_string_lossy().into_owned();
            (name, std::fs::read(&path).expect("a model"))
        })
        .collect()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn shards_make_the_models_of_one_call_and_of_each_alone() {
    let study = Study::new(7);
    succeed(&mut study.fit("all.tsv", "one", &[]));
    for shard in ["0/3", "1/3", "2/3"] {
        let status = format!("status/{}.tsv", &shard[..1]);
        succeed(&mut study.fit("all.tsv", "sharded", &["--shard", shard, "--status", &status, "--keep-going"]));
    }
    let one = study.models("one");
    assert_eq!(one.len(), 7);
    assert!(study.models("sharded") == one);
    study.write("lone.tsv", "surface\tid\tsphere\ns4.ply\ts4\tsphere.ply\n");
    succeed(&mut study.fit("lone.tsv", "lone", &[]));
    assert!(study.models("lone")["s4.spharm.npz"] == one["s4.spharm.npz"]);
    let provenance = Model::read(study.path("one/s4.spharm.npz")).expect("a model").provenance;
    assert_eq!(provenance.id.as_deref(), Some("s4"));
    let found = study.status(&["status", "--manifest", "all.tsv"]);
    assert_eq!((&found["done"], &found["not_started"], &found["all"]), (&7.into(), &0.into(), &7.into()));
}

/// Writes a manifest with rows that can be fitted, and one row for each reason for a failure.
fn with_bad_rows(study: &Study) {
    study.write("cut.ply", "");
    let whole = std::fs::read(study.path("s0.ply")).expect("a surface");
    std::fs::write(study.path("cut.ply"), &whole[..whole.len() / 2]).expect("written");
    write_mesh(study.path("small.ply"), &icosphere(2), &OPTIONS).expect("a surface");
    let rows: String = (0..642).map(|row| if row == 5 { "inf\n".to_owned() } else { format!("{row}\n") }).collect();
    study.write("infinite.csv", &rows);
    let mut open = icosphere(2);
    open.faces.truncate(200);
    write_mesh(study.path("open.ply"), &open, &OPTIONS).expect("a surface");
    study.write(
        "bad.tsv",
        "id\tsurface\tsphere\tweights\na\ts0.ply\tsphere.ply\t\nmissing\tno.ply\tsphere.ply\t\n\
         b\ts1.ply\tsphere.ply\t\ncut\tcut.ply\tsphere.ply\t\nc\ts2.ply\tsphere.ply\t\n\
         small\tsmall.ply\tsphere.ply\t\ninfinite\tinfinite.csv\tsphere.ply\t\nopen\topen.ply\t\t\n\
         sphere\ts0.ply\tcut.ply\t\nweights\ts0.ply\tsphere.ply\tinfinite.csv\nd\ts3.ply\tsphere.ply\t\n",
    );
}

#[test]
fn bad_rows_are_named_and_cost_no_other_its_model() {
    let study = Study::new(4);
    with_bad_rows(&study);
    study.write(
        "good.tsv",
        "id\tsurface\tsphere\na\ts0.ply\tsphere.ply\nb\ts1.ply\tsphere.ply\nc\ts2.ply\tsphere.ply\nd\ts3.ply\tsphere.ply\n",
    );
    succeed(&mut study.fit("good.tsv", "good", &[]));
    let bad = ["missing", "cut", "small", "infinite", "open", "sphere", "weights"];
    let keep = ["--keep-going", "--status", "s.tsv", "--report", "r.json"];
    let output = finish(&mut study.fit("bad.tsv", "out", &keep));
    let error = error_line(&output);
    assert!(error.contains("7 of 11 surfaces failed") && error.contains("and 2 more"), "{error}");
    for id in bad {
        assert!(
            stderr(&output).lines().any(|line| line.starts_with(&format!("warning: {id}: "))),
            "{id}: {}",
            stderr(&output)
        );
    }
    assert!(study.models("out") == study.models("good"));
    let found = study.status(&["s.tsv", "--manifest", "bad.tsv"]);
    assert_eq!((&found["done"], &found["failed"]), (&4.into(), &7.into()));
    let failures = found["failures"].as_array().expect("a list");
    let named: Vec<&str> = failures.iter().filter_map(|failure| failure["id"].as_str()).collect();
    assert!(named.iter().all(|id| bad.contains(id)) && named.len() == 7, "{named:?}");
    let of = |id: &str| failures.iter().find(|failure| failure["id"] == id).expect("it failed")["error"].to_string();
    assert!(of("missing").contains("no such file") && of("small").contains("vertices"), "{failures:?}");
    assert!(of("sphere").contains("cut.ply") && of("weights").contains("infinite.csv"), "{failures:?}");
    let report: Value = serde_json::from_slice(&std::fs::read(study.path("r.json")).expect("a report")).expect("JSON");
    assert_eq!((&report["rows"]["failed"], report["failed"].as_array().map(Vec::len)), (&7.into(), Some(7)));
    assert_eq!(report["surfaces"][0]["id"], "a");
    // Without --keep-going the first failure ends the call.
    assert!(fail(&mut study.fit("bad.tsv", "first", &[])).contains("no.ply"));
}

#[test]
fn lists_keep_going_too() {
    let study = Study::new(3);
    let fit = |out: &str, surfaces: &[&str], more: &[&str]| {
        let mut fit = tool("fit");
        fit.args(["--sphere", "sphere.ply", "--max-degree", "6", "-q", "-o", out]).args(more);
        fit.arg("--surface").args(surfaces).current_dir(study.folder.path());
        fit
    };
    succeed(&mut fit("good", &["s0.ply", "s1.ply", "s2.ply"], &[]));
    study.write("broken.ply", "ply\n");
    let bad = ["s0.ply", "no.ply", "s1.ply", "broken.ply", "s2.ply"];
    let output = finish(&mut fit("out", &bad, &["--keep-going", "--status", "s.tsv"]));
    assert!(error_line(&output).contains("2 of 5 surfaces failed: no, broken"), "{}", text(&output));
    assert!(study.models("out") == study.models("good"));
    assert_eq!(study.status(&["s.tsv"])["failed"], 2);
    // Without --sphere, each surface is fitted on its own sphere.
    let mut bare = tool("fit");
    bare.args(["--max-degree", "4", "-q", "-o", "bare", "--keep-going", "--surface"]).args(["broken.ply", "s0.ply"]);
    assert!(error_line(&finish(bare.current_dir(study.folder.path()))).contains("1 of 2 surfaces failed: broken"));
    assert_eq!(study.models("bare").len(), 1);
}

/// Waits until a file has this number of lines.
fn wait_for_lines(path: &Path, lines: usize) {
    for _ in 0..6000 {
        if std::fs::read_to_string(path).is_ok_and(|text| text.lines().count() >= lines) {
            return;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    panic!("{}: not {lines} lines within a minute", path.display());
}

#[test]
fn a_killed_call_goes_on_where_it_was_and_makes_the_same_bytes() {
    let study = Study::new(6);
    // Mapping surfaces to spheres takes long enough to kill the process in between.
    study.write("bare.tsv", "id\tsurface\n0\ts0.ply\n1\ts1.ply\n2\ts2.ply\n3\ts3.ply\n4\ts4.ply\n5\ts5.ply\n");
    // Models record the paths of their spheres, so every call writes into a folder of the same name, `out`.
    let out = "out";
    succeed(&mut study.fit("bare.tsv", out, &[]));
    std::fs::rename(study.path(out), study.path("whole")).expect("renamed");
    for (signal, after, code) in [(Signal::KILL, 2, None), (Signal::TERM, 3, Some(75))] {
        let status = format!("killed{after}.tsv");
        let arguments = ["--skip-existing", "--keep-going", "--status", &status, "--report", "r.json"];
        let mut call = study.fit("bare.tsv", out, &arguments);
        let child = call.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("it starts");
        let pid = Pid::from_child(&child);
        wait_for_lines(&study.path(&status), after);
        kill_process(pid, signal).expect("it runs");
        let output = wait(child);
        // The process may have finished just before the signal.
        if !output.status.success() {
            assert_eq!(output.status.code(), code, "{}", text(&output));
        }
        let before = study.status(&[&status]);
        assert!(before["done"].as_u64() >= Some(after as u64 - 1), "{before}");
        succeed(&mut study.fit("bare.tsv", out, &arguments));
        assert!(study.models(out) == study.models("whole"));
        let found = study.status(&[&status, "--manifest", "bare.tsv"]);
        assert_eq!(
            (&found["all"], &found["failed"], &found["interrupted"]),
            (&6.into(), &0.into(), &0.into()),
            "{found}"
        );
        let there = found["done"].as_u64().unwrap_or(0) + found["skipped"].as_u64().unwrap_or(0);
        assert_eq!(there, 6, "{found}");
        std::fs::remove_dir_all(study.path(out)).expect("removed");
    }
}

#[test]
fn a_report_is_written_with_nothing_to_do() {
    let study = Study::new(2);
    succeed(&mut study.fit("all.tsv", "out", &[]));
    let said =
        succeed(&mut study.fit("all.tsv", "out", &["--skip-existing", "--report", "r.json", "--status", "s.tsv"]));
    assert!(said.contains("nothing to do"), "{said}");
    let report =
        || -> Value { serde_json::from_slice(&std::fs::read(study.path("r.json")).expect("a report")).expect("JSON") };
    assert_eq!((&report()["rows"]["skipped"], &report()["rows"]["done"]), (&2.into(), &0.into()));
    // A shard without rows replaces the report of an earlier call.
    let empty = ["--skip-existing", "--report", "r.json", "--shard", "5/6"];
    let said = succeed(&mut study.fit("all.tsv", "out", &empty));
    assert!(said.contains("shard 5/6 has no rows") && !said.contains("nothing to do"), "{said}");
    assert_eq!(report()["rows"]["all"], 0);
    assert_eq!(study.status(&["s.tsv"])["skipped"], 2);
}

#[test]
fn a_model_is_not_taken_for_that_of_another_id() {
    let study = Study::new(1);
    study.write("one.tsv", "id\tsurface\tsphere\toutput\na\ts0.ply\tsphere.ply\tx\n");
    study.write("two.tsv", "id\tsurface\tsphere\toutput\nb\ts0.ply\tsphere.ply\tx\n");
    succeed(&mut study.fit("one.tsv", "out", &[]));
    succeed(&mut study.fit("one.tsv", "out", &["--skip-existing"]));
    let error = fail(&mut study.fit("two.tsv", "out", &["--skip-existing"]));
    assert!(error.contains("x.spharm.npz") && error.contains("id a, not b"), "{error}");
}

#[test]
fn spheres_of_the_same_contents_are_one_and_keep_their_names() {
    let study = Study::new(2);
    std::fs::copy(study.path("sphere.ply"), study.path("copy.ply")).expect("copied");
    study.write("two.tsv", "id\tsurface\tsphere\na\ts0.ply\tsphere.ply\nb\ts1.ply\tcopy.ply\n");
    let said = succeed(&mut study.fit("two.tsv", "out", &["--dry-run"]));
    assert!(said.contains("2 models, of which 0 exist") && said.contains("over 1 sphere\n"), "{said}");
    assert!(!study.path("out").exists());
    succeed(&mut study.fit("two.tsv", "out", &[]));
    let sphere = |name: &str| Model::read(study.path("out").join(name)).expect("a model").provenance.sphere;
    assert!(sphere("a.spharm.npz").is_some_and(|path| path.ends_with("sphere.ply")));
    assert!(sphere("b.spharm.npz").is_some_and(|path| path.ends_with("copy.ply")));
}

#[test]
fn events_are_a_json_object_a_line() {
    let study = Study::new(2);
    study.write(
        "three.tsv",
        "id\tsurface\tsphere\na\ts0.ply\tsphere.ply\nx\tno.ply\tsphere.ply\nb\ts1.ply\tsphere.ply\n",
    );
    let call = study.fit("three.tsv", "out", &["--keep-going", "--log", "json", "--verbose"]);
    // Without -q, every line on stderr must be JSON.
    let arguments: Vec<_> = call.get_args().filter(|argument| *argument != "-q").map(ToOwned::to_owned).collect();
    let mut call = Command::new(call.get_program());
    let output = finish(call.args(arguments).current_dir(study.folder.path()));
    assert_eq!(output.status.code(), Some(1), "{}", text(&output));
    let events: Vec<Value> =
        stderr(&output).lines().map(|line| serde_json::from_str(line).expect("a JSON object a line")).collect();
    let of = |name: &str| events.iter().filter(|event| event["event"] == name).collect::<Vec<_>>();
    assert_eq!((of("start").len(), of("done").len(), of("failed").len(), of("end").len()), (3, 2, 1, 1), "{events:?}");
    assert!(of("failed")[0]["error"].to_string().contains("no.ply") && of("done")[0]["msd"].is_number());
    assert_eq!((&of("end")[0]["done"], &of("end")[0]["failed"]), (&2.into(), &1.into()));
    assert!(of("error")[0]["text"].to_string().contains("1 of 3 surfaces failed"));
}

#[test]
fn the_rest_is_a_manifest() {
    let study = Study::new(3);
    study.write(
        "bad.tsv",
        "id\tsurface\tsphere\na\ts0.ply\tsphere.ply\nb\tlater.ply\tsphere.ply\nc\ts1.ply\tsphere.ply\n",
    );
    fail(&mut study.fit("bad.tsv", "out", &["--keep-going", "--status", "status/0.tsv", "--shard", "1/2"]));
    succeed(&mut study.fit("bad.tsv", "out", &["--keep-going", "--status", "status/1.tsv", "--shard", "0/2"]));
    let mut status = tool("status");
    status.args(["status", "--manifest", "bad.tsv", "--failed", "rest.tsv"]).current_dir(study.folder.path());
    let said = succeed(&mut status);
    assert!(said.contains("b: ") && said.contains("later.ply"), "{said}");
    assert_eq!(
        std::fs::read(study.path("rest.tsv")).expect("a manifest"),
        b"id\tsurface\tsphere\nb\tlater.ply\tsphere.ply\n"
    );
    assert!(fail(&mut status).contains("rest.tsv"), "it isn't overwritten");
    std::fs::copy(study.path("s2.ply"), study.path("later.ply")).expect("copied");
    succeed(&mut study.fit("rest.tsv", "out", &["--status", "status/1.tsv"]));
    assert_eq!(study.status(&["status", "--manifest", "bad.tsv"])["done"], 3);
    assert_eq!(study.models("out").len(), 3);
}

#[test]
fn manifests_that_are_wrong_are_refused_before_any_work() {
    let study = Study::new(1);
    study.write("twice.tsv", "id\tsurface\na\ts0.ply\n# c\r\na\ts0.ply\n");
    let error = fail(&mut study.fit("twice.tsv", "out", &["--keep-going", "--status", "s.tsv"]));
    assert!(error.contains("twice.tsv: line 4: duplicate id a, first used on line 2"), "{error}");
    assert!(!study.path("out").exists() && !study.path("s.tsv").exists());
    let output = finish(&mut study.fit("all.tsv", "out", &["--shard", "2/2"]));
    assert_eq!(output.status.code(), Some(2), "{}", text(&output));
}

/// A full disk ends the call, because all other rows would fail in the same way. A limit on the size of files simulates
/// it.
#[test]
fn a_disk_that_is_full_ends_the_call_and_loses_nothing() {
    let study = Study::new(40);
    let run = |limited: bool| {
        let arguments = ["--keep-going", "--skip-existing", "--status", "s.tsv"];
        let fit = study.fit("all.tsv", "out", &arguments);
        if !limited {
            return fit;
        }
        // A write beyond the limit then fails; the program handles SIGXFSZ, so the signal doesn't end the process.
        let mut shell = Command::new("sh");
        shell.arg("-c").arg("ulimit -f 16; exec \"$@\"").arg("sh").arg(fit.get_program()).args(fit.get_args());
        shell.current_dir(study.folder.path());
        shell
    };
    let error = fail(&mut run(true));
    assert!(error.contains(".spharm.npz") && error.contains("File too large"), "{error}");
    assert!(study.models("out").is_empty());
    let found = study.status(&["s.tsv", "--manifest", "all.tsv"]);
    assert!(found["done"] == 0 && found["not_started"].as_u64() >= Some(1), "{found}");
    assert_eq!(found["interrupted"], 0, "{found}");
    succeed(&mut run(false));
    let found = study.status(&["s.tsv", "--manifest", "all.tsv"]);
    assert_eq!((&found["done"], study.models("out").len()), (&40.into(), 40));
}

/// Row 40 of the problems of first-time users: warnings scroll out of sight, because each surface prints a line.
#[test]
fn warnings_of_long_runs_are_repeated_at_the_end() {
    for (count, times) in [(11, 2), (5, 1)] {
        let study = Study::new(count);
        std::fs::copy(study.path("s1.ply"), study.path("s3.ply")).expect("a copy");
        let output = finish(&mut study.fit("all.tsv", "out", &[]));
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{stderr}");
        let warnings: Vec<&str> = stderr.lines().filter(|line| line.starts_with("warning: ")).collect();
        assert!(
            warnings.len() == times && warnings.iter().all(|line| line.contains("s1") && line.contains("s3")),
            "{stderr}"
        );
    }
}
