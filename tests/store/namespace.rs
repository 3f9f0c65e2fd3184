//! Runs tests that mount file systems again in their own mount namespace, where they may mount any file system, and
//! whose mounts vanish when they end.

use std::path::Path;
use std::process::Command;

const INSIDE: &str = "SPHARM_TEST_NAMESPACE";

/// Returns whether this process may mount. If not, runs the test of this name in a process that may, and returns false;
/// prints a note if the system doesn't permit that.
pub(crate) fn entered(test: &str) -> bool {
    if std::env::var_os(INSIDE).is_some() {
        return true;
    }
    let unshare = || {
        let mut command = Command::new("unshare");
        command.args(["--map-root-user", "--mount"]);
        command
    };
    let folder = tempfile::tempdir().expect("a folder");
    let mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs"];
    if !unshare().args(mount).arg(folder.path()).output().is_ok_and(|output| output.status.success()) {
        eprintln!("skipped: {test}: no mount namespaces here (unshare --map-root-user --mount fails)");
        return false;
    }
    let output = unshare()
        .arg(std::env::current_exe().expect("this program"))
        .args(["--exact", test, "--nocapture"])
        .env(INSIDE, "1")
        .output()
        .expect("unshare, which has just worked");
    let text = crate::common::text(&output);
    assert!(output.status.success() && text.contains("1 passed"), "{text}");
    eprint!("{}", String::from_utf8_lossy(&output.stderr));
    false
}

/// Mounts a file system in memory, of a given size, on a folder.
pub(crate) fn mount(folder: &Path, bytes: u64) {
    run(Command::new("mount").args(["-t", "tmpfs", "-o", &format!("size={bytes}"), "tmpfs"]).arg(folder));
}

/// Changes the options of a mounted file system: `"size=.."`, `"ro"`, `"rw"`.
pub(crate) fn remount(folder: &Path, options: &str) {
    run(Command::new("mount").args(["-o", &format!("remount,{options}")]).arg(folder));
}

pub(crate) fn unmount(folder: &Path) {
    run(Command::new("umount").arg(folder));
}

fn run(command: &mut Command) {
    let output = command.output().expect("the command starts");
    assert!(output.status.success(), "{command:?}: {}", crate::common::text(&output));
}
