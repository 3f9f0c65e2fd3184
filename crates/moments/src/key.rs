//! Computes the key that identifies tables: a hash of the request and of the files; see "Keys" in
//! `docs/moments-format.md`.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::PoisonError;

use spharm_store::SchemeKey;

use crate::MomentsError;
use crate::samples::{Columns, Opened, Positions, STDIN};

const KEY_CONTEXT: &str = "spharm-rs 2026-11 samples v1";
/// Number of bytes at the beginning of a file, and also at its end, that are hashed into the key.
const END: u64 = 1 << 16;

/// Hasher that computes the key of a request and its tables.
pub(crate) struct Key(blake3::Hasher);

impl Key {
    pub(crate) fn new(columns: &Columns, scheme: Option<SchemeKey>) -> Self {
        let mut key = Self(blake3::Hasher::new_derive_key(KEY_CONTEXT));
        let (kind, names): (u8, &[String]) = match &columns.positions {
            None => (0, &[]),
            Some(Positions::Angles(names)) => (1, names),
            Some(Positions::LonLat(names)) => (2, names),
            Some(Positions::Vectors(names)) => (3, names),
            Some(Positions::Scheme(_)) => (4, &[]),
        };
        key.0.update(&[kind]);
        for list in [names, &columns.values, columns.weight.as_slice()] {
            key.number(list.len() as u64);
            list.iter().for_each(|name| key.bytes(name.as_bytes()));
        }
        columns.centre.iter().for_each(|x| key.number(x.to_bits()));
        if let Some(SchemeKey(scheme)) = scheme {
            key.0.update(&scheme);
        }
        key
    }

    pub(crate) fn add(&mut self, path: &Path, opened: &Opened) -> Result<(), MomentsError> {
        match &opened.hash {
            Some(hash) => {
                let hash = hash.lock().unwrap_or_else(PoisonError::into_inner).finalize();
                self.bytes(STDIN.as_bytes());
                self.bytes(hash.as_bytes());
            }
            None => {
                let was = opened.bytes.unwrap_or(0);
                let now = std::fs::metadata(path).map_err(MomentsError::io(path, "read"))?.len();
                if now != was {
                    return Err(MomentsError::Changed { path: path.to_owned(), was, now });
                }
                self.bytes(path.file_name().unwrap_or_default().to_string_lossy().as_bytes());
                self.number(was);
                self.ends(path, was).map_err(MomentsError::io(path, "read"))?;
            }
        }
        Ok(())
    }

    /// Returns a hash of a file's size and of its first and last bytes.
    pub(crate) fn of_ends(path: &Path) -> io::Result<[u8; 32]> {
        let mut key = Self(blake3::Hasher::new());
        let size = std::fs::metadata(path)?.len();
        key.number(size);
        key.ends(path, size)?;
        Ok(key.finish())
    }

    /// Adds the first and last bytes of a file to the key, to distinguish files of equal name and size.
    fn ends(&mut self, path: &Path, size: u64) -> io::Result<()> {
        let mut file = File::open(path)?;
        for start in [0, size.saturating_sub(END)] {
            let mut bytes = Vec::new();
            file.seek(SeekFrom::Start(start))?;
            file.by_ref().take(END).read_to_end(&mut bytes)?;
            self.bytes(&bytes);
        }
        Ok(())
    }

    fn bytes(&mut self, bytes: &[u8]) {
        self.number(bytes.len() as u64);
        self.0.update(bytes);
    }

    fn number(&mut self, number: u64) {
        self.0.update(&number.to_le_bytes());
    }

    pub(crate) fn finish(self) -> [u8; 32] {
        *self.0.finalize().as_bytes()
    }
}

/// Returns whether two paths lead to the same file, or to files with the same bytes.
pub(crate) fn are_equal(first: &Path, second: &Path) -> io::Result<bool> {
    if std::fs::canonicalize(first)? == std::fs::canonicalize(second)? {
        return Ok(true);
    }
    let [mut first, mut second] = [BufReader::new(File::open(first)?), BufReader::new(File::open(second)?)];
    loop {
        let (a, b) = (first.fill_buf()?, second.fill_buf()?);
        let count = a.len().min(b.len());
        if count == 0 || a[..count] != b[..count] {
            return Ok(a.is_empty() && b.is_empty());
        }
        first.consume(count);
        second.consume(count);
    }
}
