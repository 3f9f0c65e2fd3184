//! Compares surfaces that differ in size.
//!
//! A body fits a larger body of the same shape best where it leans against one side: most of its surface then lies on
//! the larger one. A body that is 10 % smaller is turned by some 5 degrees, one that is 20 % smaller by 13 to 27. If
//! scaling removes most of the distance between two surfaces, size explains their difference, and they are aligned at
//! one size; groups are, if this is so for half of their members. Otherwise poses are those of the surfaces as they
//! are: a body that is cut off must not be enlarged.

use rayon::prelude::*;
use spharm_monitor::{Interrupted, Monitor};

use super::group::{Group, GroupPoses, OF_ANOTHER_KIND, median};
use super::surface::Density;
use super::warning::{CLOSE, GroupPoseWarning};
use super::{GAIN, PoseParams, PoseSurface, STAGES, differ, distance, icp, improved, nearest};
use crate::geometry::{scale, sub};
use crate::matrix3::times;
use crate::similarity::Similarity;

/// Size explains the difference between two surfaces if scaling reduces their distance to less than this share. For
/// vertebrae and hippocampi of different people, the share is 0.63 to 0.99.
const EXPLAINED: f64 = 0.5;
/// Ratio of sizes above which poses at one size are searched anew. Up to it, they are near the poses at own sizes.
const UNLIKE: f64 = 1.1;
/// Largest number of rounds, with few points, that improve a motion after both surfaces have been scaled to the same
/// size.
const SETTLING: usize = 4;

/// Returns the pose near `motion` that also scales `moving` to the size of `fixed`, if size explains the difference
/// between the surfaces: if scaling at least halves the distance that they have after `motion`. Returns `None` if this
/// isn't so, or if poses are computed with [`PoseParams::scale`] anyway.
#[must_use]
pub fn at_one_size(
    moving: &PoseSurface,
    fixed: &PoseSurface,
    motion: &Similarity,
    params: &PoseParams,
) -> Option<Similarity> {
    let own = distance(moving, fixed, motion, params.trimmed);
    let (near, explained) = settled(moving, fixed, motion, params);
    (!params.scale && explained < EXPLAINED * own).then_some(near)
}

/// A pose at one size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScaledPose {
    /// The motion, which scales the moving surface to the size of the fixed one.
    pub similarity: Similarity,
    /// Distance between the surfaces, as for [`Pose`](super::Pose).
    pub distance: f64,
    /// Distance in the second best pose at one size, as for [`Pose`](super::Pose).
    pub second: f64,
}

/// Does the same as [`at_one_size`], but searches all poses at one size if size explains the difference near `motion`,
/// or if the sizes differ so much that the pose at one size may be far from `motion`.
pub(super) fn searched_at_one_size(
    moving: &PoseSurface,
    fixed: &PoseSurface,
    motion: &Similarity,
    params: &PoseParams,
    monitor: &dyn Monitor,
) -> Result<Option<ScaledPose>, Interrupted> {
    if params.scale {
        return Ok(None);
    }
    let own = distance(moving, fixed, motion, params.trimmed);
    let (near, explained) = settled(moving, fixed, motion, params);
    let ratio = moving.size() / fixed.size();
    if explained >= EXPLAINED * own && f64::max(ratio, 1.0 / ratio) < UNLIKE {
        return Ok(None);
    }
    let found = nearest(moving, fixed, &PoseParams { scale: true, ..*params }, monitor)?;
    let best = if found.distance < explained {
        ScaledPose { similarity: found.similarity, distance: found.distance, second: found.second }
    } else {
        let second = if differ(&near, &found.similarity) { found.distance } else { found.second };
        ScaledPose { similarity: near, distance: explained, second }
    };
    Ok((best.distance < EXPLAINED * own).then_some(best))
}

/// Returns the local optimum at one size that is reached from a motion, and its distance.
fn settled(moving: &PoseSurface, fixed: &PoseSurface, motion: &Similarity, params: &PoseParams) -> (Similarity, f64) {
    improved(moving, fixed, &of_size(motion, moving, fixed), &PoseParams { scale: true, ..*params })
}

impl Group<'_> {
    /// Calls [`searched_at_one_size`] for each member and the member `template`, whose pose is the identity.
    pub(super) fn at_one_size(
        &self,
        motions: &[Similarity],
        template: usize,
    ) -> Result<Vec<Option<Similarity>>, Interrupted> {
        let one = |(member, motion): (usize, &Similarity)| -> Result<Option<Similarity>, Interrupted> {
            self.monitor.check()?;
            if member == template {
                return Ok(None);
            }
            let (moving, fixed) = (&self.surfaces[member], &self.surfaces[template]);
            let found = searched_at_one_size(moving, fixed, motion, self.params, self.monitor)?;
            Ok(found.map(|found| found.similarity))
        };
        let found: Vec<Result<Option<Similarity>, Interrupted>> = motions.par_iter().enumerate().map(one).collect();
        found.into_iter().collect()
    }

    /// Returns the poses of a group whose members differ mainly in size, from its poses `scaled` at the template's
    /// size. A member that is much nearer to the template at its own size, such as a body that is cut off, is aligned
    /// at its own size. Warnings are those at one size, and those of members far from the others at their own sizes.
    pub(super) fn at_own_sizes(&self, scaled: GroupPoses) -> Result<GroupPoses, Interrupted> {
        let GroupPoses { similarities, template, mut warnings, .. } = scaled;
        let one = |(member, motion): (usize, &Similarity)| -> Result<(Similarity, Option<Similarity>), Interrupted> {
            self.monitor.check()?;
            if member == template {
                return Ok((*motion, None));
            }
            let (moving, fixed) = (&self.surfaces[member], &self.surfaces[template]);
            let apart = distance(moving, fixed, motion, self.params.trimmed);
            let own = nearest(moving, fixed, self.params, self.monitor)?;
            if CLOSE * own.distance < apart {
                return Ok((own.similarity, None));
            }
            Ok((motion.with_scale(1.0, moving.centre), Some(*motion)))
        };
        let found: Vec<Result<_, Interrupted>> = similarities.par_iter().enumerate().map(one).collect();
        let (similarities, at_one_size): (Vec<_>, Vec<_>) =
            found.into_iter().collect::<Result<Vec<_>, _>>()?.into_iter().unzip();
        let distances = self.distances(&similarities);
        let median = median(distances.clone());
        for (member, distance) in distances.iter().copied().enumerate() {
            if distance > OF_ANOTHER_KIND * median {
                warnings.retain(|warning| warning.member() != member || warning.explains_distance());
                if warnings.iter().all(|warning| warning.member() != member) {
                    warnings.push(GroupPoseWarning::Far { member, distance, median });
                }
            }
        }
        Ok(GroupPoses { similarities, at_one_size, template, distances, warnings })
    }
}

/// Returns the smaller of two untrimmed distances: at the given sizes, and with the moving surface scaled to the size
/// of the fixed one. Without scaling, a larger body hides the bumps of a smaller one; with scaling, a body that is cut
/// off would be enlarged.
pub(super) fn whole(moving: &PoseSurface, fixed: &PoseSurface, density: Density, motion: &Similarity) -> f64 {
    let (a, b) = (moving.view(density), fixed.view(density));
    let [as_it_is, of_one_size] =
        [*motion, of_size(motion, moving, fixed)].map(|motion| icp::distance(a, b, &motion, 0.0));
    as_it_is.min(of_one_size)
}

/// Returns a motion that also scales the moving surface to the size of the fixed one, improved by a few rounds.
fn of_size(motion: &Similarity, moving: &PoseSurface, fixed: &PoseSurface) -> Similarity {
    let size = fixed.size() / moving.size();
    let translation = sub(motion.apply(moving.centre), scale(times(&motion.orthogonal, moving.centre), size));
    let start = Similarity { scale: size, translation, ..*motion };
    let rounds = icp::Rounds {
        most: SETTLING,
        rest: 1e-3 * fixed.size(),
        gain: GAIN,
        trimmed: 0.0,
        tangential: STAGES[0].tangential,
        scale: true,
    };
    icp::improved(moving.view(Density::Few), fixed.view(Density::Few), start, &rounds)
}
