//! Writes meshes with a value and a colour per vertex, for viewers.

use std::path::Path;

use super::choose::{Output, check_output, to_write_mesh};
use super::ply::PlyAttributes;
use super::{WriteOptions, check, glb, ply, vtk, vtkxml, write_new, write_signal};
use crate::error::SurfaceError;
use crate::mesh::{Mesh, Signal};

/// Extensions of file names that [`write_painted`] accepts.
pub const PAINTED: &[&str] = &[".ply", ".glb", ".vtk", ".vtp", ".shape.gii", ".func.gii"];

/// Writes a PLY file with a value and a colour per vertex, for viewers such as MeshLab and CloudCompare.
///
/// # Errors
///
/// The errors of [`write_mesh`](super::write_mesh()); [`UnknownFormat`](SurfaceError::UnknownFormat) if the name
/// doesn't end in `.ply`; [`LengthMismatch`](SurfaceError::LengthMismatch) if an attribute's length isn't the number of
/// vertices; [`Argument`](SurfaceError::Argument) if the attribute's name isn't a single word, or names a coordinate or
/// a colour.
pub fn write_ply(
    path: impl AsRef<Path>,
    mesh: &Mesh,
    attributes: &PlyAttributes<'_>,
    options: &WriteOptions,
) -> Result<(), SurfaceError> {
    let path = path.as_ref();
    check_output(path, Output::Ending(&[".ply"]))?;
    let format = to_write_mesh(path)?;
    check::mesh(path, mesh)?;
    attributes.check(mesh)?;
    if !format.holds_double(options.double) {
        check::fits_f32(path, &mesh.vertices, format)?;
    }
    write_new(path, options.overwrite, |out| ply::write(out, mesh, attributes, options.double))
}

/// Writes one value per vertex in the form that viewers of each format display. `.ply` and `.glb` contain the mesh with
/// values and colours, `.vtk` and `.vtp` the mesh with the values as `POINT_DATA`. `.shape.gii` and `.func.gii` contain
/// only the values, to be displayed on a surface with the same vertices.
///
/// # Errors
///
/// The errors of [`write_ply`], except that [`UnknownFormat`](SurfaceError::UnknownFormat) means an extension that
/// isn't in [`PAINTED`]; [`Empty`](SurfaceError::Empty) for GIfTI without values.
pub fn write_painted(
    path: impl AsRef<Path>,
    mesh: &Mesh,
    attributes: &PlyAttributes<'_>,
    options: &WriteOptions,
) -> Result<(), SurfaceError> {
    let path = path.as_ref();
    check_output(path, Output::Ending(PAINTED))?;
    let ends_in = |ending: &str| path.to_string_lossy().to_ascii_lowercase().ends_with(ending);
    if ends_in(".ply") {
        return write_ply(path, mesh, attributes, options);
    }
    check::mesh(path, mesh)?;
    attributes.check(mesh)?;
    if ends_in(".gii") {
        let values = attributes.scalar.map(|(_, values)| values.to_vec()).unwrap_or_default();
        let vertices = values.len();
        return write_signal(path, &Signal::new(values, vertices, 1), options);
    }
    if ends_in(".vtk") {
        return write_new(path, options.overwrite, |out| vtk::write(out, mesh, attributes.scalar));
    }
    if ends_in(".vtp") {
        return write_new(path, options.overwrite, |out| vtkxml::write(out, mesh, attributes.scalar));
    }
    check::fits_f32(path, &mesh.vertices, to_write_mesh(path)?)?;
    write_new(path, options.overwrite, |out| glb::write(out, mesh, attributes))
}
