//! Files of moments are complete or absent, on a full disk and after the program is killed or interrupted.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};

use crate::common::{fail, finish, succeed, text, times, tool, wait};
use crate::store::{Random, namespace};

/// Degree for which a file of moments has 1.7 MB, so that writing it takes a while.
const MAX_DEGREE: &str = "200";
/// Number of samples; reading them and computing their moments takes a while.
const SAMPLES: usize = 300_000;

/// A folder with a table, the moments of its halves, and the expected sum of the two.
struct Site {
    folder: tempfile::TempDir,
    expected: Vec<u8>,
    /// Duration of adding the moments.
    adding: Duration,
}

impl Site {
    fn new(samples: usize) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let directions = spharm_harmonics::Directions::fibonacci(samples).expect("directions");
        let table = ndarray::Array2::from_shape_fn((samples, 4), |(row, column)| {
            let v = directions.as_slice()[row];
            *v.get(column).unwrap_or(&v[0].mul_add(v[1], (row as f64).sin()))
        });
        ndarray_npy::write_npy(folder.path().join("samples.npy"), &table).expect("a table");
        let mut site = Self { folder, expected: Vec::new(), adding: Duration::ZERO };
        for part in 0..2 {
            let mut command = site.moments(&site.path(&format!("part{part}.moments")));
            succeed(command.args(["--shard", &format!("{part}/2")]));
        }
        let (whole, started) = (site.path("whole.moments"), Instant::now());
        succeed(&mut site.merge(&whole));
        site.adding = started.elapsed();
        site.expected = std::fs::read(whole).expect("a file");
        site
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn moments(&self, output: &Path) -> Command {
        let mut command = tool("moments");
        command.arg("--samples").arg(self.path("samples.npy")).args(["--vectors", "0", "1", "2", "--values", "3"]);
        command.args(["--max-degree", MAX_DEGREE, "--threads", "1", "-q", "-o"]).arg(output);
        command
    }

    fn merge(&self, output: &Path) -> Command {
        let mut command = tool("moments");
        command.arg("merge").args([self.path("part0.moments"), self.path("part1.moments")]).arg("-o").arg(output);
        command
    }
}

fn start(command: &mut Command) -> Child {
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the tool starts")
}

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).expect("a folder");
    entries.map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned()).collect()
}

#[test]
fn a_disk_of_any_size_has_a_whole_file_or_none() {
    if !namespace::entered("moments_faults::a_disk_of_any_size_has_a_whole_file_or_none") {
        return;
    }
    let site = Site::new(2_000);
    let disk = site.path("disk");
    std::fs::create_dir(&disk).expect("a folder");
    let output = disk.join("all.moments");
    let steps = times(6) as u64;
    for step in 0..steps {
        // The disk space ranges from almost nothing to one page less than the file needs.
        let room = 4096 + (site.expected.len() as u64 - 8192) * step / (steps - 1);
        for there in [false, true] {
            namespace::mount(&disk, room);
            if there {
                std::fs::write(&output, b"earlier").expect("room for a few bytes");
            }
            for (verb, mut command) in [("merge", site.merge(&output)), ("moments", site.moments(&output))] {
                let line = fail(if there { command.arg("--force") } else { &mut command });
                assert!(line.contains("all.moments") && line.contains("No space left"), "{verb}: {line}");
                assert_eq!(names(&disk), ["all.moments"][..usize::from(there)], "{verb}: nothing is left behind");
                assert!(!there || std::fs::read(&output).is_ok_and(|bytes| bytes == b"earlier"), "{verb}");
            }
            namespace::remount(&disk, "size=16m");
            succeed(site.merge(&output).arg("--force"));
            assert!(std::fs::read(&output).is_ok_and(|bytes| bytes == site.expected));
            namespace::unmount(&disk);
        }
    }
}

#[test]
fn a_killed_program_leaves_the_earlier_file_or_a_whole_one() {
    let site = Site::new(2_000);
    let (mut random, mut killed, mut written) = (Random(5), 0, 0);
    let output = site.path("all.moments");
    for round in 0..times(20) {
        let earlier = round % 2 == 0;
        let _ = std::fs::remove_file(&output);
        if earlier {
            std::fs::write(&output, b"earlier").expect("a file");
        }
        let mut child = start(site.merge(&output).arg("--force"));
        std::thread::sleep(site.adding.mul_f64(random.below(1 << 20) as f64 / f64::from(1 << 20)));
        child.kill().expect("it can be killed");
        killed += usize::from(!wait(child).status.success());
        match std::fs::read(&output) {
            Ok(bytes) if bytes == site.expected => written += 1,
            Ok(bytes) => assert!(earlier && bytes == b"earlier", "{} bytes in round {round}", bytes.len()),
            Err(_) => assert!(!earlier, "what was there has gone in round {round}"),
        }
        // A temporary file of the killed process may remain, and doesn't disturb the next run.
        succeed(site.merge(&output).arg("--force"));
        assert!(std::fs::read(&output).is_ok_and(|bytes| bytes == site.expected));
    }
    eprintln!("{killed} programs were killed before their end; {written} had written their file");
    assert!(killed > 0, "the moments are in the run");
}

#[test]
fn a_program_that_is_asked_to_stop_says_so_and_leaves_nothing() {
    let site = Site::new(SAMPLES);
    let whole = site.path("all.moments");
    let started = Instant::now();
    succeed(&mut site.moments(&whole));
    let (duration, expected) = (started.elapsed(), std::fs::read(&whole).expect("a file"));
    std::fs::remove_file(&whole).expect("a removal");
    let mut before = names(site.folder.path());
    before.sort();
    let (mut random, mut stopped) = (Random(6), 0);
    for signal in [Signal::TERM, Signal::INT, Signal::HUP].into_iter().cycle().take(times(9)) {
        let child = start(&mut site.moments(&whole));
        let pid = Pid::from_child(&child);
        // The process handles signals once it reads the table.
        let reads = || {
            let files = std::fs::read_dir(format!("/proc/{}/fd", pid.as_raw_nonzero())).into_iter().flatten();
            let files = files.filter_map(|file| std::fs::read_link(file.ok()?.path()).ok());
            files.into_iter().any(|path| path.ends_with("samples.npy"))
        };
        let waited = Instant::now();
        while !reads() && waited.elapsed() < 2 * duration {
            std::thread::sleep(Duration::from_micros(100));
        }
        std::thread::sleep(duration.mul_f64(0.5 * random.below(1 << 20) as f64 / f64::from(1 << 20)));
        // The process may have ended already, so the signal may fail.
        let _ = kill_process(pid, signal);
        let output = wait(child);
        match output.status.code() {
            Some(75) => {
                let said = String::from_utf8_lossy(&output.stderr);
                assert!(said.contains("interrupted"), "{said}");
                let mut after = names(site.folder.path());
                after.sort();
                assert_eq!(after, before, "nothing is left behind");
                stopped += 1;
            }
            // The process had finished before the signal arrived.
            code => {
                assert_eq!(code, Some(0), "{}", text(&output));
                assert!(std::fs::read(&whole).is_ok_and(|bytes| bytes == expected));
                std::fs::remove_file(&whole).expect("a removal");
            }
        }
    }
    eprintln!("{stopped} programs were stopped before their end");
    assert!(stopped > 0, "the moments are in the run");
    assert!(finish(&mut site.moments(&whole)).status.success());
    assert!(std::fs::read(&whole).is_ok_and(|bytes| bytes == expected), "the bytes of an undisturbed run");
}
