//! Every changed bit and every truncation of a factor is detected.

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::Path;

use spharm_monitor::Silent;
use spharm_store::{FactorFile, Scalar, StoreError};

use super::super::{assert_helpful, directions};
use super::Textbook;

fn open_and_verify(path: &Path) -> Result<(), StoreError> {
    FactorFile::open(path)?.verify(&Silent)
}

#[test]
fn every_flipped_bit_truncation_and_tail_is_found() {
    let directions = directions(30);
    let of = Textbook { directions: &directions, max_degree: 2, weights: None, smoothness: 0.0 };
    let folder = tempfile::tempdir().expect("a folder");
    for scalar in [Scalar::F64, Scalar::F32] {
        let path = of.build(folder.path(), scalar).path().to_owned();
        let bytes = std::fs::read(&path).expect("a file");
        let file = File::options().write(true).open(&path).expect("a file");
        for (at, byte) in bytes.iter().enumerate() {
            for bit in 0..8 {
                file.write_all_at(&[byte ^ (1 << bit)], at as u64).expect("a write");
                assert_helpful(&open_and_verify(&path).expect_err("a flipped bit"), &path);
            }
            file.write_all_at(&[*byte], at as u64).expect("a write");
        }
        open_and_verify(&path).expect("the file as it was");
        for len in (0..bytes.len() as u64).rev() {
            file.set_len(len).expect("a truncation");
            assert_helpful(&open_and_verify(&path).expect_err("a truncated file"), &path);
        }
        for tail in [&[0u8][..], &[0; 128], &bytes[bytes.len() - 128..], &bytes] {
            std::fs::write(&path, [&bytes, tail].concat()).expect("a file");
            assert_helpful(&open_and_verify(&path).expect_err("a longer file"), &path);
        }
        std::fs::write(&path, &bytes).expect("a file");
        open_and_verify(&path).expect("the file as it was");
    }
}
