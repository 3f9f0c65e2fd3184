//! Guarantees of the basis store, one file for each guarantee. `store-format.md` defines the bytes.

mod bits;
mod extend;
mod factor;
mod forge;
mod full_disk;
mod golden;
mod hostile;
mod in_use;
mod interrupted;
mod killed;
pub(crate) mod namespace;
mod not_a_file;
mod python;
mod race;
mod read_only;

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use spharm_harmonics::Directions;
use spharm_monitor::Silent;
use spharm_store::{BuildParams, SchemeKey, StoreError, build, catalog};

/// Returns the angles of n points spread over the sphere on a spiral; the first two are the poles.
fn spiral(n: usize) -> Vec<[f64; 2]> {
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let rest = (2..n)
        .map(|i| [(1.0 - (2 * i - 3) as f64 / (n - 2) as f64).acos(), (golden * i as f64) % std::f64::consts::TAU]);
    [[0.0, 0.0], [std::f64::consts::PI, 0.0]].into_iter().chain(rest).collect()
}

fn directions(n: usize) -> Directions {
    Directions::from_angles(&spiral(n)).expect("directions")
}

/// Writes the sphere of [`spiral`] to a file for the tools.
fn write_sphere(folder: &Path, n: usize) -> PathBuf {
    let mut text = "theta,phi\n".to_owned();
    spiral(n).iter().for_each(|[theta, phi]| writeln!(text, "{theta:?},{phi:?}").expect("a string"));
    let path = folder.join(format!("sphere{n}.csv"));
    std::fs::write(&path, text).expect("a file");
    path
}

/// Writes a signal to fit: a smooth function on the spiral.
fn write_signal(folder: &Path, n: usize) -> PathBuf {
    let mut text = String::new();
    spiral(n)
        .iter()
        .for_each(|[theta, phi]| writeln!(text, "{:?}", (3.0 * theta).sin() + phi.cos()).expect("a string"));
    let path = folder.join(format!("signal{n}.csv"));
    std::fs::write(&path, text).expect("a file");
    path
}

/// Builds a store in this process, without interruption.
fn build_here(store: &Path, n: usize, params: &BuildParams) -> SchemeKey {
    build(store, &directions(n), params, &Silent).expect("a build").key
}

/// Returns the key of a store's only scheme.
fn only_scheme(store: &Path) -> SchemeKey {
    let keys = catalog::schemes(store).expect("a store");
    assert_eq!(keys.len(), 1, "{keys:?}");
    keys[0]
}

/// Returns the bytes of all basis files of the store's only scheme, by degree, after verifying them.
fn verified(store: &Path) -> BTreeMap<usize, Vec<u8>> {
    let key = only_scheme(store);
    let files = catalog::degrees(store, key).expect("a folder").into_iter();
    files
        .map(|(degree, file)| {
            let file = file.expect("a sound file");
            file.verify(&Silent).expect("sound bytes");
            (degree, std::fs::read(file.path()).expect("a file"))
        })
        .collect()
}

/// Returns the names of the files in the folder of the store's only scheme, except basis files and the lock.
fn leftovers(store: &Path) -> Vec<String> {
    let folder = store.join(only_scheme(store).to_string());
    let names = std::fs::read_dir(folder).expect("a folder").map(|item| item.expect("an item").file_name());
    let name = |name: std::ffi::OsString| name.into_string().expect("UTF-8");
    names.map(name).filter(|name| !name.starts_with("A_") && name != ".lock").collect()
}

/// Checks that an error names the file and the remedy.
fn assert_helpful(error: &StoreError, path: &Path) {
    assert_helpful_line(&error.to_string(), path);
}

fn assert_helpful_line(line: &str, path: &Path) {
    assert!(line.contains(&path.display().to_string()), "names {}: {line}", path.display());
    let remedies = ["build it again", "build the file again", "build a new store", "build the damaged files again"];
    assert!(remedies.iter().any(|remedy| line.contains(remedy)), "says what to do: {line}");
}

/// Generator of reproducible pseudo-random numbers (splitmix64).
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn below(&mut self, bound: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ (z >> 31)) % bound
    }
}
