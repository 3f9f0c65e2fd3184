//! A build killed at any moment leaves only complete files; a rerun makes the same store without leftovers.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};
use spharm_store::{BuildParams, catalog};

use super::{Random, build_here, leftovers, verified, write_sphere};
use crate::common::{finish, text, times, tool, wait};

const N: usize = 4000;
const MAX_DEGREE: usize = 30;

struct Site {
    folder: tempfile::TempDir,
    sphere: PathBuf,
    expected: BTreeMap<usize, Vec<u8>>,
    /// Duration of an undisturbed build.
    duration: Duration,
}

impl Site {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let sphere = write_sphere(folder.path(), N);
        let reference = folder.path().join("reference");
        build_here(&reference, N, &BuildParams { max_degree: MAX_DEGREE, ..BuildParams::default() });
        let expected = verified(&reference);
        let mut site = Self { folder, sphere, expected, duration: Duration::ZERO };
        let started = Instant::now();
        assert!(finish(&mut site.builder(&site.store(0))).status.success());
        site.duration = started.elapsed();
        site
    }

    fn store(&self, round: usize) -> PathBuf {
        self.folder.path().join(format!("store{round}"))
    }

    fn builder(&self, store: &Path) -> Command {
        let mut command = tool("basis-build");
        command.arg("--store").arg(store).arg("--sphere").arg(&self.sphere).args(["--max-degree", "30", "-q"]);
        command
    }

    fn start(&self, store: &Path) -> Child {
        self.builder(store).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the tool starts")
    }

    /// Checks that every file with a final name is complete; returns the number of these files.
    fn assert_nothing_half_written(&self, store: &Path) -> usize {
        if !catalog::schemes(store).is_ok_and(|keys| !keys.is_empty()) {
            return 0;
        }
        let there = verified(store);
        assert!(there.iter().all(|(degree, bytes)| *bytes == self.expected[degree]));
        there.len()
    }

    fn assert_rerun_completes(&self, store: &Path) {
        let output = finish(&mut self.builder(store));
        assert!(output.status.success(), "{}", text(&output));
        assert!(verified(store) == self.expected, "the bytes of an undisturbed build");
        assert_eq!(leftovers(store), [""; 0]);
    }
}

#[test]
fn a_killed_build_leaves_nothing_half_written_and_a_rerun_completes_it() {
    let site = Site::new();
    let mut random = Random(2);
    let (mut killed, mut partly) = (0, 0);
    for round in 1..=times(60) {
        let store = site.store(round);
        let mut child = site.start(&store);
        // Choose a random moment in the build, more often in its second half, in which files are published.
        let part = random.below(1 << 20) as f64 / (1u64 << 20) as f64;
        let part = if round % 2 == 0 { part } else { 0.5 + 0.5 * part };
        std::thread::sleep(site.duration.mul_f64(part));
        child.kill().expect("it can be killed");
        killed += usize::from(!wait(child).status.success());
        let there = site.assert_nothing_half_written(&store);
        partly += usize::from((1..=MAX_DEGREE).contains(&there));
        site.assert_rerun_completes(&store);
        std::fs::remove_dir_all(&store).expect("a removal");
    }
    eprintln!("{killed} builds were killed before their end, {partly} of them with some degrees published");
    assert!(killed > 0, "the moments are in the build");
}

#[test]
fn a_build_that_is_asked_to_stop_stops_cleanly_and_a_rerun_completes_it() {
    let site = Site::new();
    let mut random = Random(3);
    let mut stopped = 0;
    for (round, signal) in (1..=times(30)).zip([Signal::TERM, Signal::INT, Signal::HUP].into_iter().cycle()) {
        let store = site.store(round);
        let mut child = site.start(&store);
        // The build creates folders only after it has installed its signal handlers, and files once it computes.
        let computes =
            |store: &Path| catalog::schemes(store).is_ok_and(|k| !k.is_empty()) && !leftovers(store).is_empty();
        while !computes(&store) && child.try_wait().expect("it can be waited for").is_none() {
            std::thread::sleep(Duration::from_micros(100));
        }
        if round % 2 == 0 {
            std::thread::sleep(site.duration.mul_f64(random.below(1000) as f64 / 1000.0));
        }
        // The process may have ended already; it is waited for below.
        let _ = kill_process(Pid::from_child(&child), signal);
        let output = wait(child);
        match output.status.code() {
            Some(75) => {
                let stderr = String::from_utf8_lossy(&output.stderr);
                assert!(stderr.contains("interrupted") && stderr.contains("run the same command again"), "{stderr}");
                stopped += 1;
                if catalog::schemes(&store).is_ok_and(|keys| !keys.is_empty()) {
                    assert_eq!(leftovers(&store), [""; 0], "it has cleared up after itself");
                }
            }
            // The build had finished before the signal arrived.
            code => assert_eq!(code, Some(0), "{}", text(&output)),
        }
        site.assert_nothing_half_written(&store);
        site.assert_rerun_completes(&store);
        std::fs::remove_dir_all(&store).expect("a removal");
    }
    eprintln!("{stopped} builds were stopped before their end");
    assert!(stopped > 0, "the moments are in the build");
}

/// A build can also be stopped while it waits for another builder's lock.
#[test]
fn a_build_that_waits_for_another_stops_when_it_is_asked_to() {
    let folder = tempfile::tempdir().expect("a folder");
    let store = folder.path().join("store");
    let key = build_here(&store, 20, &BuildParams { max_degree: 1, ..BuildParams::default() });
    let lock = std::fs::File::open(store.join(key.to_string()).join(".lock")).expect("the lock");
    lock.lock().expect("nobody builds");
    let mut command = tool("basis-build");
    command.arg("--store").arg(&store).arg("--sphere").arg(write_sphere(folder.path(), 20)).args(["--max-degree", "2"]);
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("the tool starts");
    let mut said = std::io::BufReader::new(child.stderr.take().expect("a pipe"));
    let mut line = String::new();
    std::io::BufRead::read_line(&mut said, &mut line).expect("a line");
    assert!(line.contains("another build of this scheme is running; waiting for it to finish"), "{line}");
    kill_process(Pid::from_child(&child), Signal::TERM).expect("a signal");
    assert_eq!(wait(child).status.code(), Some(75));
    assert_eq!(verified(&store).len(), 2);
    drop(lock);
    assert!(finish(&mut command).status.success());
    assert_eq!(verified(&store).len(), 3);
}

/// Under `nohup`, SIGHUP is ignored from the start: the build continues after a logout.
#[test]
fn a_signal_that_is_ignored_from_the_start_stays_ignored() {
    let folder = tempfile::tempdir().expect("a folder");
    let store = folder.path().join("store");
    let key = build_here(&store, 20, &BuildParams { max_degree: 1, ..BuildParams::default() });
    let lock = std::fs::File::open(store.join(key.to_string()).join(".lock")).expect("the lock");
    lock.lock().expect("nobody builds");
    let mut build = tool("basis-build");
    build.arg("--store").arg(&store).arg("--sphere").arg(write_sphere(folder.path(), 20)).args(["--max-degree", "2"]);
    let mut command = Command::new("sh");
    command.args(["-c", "trap '' HUP; exec \"$@\"", "sh"]).arg(build.get_program()).args(build.get_args());
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("a shell");
    let mut said = std::io::BufReader::new(child.stderr.take().expect("a pipe"));
    std::io::BufRead::read_line(&mut said, &mut String::new()).expect("that it waits");
    kill_process(Pid::from_child(&child), Signal::HUP).expect("a signal");
    std::thread::sleep(Duration::from_millis(300));
    drop(lock);
    assert!(wait(child).status.success());
    assert_eq!(verified(&store).len(), 3);
}
