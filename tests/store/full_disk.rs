//! If the disk fills up at any moment of a build, the error is clear, no file is half-written, and a rerun with more
//! space completes.

use std::path::Path;
use std::process::Command;

use spharm_store::{BuildParams, Codec, catalog};

use super::{build_here, leftovers, namespace, verified, write_sphere};
use crate::common::{fail, finish, text, times, tool};

const N: usize = 2000;
const MAX_DEGREE: usize = 20;
const STEP: u64 = 64 << 10;

fn builder(store: &Path, sphere: &Path, codec: &str) -> Command {
    let mut command = tool("basis-build");
    command.arg("--store").arg(store).arg("--sphere").arg(sphere).args(["--max-degree", "20", "--codec", codec]);
    command
}

#[test]
fn a_build_on_a_disk_of_any_size_fails_cleanly_and_completes_later() {
    if !namespace::entered("store::full_disk::a_build_on_a_disk_of_any_size_fails_cleanly_and_completes_later") {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let sphere = write_sphere(folder.path(), N);
    let disk = folder.path().join("disk");
    std::fs::create_dir(&disk).expect("a folder");
    for (codec, name) in [(Codec::Raw, "none"), (Codec::Zstd, "zstd")] {
        let reference = folder.path().join(name);
        build_here(&reference, N, &BuildParams { max_degree: MAX_DEGREE, codec, ..BuildParams::default() });
        let expected = verified(&reference);
        let steps = expected.values().map(|bytes| bytes.len() as u64).sum::<u64>() / STEP;
        // The soak test uses all disk sizes. Other runs use every tenth size, from a different start for each codec.
        let stride = (steps as usize / times(steps as usize)).max(1);
        for step in (1..=steps).skip(3 * name.len() % stride.max(1)).step_by(stride.max(1)) {
            namespace::mount(&disk, step * STEP);
            let store = disk.join("store");
            // A plan that needs more than the free space is refused before anything is written. --yes builds anyway,
            // since compression may make the files fit.
            let line = fail(&mut builder(&store, &sphere, name));
            assert!(line.contains(&store.display().to_string()) && line.contains("with more free space"), "{line}");
            assert!(!store.exists());
            let line = fail(builder(&store, &sphere, name).arg("--yes"));
            assert!(line.contains(&store.display().to_string()), "names the store: {line}");
            assert!(line.contains("free some space or choose another --store"), "says what to do: {line}");
            assert!(line.contains("run the same command again"), "says what to do: {line}");
            if catalog::schemes(&store).is_ok_and(|keys| !keys.is_empty()) {
                assert_eq!(leftovers(&store), [""; 0]);
                for (degree, bytes) in verified(&store) {
                    assert!(bytes == expected[&degree], "A_{degree} is whole or not there");
                }
            }
            namespace::remount(&disk, &format!("size={}", 64 << 20));
            let output = finish(&mut builder(&store, &sphere, name));
            assert!(output.status.success(), "{}", text(&output));
            assert!(verified(&store) == expected, "the same bytes as on a disk with room");
            assert_eq!(leftovers(&store), [""; 0]);
            namespace::unmount(&disk);
        }
    }
}

/// Leftovers of a killed build take up space that the next build needs, so the next build removes them first.
#[test]
fn leftovers_make_room_for_the_build_that_needs_it() {
    if !namespace::entered("store::full_disk::leftovers_make_room_for_the_build_that_needs_it") {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let sphere = write_sphere(folder.path(), N);
    let disk = folder.path().join("disk");
    std::fs::create_dir(&disk).expect("a folder");
    namespace::mount(&disk, 8 << 20);
    let key = spharm_store::SchemeKey::of(&super::directions(N), spharm_store::Scalar::F64);
    let scheme = disk.join(key.to_string());
    std::fs::create_dir(&scheme).expect("a folder");
    std::fs::write(scheme.join(".A_20.abandoned.tmp"), vec![1; 7 << 20]).expect("a file");
    let output = finish(&mut builder(&disk, &sphere, "none"));
    assert!(output.status.success(), "{}", text(&output));
    assert_eq!(verified(&disk).len(), MAX_DEGREE + 1);
    assert_eq!(leftovers(&disk), [""; 0]);
}
