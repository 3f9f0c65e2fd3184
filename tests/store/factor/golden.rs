//! Committed factors of format version 1, which must stay readable.

use std::path::PathBuf;

use spharm_harmonics::Directions;
use spharm_monitor::Silent;
use spharm_store::factor::{factors, open_factor};
use spharm_store::{FactorFile, Scalar, SchemeKey, WeightsHash};
use spharm_surface::io::read_mesh;

use super::{ROOT_CONTEXT, Textbook, lower};
use crate::common::root;

/// Key of the golden sphere's scheme, which is also the name of its folder.
const KEY: &str = "48706de2f3a23acf2cb176a0643736d11eb525b2070ce93aa4f5c51203b73c20";
const ROWS: usize = 18;

fn store() -> PathBuf {
    root().join("tests/data/golden-v1/store")
}

fn sphere() -> Directions {
    let mesh = read_mesh(root().join("tests/data/golden-v1/sphere.obj")).expect("the golden sphere");
    Directions::from_vertices(&mesh.vertices).expect("directions")
}

fn weights() -> Vec<f64> {
    (0..ROWS).map(|i| 0.5 + i as f64 / 8.0).collect()
}

/// Returns the golden factors: name, scalar type, matrix and number of tiles.
fn golden<'a>(directions: &'a Directions, weights: &'a [f64]) -> [(&'static str, Scalar, Textbook<'a>, usize); 2] {
    let plain = Textbook { directions, max_degree: 2, weights: None, smoothness: 0.0 };
    let other = Textbook { directions, max_degree: 4, weights: Some(weights), smoothness: 0.25 };
    [("factor_2_f64_fc47a033", Scalar::F64, plain, 3), ("factor_4_f32_00834997", Scalar::F32, other, 10)]
}

fn assert_factor(file: &FactorFile, of: &Textbook<'_>, scalar: Scalar) {
    file.expect(&of.spec(Scalar::F64)).expect("the factor of this");
    let (c, size) = (lower(file), file.header().grid.size());
    let tolerance = if scalar == Scalar::F64 { 1e-14 } else { 1e-6 };
    for i in 0..size {
        for j in 0..size {
            let product: f64 = (0..size).map(|k| c[i * size + k] * c[j * size + k]).sum();
            let entry = of.entry(i, j);
            assert!(
                (product - entry).abs() <= tolerance * file.header().condition.norm,
                "({i}, {j}) {product} {entry}"
            );
            assert!(j <= i || c[i * size + j] == 0.0, "({i}, {j}) lies above the diagonal");
        }
    }
}

#[test]
fn factors_are_read_forever() {
    let (directions, weights) = (sphere(), weights());
    for (name, scalar, of, _) in golden(&directions, &weights) {
        let file = open_factor(&store(), &of.spec(Scalar::F64), Some(scalar)).expect("the golden factor");
        assert_eq!(file.path().file_name().and_then(|name| name.to_str()), Some(name));
        file.verify(&Silent).expect("sound bytes");
        assert_factor(&file, &of, scalar);
    }
    assert_eq!(factors(&store(), KEY.parse().expect("a key")).expect("a folder").len(), 2);
}

/// Names, layout and rounded values are the same as in the golden files; last bits may differ between processors.
#[test]
fn a_build_today_makes_the_same_factors() {
    let (directions, weights) = (sphere(), weights());
    let folder = tempfile::tempdir().expect("a folder");
    for (name, scalar, of, _) in golden(&directions, &weights) {
        let file = of.build(folder.path(), scalar);
        assert_factor(&file, &of, scalar);
        let old = FactorFile::open(&store().join(KEY).join(name)).expect("the golden factor");
        assert_eq!(file.file_len(), old.file_len());
        assert_eq!((file.header().spec, file.header().grid), (old.header().spec, old.header().grid));
        let (new, old) = (file.header().condition, old.header().condition);
        assert!((new.norm - old.norm).abs() < 1e-13 * old.norm);
        assert!((new.reciprocal - old.reciprocal).abs() < 1e-10 * old.reciprocal);
    }
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes"))
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(bytes[at..at + 8].try_into().expect("eight bytes"))
}

fn f64_at(bytes: &[u8], at: usize) -> f64 {
    f64::from_bits(u64_at(bytes, at))
}

/// Checks offsets taken by hand from `store-format.md`, without constants of the store's code.
#[test]
fn header_table_and_footer_lie_where_the_format_says() {
    let (directions, weights) = (sphere(), weights());
    for (name, scalar, of, tiles) in golden(&directions, &weights) {
        let bytes = std::fs::read(store().join(KEY).join(name)).expect("a file");
        let size = if scalar == Scalar::F64 { 8 } else { 4 };
        let columns = (of.max_degree + 1) * (of.max_degree + 1);
        assert_eq!(bytes[0..8], [0x89, b'S', b'P', b'F', 0x0d, 0x0a, 0x1a, 0x0a]);
        assert_eq!(u32_at(&bytes, 8), 1, "version");
        assert_eq!(u32_at(&bytes, 12), 4096, "header length");
        assert_eq!(SchemeKey(bytes[16..48].try_into().expect("32 bytes")).to_string(), KEY);
        assert_eq!(u64_at(&bytes, 48), 18, "rows");
        assert_eq!(u32_at(&bytes, 56) as usize, of.max_degree);
        assert_eq!(u32_at(&bytes, 60), if scalar == Scalar::F64 { 1 } else { 2 }, "scalar type");
        assert_eq!(u64_at(&bytes, 64) as usize, columns, "columns");
        assert_eq!(u32_at(&bytes, 72), 8, "tile");
        assert_eq!(u32_at(&bytes, 76) as usize, columns.div_ceil(8), "tile columns");
        assert_eq!(u64_at(&bytes, 80) as usize, tiles, "tiles");
        match of.weights {
            None => assert_eq!(bytes[88..120], [0; 32], "weights of one"),
            Some(weights) => {
                let mut fields = (weights.len() as u64).to_le_bytes().to_vec();
                weights.iter().for_each(|weight| fields.extend(weight.to_le_bytes()));
                let hash = blake3::derive_key("spharm-rs 2026-11 factor weights v1", &fields);
                assert_eq!(bytes[88..120], hash);
                assert_eq!(WeightsHash::of(Some(weights)), WeightsHash(hash));
            }
        }
        assert_eq!(f64_at(&bytes, 120), of.smoothness);
        let norm = (0..columns).map(|j| (0..columns).map(|i| of.entry(i, j).abs()).sum::<f64>()).fold(0.0, f64::max);
        assert!((f64_at(&bytes, 128) - norm).abs() < 1e-13 * norm, "norm");
        assert!(f64_at(&bytes, 136) > 1e-6 && f64_at(&bytes, 136) < 1.0, "reciprocal condition number");
        assert!(bytes[144..4064].iter().all(|&b| b == 0), "reserved");
        assert_eq!(blake3::hash(&bytes[..4064]).as_bytes()[..], bytes[4064..4096], "hash of the header");
        let named = [&bytes[88..120], &bytes[120..128]].concat();
        let named = blake3::derive_key("spharm-rs 2026-11 factor name v1", &named);
        let digits: String = named[..4].iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(name, format!("factor_{}_{}_{digits}", of.max_degree, scalar.name()));

        let footer = &bytes[bytes.len() - 128..];
        assert_eq!(footer[0..8], *b"SPH-END\n");
        let table_at = u64_at(footer, 8) as usize;
        assert_eq!(u64_at(footer, 16) as usize, tiles, "entries");
        assert_eq!(u64_at(footer, 24), bytes.len() as u64, "file length");
        let mut root = blake3::Hasher::new_derive_key(ROOT_CONTEXT);
        root.update(&bytes[..4096]).update(&bytes[table_at..bytes.len() - 128]);
        assert_eq!(root.finalize().as_bytes()[..], footer[32..64], "root");

        let (mut next, mut entry_at) = (4096, table_at);
        for column in (0..columns).step_by(8) {
            for row in (column..columns).step_by(8) {
                let len = 8.min(columns - row) * 8.min(columns - column) * size;
                let entry = &bytes[entry_at..entry_at + 64];
                assert_eq!(u64_at(entry, 0) as usize, next, "tiles follow each other at multiples of 64");
                assert_eq!((u64_at(entry, 8) as usize, u64_at(entry, 16) as usize), (len, len));
                let stored = &bytes[next..next + len];
                assert_eq!(crc32c::crc32c(stored), u32_at(entry, 24));
                assert_eq!(u32_at(entry, 28), 0, "codec");
                assert_eq!(blake3::hash(stored).as_bytes()[..], entry[32..64]);
                let end = next + len;
                next = end.next_multiple_of(64);
                assert!(bytes[end..next].iter().all(|&b| b == 0), "padding");
                entry_at += 64;
            }
        }
        assert_eq!(table_at, next);
        assert_eq!(bytes.len(), entry_at + 128);
    }
}

/// Makes the committed factors; keeps existing files.
#[test]
#[ignore = "makes the golden files where there are none"]
fn make_golden_factors() {
    let (directions, weights) = (sphere(), weights());
    for (_, scalar, of, _) in golden(&directions, &weights) {
        eprintln!("{}", of.build(&store(), scalar).path().display());
    }
}
