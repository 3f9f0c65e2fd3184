//! What is in a store: its schemes, their degrees; opening a scheme for a fit; verifying; clearing away.

use std::path::{Path, PathBuf};

use crate::StoreError;
use crate::reader::DegreeFile;
use crate::scheme::SchemeKey;
use crate::writer::{abandoned, file_name, remove_abandoned};

/// The schemes of a store, by key. A folder without any basis has none.
///
/// # Errors
///
/// [`StoreError::Io`] when the store can't be listed.
pub fn schemes(store: &Path) -> Result<Vec<SchemeKey>, StoreError> {
    let mut keys = Vec::new();
    for item in std::fs::read_dir(store).map_err(StoreError::io(store, "cannot open the store"))? {
        let item = item.map_err(StoreError::io(store, "cannot open the store"))?;
        if let Some(key) = item.file_name().to_str().and_then(|name| name.parse().ok()) {
            keys.push(key);
        }
    }
    keys.sort();
    Ok(keys)
}

/// One scheme of a store, with the files of degrees 0 to `max_degree` open.
#[derive(Debug)]
pub struct Scheme {
    key: SchemeKey,
    files: Vec<DegreeFile>,
}

impl Scheme {
    /// Opens and checks the files of degrees `0..=max_degree` of a scheme of `rows` directions.
    ///
    /// # Errors
    ///
    /// [`StoreError::NoSuchScheme`], [`StoreError::DegreeMissing`], and those of [`DegreeFile::open`].
    pub fn open(store: &Path, key: SchemeKey, rows: usize, max_degree: usize) -> Result<Self, StoreError> {
        if max_degree > spharm_harmonics::MAX_DEGREE {
            let max = spharm_harmonics::MAX_DEGREE;
            return Err(spharm_harmonics::HarmonicsError::DegreeTooHigh { degree: max_degree, max }.into());
        }
        let folder = store.join(key.to_string());
        if !folder.is_dir() {
            let available = schemes(store)?;
            return Err(StoreError::NoSuchScheme { store: store.to_path_buf(), key, available });
        }
        let mut files: Vec<DegreeFile> = Vec::with_capacity(max_degree + 1);
        for degree in 0..=max_degree {
            let path = folder.join(file_name(degree));
            let file = DegreeFile::open(&path).map_err(|error| match error {
                StoreError::Io { source, .. } if source.kind() == std::io::ErrorKind::NotFound => {
                    let store = store.to_path_buf();
                    let (complete_to, scalar) = (degree.checked_sub(1), files.first().map(|file| file.header().scalar));
                    StoreError::DegreeMissing { store, key, scalar, complete_to, missing: degree, wanted: max_degree }
                }
                error => error,
            })?;
            let header = file.header();
            if header.key != key || header.degree != degree || header.rows != rows {
                let expected = format!("scheme {} degree {degree} of {rows} rows", key.short());
                let found = format!("scheme {} degree {} of {} rows", header.key.short(), header.degree, header.rows);
                return Err(StoreError::corrupt(&path, "contents", expected, found));
            }
            let first = files.first().map_or(header, DegreeFile::header);
            if header.scalar != first.scalar {
                let (expected, found) = (first.scalar.name(), header.scalar.name());
                return Err(StoreError::corrupt(&path, "scalar type (degree 0's is another)", expected, found));
            }
            if header.chunk_rows != first.chunk_rows {
                let (expected, found) = (first.chunk_rows, header.chunk_rows);
                return Err(StoreError::ChunkRowsDiffer { path, expected, found });
            }
            files.push(file);
        }
        Ok(Self { key, files })
    }

    /// The scheme's key.
    pub fn key(&self) -> SchemeKey {
        self.key
    }

    /// The files, by degree.
    pub fn files(&self) -> &[DegreeFile] {
        &self.files
    }

    /// The highest degree open.
    pub fn max_degree(&self) -> usize {
        self.files.len() - 1
    }
}

/// A basis file of a scheme: its degree, and the file, opened and checked, or what is wrong with it.
pub type Found = (usize, Result<DegreeFile, StoreError>);

/// The basis files of a scheme's folder, by degree.
///
/// # Errors
///
/// [`StoreError::Io`] when the folder can't be listed.
pub fn degrees(store: &Path, key: SchemeKey) -> Result<Vec<Found>, StoreError> {
    let folder = store.join(key.to_string());
    let mut degrees = Vec::new();
    for item in std::fs::read_dir(&folder).map_err(StoreError::io(&folder, "cannot open"))? {
        let name = item.map_err(StoreError::io(&folder, "cannot open"))?.file_name();
        let degree = name.to_str().and_then(|name| name.strip_prefix("A_")).and_then(|text| text.parse().ok());
        if let Some(degree) = degree.filter(|&degree| name.to_str() == Some(&file_name(degree))) {
            degrees.push(degree);
        }
    }
    degrees.sort_unstable();
    Ok(degrees.into_iter().map(|degree| (degree, open_as(&folder.join(file_name(degree)), key, degree))).collect())
}

/// Opens a file and checks that it is what its folder and name say.
fn open_as(path: &Path, key: SchemeKey, degree: usize) -> Result<DegreeFile, StoreError> {
    let file = DegreeFile::open(path)?;
    if file.header().key != key || file.header().degree != degree {
        let found = format!("scheme {} degree {}", file.header().key.short(), file.header().degree);
        return Err(StoreError::corrupt(path, "contents", format!("scheme {} degree {degree}", key.short()), found));
    }
    Ok(file)
}

/// Checks every byte of a file against its hashes. `buffer` is scratch space, a megabyte at most.
///
/// # Errors
///
/// [`StoreError::ChunkDamaged`], [`StoreError::ChangedWhileRead`], [`StoreError::Io`].
pub fn verify(file: &DegreeFile, buffer: &mut Vec<u8>) -> Result<(), StoreError> {
    file.verify(buffer)
}

/// Temporary files of a scheme that killed builders left behind.
///
/// # Errors
///
/// [`StoreError::Io`] when the folder can't be listed.
pub fn leftovers(store: &Path, key: SchemeKey) -> Result<Vec<PathBuf>, StoreError> {
    abandoned(&store.join(key.to_string()))
}

/// Removes the [`leftovers`] of a scheme and says which they were. Safe while others build: each is removed under its
/// lock, which a builder takes on every file it creates.
///
/// # Errors
///
/// [`StoreError::Io`] when the folder can't be listed.
pub fn remove_leftovers(store: &Path, key: SchemeKey) -> Result<Vec<PathBuf>, StoreError> {
    remove_abandoned(&store.join(key.to_string()))
}
