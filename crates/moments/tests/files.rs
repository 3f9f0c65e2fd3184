//! Tests that the format of moments files stays the same, and that damage is detected.

use std::path::{Path, PathBuf};

use ndarray::Array2;
use spharm_moments::{Moments, MomentsError, Shard, Source};
use spharm_store::SchemeKey;
use spharm_transform::{Occupied, SampleSums};

/// Returns the moments that the committed files contain. `scheme` is the key of the sampling scheme, which files store
/// from version 2 on.
fn small(scheme: Option<SchemeKey>) -> Moments {
    let sums = SampleSums {
        max_degree: 1,
        moments: (0..9).map(|i| 0.5 * f64::from(i)).collect(),
        right_sides: Array2::from_shape_fn((4, 2), |(k, c)| k as f64 - c as f64),
        count: 6,
        weight: 6.5,
        squares: vec![1.25, 2.5],
    };
    let sources = vec![Source { key: [7; 32], shard: Shard { index: 1, of: 3 }, rows: 7 }];
    let channels = vec!["height".to_owned(), "h\u{f6}he".to_owned()];
    Moments { channels, sums, rows: 7, occupied: Occupied::new(1), scheme, sources }
}

const SCHEME: SchemeKey = SchemeKey([9; 32]);

fn golden(version: u32) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/data/v{version}.moments"))
}

/// Checks a committed file against `docs/moments-format.md`.
fn check_bytes(version: u32, header: usize) {
    let expected = std::fs::read(golden(version)).unwrap();
    let u32_at = |at: usize| u32::from_le_bytes(expected[at..at + 4].try_into().unwrap());
    let u64_at = |at: usize| u64::from_le_bytes(expected[at..at + 8].try_into().unwrap());
    let f64_at = |at: usize| f64::from_bits(u64_at(at));
    assert_eq!(&expected[..8], b"SPHMOMNT");
    assert_eq!((u32_at(8), u32_at(12) as usize, u64_at(16)), (version, header, expected.len() as u64));
    let cells = Occupied::new(1).bytes().len();
    assert_eq!([24, 28, 32, 36, 40, 44].map(u32_at), [1, 1, 2, 1, 4 + 6 + 4 + 5, cells as u32]);
    assert_eq!((u64_at(48), u64_at(56), f64_at(64)), (7, 6, 6.5));
    let scheme = if version == 1 { Vec::new() } else { SCHEME.0.to_vec() };
    assert_eq!(expected[72..header - 32], [scheme, vec![0; 24]].concat());
    assert_eq!(blake3::hash(&expected[..header - 32]).as_bytes(), &expected[header - 32..header]);
    let numbers = [1.25, 2.5, 0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 0.0, -1.0, 1.0, 0.0, 2.0, 1.0, 3.0, 2.0];
    for (i, number) in numbers.into_iter().enumerate() {
        assert_eq!(f64_at(header + 8 * i), number);
    }
    let at = header + 8 * numbers.len();
    assert_eq!((&expected[at..at + 32], u32_at(at + 32), u32_at(at + 36), u64_at(at + 40)), (&[7; 32][..], 1, 3, 7));
    let names = at + 48 + cells;
    assert_eq!((u32_at(names), &expected[names + 4..names + 10]), (6, &b"height"[..]));
    let end = expected.len() - 32;
    assert_eq!(blake3::hash(&expected[..end]).as_bytes(), &expected[end..]);
}

/// Files of version 1 can be read: the committed file was written by version 1 of the format.
#[test]
fn version_1_stays_readable() {
    check_bytes(1, 128);
    assert_eq!(Moments::read(&golden(1)).unwrap(), small(None));
}

/// Moments are written as the same bytes as in the committed file of version 2.
#[test]
fn the_bytes_of_version_2_stay() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.moments");
    small(Some(SCHEME)).write(&path, false).unwrap();
    assert_eq!(std::fs::read(path).unwrap(), std::fs::read(golden(2)).unwrap());
    check_bytes(2, 160);
    assert_eq!(Moments::read(&golden(2)).unwrap(), small(Some(SCHEME)));
}

#[test]
fn moments_without_a_scheme_have_zeros_for_its_key() {
    let bytes = small(None).to_bytes().unwrap();
    assert_eq!((bytes[8], &bytes[72..104]), (2, &[0; 32][..]));
    assert_eq!(Moments::from_bytes(&bytes).unwrap(), small(None));
}

/// In both versions, reserved bytes that aren't zero are rejected, even if all hashes match.
#[test]
fn reserved_bytes_are_zeros() {
    for (version, reserved, fields) in [(1, 72..96, 96), (2, 104..128, 128)] {
        for at in reserved {
            let mut bytes = std::fs::read(golden(version)).unwrap();
            let end = bytes.len() - 32;
            bytes[at] = 1;
            let hash = blake3::hash(&bytes[..fields]);
            bytes[fields..fields + 32].copy_from_slice(hash.as_bytes());
            let hash = blake3::hash(&bytes[..end]);
            bytes[end..].copy_from_slice(hash.as_bytes());
            let error = Moments::from_bytes(&bytes).unwrap_err();
            assert!(matches!(error, MomentsError::Corrupt { what: "reserved bytes", .. }), "{error}");
        }
    }
}

#[test]
fn an_error_says_which_versions_are_read() {
    let mut bytes = std::fs::read(golden(2)).unwrap();
    bytes[8] = 3;
    let error = Moments::from_bytes(&bytes).unwrap_err();
    assert!(matches!(&error, MomentsError::Version { found: 3, .. }), "{error}");
    assert!(error.to_string().contains("format version 3, but this program reads versions 1 to 2"), "{error}");
}

#[test]
fn any_byte_that_differs_and_any_length_is_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("damaged.moments");
    let refused = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        let error = Moments::read(&path).unwrap_err();
        assert!(matches!(error, MomentsError::Corrupt { .. } | MomentsError::Version { .. }), "{error}");
        assert!(error.to_string().contains("damaged.moments"), "{error}");
    };
    for version in [1, 2] {
        let whole = std::fs::read(golden(version)).unwrap();
        for at in 0..whole.len() {
            // Flipping both bits of 3 in the version field turns version 1 into 2, and 2 into 1.
            for flip in [1, 3, 0x80, 0xff] {
                let mut bytes = whole.clone();
                bytes[at] ^= flip;
                refused(&bytes);
            }
        }
        for length in 0..whole.len() {
            refused(&whole[..length]);
        }
        refused(&[&whole[..], &[0]].concat());
    }
}

#[test]
fn files_that_exist_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.moments");
    std::fs::write(&path, "mine").unwrap();
    assert!(matches!(small(Some(SCHEME)).write(&path, false), Err(MomentsError::Output(_))));
    assert_eq!(std::fs::read(&path).unwrap(), b"mine");
    small(Some(SCHEME)).write(&path, true).unwrap();
    assert_eq!(Moments::read(&path).unwrap(), small(Some(SCHEME)));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "nothing is left behind");
    assert!(matches!(Moments::read(folder.path()), Err(MomentsError::Io { .. })));
    assert!(matches!(Moments::read(&folder.path().join("none")), Err(MomentsError::Io { .. })));
}
