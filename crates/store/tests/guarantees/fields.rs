//! Tests that every field of a header is checked before it is used. Each test header has a false value in one field, or
//! in fields that depend on each other, and all hashes are recomputed to match. If a false value can't be detected by
//! itself, it must be rejected at the first field that contradicts it.

use spharm_store::{DegreeFile, FactorFile, Scalar, StoreError};

use crate::forge::{BASIS_ROOT, FACTOR_ROOT, Forged, put64};
use crate::{params, path_of, store, write_factor};

/// The text that the error must contain, and a change of the header.
type Lie = (&'static str, fn(&mut [u8]));

fn put32(bytes: &mut [u8], at: usize, value: u32) {
    bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
}

/// Sets the number of rows per chunk to 2^20, and the degree and scalar type to the given values.
fn wide(header: &mut [u8], scalar: u32, degree: u32) {
    put64(header, 72, 1 << 20);
    put32(header, 56, degree);
    put32(header, 60, 2 * degree + 1);
    put32(header, 64, scalar);
}

/// Changes to the header of a basis file with 18 rows of degree 1 in chunks of 8.
const BASIS: &[Lie] = &[
    ("rows", |h| put64(h, 48, 0)),
    ("rows", |h| put64(h, 48, (1 << 40) + 1)),
    ("number of chunks", |h| put64(h, 48, 25)),
    ("decoded length of a chunk", |h| put64(h, 48, 17)),
    ("degree", |h| put32(h, 56, 2001)),
    ("columns: expected 5, found 3", |h| put32(h, 56, 2)),
    ("columns: expected 3, found 5", |h| put32(h, 60, 5)),
    ("decoded length of a chunk", |h| {
        put32(h, 56, 2);
        put32(h, 60, 5);
    }),
    ("scalar type", |h| put32(h, 64, 0)),
    ("scalar type", |h| put32(h, 64, 3)),
    ("decoded length of a chunk", |h| put32(h, 64, 2)),
    ("codec", |h| put32(h, 68, 2)),
    ("rows per chunk", |h| put64(h, 72, 0)),
    ("rows per chunk", |h| put64(h, 72, 7)),
    ("rows per chunk", |h| put64(h, 72, (1 << 20) + 8)),
    ("chunk size", |h| {
        put64(h, 72, 1 << 20);
        put32(h, 56, 2000);
        put32(h, 60, 4001);
    }),
    // For each scalar type: first the lowest degree whose chunks exceed 2^32 bytes, rejected by the chunk size; then
    // the degree below it, rejected because it contradicts the number of chunks.
    ("chunk size: expected at most 4294967296 bytes, found 4303355904 bytes", |h| wide(h, 1, 256)),
    ("chunk size", |h| wide(h, 2, 512)),
    ("number of chunks", |h| wide(h, 1, 255)),
    ("number of chunks", |h| wide(h, 2, 511)),
    ("number of chunks", |h| put64(h, 80, 2)),
    ("number of chunks: expected at most", |h| put64(h, 80, u64::MAX)),
    ("number of entries in the table", |h| {
        put64(h, 48, 8 << 22);
        put64(h, 80, 1 << 22);
    }),
    ("reserved bytes", |h| h[88] = 1),
    ("reserved bytes", |h| h[4063] = 1),
];

const NAN: u64 = f64::NAN.to_bits();

/// Changes to the header of a factor with 9 columns in tiles of 8.
const FACTOR: &[Lie] = &[
    ("rows", |h| put64(h, 48, 0)),
    ("rows", |h| put64(h, 48, (1 << 40) + 1)),
    ("degree", |h| put32(h, 56, 2001)),
    ("columns", |h| put32(h, 56, 3)),
    ("columns", |h| put64(h, 64, 10)),
    ("scalar type", |h| put32(h, 60, 0)),
    ("decoded length of a tile", |h| put32(h, 60, 2)),
    ("size of the tiles", |h| put32(h, 72, 0)),
    ("size of the tiles", |h| put32(h, 72, 12)),
    ("size of the tiles", |h| put32(h, 72, 1032)),
    ("size of the tiles", |h| {
        put32(h, 56, 2000);
        put64(h, 64, 2001 * 2001);
    }),
    ("number of tile columns", |h| put32(h, 76, 3)),
    ("number of tiles", |h| put64(h, 80, 4)),
    ("smoothness", |h| put64(h, 120, (-0.0_f64).to_bits())),
    ("smoothness", |h| put64(h, 120, NAN)),
    ("norm", |h| put64(h, 128, f64::INFINITY.to_bits())),
    ("norm", |h| put64(h, 128, (-1.0_f64).to_bits())),
    ("reciprocal condition number", |h| put64(h, 136, 1.5_f64.to_bits())),
    ("reciprocal condition number", |h| put64(h, 136, NAN)),
    ("reserved bytes", |h| h[144] = 1),
];

fn refused(original: &Forged, lies: &[Lie], mut open: impl FnMut(&mut Forged) -> Result<(), StoreError>) {
    open(&mut original.clone()).expect("a sound file");
    for (at, (what, change)) in lies.iter().enumerate() {
        let mut forged = original.clone();
        change(&mut forged.header);
        let error = open(&mut forged).expect_err(what);
        assert!(matches!(error, StoreError::Corrupt { .. }), "{at}: {error:?}");
        assert!(error.to_string().contains(what), "{at}: expected {what:?}: {error}");
    }
}

#[test]
fn a_basis_whose_header_lies_is_not_opened() {
    let (folder, key) = store(&params());
    let path = path_of(folder.path(), key, "A_1");
    refused(&Forged::read(&path, BASIS_ROOT), BASIS, |forged| {
        forged.write_sealed(&path);
        DegreeFile::open(&path).map(drop)
    });
}

#[test]
fn a_factor_whose_header_lies_is_not_opened() {
    let (folder, key) = store(&params());
    let path = write_factor(folder.path(), key, Scalar::F64).path().to_owned();
    refused(&Forged::read(&path, FACTOR_ROOT), FACTOR, |forged| {
        forged.write_sealed(&path);
        FactorFile::open(&path).map(drop)
    });
}

/// A basis file isn't opened as a factor, nor a factor as a basis file, even if its root hash is that of the other
/// kind.
#[test]
fn kinds_are_told_apart() {
    let (folder, key) = store(&params());
    let (basis, factor) = (path_of(folder.path(), key, "A_1"), write_factor(folder.path(), key, Scalar::F64));
    assert!(DegreeFile::open(factor.path()).expect_err("a factor").to_string().contains("magic number"));
    assert!(FactorFile::open(&basis).expect_err("a basis").to_string().contains("magic number"));
    Forged::read(&basis, FACTOR_ROOT).write_sealed(&basis);
    assert!(DegreeFile::open(&basis).expect_err("another root").to_string().contains("root hash"));
}
