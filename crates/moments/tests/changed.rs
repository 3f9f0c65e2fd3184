//! Tests that tables that grow or shrink while they are read cause an error.

use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use spharm_moments::{MomentsError, Request, Shard, accumulate};
use spharm_monitor::{Monitor, Stage};

/// Number of rows: more than a chunk, so that part of the file is still unread when the file changes.
const ROWS: usize = 700_000;

fn header() -> Vec<u8> {
    let text = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({ROWS}, 4), }}");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    let padded = format!("{text:<117}\n");
    bytes.extend_from_slice(&(padded.len() as u16).to_le_bytes());
    bytes.extend_from_slice(padded.as_bytes());
    bytes
}

fn tables(folder: &Path) -> [PathBuf; 2] {
    let [npy, csv] = ["f.npy", "f.csv"].map(|name| folder.join(name));
    let mut bytes = header();
    let row: Vec<u8> = [0.0f64, 0.6, 0.8, 2.0].iter().flat_map(|value| value.to_le_bytes()).collect();
    bytes.extend(row.repeat(ROWS));
    std::fs::write(&npy, bytes).unwrap();
    std::fs::write(&csv, "0,0.6,0.8,2\n".repeat(ROWS)).unwrap();
    [npy, csv]
}

/// A monitor that changes a file after its first rows have been read.
struct Meddler<F: Fn(&mut File) + Sync> {
    path: PathBuf,
    change: F,
    done: AtomicBool,
}

impl<F: Fn(&mut File) + Sync> Monitor for Meddler<F> {
    fn begin(&self, _: Stage, _: u64) {}

    fn step(&self, _: u64) {
        if !self.done.swap(true, Ordering::Relaxed) {
            (self.change)(&mut OpenOptions::new().append(true).open(&self.path).unwrap());
        }
    }

    fn cancelled(&self) -> bool {
        false
    }
}

fn meddle(path: &Path, shard: Shard, change: impl Fn(&mut File) + Sync) -> MomentsError {
    let mut request = Request { shard, ..Request::new(vec![path.to_owned()], 2) };
    request.columns.positions = Some(spharm_moments::Positions::Vectors(["0", "1", "2"].map(str::to_owned)));
    request.columns.values = vec!["3".to_owned()];
    let whole = std::fs::read(path).unwrap();
    let meddler = Meddler { path: path.to_owned(), change, done: AtomicBool::new(false) };
    let error = accumulate(&request, &meddler).expect_err("refused");
    std::fs::write(path, &whole).unwrap();
    assert!(accumulate(&request, &spharm_monitor::Silent).is_ok(), "as it was it can be read");
    error
}

#[test]
fn a_table_that_grows_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    for path in tables(folder.path()) {
        let was = std::fs::metadata(&path).unwrap().len();
        for shard in [Shard::WHOLE, Shard { index: 0, of: 2 }, Shard { index: 1, of: 2 }] {
            let error = meddle(&path, shard, |file| file.write_all(b"1,0,0,2\n").unwrap());
            let grown = was + 8;
            let told = matches!(&error, MomentsError::Changed { path: named, was: before, now }
                if *named == path && (*before, *now) == (was, grown));
            assert!(told, "{error}");
        }
    }
}

#[test]
fn a_table_that_shrinks_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    for path in tables(folder.path()) {
        let was = std::fs::metadata(&path).unwrap().len();
        for shard in [Shard::WHOLE, Shard { index: 0, of: 2 }, Shard { index: 1, of: 2 }] {
            // Truncate within the rows already read, within the rows still to read, and within the last row.
            for left in [was / 10, was - 12 * 50_000, was - 5] {
                let error = meddle(&path, shard, |file| file.set_len(left).unwrap());
                assert!(error.to_string().contains(&path.display().to_string()), "{error}");
            }
        }
    }
}
