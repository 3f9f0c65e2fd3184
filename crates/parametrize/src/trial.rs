//! Tries to repair a mesh that was refused, so that the error can state whether a repair would succeed.

use spharm_monitor::Monitor;
use spharm_surface::Mesh;
use spharm_surface::range::scaled_meshes;
use spharm_surface::repair::{MeshRepair, repair};

use crate::enclosure::check_enclosure;
use crate::error::ParametrizeError;
use crate::flaws::Flaws;
use crate::handles::fill_holes;
use crate::mending::Mending;
use crate::wrap::would_wrap;

/// If a repair drops pieces with more than this share of the mesh's area, a trial with a coarse wrap determines whether
/// a wrap would keep all bodies of the mesh.
const DROPPED: f64 = 0.05;

/// A repaired copy of a mesh.
pub(crate) struct Repaired {
    /// The repaired mesh, whose coordinates are divided by 2^`exponent`.
    pub(crate) mesh: Mesh,
    pub(crate) exponent: i32,
    /// The changes that the repair made.
    pub(crate) repair: MeshRepair,
    /// Whether the repaired mesh has two sides, see [`check_enclosure`].
    pub(crate) two_sided: bool,
}

/// Repairs a copy of a mesh, whose triangles must have valid indices, and fills its holes.
///
/// # Errors
///
/// The errors of [`mending`].
pub(crate) fn repaired(mesh: &Mesh, monitor: &dyn Monitor) -> Result<Repaired, ParametrizeError> {
    // With very large or very small coordinates, areas would overflow or underflow, so the coordinates are scaled.
    let scaled = scaled_meshes([mesh]);
    let (given, exponent) = scaled.as_ref().map_or((mesh, 0), |([mesh], exponent)| (mesh, *exponent));
    let (mut mesh, mut repair) = repair(given);
    let open = fill_holes(&mut mesh, &mut repair, monitor)?;
    let two_sided = check_enclosure(given, &mesh, &open, &repair)?;
    Ok(Repaired { mesh, exponent, repair, two_sided })
}

/// Repairs a copy of a mesh, whose triangles must have valid indices. Returns `None` if the repair changes nothing, or
/// if defects other than handles remain.
///
/// # Errors
///
/// [`ParametrizeError::OneSided`] or [`ParametrizeError::OpenSheet`] if the mesh can't enclose a body;
/// [`ParametrizeError::BadSurface`] if the pieces of the mesh aren't connected; [`ParametrizeError::Interrupted`].
pub(crate) fn mending(mesh: &Mesh, monitor: &dyn Monitor) -> Result<Option<Box<Mending>>, ParametrizeError> {
    let Repaired { mesh: mended, repair, two_sided, .. } = repaired(mesh, monitor)?;
    if !two_sided || !repair.is_any() {
        return Ok(None);
    }
    let (defects, handles) = defects(&mended);
    if !defects.is_empty() {
        return Ok(None);
    }
    let wraps = repair.dropped_area > DROPPED && would_wrap(mesh, monitor)?;
    Ok(Some(Box::new(Mending { repair, handles, wraps })))
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

/// Adds the repair of this mesh to an error, if the error is [`ParametrizeError::BadSurface`] without a repair and a
/// repair would succeed. If the mesh can't enclose a body, the error that states this is returned instead. Other errors
/// are returned unchanged.
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
