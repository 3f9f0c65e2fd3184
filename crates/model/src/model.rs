//! A fitted model.

use std::fs::File;
use std::io::{self, BufReader, Write};
use std::path::Path;

use spharm_harmonics::Coefficients;
use spharm_surface::io::write_new;
use spharm_surface::{Kind, Sphere};

use crate::error::ModelError;
use crate::npz;
use crate::provenance::Provenance;

/// What `convention` says in every model.
pub const CONVENTION: &str = "real orthonormal, no Condon-Shortley phase, row l^2 + l + m, sin(m phi) for negative m";

/// A fitted model.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// Canonical coefficients, (K, c), finite, in the input's unit.
    pub coefficients: Coefficients,
    /// The sampling that it was fitted over; none for a model of coefficients alone.
    pub sphere: Option<Sphere>,
    /// Key of the sampling scheme in a basis store: 64 hexadecimal digits.
    pub scheme_key: Option<String>,
    /// How it was made.
    pub provenance: Provenance,
}

/// What a model has beside its sphere: the result of a fit, or coefficients of unknown origin.
#[derive(Debug, Clone, PartialEq)]
pub struct Fitted {
    /// Canonical coefficients, (K, c).
    pub coefficients: Coefficients,
    /// Key of the sampling scheme in a basis store.
    pub scheme_key: Option<String>,
    /// How they were found.
    pub provenance: Provenance,
}

impl From<Coefficients> for Fitted {
    fn from(coefficients: Coefficients) -> Self {
        Self { coefficients, scheme_key: None, provenance: Provenance::default() }
    }
}

impl Model {
    /// Returns the model of a fit over a sphere, or of coefficients that belong to one.
    #[must_use]
    pub fn new(sphere: Sphere, fitted: impl Into<Fitted>, kind: Kind) -> Self {
        let mut model = Self::without_sphere(fitted, kind);
        model.provenance.sphere = sphere.path.as_deref().map(|path| path.to_string_lossy().into_owned());
        model.provenance.parametrized = sphere.parametrized;
        model.sphere = Some(sphere);
        model
    }

    /// Returns a model that has no sampling of its own: it is evaluated on any sphere.
    #[must_use]
    pub fn without_sphere(fitted: impl Into<Fitted>, kind: Kind) -> Self {
        let Fitted { coefficients, scheme_key, provenance } = fitted.into();
        let provenance = Provenance { surface: Some(kind == Kind::Surface), ..provenance };
        Self { coefficients, sphere: None, scheme_key, provenance }
    }

    /// Returns what the channels are: x, y and z where there are three of them, unless the provenance says otherwise.
    #[must_use]
    pub fn kind(&self) -> Kind {
        let surface = self.coefficients.channels() == 3 && self.provenance.surface.unwrap_or(true);
        if surface { Kind::Surface } else { Kind::Signal }
    }

    /// Writes the model to a file that isn't there yet, whole or not at all.
    ///
    /// # Errors
    ///
    /// [`NonFinite`](ModelError::NonFinite); those of [`write_new`], such as
    /// [`OutputExists`](spharm_surface::SurfaceError::OutputExists).
    pub fn write(&self, path: impl AsRef<Path>) -> Result<(), ModelError> {
        self.write_with(path, false)
    }

    /// Writes the model, replacing a file that is there if `overwrite`.
    ///
    /// # Errors
    ///
    /// As [`write`](Self::write).
    pub fn write_with(&self, path: impl AsRef<Path>, overwrite: bool) -> Result<(), ModelError> {
        let path = path.as_ref();
        if let Some((row, channel, value)) = self.not_finite() {
            return Err(ModelError::NonFinite { path: path.to_owned(), row, channel, value });
        }
        Ok(write_new(path, overwrite, |out| self.write_to(out))?)
    }

    /// Writes the archive; `out` need not seek.
    ///
    /// # Errors
    ///
    /// Those of `out`; [`InvalidData`](io::ErrorKind::InvalidData) for a coefficient that isn't finite.
    pub fn write_to(&self, out: &mut dyn Write) -> io::Result<()> {
        npz::write(self, out)
    }

    /// Reads a model: any NumPy archive that has an array `coefficients`.
    ///
    /// Its values may be f32 or f64, in C or Fortran order, stored or deflated. `max_degree` and `convention` are checked
    /// where they are there. Directions need not have length 1.
    ///
    /// # Errors
    ///
    /// [`Open`](ModelError::Open), [`Invalid`](ModelError::Invalid), [`NonFinite`](ModelError::NonFinite).
    pub fn read(path: impl AsRef<Path>) -> Result<Self, ModelError> {
        let path = path.as_ref();
        let open = |source| ModelError::Open { path: path.to_owned(), source };
        if !std::fs::metadata(path).map_err(open)?.is_file() {
            return Err(ModelError::Invalid { path: path.to_owned(), problem: "it is not a regular file".to_owned() });
        }
        npz::read(path, BufReader::new(File::open(path).map_err(open)?))
    }

    /// Row, channel and value of the first coefficient that isn't finite.
    pub(crate) fn not_finite(&self) -> Option<(usize, usize, f64)> {
        let mut values = self.coefficients.values().indexed_iter();
        values.find(|(_, value)| !value.is_finite()).map(|((row, channel), &value)| (row, channel, value))
    }
}
