//! Lists the schemes and files of a store, summarises and verifies them, and removes the leftovers of killed builds.

use std::path::{Path, PathBuf};

use rayon::prelude::*;
use spharm_monitor::{Monitor, Stage};

use crate::basis::DegreeFile;
use crate::container::codec::Codec;
use crate::error::StoreError;
use crate::factor::{FactorFile, factors};
use crate::scheme::{Scalar, SchemeKey};
use crate::{folder, temporary};

pub use crate::basis::degrees;

/// Lists the keys of the schemes in a store, in ascending order. The list is empty for a folder that isn't a store.
///
/// # Errors
///
/// [`StoreError::Io`] if the store can't be listed.
pub fn schemes(store: &Path) -> Result<Vec<SchemeKey>, StoreError> {
    folder::schemes(store)
}

/// Returns the key of the only scheme whose key begins with `digits`, or the keys of all schemes if `digits` is `None`.
///
/// # Errors
///
/// [`StoreError::NoSchemes`] if the store has no schemes, [`StoreError::KeyDigits`] if no key or several keys begin
/// with the digits, [`StoreError::Io`] if the store can't be listed.
pub fn find_schemes(store: &Path, digits: Option<&str>) -> Result<Vec<SchemeKey>, StoreError> {
    let all = schemes(store)?;
    if all.is_empty() {
        return Err(StoreError::NoSchemes { store: store.to_path_buf() });
    }
    let Some(digits) = digits else { return Ok(all) };
    let found: Vec<SchemeKey> = all.into_iter().filter(|key| key.to_string().starts_with(digits)).collect();
    if found.len() != 1 {
        let (store, digits) = (store.to_path_buf(), digits.to_owned());
        return Err(StoreError::KeyDigits { store, digits, found: found.len() });
    }
    Ok(found)
}

/// Summary of a scheme's files.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct SchemeSummary {
    /// Key of the scheme.
    pub key: SchemeKey,
    /// Number of directions, read from an undamaged basis file or factor; `None` if the scheme has neither.
    pub rows: Option<usize>,
    /// Scalar type of the basis, read from an undamaged basis file; `None` if the scheme has no such file.
    pub scalar: Option<Scalar>,
    /// Codec of the undamaged basis file with the lowest degree; `None` if the scheme has no such file.
    pub codec: Option<Codec>,
    /// Number of basis files.
    pub degrees: usize,
    /// Highest degree L for which the basis files of all degrees 0 to L exist and are intact.
    pub complete_to: Option<usize>,
    /// Number of factors.
    pub factors: usize,
    /// Number of basis files and factors that couldn't be opened.
    pub damaged: usize,
    /// Number of the files counted in `damaged` whose format version is newer than the version that this program reads.
    pub newer: usize,
    /// Total size in bytes of the basis files and factors that could be opened.
    pub bytes: u64,
}

/// Opens the files of a scheme and summarises them.
///
/// # Errors
///
/// [`StoreError::Io`] if the scheme's folder can't be listed.
pub fn summarize(store: &Path, key: SchemeKey) -> Result<SchemeSummary, StoreError> {
    let (degrees, factors) = (degrees(store, key)?, factors(store, key)?);
    let sound: Vec<&DegreeFile> = degrees.iter().filter_map(|(_, file)| file.as_ref().ok()).collect();
    let sound_factors: Vec<&FactorFile> = factors.iter().filter_map(|(_, file)| file.as_ref().ok()).collect();
    let errors = degrees.iter().filter_map(|(_, file)| file.as_ref().err());
    let errors = errors.chain(factors.iter().filter_map(|(_, file)| file.as_ref().err()));
    let is_newer =
        |error: &&StoreError| matches!(error, StoreError::Version { found, expected, .. } if found > expected);
    let first = sound.first().map(|file| file.header());
    let complete = degrees.iter().enumerate().take_while(|(at, (degree, file))| at == degree && file.is_ok()).count();
    Ok(SchemeSummary {
        key,
        rows: first.map(|header| header.rows).or(sound_factors.first().map(|file| file.header().spec.rows)),
        scalar: first.map(|header| header.scalar),
        codec: first.map(|header| header.codec),
        degrees: degrees.len(),
        complete_to: complete.checked_sub(1),
        factors: factors.len(),
        damaged: degrees.len() + factors.len() - sound.len() - sound_factors.len(),
        newer: errors.filter(is_newer).count(),
        bytes: sound.iter().map(|file| file.file_len()).sum::<u64>()
            + sound_factors.iter().map(|file| file.file_len()).sum::<u64>(),
    })
}

/// Result of [`verify`].
#[derive(Debug)]
#[non_exhaustive]
pub struct Verification {
    /// Number of basis files and factors checked.
    pub files: usize,
    /// Total size in bytes of the files that could be opened.
    pub bytes: u64,
    /// Errors of the damaged files.
    pub damaged: Vec<StoreError>,
}

/// Checks every byte of the basis files and factors of the given schemes against their hashes, on the caller's rayon
/// pool. Reports one stage, `verify`, counted in bytes, to the monitor. Each thread uses a buffer of 1 MiB.
///
/// # Errors
///
/// [`StoreError::Io`] if a folder can't be listed, [`StoreError::Interrupted`] if the monitor cancels the verification.
/// Damaged files don't cause an error; the result lists them.
pub fn verify(store: &Path, keys: &[SchemeKey], monitor: &dyn Monitor) -> Result<Verification, StoreError> {
    let mut files = Vec::new();
    for &key in keys {
        files.extend(degrees(store, key)?.into_iter().map(|(_, file)| file.map(AnyFile::Degree)));
        files.extend(factors(store, key)?.into_iter().map(|(_, file)| file.map(AnyFile::Factor)));
    }
    let count = files.len();
    let bytes: u64 = files.iter().flatten().map(AnyFile::len).sum();
    monitor.begin(Stage::bytes("verify"), bytes);
    let verify = |file: Result<AnyFile, StoreError>| file.and_then(|file| file.verify(monitor)).err();
    let damaged: Vec<StoreError> = files.into_par_iter().filter_map(verify).collect();
    monitor.end();
    monitor.check()?;
    Ok(Verification { files: count, bytes, damaged })
}

/// An open basis file or factor.
enum AnyFile {
    Degree(DegreeFile),
    Factor(FactorFile),
}

impl AnyFile {
    fn len(&self) -> u64 {
        match self {
            Self::Degree(file) => file.file_len(),
            Self::Factor(file) => file.file_len(),
        }
    }

    fn verify(&self, monitor: &dyn Monitor) -> Result<(), StoreError> {
        match self {
            Self::Degree(file) => file.verify_within(monitor),
            Self::Factor(file) => file.verify_within(monitor),
        }
    }
}

/// Lists the temporary files of a scheme that killed builders left behind.
///
/// # Errors
///
/// [`StoreError::Io`] if the scheme's folder can't be listed.
pub fn leftovers(store: &Path, key: SchemeKey) -> Result<Vec<PathBuf>, StoreError> {
    temporary::abandoned(&folder::of_scheme(store, key))
}

/// Removes the [`leftovers`] of a scheme and returns their paths. Other processes may build at the same time: each
/// leftover is removed while its lock is held, and a builder locks every temporary file that it creates.
///
/// # Errors
///
/// [`StoreError::Io`] if the scheme's folder can't be listed.
pub fn remove_leftovers(store: &Path, key: SchemeKey) -> Result<Vec<PathBuf>, StoreError> {
    temporary::remove_abandoned(&folder::of_scheme(store, key))
}
