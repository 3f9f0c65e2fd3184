//! Many concurrent builders of one key leave one correct store.

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};

use spharm_monitor::Silent;
use spharm_store::{BuildParams, Scalar, SchemeKey, StoreError, build, catalog};

use super::{build_here, directions, leftovers, verified, write_sphere};
use crate::common::{text, times, tool, wait};

const N: usize = 1000;
const MAX_DEGREE: usize = 20;
const BUILDERS: usize = 16;

fn builder(store: &Path, sphere: &Path) -> Command {
    let mut command = tool("basis-build");
    command.arg("--store").arg(store).arg("--sphere").arg(sphere).args(["--max-degree", "20", "--threads", "1"]);
    command.args(["-q", "--json", "-"]).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

/// Runs all builders at once, and returns the total number of degrees that they report as built.
fn race(store: &Path, sphere: &Path) -> u64 {
    let children: Vec<Child> =
        (0..BUILDERS).map(|_| builder(store, sphere).spawn().expect("the tool starts")).collect();
    let built = children.into_iter().map(|child| {
        let output = wait(child);
        assert!(output.status.success(), "{}", text(&output));
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("a report");
        let count = |name: &str| report[name].as_u64().expect("a number");
        assert_eq!(count("degrees_built") + count("degrees_present"), MAX_DEGREE as u64 + 1);
        count("degrees_built")
    });
    built.sum()
}

fn reference(folder: &Path) -> std::collections::BTreeMap<usize, Vec<u8>> {
    let store = folder.join("reference");
    build_here(&store, N, &BuildParams { max_degree: MAX_DEGREE, ..BuildParams::default() });
    verified(&store)
}

#[test]
fn sixteen_builders_leave_one_store() {
    let folder = tempfile::tempdir().expect("a folder");
    let sphere = write_sphere(folder.path(), N);
    let store = folder.path().join("store");
    assert_eq!(race(&store, &sphere), MAX_DEGREE as u64 + 1, "each degree is built once");
    assert!(verified(&store) == reference(folder.path()));
    assert_eq!(leftovers(&store), [""; 0]);
}

/// Without working locks (simulated by a link in place of the lock file) the builders repeat each other's work, and the
/// first one to publish a degree succeeds.
#[test]
fn sixteen_builders_without_a_lock_leave_one_store() {
    let folder = tempfile::tempdir().expect("a folder");
    let sphere = write_sphere(folder.path(), N);
    let expected = reference(folder.path());
    for round in 0..times(10) {
        let store = folder.path().join(format!("store{round}"));
        let scheme = store.join(SchemeKey::of(&directions(N), Scalar::F64).to_string());
        std::fs::create_dir_all(&scheme).expect("a folder");
        std::os::unix::fs::symlink("nowhere", scheme.join(".lock")).expect("a link");
        assert_eq!(race(&store, &sphere), MAX_DEGREE as u64 + 1, "each degree is published once");
        assert!(verified(&store) == expected);
        assert_eq!(leftovers(&store), [""; 0]);
    }
}

/// A process that continually removes leftovers doesn't disturb builders, even between the creation of a file and its
/// locking.
#[test]
fn clearing_away_spares_what_is_being_written() {
    const ROWS: usize = 8;
    const FILES: usize = 200;
    // Use a file system in memory, because the test needs many files rather than a disk.
    let memory = Path::new("/dev/shm");
    let folder = if memory.is_dir() { tempfile::tempdir_in(memory) } else { tempfile::tempdir() }.expect("a folder");
    let store = folder.path();
    let key = SchemeKey::of(&directions(ROWS), Scalar::F64);
    let scheme = store.join(key.to_string());
    std::fs::create_dir_all(&scheme).expect("a folder");
    let abandoned = scheme.join(".A_3.abandoned.tmp");
    let done = AtomicBool::new(false);
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                while !done.load(Ordering::Relaxed) {
                    // Files that change between listing and removing must cause neither an error nor harm.
                    catalog::remove_leftovers(store, key).expect("a folder");
                }
            });
        }
        let params = BuildParams { max_degree: FILES - 1, ..BuildParams::default() };
        let build = || -> Result<(), StoreError> {
            for _ in 0..times(100) {
                std::fs::write(&abandoned, "").expect("a file");
                build(store, &directions(ROWS), &params, &Silent)?;
                for degree in 0..FILES {
                    std::fs::remove_file(scheme.join(format!("A_{degree}"))).expect("a published file");
                }
            }
            Ok(())
        };
        let built = build();
        done.store(true, Ordering::Relaxed);
        built.expect("undisturbed builds");
    });
    catalog::remove_leftovers(store, key).expect("a folder");
    assert!(!abandoned.exists());
}
