//! Finds the poses of surfaces on one fixed surface, and surfaces whose mirror images fit it better.

use spharm_monitor::{Interrupted, Monitor};

use super::warning::{CLOSE, NearerMirrored};
use super::{Pose, PoseParams, PoseSearch, PoseSurface, nearest, pose};
use crate::mesh::Mesh;
use crate::similarity::Similarity;

/// Distances below this fraction of the fixed surface's size are treated as an exact fit, which no mirror image
/// improves.
const EXACT: f64 = 1e-3;

impl Pose {
    /// Returns the distance in this pose, and the settings of a search over all poses whose result can be compared with
    /// it. If size explains the difference between the surfaces, both distances are measured after scaling the moving
    /// surface to the size of the fixed surface.
    #[must_use]
    pub fn compared(&self, params: &PoseParams) -> (f64, PoseParams) {
        let distance = self.at_one_size.map_or(self.distance, |scaled| scaled.distance);
        let scale = params.scale || self.at_one_size.is_some();
        (distance, PoseParams { search: PoseSearch::Any, scale, ..*params })
    }
}

/// A fixed surface, onto which other surfaces are brought.
pub struct FixedSurface {
    surface: PoseSurface,
    /// Mirror image of the fixed surface. A moving surface fits it as well as the mirror image of the moving surface
    /// fits the fixed surface.
    mirrored: PoseSurface,
}

impl FixedSurface {
    /// Prepares a mesh as the fixed surface. Returns `None` in the same cases as [`PoseSurface::new`].
    #[must_use]
    pub fn new(mesh: &Mesh) -> Option<Self> {
        let mirrored = PoseSurface::new(&Similarity::reflection().apply_mesh(mesh))?;
        Some(Self { surface: PoseSurface::new(mesh)?, mirrored })
    }

    /// Returns the fixed surface without its mirror image.
    #[must_use]
    pub fn surface(&self) -> &PoseSurface {
        &self.surface
    }

    /// Finds the pose of a surface as [`pose()`] does. Also returns a warning if the surface's mirror image fits much
    /// better, unless the settings allow mirror images or the surface fits exactly. For this warning, all poses of the
    /// mirror image are searched, which takes about as long as finding the pose.
    ///
    /// # Errors
    ///
    /// [`Interrupted`] if the monitor asks to stop.
    pub fn pose(
        &self,
        moving: &PoseSurface,
        params: &PoseParams,
        monitor: &dyn Monitor,
    ) -> Result<(Pose, Option<NearerMirrored>), Interrupted> {
        let found = pose(moving, &self.surface, params, monitor)?;
        let (distance, any) = found.compared(params);
        if params.mirror || distance <= EXACT * self.surface.size() {
            return Ok((found, None));
        }
        let mirrored = nearest(moving, &self.mirrored, &any, monitor)?.distance;
        // The mirror image of a single body may be somewhat nearer by chance, so a warning is given only if it is
        // nearer by the factor `CLOSE`.
        let is_nearer = CLOSE * mirrored < distance;
        Ok((found, is_nearer.then_some(NearerMirrored { distance, mirrored })))
    }
}

#[cfg(test)]
mod tests {
    use spharm_monitor::Silent;

    use super::*;
    use crate::pose::tests::lump;

    #[test]
    fn a_mirror_image_is_noticed_unless_it_is_allowed() {
        let (fixed, other) = (FixedSurface::new(&lump(4)).unwrap(), lump(3));
        let mirror_image = Similarity::reflection().apply_mesh(&other);
        let warning = |mesh: &Mesh, mirror: bool| {
            let params = PoseParams { mirror, ..PoseParams::default() };
            fixed.pose(&PoseSurface::new(mesh).unwrap(), &params, &Silent).unwrap().1
        };
        let found = warning(&mirror_image, false).expect("a warning");
        assert!(found.mirrored < 0.5 * found.distance, "{found:?}");
        let text = found.to_string();
        assert!(
            text.starts_with("the mirror image fits the other surface better") && text.contains("--mirror"),
            "{text}"
        );
        assert_eq!([warning(&mirror_image, true), warning(&other, false)], [None, None]);
    }
}
