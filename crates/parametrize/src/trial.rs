//! Tries the repair of a mesh that was refused, so that the error can state whether a repair succeeds.

use spharm_monitor::Monitor;
use spharm_surface::Mesh;
use spharm_surface::range::scaled_meshes;
use spharm_surface::repair::repair;

use crate::enclosure::check_enclosure;
use crate::error::ParametrizeError;
use crate::flaws::Flaws;
use crate::handles::fill_holes;
use crate::mending::Mending;

/// Repairs a copy of a mesh, whose triangles must have valid indices. Returns `None` if the repair changes nothing, or
/// if defects other than handles remain.
///
/// # Errors
///
/// [`ParametrizeError::OneSided`] or [`ParametrizeError::OpenSheet`] if the mesh can't enclose a body;
/// [`ParametrizeError::Interrupted`].
pub(crate) fn mending(mesh: &Mesh, monitor: &dyn Monitor) -> Result<Option<Box<Mending>>, ParametrizeError> {
    // Areas of very large or small coordinates leave the range of f64.
    let scaled = scaled_meshes([mesh]);
    let mesh = scaled.as_ref().map_or(mesh, |([mesh], _)| mesh);
    let (mut mended, mut repair) = repair(mesh);
    let open = fill_holes(&mut mended, &mut repair, monitor)?;
    if !check_enclosure(mesh, &mended, &open, &repair)? || !repair.is_any() {
        return Ok(None);
    }
    let (defects, handles) = defects(&mended);
    let succeeds = defects.is_empty();
    Ok(succeeds.then(|| Box::new(Mending { repair, handles })))
}

/// Returns the defects, other than handles, that prevent a mesh from being mapped to the sphere, and the mesh's number
/// of handles.
#[must_use]
pub fn defects(mesh: &Mesh) -> (Vec<String>, usize) {
    match Flaws::of(mesh) {
        Ok(flaws) => {
            let handles = flaws.handles();
            (flaws.problems, handles)
        }
        Err(error) => (vec![error.to_string()], 0),
    }
}

/// Adds the repair of this mesh to an error, if it is [`ParametrizeError::BadSurface`] without a repair and a repair
/// would succeed. If the mesh can't enclose a body, the error says so instead. Other errors are returned unchanged.
pub(crate) fn with_mending(error: ParametrizeError, mesh: &Mesh, monitor: &dyn Monitor) -> ParametrizeError {
    let in_range = || mesh.faces.as_flattened().iter().all(|&v| (v as usize) < mesh.vertices.len());
    match error {
        ParametrizeError::BadSurface { problems, handles, remedy, mending: None } if in_range() => {
            match mending(mesh, monitor) {
                Ok(mending) => ParametrizeError::BadSurface { problems, handles, remedy, mending },
                Err(error) => error,
            }
        }
        error => error,
    }
}
