//! Tests of the crate's public interface, grouped by guarantee.

mod compare;
mod cortex;
mod distance;
mod first_users;
mod fixtures;
mod generated;
mod gltf;
mod hostile;
mod locator;
mod metamesh;
mod polygons;
mod round_trip;
mod shared_data;
mod threemf;
mod topology;
mod vrml;
mod vtkxml;
mod writing;

use std::path::PathBuf;

/// Returns the folder of files written by other programs; see tests/scripts/make_mesh_fixtures.py.
fn fixtures() -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/meshes"))
}

/// Returns all files in the fixtures' folder except the expected results.
fn fixture_files() -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(fixtures())
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_none_or(|e| e != "json"))
        .collect();
    files.sort();
    assert!(files.len() >= 25, "the fixtures are there");
    files
}

/// A seeded generator of random numbers for tests (SplitMix64).
struct Random(u64);

impl Random {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut x = self.0;
        x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((x ^ (x >> 31)) % n as u64) as usize
    }
}
