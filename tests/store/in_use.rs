//! If a file is truncated or overwritten while it is read, an error names the file; the process isn't killed by a
//! signal, and no wrong number is returned.

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::time::Duration;

use spharm_store::{BuildParams, Codec, DegreeFile, Scalar, StoreError};

use super::{assert_helpful_line, build_here, write_signal, write_sphere};
use crate::common::{error_line, tool, wait};

fn assert_changed(error: &StoreError, path: &Path) {
    assert!(matches!(error, StoreError::ChangedWhileRead { .. }), "{error}");
    super::assert_helpful(error, path);
}

/// Makes a file whose chunks span several pages; returns its folder and its path.
fn big_file(codec: Codec, scalar: Scalar) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    let params = BuildParams { max_degree: 2, codec, scalar, chunk_rows: 2048, ..BuildParams::default() };
    let key = build_here(folder.path(), 20_000, &params);
    let path = folder.path().join(key.to_string()).join("A_2");
    (folder, path)
}

#[test]
fn a_truncated_file_is_an_error_of_its_window() {
    for (codec, scalar) in [(Codec::Raw, Scalar::F64), (Codec::Raw, Scalar::F32), (Codec::Zstd, Scalar::F64)] {
        for keep in [0, 1, 4096, 100_000] {
            let (_folder, path) = big_file(codec, scalar);
            let file = DegreeFile::open(&path).expect("a file");
            let chunks = file.header().chunk_count();
            let window = file.window(0..chunks).expect("a window");
            let mut scratch = Vec::new();
            // The first chunk has been read and verified, the other chunks have not.
            let sum: f64 = window.values(0, &mut scratch).expect("values").iter().sum();
            assert!(sum.is_finite());
            window.check().expect("an unchanged file");
            File::options().write(true).open(&path).expect("a file").set_len(keep).expect("a truncation");
            for chunk in 0..chunks {
                match window.values(chunk, &mut scratch) {
                    Ok(values) => assert!(values.iter().all(|value| value.is_finite())),
                    Err(error) => assert_changed(&error, &path),
                }
            }
            assert_changed(&window.check().expect_err("a truncated file"), &path);
            assert!(DegreeFile::open(&path).is_err());
        }
    }
}

#[test]
fn an_overwritten_file_is_an_error_of_its_window() {
    let (_folder, path) = big_file(Codec::Raw, Scalar::F64);
    let file = DegreeFile::open(&path).expect("a file");
    let window = file.window(0..1).expect("a window");
    let mut scratch = Vec::new();
    window.values(0, &mut scratch).expect("values");
    window.check().expect("an unchanged file");
    // Wait for one clock tick, the resolution of modification times.
    std::thread::sleep(Duration::from_millis(20));
    File::options().write(true).open(&path).expect("a file").write_all_at(&[1; 8], 5000).expect("a write");
    // The checksum is verified only once, so `check` must notice the change.
    window.values(0, &mut scratch).expect("values");
    assert_changed(&window.check().expect_err("an overwritten file"), &path);
}

#[test]
fn a_file_that_is_removed_stays_readable_for_those_who_have_it() {
    let (_folder, path) = big_file(Codec::Raw, Scalar::F64);
    let file = DegreeFile::open(&path).expect("a file");
    std::fs::remove_file(&path).expect("a removal");
    let window = file.window(0..file.header().chunk_count()).expect("a window");
    for chunk in window.chunks() {
        window.values(chunk, &mut Vec::new()).expect("values");
    }
    window.check().expect("an unchanged file");
}

/// Function that damages a file in the middle of a fit.
type Harm = fn(&Path);

fn truncate(path: &Path) {
    File::options().write(true).open(path).expect("a file").set_len(5000).expect("a truncation");
}

fn empty(path: &Path) {
    File::create(path).expect("an empty file");
}

fn overwrite(path: &Path) {
    let file = File::options().write(true).open(path).expect("a file");
    file.write_all_at(&[0xff; 64], 4096 + 640).expect("a write");
}

#[test]
fn a_fit_ends_with_one_clear_line() {
    const N: usize = 3000;
    let folder = tempfile::tempdir().expect("a folder");
    let (sphere, signal) = (write_sphere(folder.path(), N), write_signal(folder.path(), N));
    let kinds = [(Codec::Raw, Scalar::F64), (Codec::Zstd, Scalar::F32)];
    for (at, (codec, scalar)) in kinds.into_iter().enumerate() {
        let store = folder.path().join(format!("store{at}"));
        let params = BuildParams { max_degree: 20, codec, scalar, ..BuildParams::default() };
        let key = build_here(&store, N, &params);
        let path = store.join(key.to_string()).join("A_17");
        let sound = std::fs::read(&path).expect("a file");
        // With the larger budget blocks are mapped as a whole; with the smallest budget, chunk by chunk.
        for memory in ["256MiB", &least_memory(&store, &sphere, &signal)] {
            for harm in [truncate as Harm, empty, overwrite] {
                let mut fit = tool("fit");
                fit.arg("--store").arg(&store).arg("--sphere").arg(&sphere).arg("--surface").arg(&signal);
                fit.args(["--max-degree", "20", "--passes", "1000000000", "--threads", "2", "-q"]);
                fit.args(["--memory", memory, "-o"]).arg(folder.path().join("out.spharm.npz"));
                let mut child = fit.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the tool starts");
                wait_until_it_reads(&mut child, &path);
                harm(&path);
                let line = error_line(&wait(child));
                assert_helpful_line(&line, &path);
                assert!(!folder.path().join("out.spharm.npz").exists());
                std::fs::write(&path, &sound).expect("a file");
            }
        }
    }
}

/// Returns the smallest budget of a fit, as stated by the error for a smaller one.
fn least_memory(store: &Path, sphere: &Path, signal: &Path) -> String {
    let mut fit = tool("fit");
    fit.arg("--store").arg(store).arg("--sphere").arg(sphere).arg("--surface").arg(signal);
    fit.args(["--max-degree", "20", "--passes", "2", "--threads", "2", "--memory", "1MiB"]);
    let line = crate::common::fail(fit.args(["-o", "/nonexistent/out.spharm.npz"]));
    let after = line.split("at least ").nth(1).unwrap_or_else(|| panic!("{line}"));
    format!("{}MiB", after.split(' ').next().expect("a number"))
}

/// Waits until the process has mapped the file, which shows that it is within a pass. Waits for a fixed time if that
/// can't be determined.
fn wait_until_it_reads(child: &mut Child, path: &Path) {
    let maps = PathBuf::from(format!("/proc/{}/maps", child.id()));
    let name = path.to_str().expect("UTF-8");
    for _ in 0..if maps.exists() { 100_000 } else { 2_000 } {
        if child.try_wait().expect("it can be waited for").is_some()
            || std::fs::read_to_string(&maps).is_ok_and(|maps| maps.contains(name))
        {
            return;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
}
