//! Tests `basis-build --factor`, and `store` on factors.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use spharm_monitor::Silent;
use spharm_store::catalog;
use spharm_store::factor::factors;

use super::super::{Random, leftovers, only_scheme, write_sphere};
use crate::common::{fail, finish, succeed, text, times, tool, wait};

fn builder(store: &Path, sphere: &Path, degree: usize) -> Command {
    let mut command = tool("basis-build");
    command.arg("--store").arg(store).arg("--sphere").arg(sphere).args(["--factor-only", "--threads", "2"]);
    command.args(["--factor", &degree.to_string()]);
    command
}

/// Returns the names of a store's factors, after verifying each factor.
fn sound_factors(store: &Path) -> Vec<String> {
    let found = factors(store, only_scheme(store)).expect("a folder");
    let verified = found.into_iter().map(|(name, file)| {
        file.expect("a sound factor").verify(&Silent).expect("sound bytes");
        name
    });
    verified.collect()
}

#[test]
fn a_factor_is_built_once_listed_shown_and_verified() {
    let folder = tempfile::tempdir().expect("a folder");
    let (sphere, store) = (write_sphere(folder.path(), 500), folder.path().join("store"));
    let first = succeed(&mut builder(&store, &sphere, 10));
    assert!(first.contains("degree 10, f64") && !first.contains("already existed"), "{first}");
    let path = store.join(only_scheme(&store).to_string()).join(&sound_factors(&store)[0]);
    let modified = |path: &Path| std::fs::metadata(path).and_then(|m| m.modified()).expect("a file");
    let before = modified(&path);
    assert!(succeed(&mut builder(&store, &sphere, 10)).contains("already existed"));
    assert_eq!(modified(&path), before);
    // Add a second factor, of f32 with a penalty, and a basis.
    let mut both = tool("basis-build");
    both.arg("--store").arg(&store).arg("--sphere").arg(&sphere).args(["--max-degree", "3", "--factor", "10"]);
    succeed(both.args(["--factor-dtype", "f32", "--smoothness", "1e-5"]));
    assert_eq!(sound_factors(&store).len(), 2);
    let listed: serde_json::Value =
        serde_json::from_str(&succeed(tool("store").args(["list", "--json"]).arg(&store))).expect("JSON");
    assert_eq!((listed[0]["factors"].as_u64(), listed[0]["degrees"].as_u64()), (Some(2), Some(4)));
    let shown: serde_json::Value =
        serde_json::from_str(&succeed(tool("store").args(["show", "--json"]).arg(&store))).expect("JSON");
    let shown: Vec<&serde_json::Value> =
        shown.as_array().expect("rows").iter().filter(|row| row["factor"].is_string()).collect();
    assert_eq!(shown.len(), 2);
    assert!(shown.iter().any(|row| row["dtype"] == "f32" && row["smoothness"] == 1e-5 && row["columns"] == 121));
    assert!(succeed(tool("store").arg("show").arg(&store)).contains("factor_10_f32_"));
    assert!(succeed(tool("store").arg("verify").arg(&store)).contains("6 files"));
}

#[test]
fn what_cannot_be_is_said_before_any_work() {
    let folder = tempfile::tempdir().expect("a folder");
    let (sphere, store) = (write_sphere(folder.path(), 500), folder.path().join("store"));
    let line = fail(builder(&store, &sphere, 20).args(["--memory", "1MiB"]));
    assert!(line.contains("is too small; at least"), "{line}");
    let line = fail(builder(&store, &sphere, 1001).args(["--memory", "1GiB"]));
    assert!(line.contains("1000"), "{line}");
    let line = fail(builder(&store, &sphere, 400).args(["--memory", "8GiB"]));
    assert!(line.contains("the factor needs") && line.contains("GB"), "{line}");
    assert!(!store.exists());
    // A factor of more functions than directions is refused.
    let line = fail(&mut builder(&store, &sphere, 25));
    assert!(line.contains("not numerically positive definite") && line.contains("(degree 2"), "{line}");
    assert!(line.contains("--smoothness") && line.contains("a lower degree with --factor L"), "{line}");
    assert!(!line.contains("--max-degree") && !line.contains("minimum"), "{line}");
    assert_eq!((sound_factors(&store).len(), leftovers(&store)), (0, Vec::<String>::new()));
    succeed(builder(&store, &sphere, 25).args(["--smoothness", "1e-4"]));
    for wrong in ["-1", "nan", "inf", "x"] {
        let output = finish(builder(&store, &sphere, 5).arg(format!("--smoothness={wrong}")));
        assert_eq!(output.status.code(), Some(2), "{}", text(&output));
    }
}

/// A build killed at any moment leaves no half-written factor; a rerun removes leftovers and makes the factor.
#[test]
fn a_killed_build_leaves_nothing_half_written() {
    let folder = tempfile::tempdir().expect("a folder");
    let sphere = write_sphere(folder.path(), 2000);
    let store = |round: usize| folder.path().join(format!("store{round}"));
    // With the smallest budget the factor is computed out of core, so tiles are written throughout the build.
    let line = fail(builder(&store(0), &sphere, 30).args(["--memory", "1MiB"]));
    let least = line.split("at least ").nth(1).and_then(|rest| rest.split_once(" MiB"));
    let least = format!("{}MiB", least.expect("a size").0);
    let build = |store: &Path| {
        let mut command = builder(store, &sphere, 30);
        command.args(["--memory", &least, "--factor-dtype", "f32", "-q"]);
        command
    };
    let started = Instant::now();
    succeed(&mut build(&store(0)));
    let duration = started.elapsed();
    let mut random = Random(7);
    let (mut killed, mut cleared) = (0, 0);
    for round in 1..=times(20) {
        let store = store(round);
        let mut child = build(&store).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the tool starts");
        std::thread::sleep(Duration::from_micros(random.below(duration.as_micros() as u64)));
        child.kill().expect("it can be killed");
        killed += usize::from(!wait(child).status.success());
        if catalog::schemes(&store).is_ok_and(|keys| !keys.is_empty()) {
            sound_factors(&store);
            let is_factor = |name: &String| name.starts_with("factor_");
            let left = leftovers(&store).iter().filter(|name| !is_factor(name)).count();
            succeed(tool("store").arg("gc").arg(&store));
            assert!(leftovers(&store).iter().all(is_factor));
            cleared += left;
        }
        succeed(&mut build(&store));
        assert_eq!(sound_factors(&store).len(), 1);
        std::fs::remove_dir_all(&store).expect("a removal");
    }
    eprintln!("{killed} builds were killed before their end, {cleared} leftovers were cleared away");
    assert!(killed > 0, "the moments are in the build");
}
