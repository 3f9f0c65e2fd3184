//! Tries a coarse wrap of a mesh that was refused, so that the error advises a wrap only if it would succeed.

use spharm_monitor::{Interrupted, Monitor};
use spharm_surface::Mesh;

use super::wrap;
use crate::error::ParametrizeError;

/// Number of voxels of the trial along the longest side of the mesh. The trial takes a fraction of a second.
const COARSE: usize = 32;
/// The trial succeeds only if the pieces that it leaves out have at most this share of the body's voxels.
const LEFT_OUT: f64 = 0.05;
/// At most this share of the trial wrap's area may span holes. With more voxels, this share would be larger, because
/// the parts of a filling within a voxel of the mesh don't count as spanning a hole.
const BRIDGED: f64 = 0.2;

/// Returns whether a wrap with [`USUAL_VOXELS`](super::USUAL_VOXELS) probably keeps all bodies of a mesh and spans no
/// large holes, judging by a coarse wrap. The coarse wrap may lose thin parts.
///
/// # Errors
///
/// [`Interrupted`].
pub fn would_wrap(surface: &Mesh, monitor: &dyn Monitor) -> Result<bool, Interrupted> {
    match wrap(surface, COARSE, monitor) {
        Ok((_, report)) => {
            Ok(report.wrap.is_some_and(|wrap| wrap.left_out <= LEFT_OUT && wrap.bridged_area <= BRIDGED))
        }
        Err(ParametrizeError::Interrupted(interrupted)) => Err(interrupted),
        Err(_) => Ok(false),
    }
}
