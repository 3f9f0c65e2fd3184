//! Locates the surfaces and reference results that tests use.
//!
//! References in `tests/data/reference` are part of every clone. Public surfaces, and results of other packages for
//! these surfaces, are in `../shared/data` next to the checkout, or in the folder given by `SPHARM_SHARED_DATA`. If
//! such a file is missing, a test that needs it fails, unless `SPHARM_WITHOUT_SHARED_DATA` is set. Therefore no test
//! passes merely because nothing was compared.

use std::env;
use std::path::{Path, PathBuf};

/// Environment variable for the folder of the shared data.
const FOLDER: &str = "SPHARM_SHARED_DATA";
/// Environment variable that lets tests skip comparisons with missing files.
const WITHOUT: &str = "SPHARM_WITHOUT_SHARED_DATA";

/// Returns the path of a file or folder of the shared data. Returns `None` if the file is missing and
/// `SPHARM_WITHOUT_SHARED_DATA` is set.
///
/// # Panics
///
/// If the file is missing and `SPHARM_WITHOUT_SHARED_DATA` isn't set.
#[must_use]
pub fn shared(name: &str) -> Option<PathBuf> {
    let folder = env::var_os(FOLDER).map_or_else(|| checkout().join("../shared/data"), PathBuf::from);
    let path = folder.join(name);
    if path.exists() {
        return Some(path);
    }
    assert!(
        env::var_os(WITHOUT).is_some(),
        "{}: no such file. Put the shared data there, or set {FOLDER} to its folder; {WITHOUT}=1 skips comparisons with \
         the shared data",
        path.display()
    );
    None
}

/// Returns the path of a file in `tests/data/reference`.
#[must_use]
pub fn reference(name: &str) -> PathBuf {
    checkout().join("tests/data/reference").join(name)
}

fn checkout() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
}
