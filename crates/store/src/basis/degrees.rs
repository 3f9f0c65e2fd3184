//! Lists the basis files of a scheme, or opens the files of degrees 0 to L together.

use std::path::Path;

use rayon::prelude::*;
use spharm_harmonics::{Directions, HarmonicsError, MAX_DEGREE};
use spharm_monitor::{Monitor, Stage};

use crate::basis::header::Header;
use crate::basis::near::near;
use crate::basis::reader::DegreeFile;
use crate::basis::writer::file_name;
use crate::error::StoreError;
use crate::folder;
use crate::scheme::{Scalar, SchemeKey};

/// A sampling scheme in a store, with its basis files of degrees 0 to a highest degree open.
#[derive(Debug)]
pub struct Scheme {
    key: SchemeKey,
    files: Vec<DegreeFile>,
}

impl Scheme {
    /// Opens and checks the files of degrees `0..=max_degree` of a scheme that has `rows` directions.
    ///
    /// # Errors
    ///
    /// [`StoreError::NoSuchScheme`] if the store has no basis for the scheme, [`StoreError::DegreeMissing`] if a
    /// degree's file is missing, [`StoreError::ChunkRowsDiffer`] if the files differ in their number of rows per chunk,
    /// [`StoreError::Harmonics`] if `max_degree` is above [`MAX_DEGREE`], and the errors of [`DegreeFile::open`].
    pub fn open(store: &Path, key: SchemeKey, rows: usize, max_degree: usize) -> Result<Self, StoreError> {
        if max_degree > MAX_DEGREE {
            return Err(HarmonicsError::DegreeTooHigh { degree: max_degree, max: MAX_DEGREE }.into());
        }
        let folder = folder::of_scheme(store, key);
        if !folder.is_dir() {
            let available = folder::schemes(store)?;
            return Err(StoreError::NoSuchScheme { store: store.to_path_buf(), key, available });
        }
        let mut files: Vec<DegreeFile> = Vec::with_capacity(max_degree + 1);
        for degree in 0..=max_degree {
            let path = folder.join(file_name(degree));
            let file = match DegreeFile::open(&path) {
                Err(error) if error.is_not_found() => {
                    return Err(StoreError::DegreeMissing {
                        store: store.to_path_buf(),
                        key,
                        scalar: files.first().map(|file| file.header().scalar),
                        complete_to: degree.checked_sub(1),
                        missing: degree,
                        wanted: max_degree,
                    });
                }
                opened => opened?,
            };
            check(&file, key, degree, rows, files.first().map(DegreeFile::header))?;
            files.push(file);
        }
        Ok(Self { key, files })
    }

    /// Opens the basis at `directions` up to `max_degree`, with values of type `scalar`. If `scalar` is `None`, opens
    /// the f64 basis if it exists, and the f32 basis otherwise.
    ///
    /// # Errors
    ///
    /// The errors of [`open`](Self::open); [`StoreError::NearScheme`] if the store has a basis at directions that equal
    /// these up to rounding; [`StoreError::OtherScalar`] if the store has the basis only with values of the other
    /// scalar type; [`StoreError::Io`] if the store can't be opened.
    pub fn open_at(
        store: &Path,
        directions: &Directions,
        scalar: Option<Scalar>,
        max_degree: usize,
    ) -> Result<Self, StoreError> {
        let open = |scalar| Self::open(store, SchemeKey::of(directions, scalar), directions.len(), max_degree);
        let found = match scalar {
            Some(wanted) => open(wanted).map_err(|error| {
                let found = if wanted == Scalar::F64 { Scalar::F32 } else { Scalar::F64 };
                let other = folder::of_scheme(store, SchemeKey::of(directions, found));
                match error {
                    StoreError::NoSuchScheme { store, .. } if other.is_dir() => {
                        StoreError::OtherScalar { store, wanted, found }
                    }
                    error => error,
                }
            }),
            None => match open(Scalar::F64) {
                Err(double @ StoreError::NoSuchScheme { .. }) => match open(Scalar::F32) {
                    Err(StoreError::NoSuchScheme { .. }) => Err(double),
                    single => single,
                },
                double => double,
            },
        };
        found.map_err(|error| match error {
            StoreError::NoSuchScheme { store, key, available } => match near(&store, &available, directions) {
                Some((found, difference)) => {
                    let rows = directions.len();
                    StoreError::NearScheme { store, key, found, rows, difference }
                }
                None => StoreError::NoSuchScheme { store, key, available },
            },
            error => error,
        })
    }

    /// Returns the scheme's key.
    pub fn key(&self) -> SchemeKey {
        self.key
    }

    /// Returns the scalar type of the values.
    pub fn scalar(&self) -> Scalar {
        self.files[0].header().scalar
    }

    /// Returns the files in order of degree. There is at least one file.
    pub fn files(&self) -> &[DegreeFile] {
        &self.files
    }

    /// Returns the highest open degree.
    pub fn max_degree(&self) -> usize {
        self.files.len() - 1
    }

    /// Checks every byte of the open files against their hashes, on the caller's rayon pool. Reports one stage,
    /// `verify`, counted in bytes, to the monitor. If several files are damaged, the error of the lowest degree is
    /// returned.
    ///
    /// # Errors
    ///
    /// [`StoreError::ChunkDamaged`] if a chunk or its padding doesn't pass a check, [`StoreError::ChangedWhileRead`] if
    /// a file has changed since it was opened, [`StoreError::Io`] if a file can't be read, [`StoreError::Interrupted`]
    /// if the monitor cancels the verification.
    pub fn verify(&self, monitor: &dyn Monitor) -> Result<(), StoreError> {
        monitor.begin(Stage::bytes("verify"), self.files.iter().map(DegreeFile::file_len).sum());
        let results: Vec<_> = self.files.par_iter().map(|file| file.verify_within(monitor)).collect();
        monitor.end();
        results.into_iter().collect()
    }
}

/// Checks that a file has the requested scheme, degree and number of rows. If `first` is given, also checks that the
/// file has the same scalar type and the same number of rows per chunk as `first`, the header of degree 0.
fn check(
    file: &DegreeFile,
    key: SchemeKey,
    degree: usize,
    rows: usize,
    first: Option<&Header>,
) -> Result<(), StoreError> {
    let (path, header) = (file.path(), file.header());
    if header.key != key || header.degree != degree || header.rows != rows {
        let expected = format!("scheme {}, degree {degree}, {rows} rows", key.short());
        let found = format!("scheme {}, degree {}, {} rows", header.key.short(), header.degree, header.rows);
        return Err(StoreError::corrupt(path, "contents", expected, found));
    }
    let Some(first) = first else { return Ok(()) };
    if header.scalar != first.scalar {
        let (expected, found) = (first.scalar.name(), header.scalar.name());
        return Err(StoreError::corrupt(path, "scalar type (differs from degree 0)", expected, found));
    }
    if header.chunk_rows != first.chunk_rows {
        let (expected, found) = (first.chunk_rows, header.chunk_rows);
        return Err(StoreError::ChunkRowsDiffer { path: path.to_path_buf(), expected, found });
    }
    Ok(())
}

/// A basis file of a scheme: its degree, and either the opened and checked file or the error of opening it.
pub type FoundDegree = (usize, Result<DegreeFile, StoreError>);

/// Lists and opens the basis files of a scheme, by degree.
///
/// # Errors
///
/// [`StoreError::Io`] if the scheme's folder can't be listed.
pub fn degrees(store: &Path, key: SchemeKey) -> Result<Vec<FoundDegree>, StoreError> {
    let folder = folder::of_scheme(store, key);
    let degrees = folder::list(&folder, "cannot open", |name| {
        let degree = name.strip_prefix("A_")?.parse().ok()?;
        (name == file_name(degree)).then_some(degree)
    })?;
    Ok(degrees.into_iter().map(|degree| (degree, open_as(&folder.join(file_name(degree)), key, degree))).collect())
}

/// Opens a file and checks that the key and degree in its header match the names of its folder and file.
fn open_as(path: &Path, key: SchemeKey, degree: usize) -> Result<DegreeFile, StoreError> {
    let file = DegreeFile::open(path)?;
    if file.header().key != key || file.header().degree != degree {
        let found = format!("scheme {}, degree {}", file.header().key.short(), file.header().degree);
        return Err(StoreError::corrupt(path, "contents", format!("scheme {}, degree {degree}", key.short()), found));
    }
    Ok(file)
}
