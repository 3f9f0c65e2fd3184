//! Reads and writes NumPy archives of named matrices and strings, for the results of group analyses.

use std::fs::File;
use std::io::{BufReader, Write};
use std::path::{Path, PathBuf};

use ndarray::{Array2, ArrayView2, ArrayView3};
use spharm_surface::io::write_new;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

use crate::error::ModelError;
use crate::npy::{Array, write_header, write_text};
use crate::npz::{Archive, file, opened, write_all};

/// Contents of an entry to write to an archive.
#[derive(Debug, Clone, Copy)]
pub enum Entry<'a> {
    /// A matrix of f64.
    Matrix(ArrayView2<'a, f64>),
    /// An array of f64 with three axes, such as the coefficients (models, K, c) of several models.
    Cube(ArrayView3<'a, f64>),
    /// A string.
    Text(&'a str),
}

/// Writes an archive. The file appears under its name only when it is complete. An existing file is replaced only if
/// `overwrite` is set.
///
/// # Errors
///
/// [`Surface`](ModelError::Surface) if the file exists and `overwrite` isn't set, or if it can't be written.
pub fn write_arrays(path: &Path, overwrite: bool, entries: &[(&str, Entry<'_>)]) -> Result<(), ModelError> {
    let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored).large_file(true);
    write_new(path, overwrite, |out| {
        let mut zip = ZipWriter::new_stream(out);
        for (name, entry) in entries {
            zip.start_file(format!("{name}.npy"), options).map_err(std::io::Error::other)?;
            match entry {
                Entry::Matrix(matrix) => {
                    write_header(&mut zip, "<f8", &format!("({}, {})", matrix.nrows(), matrix.ncols()))?;
                    write_all(&mut zip, matrix.iter().map(|value| value.to_le_bytes()))?;
                }
                Entry::Cube(cube) => {
                    let (n, rows, columns) = cube.dim();
                    write_header(&mut zip, "<f8", &format!("({n}, {rows}, {columns})"))?;
                    write_all(&mut zip, cube.iter().map(|value| value.to_le_bytes()))?;
                }
                Entry::Text(text) => write_text(&mut zip, text)?,
            }
        }
        zip.finish().map_err(std::io::Error::other)?.flush()
    })?;
    Ok(())
}

/// An archive opened for reading.
pub struct Arrays {
    path: PathBuf,
    zip: ZipArchive<BufReader<File>>,
}

impl Arrays {
    /// Opens an archive.
    ///
    /// # Errors
    ///
    /// [`Open`](ModelError::Open) if the file can't be opened, [`Compressed`](ModelError::Compressed) if it is a
    /// compressed model, and [`Invalid`](ModelError::Invalid) if it isn't an archive.
    pub fn open(path: &Path) -> Result<Self, ModelError> {
        let zip = opened(path, file(path)?)?;
        Ok(Self { path: path.to_owned(), zip })
    }

    /// Reads a matrix. A vector is returned as a matrix of one column.
    ///
    /// # Errors
    ///
    /// [`Invalid`](ModelError::Invalid) if the archive has no entry of that name, or if the entry isn't a matrix.
    pub fn matrix(&mut self, name: &str) -> Result<Array2<f64>, ModelError> {
        self.array(name, Array::matrix)
    }

    /// Reads a string.
    ///
    /// # Errors
    ///
    /// [`Invalid`](ModelError::Invalid) if the archive has no entry of that name, or if the entry isn't a string.
    pub fn text(&mut self, name: &str) -> Result<String, ModelError> {
        self.array(name, Array::text)
    }

    fn array<T>(&mut self, name: &str, convert: impl FnOnce(&Array) -> Result<T, String>) -> Result<T, ModelError> {
        let found = Archive { path: &self.path, zip: &mut self.zip }.array(name, convert)?;
        let problem = || format!("the file has no array `{name}`");
        found.ok_or_else(|| ModelError::Invalid { path: self.path.clone(), problem: problem() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn matrices_and_texts_return() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("group.npz");
        let matrix = Array2::from_shape_fn((3, 2), |(i, j)| (i as f64).exp() * (j as f64 - 0.3));
        let entries = [("scores", Entry::Matrix(matrix.view())), ("kind", Entry::Text("modes"))];
        write_arrays(&path, false, &entries).unwrap();
        assert!(write_arrays(&path, false, &entries).is_err());
        let mut read = Arrays::open(&path).unwrap();
        assert_eq!((read.matrix("scores").unwrap(), read.text("kind").unwrap()), (matrix, "modes".to_owned()));
        assert!(read.matrix("kind").is_err() && read.text("other").is_err());
        std::fs::write(&path, b"PK").unwrap();
        assert!(Arrays::open(&path).is_err() && Arrays::open(folder.path()).is_err());
    }
}
