//! If something other than a regular file is in place of a basis file, the program reports an error and never waits.

use std::path::{Path, PathBuf};
use std::process::Command;

use spharm_store::{BuildParams, DegreeFile, StoreError};

use super::{assert_helpful, assert_helpful_line, build_here, write_signal, write_sphere};
use crate::common::{fail, tool};

type Replace = fn(&Path);

pub(super) fn fifo(path: &Path) {
    assert!(Command::new("mkfifo").arg(path).status().expect("mkfifo").success());
}

fn socket(path: &Path) {
    // A socket's path has at most 108 bytes; a link to its folder makes it short enough.
    let short = tempfile::tempdir().expect("a folder");
    let link = short.path().join("l");
    std::os::unix::fs::symlink(path.parent().expect("a folder"), &link).expect("a link");
    drop(std::os::unix::net::UnixListener::bind(link.join(path.file_name().expect("a name"))).expect("a socket"));
}

fn link_to_a_sound_file(path: &Path) {
    std::os::unix::fs::symlink(path.with_file_name("kept"), path).expect("a link");
}

fn dangling_link(path: &Path) {
    std::os::unix::fs::symlink("nowhere", path).expect("a link");
}

fn link_to_itself(path: &Path) {
    std::os::unix::fs::symlink(path, path).expect("a link");
}

fn folder(path: &Path) {
    std::fs::create_dir(path).expect("a folder");
}

fn full_folder(path: &Path) {
    folder(path);
    std::fs::write(path.join("file"), "").expect("a file");
}

fn empty_file(path: &Path) {
    std::fs::write(path, "").expect("a file");
}

const THINGS: &[(&str, Replace)] = &[
    ("a FIFO", fifo),
    ("a socket", socket),
    ("a symbolic link", link_to_a_sound_file),
    ("a symbolic link", dangling_link),
    ("a symbolic link", link_to_itself),
    ("a folder", folder),
    ("a folder", full_folder),
    ("length of the file", empty_file),
];

#[test]
fn each_kind_of_thing_is_named_and_nothing_waits() {
    let folder = tempfile::tempdir().expect("a folder");
    let (sphere, signal) = (write_sphere(folder.path(), 20), write_signal(folder.path(), 20));
    let store = folder.path().join("store");
    let key = build_here(&store, 20, &BuildParams { max_degree: 2, ..BuildParams::default() });
    let path: PathBuf = store.join(key.to_string()).join("A_1");
    std::fs::rename(&path, path.with_file_name("kept")).expect("a rename");
    for (what, replace) in THINGS {
        replace(&path);
        let error = DegreeFile::open(&path).expect_err(what);
        assert_helpful(&error, &path);
        assert!(error.to_string().contains(what), "{what}: {error}");
        let a_file = *what == "length of the file";
        assert_eq!(matches!(error, StoreError::NotAFile { .. }), !a_file);
        let mut fit = tool("fit");
        fit.args(["--max-degree", "2", "--store"])
            .arg(&store)
            .arg("--sphere")
            .arg(&sphere)
            .arg("--surface")
            .arg(&signal);
        let line = fail(fit.arg("-o").arg(folder.path().join("out.spharm.npz")));
        assert_helpful_line(&line, &path);
        assert!(line.contains(what), "{what}: {line}");
        assert_helpful_line(&fail(tool("store").arg("verify").arg(&store)), &path);
        // A build replaces damaged regular files, and refuses anything else in their place.
        let mut build = tool("basis-build");
        build.args(["--max-degree", "2", "--store"]).arg(&store).arg("--sphere").arg(&sphere);
        if a_file {
            assert!(crate::common::finish(&mut build).status.success());
            std::fs::remove_file(&path).expect("a removal");
        } else {
            assert_helpful_line(&fail(&mut build), &path);
            let metadata = path.symlink_metadata().expect("it is still there");
            if metadata.is_dir() { std::fs::remove_dir_all(&path) } else { std::fs::remove_file(&path) }
                .expect("a removal");
        }
    }
}

#[test]
fn the_lock_and_the_folders_may_be_anything() {
    let folder = tempfile::tempdir().expect("a folder");
    let sphere = write_sphere(folder.path(), 20);
    let store = folder.path().join("store");
    let key = build_here(&store, 20, &BuildParams { max_degree: 1, ..BuildParams::default() });
    let lock = store.join(key.to_string()).join(".lock");
    let build = |degree: usize| {
        let mut build = tool("basis-build");
        build.arg("--store").arg(&store).arg("--sphere").arg(&sphere).args(["--max-degree", &degree.to_string()]);
        build
    };
    // A build continues without a lock, because the lock only avoids duplicate work.
    for (at, (_, replace)) in THINGS.iter().enumerate() {
        match lock.symlink_metadata() {
            Ok(metadata) if metadata.is_dir() => std::fs::remove_dir_all(&lock).expect("a removal"),
            Ok(_) => std::fs::remove_file(&lock).expect("a removal"),
            Err(_) => {}
        }
        replace(&lock);
        let output = crate::common::finish(&mut build(at + 2));
        assert!(output.status.success(), "{}", crate::common::text(&output));
    }
    assert_eq!(super::verified(&store).len(), THINGS.len() + 2);
    // Test a file in place of a scheme's folder, and a file in place of the store.
    let file = folder.path().join("file");
    std::fs::create_dir(&file).expect("a folder");
    std::fs::write(file.join(key.to_string()), "").expect("a file");
    for store in [&file, &file.join(key.to_string())] {
        let mut build = tool("basis-build");
        build.arg("--store").arg(store).arg("--sphere").arg(&sphere).args(["--max-degree", "1"]);
        let line = fail(&mut build);
        assert!(line.contains(&store.display().to_string()), "{line}");
    }
}
