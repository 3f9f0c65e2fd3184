//! A store is extended by adding files. Existing files don't change, and serve every fit whose degrees exist.

use std::os::unix::fs::MetadataExt;
use std::path::Path;

use spharm_store::{BuildParams, Codec, Scalar, catalog};

use super::{build_here, verified, write_signal, write_sphere};
use crate::common::{fail, finish, succeed, text, tool};

const N: usize = 400;

/// Returns the inode, the size and the time of the last change of each file; these change if the file is written to.
fn stamps(folder: &Path, degrees: std::ops::RangeInclusive<usize>) -> Vec<(u64, u64, i64, i64)> {
    let stamp = |degree: usize| {
        let metadata = std::fs::metadata(folder.join(format!("A_{degree}"))).expect("a file");
        (metadata.ino(), metadata.len(), metadata.mtime(), metadata.mtime_nsec())
    };
    degrees.map(stamp).collect()
}

#[test]
fn an_extension_adds_files_and_touches_none() {
    let folder = tempfile::tempdir().expect("a folder");
    let (sphere, store) = (write_sphere(folder.path(), N), folder.path().join("store"));
    let build = |degree: &str, more: &[&str]| {
        let mut build = tool("basis-build");
        build.arg("--store").arg(&store).arg("--sphere").arg(&sphere).args(["--max-degree", degree]).args(more);
        succeed(&mut build);
    };
    build("6", &["--chunk-rows", "128"]);
    let scheme = store.join(super::only_scheme(&store).to_string());
    let before = stamps(&scheme, 0..=6);
    // New files have the scheme's chunk size, whatever is requested; codecs may be mixed.
    build("10", &["--codec", "zstd"]);
    assert_eq!(stamps(&scheme, 0..=6), before);
    let all = stamps(&scheme, 0..=10);
    build("4", &[]);
    build("10", &["--chunk-rows", "64", "--threads", "1"]);
    assert_eq!(stamps(&scheme, 0..=10), all);
    for (degree, file) in catalog::degrees(&store, super::only_scheme(&store)).expect("a folder") {
        let file = file.expect("a sound file");
        assert_eq!(file.header().chunk_rows, 128);
        assert_eq!(file.header().codec == Codec::Zstd, degree > 6);
    }
    assert_eq!(verified(&store).len(), 11);
}

#[test]
fn a_build_that_keeps_files_names_the_command_that_checks_them() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut build = tool("basis-build");
    build.arg("--store").arg(folder.path().join("store")).arg("--sphere").arg(write_sphere(folder.path(), N));
    build.args(["--max-degree", "3"]);
    let [first, again] = [text(&finish(&mut build)), text(&finish(&mut build))];
    assert!(!first.contains("store verify") && again.contains("`spharm store verify "), "{first}{again}");
}

/// An extension plans its memory with the existing chunk size instead of the requested one.
#[test]
fn an_extension_plans_with_the_chunks_that_are_there() {
    let folder = tempfile::tempdir().expect("a folder");
    let n = 50_000;
    let sphere = write_sphere(folder.path(), n);
    let mut build = tool("basis-build");
    build.arg("--store").arg(folder.path().join("store")).arg("--sphere").arg(&sphere);
    build.args(["--max-degree", "0", "--chunk-rows", "50000"]);
    succeed(&mut build);
    build.args(["--memory", "16MiB"]).arg("--max-degree").arg("0");
    let mut extend = tool("basis-build");
    extend.arg("--store").arg(folder.path().join("store")).arg("--sphere").arg(&sphere);
    extend.args(["--max-degree", "30", "--memory", "16MiB", "--threads", "1"]);
    let line = fail(&mut extend);
    assert!(line.contains("is too small; at least"), "{line}");
}

#[test]
fn a_fit_takes_any_degree_that_is_there_and_says_how_to_get_more() {
    for (scalar, dtype) in [(Scalar::F64, None), (Scalar::F32, Some("--dtype f32"))] {
        let folder = tempfile::tempdir().expect("a folder");
        let (sphere, signal) = (write_sphere(folder.path(), N), write_signal(folder.path(), N));
        let store = folder.path().join("store");
        let key = build_here(&store, N, &BuildParams { max_degree: 6, scalar, ..BuildParams::default() });
        let fit = |degree: usize| {
            let mut fit = tool("fit");
            fit.arg("--store").arg(&store).arg("--sphere").arg(&sphere).arg("--surface").arg(&signal);
            fit.args(["--max-degree", &degree.to_string(), "--force", "-o"]);
            fit.arg(folder.path().join("out.spharm.npz"));
            fit
        };
        (0..=6).for_each(|degree| drop(succeed(&mut fit(degree))));
        for degree in [7, 9] {
            let line = fail(&mut fit(degree));
            assert!(line.contains("degrees 0 to 6"), "{line}");
            let command = line.split("extend the basis with: ").nth(1).unwrap_or_else(|| panic!("{line}"));
            assert_eq!(command.contains("--dtype"), dtype.is_some(), "{line}");
            // The suggested command works as printed, once SPHERE is replaced; the store doesn't know the sphere's
            // path.
            let mut words = command.split(' ');
            assert_eq!(words.next(), Some("spharm"));
            let mut extend = tool(words.next().expect("a verb"));
            extend.args(words.map(|word| if word == "SPHERE" { sphere.to_str().expect("UTF-8") } else { word }));
            succeed(&mut extend);
            succeed(&mut fit(degree));
            assert_eq!(catalog::schemes(&store).expect("a store"), [key]);
            for above in 7..=degree {
                std::fs::remove_file(store.join(key.to_string()).join(format!("A_{above}"))).expect("a removal");
            }
        }
        // A missing degree in the middle limits the fits to the degrees below.
        std::fs::remove_file(store.join(key.to_string()).join("A_3")).expect("a removal");
        succeed(&mut fit(2));
        let line = fail(&mut fit(5));
        assert!(line.contains("degrees 0 to 2") && line.contains("degree 3 is missing"), "{line}");
    }
}

#[test]
fn a_store_of_other_schemes_says_which_it_has() {
    let folder = tempfile::tempdir().expect("a folder");
    let (sphere, signal) = (write_sphere(folder.path(), N), write_signal(folder.path(), N));
    let store = folder.path().join("store");
    let mut fit = tool("fit");
    fit.arg("--store").arg(&store).arg("--sphere").arg(&sphere).arg("--surface").arg(&signal);
    fit.args(["--max-degree", "2", "-o"]).arg(folder.path().join("out.spharm.npz"));
    let line = fail(&mut fit);
    assert!(line.contains(&store.display().to_string()) && line.contains("basis-build"), "{line}");
    std::fs::create_dir(&store).expect("a folder");
    let line = fail(&mut fit);
    assert!(line.contains("the store is empty") && line.contains("basis-build --sphere"), "{line}");
    let keys: Vec<String> = [20, 21, 22]
        .map(|n| build_here(&store, n, &BuildParams { max_degree: 2, ..BuildParams::default() }).short())
        .to_vec();
    let line = fail(&mut fit);
    assert!(keys.iter().all(|key| line.contains(key)), "{keys:?}: {line}");
    assert!(line.contains("basis-build --sphere"), "{line}");
}
