//! Fuzzes the readers of a store's files: a file that opens must agree with its header, and a verified file must be
//! readable.

use std::path::Path;

use spharm_monitor::Silent;
use spharm_store::{DegreeFile, FactorFile};

use super::{choice, file, mend};

/// Maximum number of bytes to which a chunk is decoded here; the format allows chunks of 4 GiB.
const MOST: u64 = 64 << 20;

pub(super) fn basis(folder: &Path, input: &[u8]) {
    let Some((kind, bytes)) = choice(input, 32) else { return };
    let path = file(folder, "A_2", &mend::container(bytes, kind, "spharm-rs 2026-11 basis file root v1"));
    let Ok(opened) = DegreeFile::open(&path) else { return };
    let sound = opened.verify(&Silent).is_ok();
    let header = opened.header();
    let mut scratch = Vec::new();
    for chunk in 0..(header.chunk_count()).min(16) {
        let rows = header.chunk_range(chunk).len();
        if 8 * (rows as u64) * (header.columns() as u64) > MOST {
            continue;
        }
        let window = opened.window(chunk..chunk + 1).expect("a chunk of a file that is there");
        let decoded = window.decode(chunk, &mut scratch).is_ok();
        assert!(decoded || !sound, "what is verified can be read");
        if decoded {
            assert_eq!(scratch.len(), rows * header.columns());
        }
        assert!(window.check().is_ok(), "nobody writes to it");
    }
}

pub(super) fn factors(folder: &Path, input: &[u8]) {
    let Some((kind, bytes)) = choice(input, 32) else { return };
    let path =
        file(folder, "factor_2_f64_fc47a033", &mend::container(bytes, kind, "spharm-rs 2026-11 factor file root v1"));
    let Ok(opened) = FactorFile::open(&path) else { return };
    let sound = opened.verify(&Silent).is_ok();
    let grid = opened.header().grid;
    for column in 0..grid.columns().min(4) {
        let window = opened.window(column).expect("a tile column of a file that is there");
        for row in column..grid.columns().min(column + 4) {
            assert!(window.values(row).is_ok() || !sound, "what is verified can be read");
        }
        assert!(window.check().is_ok(), "nobody writes to it");
    }
}
