//! Errors and warnings of the store.
//!
//! A message states the file, the expected value and the actual value. It also states a remedy, if there is a remedy
//! that doesn't depend on the calling program. Programs use the fields of an error to give advice on their own options.

use std::io;
use std::path::{Path, PathBuf};

use spharm_monitor::Interrupted;

use crate::format::{MAX_CHUNK_LEN, MAX_CHUNK_ROWS, MAX_CHUNKS, MAX_TILE, MAX_TILES, ROW_MULTIPLE};
use crate::scheme::{Scalar, SchemeKey};

/// Errors of this crate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StoreError {
    /// An operation of the operating system failed.
    #[error("{}: {action}: {source}", .path.display())]
    Io {
        /// Path of the file or folder.
        path: PathBuf,
        /// The attempted operation.
        action: &'static str,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The path of a basis file or factor names something other than a regular file.
    #[error("{}: expected a regular file, found {found}; move it away and build the file again", .path.display())]
    NotAFile {
        /// Path of the basis file or factor.
        path: PathBuf,
        /// What the path names instead: a folder, a symbolic link, a FIFO, ...
        found: &'static str,
    },
    /// The file violates the format: a field is invalid, or a check fails.
    #[error("{}: damaged or not a file of a basis store: {what}: expected {expected}, found {found}; delete the file and build it again", .path.display())]
    Corrupt {
        /// Path of the file.
        path: PathBuf,
        /// Name of the invalid field or failed check.
        what: String,
        /// Value required by the format.
        expected: String,
        /// Value in the file.
        found: String,
    },
    /// The bytes of a chunk don't match its checksum.
    #[error("{}: chunk {chunk} is damaged ({what} is wrong); delete the file and build it again", .path.display())]
    ChunkDamaged {
        /// Path of the file.
        path: PathBuf,
        /// Index of the chunk, from 0.
        chunk: usize,
        /// Name of the failed check.
        what: &'static str,
    },
    /// The bytes of a factor's tile don't match its checksum.
    #[error(
        "{}: tile ({row}, {column}) is damaged ({what} is wrong); delete the file and build it again",
        .path.display()
    )]
    TileDamaged {
        /// Path of the file.
        path: PathBuf,
        /// Tile row, counted from 0.
        row: usize,
        /// Tile column, counted from 0.
        column: usize,
        /// Name of the failed check.
        what: &'static str,
    },
    /// An opened factor differs from the requested factor.
    #[error("{}: the factor has a different {what}: expected {expected}, found {found}", .path.display())]
    FactorDiffers {
        /// Path of the file.
        path: PathBuf,
        /// The property that differs: scheme, number of directions, degree, weights or smoothness.
        what: &'static str,
        /// Requested value.
        expected: String,
        /// Value in the file.
        found: String,
    },
    /// The store has no factor with the requested degree, weights and smoothness.
    #[error("{}: scheme {key} has no Cholesky factor for {wanted}; {}", .store.display(), factors_there(.available))]
    FactorMissing {
        /// Path of the store.
        store: PathBuf,
        /// Key of the scheme.
        key: SchemeKey,
        /// The requested degree, weights and smoothness.
        wanted: String,
        /// File names of the scheme's existing factors.
        available: Vec<String>,
    },
    /// A factor exceeds the limits of the format.
    #[error(
        "a Cholesky factor of {size} columns can't be divided into tiles of {tile} x {tile}: the tile size must be a \
         multiple of 8 from 8 to {MAX_TILE}, and there may be at most {MAX_TILES} tiles; choose a lower degree"
    )]
    FactorLayout {
        /// Number of columns, K.
        size: usize,
        /// Number of rows and columns of a tile.
        tile: usize,
    },
    /// The file has a format version that this program can't read.
    #[error("{}: the store format version is {found}, but this program reads version {expected}; use the program version that wrote the store, or build a new store", .path.display())]
    Version {
        /// Path of the file.
        path: PathBuf,
        /// The version that this program reads.
        expected: u32,
        /// The version found.
        found: u32,
    },
    /// A file was truncated, changed or became unreadable after it had been opened.
    #[error("{}: the file was truncated, changed or became unreadable while it was being read; verify the store and build the damaged files again", .path.display())]
    ChangedWhileRead {
        /// Path of the file.
        path: PathBuf,
    },
    /// The store has no basis for this sampling scheme.
    #[error("{}: no basis for scheme {key}; {}", .store.display(), keys_there(.available))]
    NoSuchScheme {
        /// Path of the store.
        store: PathBuf,
        /// The requested key.
        key: SchemeKey,
        /// Keys of the schemes in the store.
        available: Vec<SchemeKey>,
    },
    /// The store has no basis for this sampling scheme, but has a basis at directions that differ only by rounding.
    #[error(
        "{}: no basis for scheme {key}; scheme {} has the same {rows} directions within {difference:.0e}; fit over the \
         sphere for which that basis was built, or build a basis for this sphere",
        .store.display(), .found.short()
    )]
    NearScheme {
        /// Path of the store.
        store: PathBuf,
        /// The requested key.
        key: SchemeKey,
        /// Key of the scheme with nearly the same directions.
        found: SchemeKey,
        /// Number of directions.
        rows: usize,
        /// Largest difference between the coordinates of the two schemes' directions.
        difference: f64,
    },
    /// The store has the basis at these directions only with values of another scalar type.
    #[error("{}: the store has the basis at these directions in {}, not in {}", .store.display(), .found.name(), .wanted.name())]
    OtherScalar {
        /// Path of the store.
        store: PathBuf,
        /// The requested scalar type.
        wanted: Scalar,
        /// The scalar type in the store.
        found: Scalar,
    },
    /// A folder contains no schemes.
    #[error("{}: this folder holds no schemes", .store.display())]
    NoSchemes {
        /// Path of the folder.
        store: PathBuf,
    },
    /// No scheme key begins with the given digits, or several keys begin with these digits.
    #[error("{}: {} with {digits}", .store.display(), keys_begin(*.found))]
    KeyDigits {
        /// Path of the store.
        store: PathBuf,
        /// The digits given.
        digits: String,
        /// Number of schemes whose key begins with the given digits.
        found: usize,
    },
    /// The store has the scheme, but lacks the basis file of at least one degree up to the requested degree.
    #[error("{}: scheme {key} has {}", .store.display(), degrees_there(*.complete_to, *.missing))]
    DegreeMissing {
        /// Path of the store.
        store: PathBuf,
        /// Key of the scheme.
        key: SchemeKey,
        /// Scalar type of the scheme's files, if degree 0 exists.
        scalar: Option<Scalar>,
        /// Highest degree L for which the basis files of all degrees 0 to L exist.
        complete_to: Option<usize>,
        /// The lowest missing degree.
        missing: usize,
        /// The requested degree.
        wanted: usize,
    },
    /// Two basis files of a scheme have different numbers of rows per chunk, so they can't be read together.
    #[error("{}: the file has chunks of {found} rows, but the other degrees have chunks of {expected}; delete the file and build it again", .path.display())]
    ChunkRowsDiffer {
        /// Path of the file.
        path: PathBuf,
        /// Rows per chunk of the scheme's first basis file.
        expected: usize,
        /// Rows per chunk of this file.
        found: usize,
    },
    /// The disk has too little free space, or the files exceed 64 GiB and large files aren't allowed.
    #[error(
        "{}: the {what} needs {needed} bytes ({:.1} GB){}",
        .path.display(), *.needed as f64 / 1e9, why_refused(*.needed, *.free)
    )]
    Space {
        /// Path of the store.
        path: PathBuf,
        /// Kind of file that would be written: `basis` or `factor`.
        what: &'static str,
        /// Bytes that would be written.
        needed: u64,
        /// Free bytes on the disk.
        free: u64,
    },
    /// The memory budget is too small for the computation.
    #[error("a memory budget of {} is too small; at least {} MiB are needed", size(*.budget), .needed.div_ceil(1 << 20))]
    Budget {
        /// The budget in bytes.
        budget: usize,
        /// The smallest sufficient budget in bytes.
        needed: usize,
    },
    /// The computation was cancelled; finished files are kept.
    #[error("interrupted; finished files are kept")]
    Interrupted(#[from] Interrupted),
    /// The harmonics can't be evaluated with the requested parameters.
    #[error(transparent)]
    Harmonics(#[from] spharm_harmonics::HarmonicsError),
    /// The format doesn't allow this number of rows per chunk.
    #[error(
        "the number of rows per chunk must be a multiple of {ROW_MULTIPLE} from {ROW_MULTIPLE} to {MAX_CHUNK_ROWS}, \
         found {found}"
    )]
    ChunkRows {
        /// The requested number of rows per chunk.
        found: usize,
    },
    /// The file would have more chunks, or larger chunks, than the format allows.
    #[error(
        "degree {degree} with {rows} directions and {chunk_rows} rows per chunk exceeds the format's limits of \
         {MAX_CHUNKS} chunks and {MAX_CHUNK_LEN} bytes per chunk; choose another number of rows per chunk"
    )]
    Layout {
        /// Number of directions.
        rows: usize,
        /// Degree of the file.
        degree: usize,
        /// Number of rows per chunk.
        chunk_rows: usize,
    },
}

/// A problem that a build has repaired.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StoreWarning {
    /// A file was damaged; the build has removed and rewritten it.
    #[error("a damaged file was replaced: {0}")]
    Replaced(StoreError),
}

impl StoreError {
    /// Wraps an error of the operating system with the path and the attempted operation.
    pub(crate) fn io(path: &Path, action: &'static str) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_path_buf();
        move |source| Self::Io { path, action, source }
    }

    pub(crate) fn corrupt(path: &Path, what: impl Into<String>, expected: impl ToString, found: impl ToString) -> Self {
        let (expected, found) = (expected.to_string(), found.to_string());
        Self::Corrupt { path: path.to_path_buf(), what: what.into(), expected, found }
    }

    /// Returns whether the file or folder doesn't exist.
    pub(crate) fn is_not_found(&self) -> bool {
        matches!(self, Self::Io { source, .. } if source.kind() == io::ErrorKind::NotFound)
    }
}

/// Formats a size as MiB, or as bytes if it is below 1 MiB.
fn size(bytes: usize) -> String {
    if bytes < 1 << 20 { format!("{bytes} bytes") } else { format!("{} MiB", bytes >> 20) }
}

fn keys_there(keys: &[SchemeKey]) -> String {
    match keys {
        [] => "the store is empty".to_owned(),
        keys => {
            let shown: Vec<_> = keys.iter().take(8).map(|k| k.short()).collect();
            let more = if keys.len() > 8 { format!(" and {} more", keys.len() - 8) } else { String::new() };
            format!("the store has {}{more}", shown.join(", "))
        }
    }
}

fn keys_begin(found: usize) -> String {
    if found == 0 { "no scheme key begins".to_owned() } else { format!("{found} scheme keys begin") }
}

fn why_refused(needed: u64, free: u64) -> String {
    if needed > free {
        format!(", but the disk has {free} bytes free ({:.1} GB)", free as f64 / 1e9)
    } else {
        "; files larger than 64 GiB need explicit permission".to_owned()
    }
}

fn factors_there(names: &[String]) -> String {
    if names.is_empty() { "the store has no factors".to_owned() } else { format!("the store has {}", names.join(", ")) }
}

fn degrees_there(complete_to: Option<usize>, missing: usize) -> String {
    match complete_to {
        Some(degree) => format!("degrees 0 to {degree}, but degree {missing} is missing"),
        None => "no degree 0".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// If a key, a factor or a degree is missing, the message lists the keys, factors or degrees that the store has.
    #[test]
    fn messages_name_what_is_there() {
        let store = || PathBuf::from("store");
        let key = SchemeKey([0xab; 32]);
        let none = |available| StoreError::NoSuchScheme { store: store(), key, available }.to_string();
        assert!(none(vec![]).ends_with("; the store is empty"));
        assert!(none(vec![key]).ends_with("; the store has abababababab"));
        assert!(none(vec![key; 8]).ends_with(", abababababab"));
        assert!(none(vec![key; 10]).ends_with(", abababababab and 2 more"));
        assert_eq!(none(vec![key; 10]).matches("abababababab, ").count(), 7);
        let digits = |found| StoreError::KeyDigits { store: store(), digits: "ab".into(), found }.to_string();
        assert_eq!(digits(0), "store: no scheme key begins with ab");
        assert_eq!(digits(2), "store: 2 scheme keys begin with ab");
        let missing = |available| {
            StoreError::FactorMissing { store: store(), key, wanted: "degree 2".into(), available }.to_string()
        };
        assert!(missing(vec![]).ends_with("; the store has no factors"));
        assert!(missing(vec!["factor_1".into(), "factor_2".into()]).ends_with("; the store has factor_1, factor_2"));
        let degree = |complete_to| {
            let (scalar, missing, wanted) = (None, 3, 5);
            StoreError::DegreeMissing { store: store(), key, scalar, complete_to, missing, wanted }.to_string()
        };
        assert!(degree(Some(2)).ends_with("has degrees 0 to 2, but degree 3 is missing"));
        assert!(degree(None).ends_with("has no degree 0"));
        let budget = StoreError::Budget { budget: 70 << 20, needed: (80 << 20) + 1 };
        assert_eq!(budget.to_string(), "a memory budget of 70 MiB is too small; at least 81 MiB are needed");
        let space = StoreError::Space { path: store(), what: "basis", needed: 2_500_000_000, free: 1_000_000_000 };
        let expected = "the basis needs 2500000000 bytes (2.5 GB), but the disk has 1000000000 bytes free (1.0 GB)";
        assert!(space.to_string().ends_with(expected), "{space}");
        let space = StoreError::Space { path: store(), what: "basis", needed: 70_000_000_000, free: 100_000_000_000 };
        let expected = "needs 70000000000 bytes (70.0 GB); files larger than 64 GiB need explicit permission";
        assert!(space.to_string().ends_with(expected), "{space}");
    }
}
