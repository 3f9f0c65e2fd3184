//! Checks that memory budgets are respected: a fit of 40,962 vertices from a store of 3.3 GB under system limits.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::LazyLock;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use crate::common::{succeed, tool};

const LIMIT: usize = 320 << 20;

/// A generated cortex of 40,962 vertices and its basis to degree 100, kept in the target folder between runs.
static STUDY: LazyLock<PathBuf> = LazyLock::new(|| {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("memory");
    fs::create_dir_all(&folder).unwrap();
    let sphere = folder.join("sphere.surf.gii");
    succeed(
        tool("generate").arg("--surface").arg(folder.join("s.surf.gii")).arg("--sphere").arg(&sphere).arg("--force"),
    );
    let mut build = tool("basis-build");
    build.arg("--sphere").arg(&sphere).arg("--store").arg(folder.join("store")).args(["--max-degree", "100", "-q"]);
    succeed(&mut build);
    folder
});

fn fit(wrapper: &[String]) -> Command {
    static NEXT: AtomicUsize = AtomicUsize::new(0);
    // Tests run in parallel, so each writes to a different output.
    let name = format!("{}-{}.npz", std::process::id(), NEXT.fetch_add(1, Ordering::Relaxed));
    let arguments = [
        ("--store", STUDY.join("store")),
        ("--sphere", STUDY.join("sphere.surf.gii")),
        ("--surface", STUDY.join("s.surf.gii")),
        ("--output", STUDY.join(name)),
    ];
    let tool = tool("fit");
    let mut command = match wrapper {
        [] => tool,
        [program, more @ ..] => {
            let mut command = Command::new(program);
            command.args(more).arg(tool.get_program()).args(tool.get_args());
            command
        }
    };
    for (flag, value) in arguments {
        command.arg(flag).arg(value);
    }
    command.args([
        "--max-degree",
        "100",
        "--granularity",
        "100",
        "--memory",
        "256MiB",
        "--threads",
        "2",
        "--force",
        "-q",
    ]);
    command
}

/// Drops the store's pages from the page cache and checks that they are gone, so that the next run reads from the disk.
fn drop_pages() -> bool {
    let scheme = fs::read_dir(STUDY.join("store")).unwrap().next().unwrap().unwrap().path();
    let files: Vec<PathBuf> = fs::read_dir(scheme).unwrap().map(|item| item.unwrap().path()).collect();
    for path in &files {
        let file = fs::File::open(path).unwrap();
        file.sync_all().unwrap();
        rustix::fs::fadvise(&file, 0, None, rustix::fs::Advice::DontNeed).unwrap();
    }
    let Ok(output) = Command::new("fincore").args(["-b", "-n", "-o", "RES"]).args(&files).output() else {
        eprintln!("skipped: no fincore here to see that the store's pages are gone");
        return false;
    };
    let resident: u64 =
        String::from_utf8_lossy(&output.stdout).lines().filter_map(|l| l.trim().parse::<u64>().ok()).sum();
    if resident > 64 << 20 {
        eprintln!("skipped: {resident} bytes of the store stay in memory on this file system");
    }
    resident <= 64 << 20
}

#[test]
fn anonymous_memory_stays_below_the_budget() {
    let peak = peak_anonymous(&mut fit(&[]));
    assert!(peak > 1 << 20, "something was measured");
    assert!(peak < 256 << 20, "{peak} bytes");
}

/// Returns the peak anonymous memory of a command, which must succeed.
fn peak_anonymous(command: &mut Command) -> u64 {
    let mut child = command.stdout(Stdio::null()).spawn().unwrap();
    let status = PathBuf::from(format!("/proc/{}/status", child.id()));
    let mut peak = 0;
    while child.try_wait().unwrap().is_none() {
        let text = fs::read_to_string(&status).unwrap_or_default();
        let line = text.lines().find_map(|line| line.strip_prefix("RssAnon:"));
        let kib: u64 = line.and_then(|line| line.trim().trim_end_matches(" kB").parse().ok()).unwrap_or(0);
        peak = peak.max(kib << 10);
        std::thread::sleep(Duration::from_millis(1));
    }
    assert!(child.wait().unwrap().success());
    peak
}

/// Computes a factor of 172 MB out of core, in the smallest budget, which the program's error states.
#[test]
fn a_factor_is_computed_in_less_memory_than_it_has() {
    let folder = tempfile::tempdir().unwrap();
    let sphere = folder.path().join("sphere.surf.gii");
    let surface = folder.path().join("s.surf.gii");
    succeed(
        tool("generate").args(["--subdivisions", "3", "-q", "--surface"]).arg(surface).arg("--sphere").arg(&sphere),
    );
    let build = |memory: &str| {
        let mut command = tool("basis-build");
        command.arg("--sphere").arg(&sphere).arg("--store").arg(folder.path().join("store"));
        // With fewer directions than coefficients, the penalty makes the equations solvable.
        command.args(["--factor", "80", "--factor-only", "--smoothness", "1", "--threads", "2", "--memory", memory]);
        command
    };
    let line = crate::common::fail(&mut build("1MiB"));
    let needed: u64 =
        line.split("at least ").nth(1).and_then(|rest| rest.split_once(" MiB")).unwrap().0.parse().unwrap();
    let budget = needed << 20;
    let whole = 8 * 6561 * 6562 / 2;
    let peak = peak_anonymous(&mut build(&format!("{needed}MiB")));
    assert!(peak < budget && peak > 1 << 20, "{peak} of {budget} bytes");
    assert!(budget < whole, "{budget} of {whole} bytes");
}

#[test]
fn a_limit_on_data_is_no_obstacle() {
    let limit = |bytes: usize| ["prlimit".to_owned(), format!("--data={bytes}")];
    if !has_prlimit() {
        return;
    }
    succeed(&mut fit(&limit(LIMIT)));
    succeed(&mut fit(&limit(256 << 20)));
    // Blocks of 100 functions don't need OpenBLAS, so its buffers for each thread aren't reserved.
    succeed(&mut fit(&limit(64 << 20)));
    // A limit that is too low is reported before the work starts.
    let error = crate::common::fail(&mut fit(&limit(48 << 20)));
    assert!(error.contains("ulimit -d"), "{error}");
}

/// Returns whether limits can be set; prints a message if they can't.
fn has_prlimit() -> bool {
    let there = Command::new("prlimit").arg("--version").output().is_ok();
    if !there {
        eprintln!("skipped: no prlimit here");
    }
    there
}

/// Fits a sampling that needs a factor, under a limit without room for OpenBLAS's buffers. OpenBLAS would wait for
/// these buffers forever.
#[test]
fn a_fit_that_wants_a_factor_ends_under_a_limit_on_data() {
    if !has_prlimit() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    // Pseudo-random directions from the digits of sines; an additive sequence would be too even. There are fewer than
    // two directions per coefficient, so that iterations aren't preconditioned with the density.
    let random = |i: u32| (f64::from(i).sin() * 43_758.545_3).rem_euclid(1.0);
    let (mut sphere, mut signal) = (String::new(), String::new());
    for i in 0..1800 {
        let (theta, phi) = ((1.0 - 2.0 * random(2 * i + 1)).acos(), std::f64::consts::TAU * random(2 * i + 2));
        sphere += &format!("{theta},{phi}\n");
        signal += &format!("{}\n", (3.0 * theta).sin() * (5.0 * phi).cos());
    }
    fs::write(path("sphere.csv"), sphere).unwrap();
    fs::write(path("f.csv"), signal).unwrap();
    let fit = |limit: &str, more: &[&str]| {
        let (fit, mut command) = (tool("fit"), Command::new("prlimit"));
        command.arg(format!("--data={limit}")).arg(fit.get_program()).args(fit.get_args()).args(more);
        command.arg("--sphere").arg(path("sphere.csv")).arg("--surface").arg(path("f.csv")).arg("--output");
        command.arg(path("f.npz")).args(["--max-degree", "30", "--memory", "1GiB", "--threads", "2", "--force"]);
        command
    };
    let warnings = |command: &mut Command| {
        let output = crate::common::finish(command);
        assert!(output.status.success(), "{output:?}");
        String::from_utf8(output.stderr).unwrap()
    };
    assert!(!warnings(&mut fit("unlimited", &[])).contains("no factor"), "there is room for one");
    // The iterations need only a few MiB, so the fit succeeds, with a warning that no factor was computed.
    let found = warnings(&mut fit("134217728", &[]));
    assert!(found.contains("no Cholesky factor was computed") && found.contains("ulimit -d"), "{found}");
    let error = crate::common::fail(&mut fit("134217728", &["--preconditioner", "factor"]));
    assert!(error.contains("ulimit -d") && error.contains("use fewer threads"), "{error}");
}

#[test]
fn a_cold_fit_succeeds_in_a_cgroup_far_smaller_than_the_store() {
    let Some(group) = Cgroup::new() else {
        eprintln!("skipped: no memory cgroup can be made here");
        return;
    };
    if !drop_pages() {
        return;
    }
    let enter = format!("echo $$ > '{}/cgroup.procs' && exec \"$@\"", group.0.display());
    succeed(&mut fit(&["sh".to_owned(), "-c".to_owned(), enter, "sh".to_owned()]));
}

/// A memory cgroup of `LIMIT` bytes, version 1 or 2.
struct Cgroup(PathBuf);

impl Cgroup {
    fn new() -> Option<Self> {
        let name = format!("spharm-test-{}", std::process::id());
        [("/sys/fs/cgroup/memory", "memory.limit_in_bytes"), ("/sys/fs/cgroup", "memory.max")].iter().find_map(
            |(parent, file)| {
                let group = Self(Path::new(parent).join(&name));
                fs::create_dir(&group.0).ok()?;
                fs::write(group.0.join(file), LIMIT.to_string()).ok()?;
                Some(group)
            },
        )
    }
}

impl Drop for Cgroup {
    fn drop(&mut self) {
        // The group's folder can be removed once its only process has ended.
        let _ = fs::remove_dir(&self.0);
    }
}

/// A verb that needs more memory than available is refused before any work, in one line that names a setting that
/// fits.
#[test]
fn what_does_not_fit_is_refused_with_the_nearest_setting_that_does() {
    let folder = tempfile::tempdir().unwrap();
    let (mesh, sphere) = (folder.path().join("g.ply"), folder.path().join("s.ply"));
    let mut generate = tool("generate");
    generate.args(["--subdivisions", "3", "-q", "--surface"]).arg(&mesh).arg("--sphere").arg(&sphere);
    succeed(&mut generate);
    let model = folder.path().join("m.npz");
    let mut fit = tool("fit");
    fit.args(["--max-degree", "8", "--objective", "vertices", "-q", "--surface"])
        .arg(&mesh)
        .arg("--sphere")
        .arg(&sphere);
    succeed(fit.arg("-o").arg(&model));
    let out = folder.path().join("out.ply");
    let verb = |verb: &str, more: &[&str], memory: &str| {
        let mut command = tool(verb);
        command.args(more).args(["--memory", memory]);
        command
    };
    // On any machine, the peak memory is at most the requested budget.
    let mut reconstruct = verb("reconstruct", &["--icosphere", "12"], "64MiB");
    let line = crate::common::fail(reconstruct.arg("--model").arg(&model).arg("-o").arg(&out));
    assert!(line.contains("(167772162 vertices) needs") && line.contains("--memory is 64.0 MiB"), "{line}");
    let nearest = line.split("; --icosphere ").nth(1).and_then(|rest| rest.split(' ').next()).unwrap();
    let mut reconstruct = verb("reconstruct", &["--icosphere", nearest], "64MiB");
    let peak = peak_anonymous(reconstruct.arg("--model").arg(&model).arg("-o").arg(&out));
    assert!(peak < 64 << 20, "{peak} bytes at --icosphere {nearest}");

    for samples in ["10000000000", "18446744073709551615"] {
        let mut compare = verb("compare", &["--surface-distance", "--samples", samples], "64MiB");
        let line = crate::common::fail(compare.arg(&mesh).arg(&mesh));
        let nearest = line.split("; --samples ").nth(1).and_then(|rest| rest.split(' ').next()).unwrap();
        let mut compare = verb("compare", &["--surface-distance", "--samples", nearest], "64MiB");
        let peak = peak_anonymous(compare.arg(&mesh).arg(&mesh));
        assert!(peak > 4 << 20 && peak < 64 << 20, "{peak} bytes with {nearest} samples");
    }

    let png = folder.path().join("p.png");
    let mut picture = verb("picture", &["--size", "4096"], "64MiB");
    let line = crate::common::fail(picture.arg(&mesh).arg("-o").arg(&png));
    let nearest = line.split("; --size ").nth(1).and_then(|rest| rest.split(' ').next()).unwrap();
    let peak = peak_anonymous(verb("picture", &["--size", nearest], "64MiB").arg(&mesh).arg("-o").arg(&png));
    assert!(peak < 64 << 20, "{peak} bytes at --size {nearest}");

    let mut generate = verb("generate", &["--subdivisions", "10"], "256MiB");
    let line = crate::common::fail(generate.arg("--surface").arg(&out).arg("--force"));
    assert!(line.contains("; --subdivisions 8 needs only"), "{line}");
    let mut parametrize = verb("parametrize", &["--resample-to", "icosphere:9"], "256MiB");
    parametrize.arg("--surface").arg(&mesh).arg("-o").arg(folder.path().join("x.sphere.ply"));
    assert!(crate::common::fail(&mut parametrize).contains("mapping 642 vertices"));
    // The memory for mapping a mesh without a sphere is part of the fit's budget.
    let mut fit = verb("fit", &["--max-degree", "4"], "16MiB");
    let line = crate::common::fail(fit.arg("--surface").arg(&mesh).arg("-o").arg(folder.path().join("bare.npz")));
    assert!(line.contains("is too small; at least"), "{line}");
    let there: Vec<_> = fs::read_dir(folder.path()).unwrap().map(|item| item.unwrap().file_name()).collect();
    assert_eq!(there.len(), 5, "nothing is left of what was refused: {there:?}");
}

/// A limit on data replaces `--memory` if none is given.
#[test]
fn a_limit_on_data_is_a_budget() {
    if !has_prlimit() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let limited = |arguments: &[&str]| {
        let mut command = Command::new("prlimit");
        command.arg("--data=67108864").arg(tool("generate").get_program()).args(arguments).current_dir(folder.path());
        command
    };
    succeed(&mut limited(&["generate", "--subdivisions", "6", "--surface", "g.ply"]));
    for arguments in [
        &["generate", "--subdivisions", "10", "--surface", "x.ply"][..],
        &["picture", "g.ply", "--size", "4096", "-o", "x.png"],
        &["parametrize", "--surface", "g.ply", "-o", "x.ply"],
        &["compare", "g.ply", "g.ply", "--surface-distance", "--samples", "100000000"],
    ] {
        let line = crate::common::fail(&mut limited(arguments));
        assert!(line.contains("of memory, ") && line.contains(" are free"), "{arguments:?}: {line}");
    }
}
