//! A store on a read-only disk serves fits, and repeating a finished build on it succeeds without warnings.

use std::process::Command;

use spharm_store::{BuildParams, catalog};

use super::{build_here, namespace, verified, write_signal, write_sphere};
use crate::common::{fail, succeed, tool};

#[test]
fn a_read_only_store_serves_fits_and_says_why_it_does_not_grow() {
    if !namespace::entered("store::read_only::a_read_only_store_serves_fits_and_says_why_it_does_not_grow") {
        return;
    }
    const N: usize = 300;
    let folder = tempfile::tempdir().expect("a folder");
    let (sphere, signal) = (write_sphere(folder.path(), N), write_signal(folder.path(), N));
    let store = folder.path().join("store");
    std::fs::create_dir(&store).expect("a folder");
    namespace::mount(&store, 16 << 20);
    let key = build_here(&store, N, &BuildParams { max_degree: 6, ..BuildParams::default() });
    // The leftover of a killed builder can't be removed on a read-only disk, and does no harm.
    std::fs::write(store.join(key.to_string()).join(".A_7.abandoned.tmp"), "").expect("a file");
    let before = verified(&store);
    namespace::remount(&store, "ro");
    let command = |name: &str, degree: &str| -> Command {
        let mut command = tool(name);
        command.arg("--store").arg(&store).arg("--sphere").arg(&sphere).args(["--max-degree", degree]);
        command
    };
    for degree in ["6", "3"] {
        let output = folder.path().join(format!("{degree}.spharm.npz"));
        succeed(command("fit", degree).arg("--verify").arg("--surface").arg(&signal).arg("-o").arg(output));
        succeed(&mut command("basis-build", degree));
    }
    succeed(tool("store").arg("verify").arg(&store));
    let line = fail(&mut command("basis-build", "7"));
    assert!(line.contains(&store.display().to_string()), "{line}");
    assert!(line.contains("choose a --store that you have permission to use, or change its permissions"), "{line}");
    let line = fail(command("basis-build", "2").args(["--dtype", "f32"]));
    assert!(line.contains("choose a --store that you have permission to use, or change its permissions"), "{line}");
    namespace::remount(&store, "rw");
    assert_eq!(catalog::schemes(&store).expect("a store"), [key]);
    assert!(verified(&store) == before);
    succeed(&mut command("basis-build", "7"));
    assert_eq!(super::leftovers(&store), [""; 0]);
}
