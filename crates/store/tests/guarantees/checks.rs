//! Tests that readers make every check of header, table, footer and parts, for basis files and factors. Each test file
//! is wrong in exactly one place, and all its other hashes are recomputed to match. If the reader lacked a check, a
//! test would fail.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use spharm_monitor::{Monitor, Silent};
use spharm_store::{BuildParams, Codec, DegreeFile, FactorFile, Scalar, StoreError};
use tempfile::TempDir;

use crate::forge::{BASIS_ROOT, FACTOR_ROOT, Forged, put64};
use crate::{params, path_of, store, write_factor};

/// Kind of file that a test expects at a path.
#[derive(Clone, Copy)]
enum As {
    Basis,
    Factor,
}

impl As {
    fn open(self, path: &Path) -> Result<(), StoreError> {
        match self {
            Self::Basis => DegreeFile::open(path).map(drop),
            Self::Factor => FactorFile::open(path).map(drop),
        }
    }

    fn verify(self, path: &Path) -> Result<(), StoreError> {
        match self {
            Self::Basis => DegreeFile::open(path)?.verify(&Silent),
            Self::Factor => FactorFile::open(path)?.verify(&Silent),
        }
    }

    /// Reads the first chunk or tile.
    fn read_first(self, path: &Path) -> Result<(), StoreError> {
        match self {
            Self::Basis => DegreeFile::open(path)?.window(0..1)?.values(0, &mut Vec::new()).map(drop),
            Self::Factor => FactorFile::open(path)?.window(0)?.values(0).map(drop),
        }
    }
}

/// Returns an intact basis file and an intact factor of three parts each.
fn files() -> (TempDir, [(As, PathBuf, Forged); 2]) {
    let (folder, key) = store(&params());
    let basis = path_of(folder.path(), key, "A_1");
    let factor = write_factor(folder.path(), key, Scalar::F64).path().to_owned();
    let (read_basis, read_factor) = (Forged::read(&basis, BASIS_ROOT), Forged::read(&factor, FACTOR_ROOT));
    (folder, [(As::Basis, basis, read_basis), (As::Factor, factor, read_factor)])
}

/// A falsified file: a change, the hashes recomputed after it, and the text that the error must contain.
struct Lie {
    what: &'static str,
    change: fn(&mut Forged),
    seal: fn(&mut Forged),
}

/// The text that the error must contain, and a change of the file.
type Change = (&'static str, fn(&mut Forged));

fn all(forged: &mut Forged) {
    forged.seal_header();
    forged.seal_root();
    forged.seal_footer();
}

fn nothing(_: &mut Forged) {}

const LIES: &[Lie] = &[
    Lie { what: "magic number", change: |f| f.header[0] ^= 1, seal: all },
    Lie { what: "version is 2", change: |f| f.header[8] = 2, seal: all },
    Lie { what: "version: expected 1", change: |f| f.header[8] = 2, seal: nothing },
    Lie { what: "header length", change: |f| f.header[13] ^= 1, seal: all },
    Lie { what: "reserved bytes", change: |f| f.header[4000] = 1, seal: all },
    // In these entries, the hash of the header, table or footer is wrong. No other check on opening covers the changed
    // bytes.
    Lie {
        what: "hash of the header: expected the stored hash",
        change: |f| f.header[16] ^= 1,
        seal: |f| {
            f.seal_root();
            f.seal_footer();
        },
    },
    Lie { what: "root hash", change: |f| f.table[40] ^= 1, seal: Forged::seal_footer },
    Lie { what: "root hash", change: |f| f.footer[32] ^= 1, seal: Forged::seal_footer },
    Lie { what: "hash of the footer: expected the stored hash", change: |f| f.footer[96] ^= 1, seal: nothing },
    Lie { what: "footer (truncated file?)", change: |f| f.footer[0] ^= 1, seal: all },
    Lie { what: "reserved bytes of the footer", change: |f| f.footer[64] = 1, seal: all },
    Lie { what: "length of the file", change: |f| f.footer[24] ^= 1, seal: all },
    Lie { what: "number of entries in the table", change: |f| f.footer[16] ^= 1, seal: all },
    Lie { what: "offset of the table", change: |f| f.footer[8] ^= 64, seal: all },
    Lie { what: "offset of a", change: |f| f.table[64] ^= 64, seal: all },
    Lie { what: "stored length of a", change: |f| f.table[8] ^= 1, seal: all },
    Lie { what: "decoded length of a", change: |f| f.table[16] ^= 1, seal: all },
    Lie { what: "codec of a", change: |f| f.table[28] = 1, seal: all },
    Lie { what: "codec of a", change: |f| f.table[28] = 9, seal: all },
    Lie {
        what: "offset of the table",
        change: |f| {
            f.body.extend([0; 64]);
            let table_at = 4096 + f.body.len() as u64;
            put64(&mut f.footer, 8, table_at);
            put64(&mut f.footer, 24, table_at + f.table.len() as u64 + 128);
        },
        seal: all,
    },
];

#[test]
fn a_file_that_lies_in_one_place_is_not_opened() {
    let (_folder, files) = files();
    for (kind, path, original) in &files {
        kind.open(path).expect("a sound file");
        for (at, Lie { what, change, seal }) in LIES.iter().enumerate() {
            let mut forged = original.clone();
            change(&mut forged);
            seal(&mut forged);
            forged.write(path);
            let error = kind.open(path).expect_err(what);
            assert!(matches!(error, StoreError::Corrupt { .. } | StoreError::Version { .. }), "{at}: {error:?}");
            assert!(error.to_string().contains(what), "{at}: expected {what:?}: {error}");
        }
        original.clone().write_sealed(path);
        kind.open(path).expect("sealing a sound file changes nothing");
    }
}

#[test]
fn a_part_with_a_wrong_crc_is_not_read() {
    let (_folder, files) = files();
    for (kind, path, original) in &files {
        kind.read_first(path).expect("a sound file");
        // One file has a changed value; the other has a changed checksum for unchanged values.
        let mut changed_value = original.clone();
        changed_value.body[3] ^= 1;
        let mut changed_crc = original.clone();
        changed_crc.table[24] ^= 1;
        for mut forged in [changed_value, changed_crc] {
            forged.write_sealed(path);
            kind.open(path).expect("parts are not checked on opening");
            let error = kind.read_first(path).expect_err("a damaged part");
            assert!(error.to_string().contains("CRC-32C"), "{error}");
        }
    }
}

#[test]
fn verification_checks_crc_hash_and_padding_each_for_itself() {
    let (_folder, files) = files();
    for (kind, path, original) in &files {
        kind.verify(path).expect("a sound file");
        let changes: [Change; 3] = [
            ("CRC-32C", |f| f.table[24] ^= 1),
            ("BLAKE3", |f| f.table[32] ^= 1),
            ("padding", |f| {
                // Padding after the last part: that part's length isn't a multiple of 64, so padding bytes precede the
                // table.
                let last = f.body.len() - 1;
                f.body[last] = 1;
            }),
        ];
        for (what, change) in changes {
            let mut forged = original.clone();
            change(&mut forged);
            forged.write_sealed(path);
            let error = kind.verify(path).expect_err(what);
            assert!(error.to_string().contains(what), "expected {what:?}: {error}");
            let damaged = matches!(error, StoreError::ChunkDamaged { .. } | StoreError::TileDamaged { .. });
            assert!(damaged, "{error:?}");
        }
    }
}

/// Reading and verification reject stored bytes that aren't a valid zstd frame, even if they match their checksum and
/// hash.
#[test]
fn a_compressed_part_that_does_not_decode_is_neither_read_nor_verified() {
    let (folder, key) = store(&BuildParams { codec: Codec::Zstd, ..params() });
    let path = path_of(folder.path(), key, "A_0");
    let mut forged = Forged::read(&path, BASIS_ROOT);
    let stored = u64::from_le_bytes(forged.table[8..16].try_into().expect("8 bytes")) as usize;
    assert!(stored < 64, "constant values are compressed");
    DegreeFile::open(&path).and_then(|file| file.verify(&Silent)).expect("a sound file");
    forged.body[0] ^= 1;
    let crc = crc32c::crc32c(&forged.body[..stored]);
    forged.table[24..28].copy_from_slice(&crc.to_le_bytes());
    let hash = blake3::hash(&forged.body[..stored]);
    forged.table[32..64].copy_from_slice(hash.as_bytes());
    forged.write_sealed(&path);
    for error in [As::Basis.read_first(&path), As::Basis.verify(&path)] {
        let error = error.expect_err("no frame");
        assert!(matches!(error, StoreError::ChunkDamaged { chunk: 0, what: "its zstd frame", .. }), "{error}");
    }
}

#[test]
fn a_file_that_shrinks_while_it_is_read_is_reported() {
    let (_folder, files) = files();
    let [(_, basis, _), (_, factor, _)] = &files;
    let shrink = |path: &Path| {
        std::fs::OpenOptions::new().write(true).open(path).expect("a file").set_len(4096).expect("a truncation");
    };
    let file = DegreeFile::open(basis).expect("a file");
    let window = file.window(0..3).expect("a window");
    shrink(basis);
    assert!(matches!(window.values(2, &mut Vec::new()), Err(StoreError::ChangedWhileRead { .. })));
    assert!(matches!(window.check(), Err(StoreError::ChangedWhileRead { .. })));
    let file = FactorFile::open(factor).expect("a file");
    let window = file.window(0).expect("a window");
    shrink(factor);
    assert!(matches!(window.values(1), Err(StoreError::ChangedWhileRead { .. })));
    assert!(matches!(window.check(), Err(StoreError::ChangedWhileRead { .. })));
}

/// A monitor that appends to the file at each step of its verification.
struct Appending<'a>(&'a Path);

impl Monitor for Appending<'_> {
    fn step(&self, _: u64) {
        let mut file = std::fs::OpenOptions::new().append(true).open(self.0).expect("a file");
        file.write_all(b"more").expect("a longer file");
    }
}

#[test]
fn a_file_that_changes_while_it_is_verified_is_reported() {
    let (_folder, files) = files();
    let [(_, basis, _), (_, factor, _)] = &files;
    let error = DegreeFile::open(basis).expect("a file").verify(&Appending(basis)).expect_err("a changed file");
    assert!(matches!(error, StoreError::ChangedWhileRead { .. }), "{error}");
    let error = FactorFile::open(factor).expect("a file").verify(&Appending(factor)).expect_err("a changed file");
    assert!(matches!(error, StoreError::ChangedWhileRead { .. }), "{error}");
}
