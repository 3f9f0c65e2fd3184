//! Group alignments that were killed resume from their state file.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use ndarray::Array2;
use spharm_harmonics::Coefficients;
use spharm_model::Model;
use spharm_surface::generate::SplitMix64;
use spharm_surface::{Kind, Sphere};

use crate::common::{fail, finish, succeed, text, tool};

/// Sizes of the state file's header and of each record, in bytes; see crates/shape/src/procrustes/journal.rs.
const HEADER: u64 = 64;
const RECORD: u64 = 196;

struct Site(tempfile::TempDir);

impl Site {
    /// Creates a folder with this number of equal models of degree 8, over their own spheres.
    fn new(members: u64) -> Self {
        let site = Self(tempfile::tempdir().expect("a folder"));
        std::fs::create_dir(site.path("models")).expect("a folder");
        for member in 0..members {
            let (mut common, mut own) = (SplitMix64::new(1), SplitMix64::new(100 + member));
            let mut values = Array2::from_shape_fn((81, 3), |(k, _)| {
                let amount = 1.0 / (1.0 + k as f64);
                amount * (common.between(-1.0, 1.0) + 0.2 * own.between(-1.0, 1.0))
            });
            (values[[3, 0]], values[[1, 1]], values[[2, 2]]) = (9.0, 6.0, 4.0);
            let coefficients = Coefficients::new(values).expect("a degree");
            let path = site.path(&format!("models/{member:03}.spharm.npz"));
            Model::new(Sphere::icosphere(0), coefficients, Kind::Surface).write(path).expect("a model");
        }
        site
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn align(&self, output: &str, more: &[&str]) -> Command {
        let mut command = tool("shape");
        command.args(["align", "models", "--group", "-o", output, "--mean"]).arg(format!("{output}.mean.npz"));
        command.args(more).current_dir(self.0.path());
        command
    }

    /// Returns the bits of all coefficients of a folder's models and of their mean.
    fn bits(&self, output: &str) -> Vec<u64> {
        let list = std::fs::read_dir(self.path(output)).expect("a folder");
        let mut files: Vec<PathBuf> = list.map(|entry| entry.expect("an entry").path()).collect();
        files.sort();
        files.push(self.path(&format!("{output}.mean.npz")));
        let bits = |path: &PathBuf| Model::read(path).expect("a model").coefficients.values().mapv(f64::to_bits);
        files.iter().flat_map(|path| bits(path).into_iter().collect::<Vec<_>>()).collect()
    }
}

fn records(state: &Path) -> u64 {
    std::fs::metadata(state).map_or(0, |found| found.len().saturating_sub(HEADER) / RECORD)
}

#[test]
fn a_group_that_is_killed_goes_on_and_ends_in_the_same_bits() {
    let site = Site::new(16);
    succeed(site.align("undisturbed", &["-q"]).args(["--threads", "1"]));
    let state = site.path("align.state");
    let resumed = ["--resume", "align.state"];
    let mut last = 0;
    for _ in 0..2 {
        let mut child =
            site.align("killed", &resumed).stderr(Stdio::null()).stdout(Stdio::null()).spawn().expect("a run");
        while records(&state) < last + 16 {
            assert!(child.try_wait().expect("its state").is_none(), "the run ended before it could be killed");
            std::thread::sleep(Duration::from_millis(2));
        }
        child.kill().expect("it runs");
        child.wait().expect("it ran");
        last = records(&state);
        assert!(!site.path("killed").exists() && !site.path("killed.mean.npz").exists(), "no output is there yet");
    }
    // A state of other settings or other models is refused and kept.
    let refused = fail(site.align("killed", &resumed).arg("--scale"));
    assert!(refused.contains("align.state: expected the state of an alignment of these models"), "{refused}");
    assert_eq!(records(&state), last);
    let kept = std::fs::read(&state).expect("a state");
    let output = finish(&mut site.align("killed", &resumed));
    let told = text(&output);
    assert!(output.status.success() && told.contains("MiB planned"), "{told}");
    assert!(told.contains(&format!("resuming an earlier run that finished {last} alignments")), "{told}");
    assert!(site.bits("killed") == site.bits("undisturbed"));
    assert!(!state.exists(), "it isn't needed any more");
    // If the earlier run ended while writing its outputs, the outputs that it had written are kept.
    std::fs::write(&state, &kept).expect("written");
    std::fs::remove_file(site.path("killed/012.spharm.npz")).expect("a model");
    std::fs::remove_file(site.path("killed.mean.npz")).expect("a model");
    let modified =
        || std::fs::metadata(site.path("killed/003.spharm.npz")).and_then(|of| of.modified()).expect("a time");
    let before = modified();
    succeed(&mut site.align("killed", &resumed));
    assert!(site.bits("killed") == site.bits("undisturbed") && modified() == before);
    // An output that differs from the result isn't the earlier run's, and is refused.
    std::fs::write(&state, &kept).expect("written");
    std::fs::copy(site.path("models/004.spharm.npz"), site.path("killed/004.spharm.npz")).expect("copied");
    let refused = fail(&mut site.align("killed", &resumed));
    assert!(
        refused.contains("killed/004.spharm.npz: the file exists and differs from the result of this run"),
        "{refused}"
    );
    assert!(state.exists());
    succeed(site.align("killed", &resumed).arg("--force"));
    assert!(site.bits("killed") == site.bits("undisturbed") && !state.exists());
}

#[test]
fn what_keeps_the_state_is_a_file_of_its_own() {
    let site = Site::new(3);
    let before = std::fs::read(site.path("models/000.spharm.npz")).expect("a model");
    let refused = fail(&mut site.align("out", &["--resume", "models/000.spharm.npz"]));
    assert!(refused.contains("found a file of another kind"), "{refused}");
    assert!(std::fs::read(site.path("models/000.spharm.npz")).expect("a model") == before);
    let misused = |command: &mut Command, expected: &str| {
        let output = finish(command);
        assert!(output.status.code() == Some(2) && text(&output).contains(expected), "{}", text(&output));
    };
    misused(&mut site.align("out", &["--resume", "./out.mean.npz"]), "--resume must name a file that");
    let alone = ["align", "a.npz", "--to", "b.npz", "-o", "c.npz", "--resume", "s"];
    misused(tool("shape").args(alone), "--group");
}
