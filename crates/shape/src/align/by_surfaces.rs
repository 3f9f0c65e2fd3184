//! Aligns two surfaces by their shapes: finds first the pose in space, then the rotation of the parameters in that
//! pose.

use spharm_harmonics::Coefficients;
use spharm_monitor::{Monitor, OnlyCancel};
use spharm_surface::pose::{PoseParams, pose};

use super::params::{AlignParams, AlignWarning};
use crate::error::ShapeError;
use crate::evaluated::{Evaluated, in_pose};
use crate::pair::{Found, Unit};
use crate::refine::{Fit, Space, Target};
use crate::surface_poses::FAR_FROM_A_MEMBER;
use crate::transform::{SQRT_4_PI, Transform, rmsd};

/// Result of an alignment with [`Method::Surfaces`](crate::Method::Surfaces).
pub(super) struct BySurfaces {
    pub(super) transform: Transform,
    /// Root mean square distance between points at equal directions after the refinement from each start. Row 0 (the
    /// position) is excluded.
    pub(super) ends: Vec<f64>,
    pub(super) distance: f64,
    /// Distance between the surfaces in the pose found, but at least the sampling error of the evaluated surfaces. The
    /// distance at equal directions is never smaller than the distance between the surfaces. Another pose is therefore
    /// at least as good if its distance at equal directions is at most `bound`.
    pub(super) bound: f64,
    /// Root mean square distance between the surfaces' points at equal directions, in the pose found.
    pub(super) rmsd: f64,
    pub(super) warnings: Vec<AlignWarning>,
}

/// Finds the pose of the moving surface on the target, and then the rotation of the parameters that minimises the
/// distance between points at equal directions. Returns `None` if one of the surfaces is a point or a line.
pub(super) fn by_surfaces(
    moving: &Coefficients,
    target: &Coefficients,
    degree: usize,
    params: &AlignParams,
    monitor: &dyn Monitor,
) -> Result<Option<BySurfaces>, ShapeError> {
    let evaluated = Evaluated::new(degree)?;
    let (Some(a), Some(b)) = (evaluated.surface(moving.values().view())?, evaluated.surface(target.values().view())?)
    else {
        return Ok(None);
    };
    let of_pose = PoseParams { scale: params.scale, mirror: params.mirror, ..PoseParams::default() };
    let found = pose(&a, &b, &of_pose, monitor)?;
    let in_space = in_pose(found.similarity, &a, &b);
    let posed = in_space.apply(moving, &OnlyCancel(monitor))?;
    let (f, g) = (Unit::new(&posed, degree), Unit::new(target, degree));
    if f.norm == 0.0 || g.norm == 0.0 {
        return Ok(None);
    }
    let Found { fit: Fit { rotation, stiffness, .. }, ends, .. } =
        params.plan(degree)?.search(&f, &Target::new(g.rows.clone()), Space::Fixed, monitor);
    monitor.check()?;
    let transform = Transform { rotation, ..in_space };
    let up_to = |of: &Coefficients| Coefficients::new(of.up_to(degree).to_owned());
    let apart = rmsd(&up_to(&transform.apply(moving, &OnlyCancel(monitor))?)?, &up_to(target)?)?;
    let left = |end: &f64| (f.norm - g.norm).hypot((f.norm * g.norm).sqrt() * end) / SQRT_4_PI;
    let mut warnings = Vec::new();
    // Distances below `least` are within the sampling error of the evaluated surfaces.
    let least = 1e-3 * b.size();
    warnings.extend(found.doubt(least).map(|(distance, second)| AlignWarning::PoseInDoubt { distance, second }));
    if apart > FAR_FROM_A_MEMBER * found.distance.max(least) {
        warnings.push(AlignWarning::PlacesDiffer { rmsd: apart, distance: found.distance });
    }
    if stiffness < 1e-7 {
        warnings.push(AlignWarning::ParametersUndetermined);
    }
    Ok(Some(BySurfaces {
        transform,
        ends: ends.iter().map(left).collect(),
        distance: found.distance,
        bound: found.distance.max(least),
        rmsd: apart,
        warnings,
    }))
}
