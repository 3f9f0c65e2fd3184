//! A committed store of format version 1, which must stay readable.

use std::path::PathBuf;

use spharm_harmonics::{Directions, textbook};
use spharm_monitor::Silent;
use spharm_store::{BuildParams, Codec, DegreeFile, Scalar, Scheme, SchemeKey, build};
use spharm_surface::io::read_mesh;

use crate::common::root;

const MAX_DEGREE: usize = 4;
const ROWS: usize = 18;
/// Keys of the golden sphere's schemes, which are also the names of their folders.
const KEYS: [(Scalar, Codec, &str); 2] = [
    (Scalar::F64, Codec::Raw, "48706de2f3a23acf2cb176a0643736d11eb525b2070ce93aa4f5c51203b73c20"),
    (Scalar::F32, Codec::Zstd, "b966bb6f3b26c41a496f8b585584cf36ae11503dbe66097244a4e05100398282"),
];

fn golden() -> PathBuf {
    root().join("tests/data/golden-v1")
}

/// Returns the golden sphere. Its vertices are whole numbers, so normalising them uses only exactly rounded arithmetic,
/// and keys don't depend on a library's sine.
fn sphere() -> Directions {
    let mesh = read_mesh(golden().join("sphere.obj")).expect("the golden sphere");
    Directions::from_vertices(&mesh.vertices).expect("directions")
}

#[test]
fn keys_are_what_they_were() {
    for (scalar, _, key) in KEYS {
        assert_eq!(SchemeKey::of(&sphere(), scalar).to_string(), key);
    }
    let cases: [(&[[f64; 3]], Scalar, &str); 4] = [
        (&[[0.0, 0.0, 1.0]], Scalar::F64, "7235269a5875fca854e93b796dac27c26be9423d550bae7d750487366e98f81b"),
        (
            &[[-3.0, 0.0, 4.0], [0.0, -0.0, -7.0]],
            Scalar::F64,
            "d32696c9956b39e880479f8bb120013f18b492287884abb9d41606dd3ad523a7",
        ),
        (
            &[[-3.0, 0.0, 4.0], [0.0, -0.0, -7.0]],
            Scalar::F32,
            "d2a71eeab8cdb1217e271dbd2f243432dc9af2a95448c9ca3dc2c40c7298bc06",
        ),
        (
            &[[1.0, 2.0, 3.0], [-1.0, 1e-3, 1e9], [1e-300, -1e-300, 0.0]],
            Scalar::F64,
            "c999772a24897fa600b1d6300212137052bad7f80fa6a9b23c1104a58289f138",
        ),
    ];
    for (vertices, scalar, key) in cases {
        let directions = Directions::from_vertices(vertices).expect("directions");
        assert_eq!(SchemeKey::of(&directions, scalar).to_string(), key);
    }
}

/// Computes the key step by step from the section "Key" of `store-format.md`.
#[test]
fn the_key_is_the_hash_that_the_format_describes() {
    let directions = sphere();
    let mut bytes = Vec::new();
    let mut field = |tag: &[u8], value: &[u8]| {
        bytes.extend((tag.len() as u64).to_le_bytes());
        bytes.extend(tag);
        bytes.extend((value.len() as u64).to_le_bytes());
        bytes.extend(value);
    };
    let vectors: Vec<u8> = directions.as_slice().iter().flatten().flat_map(|c| c.to_le_bytes()).collect();
    field(b"normalisation", b"real orthonormal, no Condon-Shortley phase");
    field(b"ordering", b"l^2 + l + m");
    field(b"scalar", b"f64");
    field(b"count", &18u64.to_le_bytes());
    field(b"directions", &vectors);
    let key = blake3::derive_key("spharm-rs 2026-11 sampling scheme key v1", &bytes);
    assert_eq!(SchemeKey(key).to_string(), KEYS[0].2);
}

#[test]
fn every_value_is_read_forever() {
    let directions = sphere();
    for (scalar, _, key) in KEYS {
        let scheme = Scheme::open(&golden().join("store"), key.parse().expect("a key"), ROWS, MAX_DEGREE).expect("it");
        for (degree, file) in scheme.files().iter().enumerate() {
            file.verify(&Silent).expect("sound bytes");
            assert_values(file, &directions, degree, scalar);
        }
    }
}

fn assert_values(file: &DegreeFile, directions: &Directions, degree: usize, scalar: Scalar) {
    let header = file.header();
    let window = file.window(0..header.chunk_count()).expect("a window");
    let mut scratch = Vec::new();
    // Both the textbook formula and the recurrence have errors of a few roundings at these degrees; values are of order
    // 1.
    let tolerance = match scalar {
        Scalar::F64 => 1e-15,
        Scalar::F32 => f64::from(f32::EPSILON) / 2.0,
    };
    let mut count = 0;
    for chunk in 0..header.chunk_count() {
        let rows = header.chunk_range(chunk);
        let values = window.values(chunk, &mut scratch).expect("values");
        assert_eq!(values.len(), rows.len() * header.columns());
        for (column, order) in (-(degree as isize)..=degree as isize).enumerate() {
            for (at, row) in rows.clone().enumerate() {
                let expected = textbook::harmonic(degree, order, directions.as_slice()[row]);
                let found = values[column * rows.len() + at];
                let error = (found - expected).abs();
                assert!(
                    error <= tolerance * expected.abs().max(1.0),
                    "({degree}, {order}) row {row}: {found} {expected}"
                );
                count += 1;
            }
        }
    }
    window.check().expect("an unchanged file");
    assert_eq!(count, ROWS * (2 * degree + 1));
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes"))
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(bytes[at..at + 8].try_into().expect("eight bytes"))
}

/// Checks offsets taken by hand from `store-format.md`, without constants of the store's code.
#[test]
fn header_table_and_footer_lie_where_the_format_says() {
    for (scalar, codec, key) in KEYS {
        for degree in 0..=MAX_DEGREE {
            let bytes = std::fs::read(golden().join("store").join(key).join(format!("A_{degree}"))).expect("a file");
            let columns = 2 * degree + 1;
            let size = if scalar == Scalar::F64 { 8 } else { 4 };
            assert_eq!(bytes[0..8], [0x89, b'S', b'P', b'H', 0x0d, 0x0a, 0x1a, 0x0a]);
            assert_eq!(u32_at(&bytes, 8), 1, "version");
            assert_eq!(u32_at(&bytes, 12), 4096, "header length");
            assert_eq!(SchemeKey(bytes[16..48].try_into().expect("32 bytes")).to_string(), key);
            assert_eq!(u64_at(&bytes, 48), 18, "rows");
            assert_eq!(u32_at(&bytes, 56) as usize, degree);
            assert_eq!(u32_at(&bytes, 60) as usize, columns);
            assert_eq!(u32_at(&bytes, 64), if scalar == Scalar::F64 { 1 } else { 2 }, "scalar type");
            assert_eq!(u32_at(&bytes, 68), u32::from(codec == Codec::Zstd), "codec");
            assert_eq!(u64_at(&bytes, 72), 8, "rows of a chunk");
            assert_eq!(u64_at(&bytes, 80), 3, "chunks");
            assert!(bytes[88..4064].iter().all(|&b| b == 0), "reserved");
            assert_eq!(blake3::hash(&bytes[..4064]).as_bytes()[..], bytes[4064..4096], "hash of the header");

            let footer = &bytes[bytes.len() - 128..];
            assert_eq!(footer[0..8], *b"SPH-END\n");
            let table_at = u64_at(footer, 8) as usize;
            assert_eq!(u64_at(footer, 16), 3, "entries");
            assert_eq!(u64_at(footer, 24), bytes.len() as u64, "file length");
            let mut root = blake3::Hasher::new_derive_key("spharm-rs 2026-11 basis file root v1");
            root.update(&bytes[..4096]).update(&bytes[table_at..bytes.len() - 128]);
            assert_eq!(root.finalize().as_bytes()[..], footer[32..64], "root");
            assert!(footer[64..96].iter().all(|&b| b == 0), "reserved");
            assert_eq!(blake3::hash(&footer[..96]).as_bytes()[..], footer[96..128], "hash of the footer");

            let mut next = 4096;
            for (chunk, rows) in [8, 8, 2].into_iter().enumerate() {
                let entry = &bytes[table_at + 64 * chunk..][..64];
                let (offset, stored_len) = (u64_at(entry, 0) as usize, u64_at(entry, 8) as usize);
                assert_eq!(offset, next, "chunks follow each other at multiples of 64");
                assert_eq!(u64_at(entry, 16) as usize, rows * columns * size, "decoded length");
                let stored = &bytes[offset..offset + stored_len];
                assert_eq!(crc32c::crc32c(stored), u32_at(entry, 24));
                assert_eq!(blake3::hash(stored).as_bytes()[..], entry[32..64]);
                match u32_at(entry, 28) {
                    0 => assert_eq!(stored_len, rows * columns * size),
                    1 => assert!(codec == Codec::Zstd && stored_len < rows * columns * size),
                    other => panic!("codec {other}"),
                }
                next = (offset + stored_len).next_multiple_of(64);
                assert!(bytes[offset + stored_len..next].iter().all(|&b| b == 0), "padding");
            }
            assert_eq!(table_at, next);
            assert_eq!(bytes.len(), table_at + 3 * 64 + 128);
        }
    }
}

/// The golden files of one codec have both kinds of chunks, so that readers are tested on both.
#[test]
fn the_golden_store_has_compressed_and_uncompressed_chunks() {
    let folder = golden().join("store").join(KEYS[1].2);
    let mut codecs = Vec::new();
    for degree in 0..=MAX_DEGREE {
        let bytes = std::fs::read(folder.join(format!("A_{degree}"))).expect("a file");
        let table_at = u64_at(&bytes, bytes.len() - 128 + 8) as usize;
        codecs.extend((0..3).map(|chunk| u32_at(&bytes, table_at + 64 * chunk + 28)));
    }
    assert!(codecs.contains(&0) && codecs.contains(&1), "{codecs:?}");
}

/// Keys, layout and rounded values are the same as in the golden store; last bits may differ between processors.
#[test]
fn a_build_today_makes_the_same_store() {
    let folder = tempfile::tempdir().expect("a folder");
    for (scalar, codec, key) in KEYS {
        let params = BuildParams { max_degree: MAX_DEGREE, scalar, codec, chunk_rows: 8, ..BuildParams::default() };
        let report = build(folder.path(), &sphere(), &params, &Silent).expect("a build");
        assert_eq!(report.key.to_string(), key);
        let scheme = Scheme::open(folder.path(), report.key, ROWS, MAX_DEGREE).expect("it");
        for (degree, file) in scheme.files().iter().enumerate() {
            assert_values(file, &sphere(), degree, scalar);
            let old = DegreeFile::open(&golden().join("store").join(key).join(format!("A_{degree}"))).expect("a file");
            assert_eq!(file.header(), old.header());
            if codec == Codec::Raw {
                assert_eq!(file.file_len(), old.file_len());
            }
        }
    }
}
