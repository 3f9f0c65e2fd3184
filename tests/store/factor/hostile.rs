//! Factors with false contents but correct hashes give a typed error. There is no panic, and no memory is allocated
//! for sizes that the file only claims.

use spharm_monitor::Silent;
use spharm_store::factor::open_factor;
use spharm_store::{FactorFile, Scalar, StoreError};

use super::super::forge::{Forged, put32, put64};
use super::super::{assert_helpful, assert_helpful_line, directions, not_a_file::fifo};
use super::{ROOT_CONTEXT, Textbook};
use crate::common::{fail, succeed, tool};

/// A test case: words of the expected error, and a function that falsifies an entry of a factor with 9 columns in
/// tiles of 8.
type Lie = (&'static str, fn(&mut Forged));

const NAN: u64 = f64::NAN.to_bits();

const LIES: &[Lie] = &[
    ("magic number", |f| f.header[3] = b'H'),
    ("store format version", |f| put32(&mut f.header, 8, 0)),
    ("store format version", |f| put32(&mut f.header, 8, 2)),
    ("header length", |f| put32(&mut f.header, 12, 8192)),
    ("rows", |f| put64(&mut f.header, 48, 0)),
    ("rows", |f| put64(&mut f.header, 48, u64::MAX)),
    ("degree", |f| put32(&mut f.header, 56, 2001)),
    ("degree", |f| put32(&mut f.header, 56, u32::MAX)),
    ("columns", |f| put32(&mut f.header, 56, 3)),
    ("columns", |f| put64(&mut f.header, 64, 0)),
    ("columns", |f| put64(&mut f.header, 64, u64::MAX)),
    ("scalar type", |f| put32(&mut f.header, 60, 0)),
    ("scalar type", |f| put32(&mut f.header, 60, 3)),
    ("decoded length of a tile", |f| put32(&mut f.header, 60, 2)),
    ("size of the tiles", |f| put32(&mut f.header, 72, 0)),
    ("size of the tiles", |f| put32(&mut f.header, 72, 12)),
    ("size of the tiles", |f| put32(&mut f.header, 72, 1032)),
    ("size of the tiles", |f| put32(&mut f.header, 72, !7)),
    // A factor of degree 2,000 in tiles of 8 would have 10^11 tiles.
    ("size of the tiles", |f| {
        put32(&mut f.header, 56, 2000);
        put64(&mut f.header, 64, 2001 * 2001);
    }),
    ("number of tile columns", |f| put32(&mut f.header, 76, 0)),
    ("number of tile columns", |f| put32(&mut f.header, 76, u32::MAX)),
    ("number of tile columns", |f| put32(&mut f.header, 72, 16)),
    ("number of tiles", |f| put64(&mut f.header, 80, 0)),
    ("number of tiles", |f| put64(&mut f.header, 80, u64::MAX)),
    ("number of entries in the table", |f| {
        put32(&mut f.header, 72, 16);
        put32(&mut f.header, 76, 1);
        put64(&mut f.header, 80, 1);
    }),
    // Header and footer agree on more tiles than the file has bytes for: 2,888 columns of tiles of 8.
    ("offset of the table", |f| {
        put32(&mut f.header, 56, 151);
        put64(&mut f.header, 64, 152 * 152);
        put32(&mut f.header, 76, 2888);
        put64(&mut f.header, 80, 2888 * 2889 / 2);
        put64(&mut f.footer, 16, 2888 * 2889 / 2);
    }),
    ("smoothness", |f| put64(&mut f.header, 120, (-1.0f64).to_bits())),
    ("smoothness", |f| put64(&mut f.header, 120, (-0.0f64).to_bits())),
    ("smoothness", |f| put64(&mut f.header, 120, NAN)),
    ("smoothness", |f| put64(&mut f.header, 120, f64::INFINITY.to_bits())),
    ("norm", |f| put64(&mut f.header, 128, NAN)),
    ("norm", |f| put64(&mut f.header, 128, (-1.0f64).to_bits())),
    ("reciprocal condition number", |f| put64(&mut f.header, 136, 1.5f64.to_bits())),
    ("reciprocal condition number", |f| put64(&mut f.header, 136, NAN)),
    ("reserved bytes", |f| f.header[144] = 1),
    ("reserved bytes", |f| f.header[4063] = 1),
    ("footer (truncated file?)", |f| f.footer[0] = b's'),
    ("offset of the table", |f| put64(&mut f.footer, 8, 0)),
    ("offset of the table", |f| put64(&mut f.footer, 8, u64::MAX)),
    ("number of entries in the table", |f| put64(&mut f.footer, 16, 2)),
    ("number of entries in the table", |f| put64(&mut f.footer, 16, u64::MAX)),
    ("length of the file", |f| put64(&mut f.footer, 24, 0)),
    ("reserved bytes of the footer", |f| f.footer[95] = 1),
    ("offset of a tile", |f| put64(&mut f.table, 0, 0)),
    ("offset of a tile", |f| put64(&mut f.table, 64, 4096)),
    ("offset of a tile", |f| put64(&mut f.table, 128, u64::MAX)),
    ("offset of a tile", |f| f.table.rotate_left(64)),
    ("stored length of a tile", |f| put64(&mut f.table, 8, 0)),
    ("stored length of a tile", |f| put64(&mut f.table, 8, u64::MAX)),
    ("decoded length of a tile", |f| put64(&mut f.table, 16, 511)),
    ("decoded length of a tile", |f| put64(&mut f.table, 16, u64::MAX)),
    ("codec of a tile", |f| put32(&mut f.table, 28, 1)),
    ("codec of a chunk", |f| put32(&mut f.table, 28, 2)),
    ("offset of the table", |f| {
        f.body.extend([0; 64]);
        f.measure();
    }),
];

#[test]
fn a_lie_is_refused_by_name() {
    let directions = directions(30);
    let of = Textbook { directions: &directions, max_degree: 2, weights: None, smoothness: 0.0 };
    let folder = tempfile::tempdir().expect("a folder");
    let path = of.build(folder.path(), Scalar::F64).path().to_owned();
    let original = Forged::read(&path);
    for (at, (what, lie)) in LIES.iter().enumerate() {
        let mut forged = original.clone();
        lie(&mut forged);
        forged.write_as(ROOT_CONTEXT, &path);
        let error = FactorFile::open(&path).expect_err(what);
        assert!(matches!(error, StoreError::Corrupt { .. } | StoreError::Version { .. }), "{at}: {error:?}");
        assert_helpful(&error, &path);
        assert!(error.to_string().contains(what), "{at}: expected {what:?}: {error}");
        assert_helpful(&open_factor(folder.path(), &of.spec(Scalar::F64), None).expect_err(what), &path);
    }
    // A root hash in the context of basis files isn't valid for a factor.
    original.clone().write(&path);
    assert!(FactorFile::open(&path).expect_err("another root").to_string().contains("root hash"));
    // Test a wrong checksum or hash of a tile, under a correct root hash.
    for (at, what) in [(24, "CRC"), (32, "BLAKE3")] {
        let mut forged = original.clone();
        forged.table[at] ^= 1;
        forged.write_as(ROOT_CONTEXT, &path);
        let file = FactorFile::open(&path).expect("a file");
        let error = file.verify(&Silent).expect_err(what);
        assert!(error.to_string().contains(what) && error.to_string().contains("tile (0, 0)"), "{error}");
        assert_helpful(&error, &path);
        assert_helpful_line(&fail(tool("store").arg("verify").arg(folder.path())), &path);
        assert_eq!(file.window(0).expect("a window").values(0).is_err(), what == "CRC");
    }
    original.clone().write_as(ROOT_CONTEXT, &path);
    FactorFile::open(&path).expect("the forger's tools change nothing by themselves");
    succeed(tool("store").arg("verify").arg(folder.path()));
}

#[test]
fn what_is_no_file_is_named_and_nothing_waits() {
    let directions = directions(30);
    let of = Textbook { directions: &directions, max_degree: 2, weights: None, smoothness: 0.0 };
    let folder = tempfile::tempdir().expect("a folder");
    let path = of.build(folder.path(), Scalar::F64).path().to_owned();
    let kept = path.with_file_name("kept");
    std::fs::rename(&path, &kept).expect("a rename");
    let link = |path: &std::path::Path| std::os::unix::fs::symlink("kept", path).expect("a link");
    for what in ["a FIFO", "a symbolic link"] {
        if what == "a FIFO" {
            fifo(&path)
        } else {
            link(&path)
        }
        let error = open_factor(folder.path(), &of.spec(Scalar::F64), None).expect_err(what);
        assert!(matches!(error, StoreError::NotAFile { .. }) && error.to_string().contains(what), "{error}");
        assert_helpful(&error, &path);
        std::fs::remove_file(&path).expect("a removal");
    }
}
