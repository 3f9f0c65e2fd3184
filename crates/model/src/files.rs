//! Reads and writes model files.

use std::io::{self, Cursor, Write};
use std::path::Path;

use spharm_surface::io::write_new;

use crate::error::ModelError;
use crate::model::Model;
use crate::npz;
use crate::provenance::Provenance;

impl Model {
    /// Writes the model to a new file. The file appears only when it is complete.
    ///
    /// # Errors
    ///
    /// [`NonFinite`](ModelError::NonFinite) if a coefficient isn't finite, and the errors of [`write_new`], such as
    /// [`OutputExists`](spharm_surface::SurfaceError::OutputExists).
    pub fn write(&self, path: impl AsRef<Path>) -> Result<(), ModelError> {
        self.write_with(path, false)
    }

    /// Writes the model to a file, which appears only when it is complete. An existing file is replaced only if
    /// `overwrite` is set.
    ///
    /// # Errors
    ///
    /// The errors of [`write`](Self::write).
    pub fn write_with(&self, path: impl AsRef<Path>, overwrite: bool) -> Result<(), ModelError> {
        let path = path.as_ref();
        if let Some((row, channel, value)) = self.not_finite() {
            return Err(ModelError::NonFinite { path: path.to_owned(), row, channel, value });
        }
        Ok(write_new(path, overwrite, |out| self.write_to(out))?)
    }

    /// Writes the model's archive to a stream, which need not be seekable.
    ///
    /// # Errors
    ///
    /// The errors of `out`, and [`InvalidData`](io::ErrorKind::InvalidData) if a coefficient isn't finite.
    pub fn write_to(&self, out: &mut dyn Write) -> io::Result<()> {
        npz::write(self, out)
    }

    /// Reads a model: any NumPy archive with an array `coefficients`.
    ///
    /// The values may be f32 or f64, in C or Fortran order, stored or deflated. The arrays `max_degree` and
    /// `convention` are optional and are checked if present. The vectors in `directions` may have any nonzero length.
    ///
    /// # Errors
    ///
    /// [`Open`](ModelError::Open) if the file can't be opened, [`Compressed`](ModelError::Compressed) if it is a
    /// compressed model, [`Invalid`](ModelError::Invalid) if it isn't a valid model, and
    /// [`NonFinite`](ModelError::NonFinite) if a coefficient isn't finite.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, ModelError> {
        let path = path.as_ref();
        npz::read(path, npz::file(path)?)
    }

    /// Reads only the provenance of a model, which takes much less time than reading the whole model. A model without a
    /// record has an empty provenance. The other contents of the file aren't checked.
    ///
    /// # Errors
    ///
    /// [`Open`](ModelError::Open) if the file can't be opened, and [`Invalid`](ModelError::Invalid) if it isn't a valid
    /// archive or the record isn't text.
    pub fn read_provenance(path: impl AsRef<Path>) -> Result<Provenance, ModelError> {
        let path = path.as_ref();
        npz::read_provenance(path, npz::file(path)?)
    }

    /// Reads a model from the bytes of an archive. See [`read`](Self::read) for the accepted contents.
    ///
    /// # Errors
    ///
    /// [`Invalid`](ModelError::Invalid) if the bytes aren't a valid model, and [`NonFinite`](ModelError::NonFinite) if
    /// a coefficient isn't finite.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, ModelError> {
        npz::read(Path::new("the model"), Cursor::new(bytes))
    }
}
