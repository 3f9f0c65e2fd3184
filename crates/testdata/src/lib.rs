//! Where the surfaces and references that tests compare with are.
//!
//! References in `tests/data/reference` are in every clone. Public surfaces, and results of other packages for them,
//! lie beside the checkout, in `../shared/data`, or in the folder that `SPHARM_SHARED_DATA` names. A test that needs
//! one of them fails without it, unless `SPHARM_WITHOUT_SHARED_DATA` is set: so none passes because nothing was
//! compared.

use std::env;
use std::path::{Path, PathBuf};

/// The variable that names the folder of the shared data.
const FOLDER: &str = "SPHARM_SHARED_DATA";
/// The variable that leaves out comparisons with files that aren't there.
const WITHOUT: &str = "SPHARM_WITHOUT_SHARED_DATA";

/// Returns a file or folder of the shared data; `None` where it isn't there and comparisons with it are to be left out.
///
/// # Panics
///
/// Where it isn't there and `SPHARM_WITHOUT_SHARED_DATA` isn't set.
#[must_use]
pub fn shared(name: &str) -> Option<PathBuf> {
    let folder = env::var_os(FOLDER).map_or_else(|| checkout().join("../shared/data"), PathBuf::from);
    let path = folder.join(name);
    if path.exists() {
        return Some(path);
    }
    assert!(
        env::var_os(WITHOUT).is_some(),
        "{}: no such file: expected the shared data there, or in the folder that {FOLDER} names; {WITHOUT}=1 leaves \
         comparisons with it out",
        path.display()
    );
    None
}

/// Returns a file of `tests/data/reference`.
#[must_use]
pub fn reference(name: &str) -> PathBuf {
    checkout().join("tests/data/reference").join(name)
}

fn checkout() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
}
