//! Imports for most programs: `use spharm::prelude::*;`.

use std::path::Path;

pub use crate::parametrize::{CaldParams, parametrize};
pub use crate::{
    Coefficients, Directions, Error, Fit, FitParams, Kind, Mesh, MeshFit, Method, Model, Signal, Silent, Smoothness,
    Sphere, Target, Weights, fit, fit_mesh,
};
pub use spharm_surface::io::{read_mesh, read_signal};
pub use spharm_surface::{read_sphere, read_target};

/// Writes a mesh to a new file, in the format of the file's extension; see
/// [`io::write_mesh`](spharm_surface::io::write_mesh) for options.
///
/// # Errors
///
/// [`Error::Surface`] if the file exists, its format is unknown, or it can't be written.
pub fn write_mesh(path: impl AsRef<Path>, mesh: &Mesh) -> Result<(), Error> {
    Ok(spharm_surface::io::write_mesh(path, mesh, &spharm_surface::io::WriteOptions::default())?)
}
