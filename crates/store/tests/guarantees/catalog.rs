//! Tests that schemes are found by the first digits of their keys, and that summaries and verification include damaged
//! files.

use spharm_monitor::Silent;
use spharm_store::catalog::{find_schemes, summarize, verify};
use spharm_store::{BuildParams, Codec, Scalar, StoreError, build};

use crate::forge::{BASIS_ROOT, Forged};
use crate::{MAX_DEGREE, ROWS, directions, params, path_of, store, write_factor};

#[test]
fn a_scheme_is_found_by_its_first_digits() {
    let (folder, double) = store(&params());
    let single = BuildParams { scalar: Scalar::F32, ..params() };
    let single = build(folder.path(), &directions(), &single, &Silent).expect("a build").key;
    let mut both = [double, single];
    both.sort();
    let find = |digits: Option<&str>| find_schemes(folder.path(), digits);
    assert_eq!(find(None).expect("schemes"), both);
    assert_eq!(find(Some(&double.short())).expect("a scheme"), [double]);
    assert!(matches!(find(Some("")), Err(StoreError::KeyDigits { found: 2, .. })));
    assert!(matches!(find(Some("xyz")), Err(StoreError::KeyDigits { found: 0, .. })));
    let empty = tempfile::tempdir().expect("a folder");
    assert!(matches!(find_schemes(empty.path(), None), Err(StoreError::NoSchemes { .. })));
}

#[test]
fn a_summary_counts_files_and_damage() {
    let (folder, key) = store(&params());
    let factor = write_factor(folder.path(), key, Scalar::F64);
    let summary = summarize(folder.path(), key).expect("a folder");
    assert_eq!((summary.rows, summary.scalar, summary.codec), (Some(ROWS), Some(Scalar::F64), Some(Codec::Raw)));
    assert_eq!((summary.degrees, summary.complete_to, summary.factors), (3, Some(MAX_DEGREE), 1));
    assert_eq!(summary.damaged, 0);
    std::fs::write(factor.path(), "no factor").expect("a file");
    std::fs::remove_file(path_of(folder.path(), key, "A_0")).expect("a removal");
    let summary = summarize(folder.path(), key).expect("a folder");
    assert_eq!((summary.degrees, summary.complete_to, summary.factors, summary.damaged), (2, None, 1, 1));
}

#[test]
fn files_of_a_newer_version_are_counted() {
    let (folder, key) = store(&params());
    let path = path_of(folder.path(), key, "A_1");
    let mut file = Forged::read(&path, BASIS_ROOT);
    file.header[8..12].copy_from_slice(&2_u32.to_le_bytes());
    file.write_sealed(&path);
    std::fs::write(path_of(folder.path(), key, "A_2"), "no basis").expect("a file");
    let summary = summarize(folder.path(), key).expect("a folder");
    assert_eq!((summary.damaged, summary.newer), (2, 1));
}

#[test]
fn verification_lists_every_damaged_file() {
    let (folder, key) = store(&params());
    let factor = write_factor(folder.path(), key, Scalar::F64).path().to_owned();
    let sound = verify(folder.path(), &[key], &Silent).expect("a verification");
    assert_eq!((sound.files, sound.damaged.len()), (4, 0));
    let paths = [path_of(folder.path(), key, "A_0"), path_of(folder.path(), key, "A_2"), factor];
    for (path, at) in paths.iter().zip([0, 4096, 4096]) {
        let mut bytes = std::fs::read(path).expect("a file");
        bytes[at] ^= 1;
        std::fs::write(path, bytes).expect("a file");
    }
    let found = verify(folder.path(), &[key], &Silent).expect("a verification");
    assert_eq!(found.files, 4);
    let lines: Vec<String> = found.damaged.iter().map(ToString::to_string).collect();
    assert_eq!(lines.len(), paths.len(), "{lines:?}");
    assert!(lines.iter().zip(&paths).all(|(line, path)| line.contains(&path.display().to_string())), "{lines:?}");
}
