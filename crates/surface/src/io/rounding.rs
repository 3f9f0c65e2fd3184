//! Finds surfaces whose coordinates lose too many digits when they are stored as 32-bit numbers.

use std::fmt;
use std::path::{Path, PathBuf};

use spharm_monitor::number;

use super::{Precision, WriteOptions, to_write_mesh};
use crate::error::SurfaceError;
use crate::geometry::{bounds, sub};
use crate::mesh::Mesh;

/// Numbers are called too coarse if the step between adjacent 32-bit coordinates exceeds this fraction of the bounding
/// box's diagonal.
const COARSE: f64 = 1e-4;

/// A warning that the 32-bit numbers in a mesh file are too coarse for a surface, because the surface is far from the
/// origin or very small.
#[derive(Debug, Clone, PartialEq)]
pub struct CoarseNumbers {
    path: PathBuf,
    /// Absolute value of the largest coordinate.
    largest: f64,
    /// Diagonal of the surface's bounding box.
    size: f64,
    /// Largest step between adjacent 32-bit coordinates.
    step: f64,
    has_choice: bool,
}

impl CoarseNumbers {
    /// Checks whether a mesh would lose too many digits if it were written to a file.
    ///
    /// # Errors
    ///
    /// [`UnknownFormat`](SurfaceError::UnknownFormat) if the file's name implies no mesh format.
    pub fn of(path: impl AsRef<Path>, mesh: &Mesh, options: &WriteOptions) -> Result<Option<Self>, SurfaceError> {
        let path = path.as_ref();
        let format = to_write_mesh(path)?;
        let (low, high) = bounds(mesh.vertices.iter().copied());
        let size = sub(high, low).into_iter().fold(0.0, f64::hypot);
        let largest = mesh.vertices.as_flattened().iter().fold(0.0_f64, |most, x| most.max(x.abs()));
        // Below the normal range of 32-bit numbers, all steps are as large as the smallest positive number.
        let step = (largest * f64::from(f32::EPSILON)).max(f64::from(f32::from_bits(1)));
        let is_coarse = !format.holds_double(options.double) && largest > 0.0 && step > COARSE * size;
        let has_choice = format.precision == Precision::Choice;
        Ok(is_coarse.then(|| Self { path: path.to_owned(), largest, size, step, has_choice }))
    }

    /// Returns the warning and a remedy. `option` is the advice to request 64-bit numbers, such as `give --double`;
    /// `None` if the caller has no such option.
    #[must_use]
    pub fn with_option(&self, option: Option<&str>) -> String {
        let other_format = "write a format with 64-bit numbers, such as .vtp";
        format!("{self}; {}", option.filter(|_| self.has_choice).unwrap_or(other_format))
    }
}

impl fmt::Display for CoarseNumbers {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (path, [largest, size, step]) = (self.path.display(), [self.largest, self.size, self.step].map(number));
        write!(
            f,
            "{path}: with coordinates up to {largest}, 32-bit numbers are too coarse for a surface of size {size}: they \
             have steps of up to {step}"
        )
    }
}
