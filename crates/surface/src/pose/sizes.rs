//! Compares surfaces that differ in size.
//!
//! A body fits a larger body of the same shape best if it leans against one side of the larger body, because most of
//! its surface then lies near the larger surface. In this pose, a body that is 10 % smaller is rotated by about 5
//! degrees from the correct pose, and a body that is 20 % smaller by 13 to 27 degrees. If scaling removes most of the
//! distance between two surfaces, size explains their difference, and they are aligned at one size. A group is aligned
//! at one size if size explains the difference from the typical member for at least half of the other members.
//! Otherwise, surfaces are aligned at their own sizes, because a body that is cut off must not be enlarged.

use rayon::prelude::*;
use spharm_monitor::{Interrupted, Monitor};

use super::group::{Group, GroupPoses, OF_ANOTHER_KIND, median};
use super::surface::Density;
use super::warning::{CLOSE, GroupPoseWarning};
use super::{GAIN, PoseParams, PoseSurface, STAGES, differ, distance, icp, improved, nearest};
use crate::geometry::{scale, sub};
use crate::matrix3::times;
use crate::similarity::Similarity;

/// Size explains the difference between two surfaces if scaling reduces their distance to less than this share of the
/// distance without scaling. For vertebrae and hippocampi of different people, the share is 0.63 to 0.99.
const EXPLAINED: f64 = 0.5;
/// If two surfaces differ in size by more than this factor, all poses at one size are searched. Below this factor, the
/// best pose at one size is near the pose at the surfaces' own sizes, so the search is skipped if scaling near this
/// pose doesn't explain the difference.
const UNLIKE: f64 = 1.1;
/// After both surfaces have been scaled to the same size, a motion is improved by at most this number of rounds with
/// few points.
const SETTLING: usize = 4;

/// Returns the pose near `motion` that also scales `moving` to the size of `fixed`, if size explains the difference
/// between the surfaces. This is the case if scaling reduces their distance after `motion` to less than half.
/// Otherwise, and if poses are computed with [`PoseParams::scale`] anyway, returns `None`.
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

/// A pose in which the moving surface is scaled to the size of the fixed surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScaledPose {
    /// The motion, which scales the moving surface to the size of the fixed one.
    pub similarity: Similarity,
    /// Distance between the surfaces in this pose, as defined in [`Pose`](super::Pose).
    pub distance: f64,
    /// Distance between the surfaces in the second best pose, if the moving surface is scaled to the size of the fixed
    /// one; like `second` of [`Pose`](super::Pose).
    pub second: f64,
}

/// Returns the pose at one size like [`at_one_size`], but searches all poses, not only those near `motion`. The search
/// is skipped if size doesn't explain the difference near `motion` and the sizes are similar. If the sizes are very
/// different, the pose at one size may be far from `motion`.
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

/// Scales `moving` to the size of `fixed`, and improves the pose, starting from `motion`. Returns the local optimum
/// that is reached, and the distance of the surfaces there.
fn settled(moving: &PoseSurface, fixed: &PoseSurface, motion: &Similarity, params: &PoseParams) -> (Similarity, f64) {
    improved(moving, fixed, &of_size(motion, moving, fixed), &PoseParams { scale: true, ..*params })
}

impl Group<'_> {
    /// Calls [`searched_at_one_size`] for each member, with the member `template` as the fixed surface. The result for
    /// the template itself is `None`.
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

    /// Computes the poses of a group whose members differ mainly in size. `scaled` has the poses at the template's
    /// size. A member that is much nearer to the template at its own size, such as a body that is cut off, is aligned
    /// at its own size. The result has the warnings of `scaled`, and warnings about members that are far from the
    /// others at their own sizes.
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
/// of the fixed one. Both are measured because either may be misleading: without scaling, a larger body hides the bumps
/// of a smaller body, and with scaling, a body that is cut off is enlarged.
pub(super) fn whole(moving: &PoseSurface, fixed: &PoseSurface, density: Density, motion: &Similarity) -> f64 {
    let (a, b) = (moving.view(density), fixed.view(density));
    let [as_it_is, of_one_size] =
        [*motion, of_size(motion, moving, fixed)].map(|motion| icp::distance(a, b, &motion, 0.0));
    as_it_is.min(of_one_size)
}

/// Adds scaling to the size of the fixed surface to a motion, and improves the result by a few rounds.
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
