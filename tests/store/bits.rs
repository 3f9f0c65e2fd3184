//! Every changed bit and every truncation of a basis file is detected.

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::Path;

use spharm_monitor::Silent;
use spharm_store::{BuildParams, Codec, DegreeFile, Scalar, StoreError};

use super::{Random, assert_helpful, build_here};
use crate::common::times;

fn open_and_verify(path: &Path) -> Result<(), StoreError> {
    DegreeFile::open(path)?.verify(&Silent)
}

/// Makes files with an uncompressed chunk and compressed chunks of each kind, as small as possible.
fn small_files(store: &Path, codec: Codec, scalar: Scalar) -> Vec<std::path::PathBuf> {
    let params = BuildParams { max_degree: 1, scalar, codec, chunk_rows: 8, ..BuildParams::default() };
    let key = build_here(store, 18, &params);
    (0..=1).map(|degree| store.join(key.to_string()).join(format!("A_{degree}"))).collect()
}

fn flip(file: &File, bytes: &[u8], bit: u64) {
    let at = bit / 8;
    file.write_all_at(&[bytes[at as usize] ^ (1 << (bit % 8))], at).expect("a write");
}

fn restore(file: &File, bytes: &[u8], bit: u64) {
    let at = bit / 8;
    file.write_all_at(&[bytes[at as usize]], at).expect("a write");
}

#[test]
fn every_flipped_bit_is_found() {
    let folder = tempfile::tempdir().expect("a folder");
    for (codec, scalar) in [(Codec::Raw, Scalar::F64), (Codec::Zstd, Scalar::F32)] {
        for path in small_files(folder.path(), codec, scalar) {
            let bytes = std::fs::read(&path).expect("a file");
            let file = File::options().write(true).open(&path).expect("a file");
            for bit in 0..8 * bytes.len() as u64 {
                flip(&file, &bytes, bit);
                let error = open_and_verify(&path).expect_err("a flipped bit");
                assert_helpful(&error, &path);
                assert_reader_is_right(&path, &bytes);
                restore(&file, &bytes, bit);
            }
            open_and_verify(&path).expect("the file as it was");
        }
    }
}

/// Checks that a reader without verification returns either the correct values of a chunk or an error.
fn assert_reader_is_right(path: &Path, original: &[u8]) {
    let Ok(damaged) = DegreeFile::open(path) else { return };
    let chunks = damaged.header().chunk_count();
    let window = damaged.window(0..chunks).expect("a window");
    let mut scratch = Vec::new();
    let changed = std::fs::read(path).expect("a file");
    let mut errors = 0;
    for chunk in 0..chunks {
        match window.values(chunk, &mut scratch) {
            Ok(values) => assert!(values.iter().all(|value| value.is_finite())),
            Err(error) => {
                assert!(matches!(error, StoreError::ChunkDamaged { chunk: found, .. } if found == chunk), "{error}");
                errors += 1;
            }
        }
    }
    // The file could be opened, so table and footer are unchanged: the change is in one chunk, or in padding, which
    // isn't used.
    let at = changed.iter().zip(original).position(|(a, b)| a != b).expect("a changed byte");
    let before: u64 = (0..chunks).map(|chunk| (damaged.stored_len(chunk) as u64).next_multiple_of(64)).sum();
    assert!((4096..4096 + before).contains(&(at as u64)));
    let in_chunk = (0..chunks).scan(4096, |start, chunk| {
        let range = *start..*start + damaged.stored_len(chunk);
        *start = range.end.next_multiple_of(64);
        Some(range)
    });
    assert_eq!(errors, usize::from(in_chunk.into_iter().any(|range| range.contains(&at))), "byte {at}");
}

#[test]
fn every_truncation_and_every_tail_is_found() {
    let folder = tempfile::tempdir().expect("a folder");
    for (codec, scalar) in [(Codec::Raw, Scalar::F64), (Codec::Zstd, Scalar::F32)] {
        let path = &small_files(folder.path(), codec, scalar)[1];
        let bytes = std::fs::read(path).expect("a file");
        let file = File::options().write(true).open(path).expect("a file");
        for len in (0..bytes.len() as u64).rev() {
            file.set_len(len).expect("a truncation");
            assert_helpful(&open_and_verify(path).expect_err("a truncated file"), path);
            // Restore the file's length, with zeros in place of the lost bytes.
            if len % 64 == 0 {
                file.set_len(bytes.len() as u64).expect("an extension");
                assert_helpful(&open_and_verify(path).expect_err("a file with a hole"), path);
                file.set_len(len).expect("a truncation");
            }
        }
        for tail in [&[0u8][..], &[0; 128], &bytes[bytes.len() - 128..], &bytes] {
            std::fs::write(path, [&bytes, tail].concat()).expect("a file");
            assert_helpful(&open_and_verify(path).expect_err("a longer file"), path);
        }
        std::fs::write(path, &bytes).expect("a file");
        open_and_verify(path).expect("the file as it was");
    }
}

#[test]
fn random_flips_in_a_file_of_64_mib_are_found() {
    let folder = tempfile::tempdir().expect("a folder");
    let rows = (64 << 20) / 24;
    let params = BuildParams { max_degree: 1, ..BuildParams::default() };
    let key = build_here(folder.path(), rows, &params);
    let path = folder.path().join(key.to_string()).join("A_1");
    let bytes = std::fs::read(&path).expect("a file");
    assert!(bytes.len() >= 64 << 20);
    open_and_verify(&path).expect("a sound file");
    let file = File::options().write(true).open(&path).expect("a file");
    let mut random = Random(1);
    for _ in 0..times(200) {
        let bit = random.below(8 * bytes.len() as u64);
        flip(&file, &bytes, bit);
        assert_helpful(&open_and_verify(&path).expect_err("a flipped bit"), &path);
        restore(&file, &bytes, bit);
    }
    open_and_verify(&path).expect("the file as it was");
}
