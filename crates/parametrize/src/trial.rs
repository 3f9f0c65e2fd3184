//! Tries the repair of a mesh that was refused, so that the error can state whether a repair succeeds.

use spharm_monitor::Silent;
use spharm_surface::Mesh;
use spharm_surface::repair::repair;

use crate::error::ParametrizeError;
use crate::flaws::Flaws;
use crate::handles::fill_holes;
use crate::mending::Mending;

/// Repairs a copy of a mesh, whose triangles must have valid indices. Returns `None` if the repair changes nothing, or
/// if defects other than handles remain.
pub(crate) fn mending(mesh: &Mesh) -> Option<Box<Mending>> {
    let (mut mended, mut repair) = repair(mesh);
    fill_holes(&mut mended, &mut repair, &Silent).ok()?;
    let flaws = Flaws::of(&mended).ok().filter(|flaws| repair.is_any() && flaws.problems.is_empty())?;
    Some(Box::new(Mending { repair, handles: flaws.handles() }))
}

/// Adds the result of the trial to an error about this mesh.
pub(crate) fn with_mending(error: ParametrizeError, mesh: &Mesh) -> ParametrizeError {
    let in_range = || mesh.faces.as_flattened().iter().all(|&v| (v as usize) < mesh.vertices.len());
    match error {
        ParametrizeError::BadSurface { problems, handles, remedy, mending: None } if in_range() => {
            ParametrizeError::BadSurface { problems, handles, remedy, mending: mending(mesh) }
        }
        error => error,
    }
}
