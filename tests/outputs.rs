//! Outputs never replace inputs or other outputs of the same call, even with `--force`.

use std::path::PathBuf;
use std::process::{Command, Output};

use serde_json::Value;
use spharm_surface::generate::{Cortex, cortex};
use spharm_surface::io::{WriteOptions, write_mesh};

use crate::common::{error_line, finish, text, tool};

/// A folder with a surface `in.ply`, its sphere, and its model.
struct Site(tempfile::TempDir);

impl Site {
    fn new() -> Self {
        let site = Self(tempfile::tempdir().expect("a folder"));
        let (surface, sphere) = cortex(&Cortex { subdivisions: 2, variant: 0 });
        for (name, mesh) in [("in.ply", &surface), ("sphere.ply", &sphere)] {
            write_mesh(site.path(name), mesh, &WriteOptions { double: true, overwrite: false }).expect("written");
        }
        site.done(&["fit", "--sphere", "sphere.ply", "--surface", "in.ply", "--max-degree", "2", "-o", "m.spharm.npz"]);
        site
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = tool(arguments[0]);
        command.args(&arguments[1..]).current_dir(self.0.path());
        command
    }

    fn done(&self, arguments: &[&str]) -> Output {
        let output = finish(&mut self.command(arguments));
        assert!(output.status.success(), "{arguments:?}: {}", text(&output));
        output
    }

    /// Returns the names of the folder's files and their contents.
    fn files(&self) -> Vec<(PathBuf, Vec<u8>)> {
        let folders = [self.0.path().to_owned(), self.path("models")];
        let entries = folders.iter().flat_map(|folder| std::fs::read_dir(folder).expect("a folder"));
        let mut files: Vec<_> = entries
            .map(|entry| entry.expect("an entry").path())
            .filter(|path| path.is_file())
            .map(|path| (path.clone(), std::fs::read(path).expect("a file")))
            .collect();
        files.sort();
        files
    }
}

#[test]
fn no_output_replaces_an_input_or_another_output() {
    let site = Site::new();
    std::fs::hard_link(site.path("in.ply"), site.path("hard.ply")).expect("a link");
    std::os::unix::fs::symlink("in.ply", site.path("soft.ply")).expect("a link");
    std::os::unix::fs::symlink(".", site.path("here")).expect("a link");
    std::fs::create_dir(site.path("models")).expect("a folder");
    std::fs::copy(site.path("m.spharm.npz"), site.path("models/m.spharm.npz")).expect("a copy");
    std::fs::write(site.path("list.txt"), "in.ply\n").expect("a list");
    std::fs::write(site.path("rows.tsv"), "id\tsurface\tsphere\na\tin.ply\tsphere.ply\n").expect("a table");
    let before = site.files();
    let fit = &["fit", "--sphere", "sphere.ply", "--max-degree", "2", "--force"][..];
    let of = |more: &[&'static str]| [fit, more].concat();
    for arguments in [
        of(&["--surface", "in.ply", "-o", "a.npz", "--report", "a.npz"]),
        of(&["--surface", "in.ply", "-o", "a.npz", "--report", "here/./a.npz"]),
        of(&["--surface", "in.ply", "-o", "a.npz", "--report", "in.ply"]),
        of(&["--surface", "in.ply", "-o", "a.npz", "--report", "hard.ply"]),
        of(&["--surface", "in.ply", "-o", "a.npz", "--status", "sphere.ply"]),
        of(&["--surface", "@list.txt", "-o", "a.npz", "--report", "soft.ply"]),
        of(&["--surface", "@list.txt", "-o", "a.npz", "--report", "list.txt"]),
        of(&["--surface", "in.ply", "-o", "models", "--report", "models/in.spharm.npz"]),
        of(&["--surface", "in.ply", "-o", "models", "--status", "models/in.spharm.csv"]),
        vec!["fit", "--manifest", "rows.tsv", "--max-degree", "2", "-o", "models", "--report", "rows.tsv", "--force"],
        vec!["generate", "--surface", "g.ply", "--sphere", "./g.ply", "--subdivisions", "1", "--force"],
        vec!["parametrize", "--surface", "in.ply", "-o", "in.ply", "--force"],
        vec!["parametrize", "--surface", "soft.ply", "-o", "hard.ply", "--force"],
        vec!["parametrize", "--surface", "in.ply", "-o", "p.ply", "--surface-output", "./p.ply", "--force"],
        vec!["parametrize", "--surface", "in.ply", "-o", "p.ply", "--report", "p.ply", "--force"],
        vec!["reconstruct", "--model", "m.spharm.npz", "--sphere", "sphere.ply", "-o", "sphere.ply", "--force"],
        vec!["compare", "in.ply", "sphere.ply", "-o", "here/in.ply", "--force"],
        vec!["compare", "in.ply", "sphere.ply", "--report", "in.ply", "--force"],
        vec!["picture", "in.ply", "-o", "in.ply", "--force"],
        vec!["shape", "align", "models", "--group", "-o", "models", "--force"],
        vec!["shape", "rotate", "models", "--euler", "0,0,0", "-o", "models/m.spharm.npz", "--force"],
        vec!["shape", "mean", "models", "-o", "models/m.spharm.npz", "--force"],
        vec!["shape", "compress", "m.spharm.npz", "-o", "c.sphz", "--report", "./c.sphz", "--force"],
        vec!["import", "m.spharm.npz", "-o", "m.spharm.npz", "--force"],
        vec!["report", "m.spharm.npz", "-o", "m.spharm.npz", "--force"],
        vec![
            "basis-build",
            "--sphere",
            "sphere.ply",
            "--store",
            "s",
            "--max-degree",
            "1",
            "--report",
            "sphere.ply",
            "--force",
        ],
    ] {
        let output = finish(&mut site.command(&arguments));
        // An extension of another format may also be the reason for the refusal; nothing is written in any case.
        assert!(matches!(output.status.code(), Some(1 | 2)), "{arguments:?}: {}", text(&output));
        assert_eq!(site.files(), before, "{arguments:?}");
    }
    // The error is one line and names the flag to change.
    let line = |arguments: &[&str]| error_line(&finish(&mut site.command(arguments)));
    let said = line(&of(&["--surface", "in.ply", "-o", "a.npz", "--report", "./a.npz"]));
    assert!(said.contains("both --output and --report"), "{said}");
    let said = line(&of(&["--surface", "in.ply", "-o", "a.npz", "--report", "hard.ply"]));
    assert!(said.contains("an input") && said.contains("--report"), "{said}");
    let said = line(&["shape", "align", "models", "--group", "-o", "models", "--force"]);
    assert!(said.contains("m.spharm.npz: this file is an input"), "{said}");
    // An existing output is replaced, even through a link, if it isn't an input.
    site.done(&of(&["--surface", "in.ply", "-o", "m.spharm.npz"]));
}

#[test]
fn modes_are_kept_and_new_files_follow_the_umask() {
    use std::os::unix::fs::PermissionsExt;
    let site = Site::new();
    let mode = |name: &str| std::fs::metadata(site.path(name)).expect("a file").permissions().mode() & 0o777;
    let fit = "exec \"$0\" fit --sphere sphere.ply --surface in.ply --max-degree 2 --force -q -o k.npz --report k.json";
    for (umask, expected) in [("022", 0o644), ("077", 0o600), ("002", 0o664)] {
        let _ = std::fs::remove_file(site.path("k.npz"));
        let _ = std::fs::remove_file(site.path("k.json"));
        let mut command = Command::new("sh");
        command.arg("-c").arg(format!("umask {umask}; {fit}")).arg(tool("fit").get_program());
        assert!(finish(command.current_dir(site.0.path())).status.success());
        assert_eq!((mode("k.npz"), mode("k.json")), (expected, expected), "{umask}");
    }
    for name in ["k.npz", "k.json"] {
        std::fs::set_permissions(site.path(name), std::fs::Permissions::from_mode(0o600)).expect("a mode");
    }
    let mut command = Command::new("sh");
    command.arg("-c").arg(format!("umask 0; {fit}")).arg(tool("fit").get_program());
    assert!(finish(command.current_dir(site.0.path())).status.success());
    assert_eq!((mode("k.npz"), mode("k.json")), (0o600, 0o600));
}

/// `-` is standard output for every verb with a report; only the report is then printed. Pipes and devices are written
/// to.
#[test]
fn reports_go_to_standard_output_and_to_devices() {
    let site = Site::new();
    let fit =
        ["fit", "--sphere", "sphere.ply", "--surface", "in.ply", "--max-degree", "2", "--force", "-o", "m.spharm.npz"];
    let basis = ["basis-build", "--sphere", "sphere.ply", "--store", "s", "--max-degree", "1"];
    std::fs::write(site.path("samples.csv"), "x,y,z,v\n1,0,0,1\n0,1,0,2\n0,0,1,3\n-1,0,0,4\n0,-1,0,5\n")
        .expect("a table");
    let moments =
        ["moments", "--samples", "samples.csv", "--vectors", "x", "y", "z", "--values", "v", "--max-degree", "1"];
    for arguments in [
        &fit[..],
        &["parametrize", "--surface", "in.ply", "-o", "p.ply", "--force"],
        &["compare", "in.ply", "in.ply", "--force"],
        &["shape", "describe", "m.spharm.npz"],
        &[&moments[..], &["--force", "-o", "o.moments"]].concat(),
        &basis,
    ] {
        for name in ["-", "/dev/stdout"] {
            let output = site.done(&[arguments, &["--report", name, "-q"]].concat());
            let report: Value = serde_json::from_slice(&output.stdout)
                .unwrap_or_else(|error| panic!("{arguments:?}: JSON alone, {error}: {}", text(&output)));
            assert!(report.is_object() || report.is_array(), "{arguments:?}");
        }
        site.done(&[arguments, &["--report", "/dev/null", "-q"]].concat());
        assert!(!site.path("-").exists(), "{arguments:?}");
    }
    // A result other than a report must be a regular file.
    for arguments in [
        &["picture", "in.ply", "-o", "-"][..],
        &["import", "m.spharm.npz", "-o", "-"],
        &["compare", "in.ply", "in.ply", "-o", "-"],
        &["shape", "describe", "m.spharm.npz", "-o", "/dev/null"],
        &["report", "m.spharm.npz", "-o", "-"],
        &["volumes", "in.ply", "--max-degree", "2", "-o", "v", "--table", "-"],
    ] {
        let line = error_line(&finish(&mut site.command(arguments)));
        assert!(line.contains("must name a file") || line.contains("label volume"), "{arguments:?}: {line}");
    }
    assert!(!site.path("-").exists());
}

/// If a folder can't be closed, the call ends with an error line. Needs strace to simulate the failure.
#[test]
fn a_folder_that_cannot_be_closed_is_a_failure_in_one_line() {
    if !Command::new("strace").args(["-qq", "true"]).output().is_ok_and(|output| output.status.success()) {
        eprintln!("skipped: no strace here that may trace");
        return;
    }
    let site = Site::new();
    let build = |degree: &str| -> Vec<String> {
        let build = ["basis-build", "--sphere", "sphere.ply", "--store", "s", "--max-degree", degree, "-q"];
        build.map(str::to_owned).to_vec()
    };
    assert!(finish(tool("basis-build").args(&build("1")[1..]).current_dir(site.0.path())).status.success());
    let store = site.path("s").canonicalize().expect("a folder");
    let scheme = std::fs::read_dir(&store).expect("a folder").next().expect("a scheme").expect("an entry").path();
    let mut failed = 0;
    for when in 1..=4 {
        let mut command = Command::new("strace");
        command.args(["-f", "-qq", "-o", "/dev/null", "-e", "trace=close"]).arg("-P").arg(&scheme);
        command.args(["-e", &format!("inject=close:error=EIO:when={when}")]).env_remove("RUST_BACKTRACE");
        let command = command.arg(tool("basis-build").get_program()).args(build(&(1 + when).to_string()));
        let output = finish(command.current_dir(site.0.path()));
        let stderr = String::from_utf8_lossy(&output.stderr);
        let lines: Vec<&str> = stderr.lines().filter(|line| !line.starts_with("strace: ")).collect();
        match output.status.code() {
            Some(0) => {}
            Some(1) => {
                failed += 1;
                assert!(matches!(lines[..], [line] if line.starts_with("error: ")), "{when}: {stderr}");
            }
            _ => panic!("{when}: {}", text(&output)),
        }
    }
    assert!(failed > 0, "no folder was closed");
    // The next call completes the unfinished build.
    assert!(finish(tool("basis-build").args(&build("5")[1..]).current_dir(site.0.path())).status.success());
    let verify = finish(tool("store").args(["verify", "s"]).current_dir(site.0.path()));
    assert!(verify.status.success(), "{}", text(&verify));
}

#[test]
fn the_name_of_a_file_is_no_folder_for_several_outputs() {
    let site = Site::new();
    std::fs::copy(site.path("m.spharm.npz"), site.path("n.spharm.npz")).expect("a copy");
    for arguments in [
        "reconstruct m.spharm.npz n.spharm.npz -o two.ply",
        "reconstruct m.spharm.npz --format ply -o two.ply",
        "shape remesh m.spharm.npz --levels 1,2 -o two.ply",
        "fit in.ply --sphere sphere.ply --max-degree 2 -o two.sphz",
    ] {
        let output = finish(&mut site.command(&arguments.split(' ').collect::<Vec<_>>()));
        let said = text(&output);
        assert!(!output.status.success() && said.contains("--output must name a folder"), "{arguments}: {said}");
    }
    assert!(!site.path("two.ply").exists() && !site.path("two.sphz").exists());
}

/// 32-bit numbers near 1e8 have steps of 8 units.
#[test]
fn coordinates_too_large_for_32_bits_are_warned_of() {
    let site = Site::new();
    let (mut far, _) = cortex(&Cortex { subdivisions: 2, variant: 0 });
    far.vertices.iter_mut().for_each(|vertex| vertex[0] += 1e8);
    write_mesh(site.path("far.ply"), &far, &WriteOptions { double: true, overwrite: false }).expect("written");
    site.done(&["fit", "--sphere", "sphere.ply", "--surface", "far.ply", "--max-degree", "2", "-o", "far.spharm.npz"]);
    let warnings = |model: &str, more: &[&str]| {
        let output = site.done(&[&["reconstruct", model, "--force", "-o"], more].concat());
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    for (name, advice) in [
        ("a.ply", "; give --double"),
        ("a.surf.gii", "; give --double"),
        ("a.stl", "such as .vtp"),
        ("a.glb", "such as .vtp"),
    ] {
        let text = warnings("far.spharm.npz", &[name]);
        assert!(text.contains("32-bit numbers are too coarse") && text.contains(advice), "{name}: {text}");
        let text = warnings("m.spharm.npz", &[name]);
        assert!(!text.contains("32-bit"), "{name}: {text}");
    }
    for more in [&["b.ply", "--double"][..], &["b.obj"], &["b.vtp", "--double"]] {
        let text = warnings("far.spharm.npz", more);
        assert!(!text.contains("32-bit"), "{more:?}: {text}");
    }
    let text = warnings("m.spharm.npz", &["b.stl", "--double"]);
    assert!(text.contains("--double has no effect, because an STL file stores 32-bit numbers"), "{text}");
}

/// A surface whose vertices are all at the origin is written exactly.
#[test]
fn zeros_are_not_too_coarse_for_32_bits() {
    let site = Site::new();
    let rows = ["1,0,0", "-1,0,0", "0,1,0", "0,-1,0", "0,0,1", "0,0,-1"].map(|row| format!("{row},0,0,0\n"));
    std::fs::write(site.path("t.csv"), format!("a,b,c,x,y,z\n{}", rows.concat())).expect("written");
    let columns = ["--vectors", "a", "b", "c", "--values", "x", "y", "z", "--max-degree", "1"];
    site.done(&[&["moments", "--samples", "t.csv", "-o", "t.moments"][..], &columns].concat());
    site.done(&["fit", "--moments", "t.moments", "--max-degree", "1", "-o", "zero.spharm.npz"]);
    let output = site.done(&["reconstruct", "zero.spharm.npz", "--icosphere", "1", "-o", "zero.stl"]);
    assert!(!String::from_utf8_lossy(&output.stderr).contains("32-bit"), "{output:?}");
}
