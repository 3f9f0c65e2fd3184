//! Compares members of a group with their mirror images, and with themselves after half-turns.

use rayon::prelude::*;
use spharm_monitor::Interrupted;

use super::group::{Group, OTHERS};
use super::warning::GroupPoseWarning;
use crate::geometry::sub;
use crate::matrix3::{product, times, transposed};
use crate::similarity::Similarity;

/// A member is reported as mirrored if the distance of its mirror image from the other members is below this multiple
/// of the member's own distance from them. The quotient of the two distances is 0.97 or more for bodies that equal
/// their mirror images, and 0.82 to 0.89 for hippocampi of the other side.
pub const NEARER_MIRRORED: f64 = 0.94;
/// Number of steps towards the other members by which the pose of a mirror image, or of a member after a half-turn, is
/// improved.
const CHANGED_STEPS: usize = 3;
/// A half-turn is applied to a member if it reduces the member's distance from the other members by more than this
/// factor.
const MUCH_NEARER: f64 = 1.5;
/// If a member fits the others after a half-turn about as well as after a reflection, the member equals its mirror
/// image, and its pose is wrong by a half-turn. This is assumed if the distance after the half-turn is at most this
/// multiple of the distance after the reflection.
const TURNED: f64 = 1.03;

impl Group<'_> {
    /// Returns warnings for members whose mirror images are nearer to the other members than the members themselves.
    /// Each member is reflected in the three planes spanned by the typical member's principal axes, and in the typical
    /// member's centre. A body that equals its mirror image may fit better after a reflection only because its pose is
    /// wrong. In this case, it also fits after a half-turn about one of the axes, and the warning reports a doubtful
    /// pose. Root mean square distances are compared, because in a group with members of both body sides, the median
    /// distance from the other members can't distinguish the sides.
    pub(super) fn mirrored(
        &self,
        motions: &[Similarity],
        template: usize,
    ) -> Result<Vec<GroupPoseWarning>, Interrupted> {
        let (reflections, half_turns) = self.changes(motions, template);
        let one = |member: usize| -> Result<Option<GroupPoseWarning>, Interrupted> {
            let distance = self.judged(member, &motions[member], motions, OTHERS).sqrt();
            let (_, mirrored) = self.best_changed(member, motions, &reflections)?;
            if mirrored >= NEARER_MIRRORED * distance {
                return Ok(None);
            }
            let (_, second) = self.best_changed(member, motions, &half_turns)?;
            Ok(Some(match second <= TURNED * mirrored {
                true => GroupPoseWarning::Doubtful { member, distance, second, near: self.searches_near() },
                false => GroupPoseWarning::Mirrored { member, distance, mirrored },
            }))
        };
        let found: Vec<_> = (0..motions.len()).into_par_iter().map(one).collect();
        Ok(found.into_iter().collect::<Result<Vec<_>, _>>()?.into_iter().flatten().collect())
    }

    /// Applies to each member, except the typical one, the half-turn that brings the member much nearer to the others,
    /// if such a half-turn exists. The distance from the typical member alone may not reveal a wrong pose, for example
    /// if the members' sizes differ greatly.
    pub(super) fn turned(&self, motions: &[Similarity], template: usize) -> Result<Vec<Similarity>, Interrupted> {
        let (_, half_turns) = self.changes(motions, template);
        let one = |member: usize| -> Result<Similarity, Interrupted> {
            if member == template {
                return Ok(motions[member]);
            }
            let own = self.judged(member, &motions[member], motions, OTHERS).sqrt();
            let (turned, distance) = self.best_changed(member, motions, &half_turns)?;
            Ok(if MUCH_NEARER * distance < own { turned } else { motions[member] })
        };
        let found: Vec<Result<Similarity, Interrupted>> = (0..motions.len()).into_par_iter().map(one).collect();
        found.into_iter().collect()
    }

    /// Returns the reflections and the half-turns that map each principal axis of the typical member to itself.
    fn changes(&self, motions: &[Similarity], template: usize) -> ([Similarity; 4], [Similarity; 3]) {
        let typical = &self.surfaces[template];
        let axes = product(&typical.axes, &transposed(&motions[template].orthogonal));
        let centre = motions[template].apply(typical.centre);
        let changed = |signs: [f64; 3]| {
            let flipped = std::array::from_fn(|i| axes[i].map(|value| signs[i] * value));
            let orthogonal = product(&transposed(&axes), &flipped);
            Similarity { orthogonal, translation: sub(centre, times(&orthogonal, centre)), ..Similarity::default() }
        };
        (
            [[-1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, -1.0], [-1.0, -1.0, -1.0]].map(changed),
            [[1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]].map(changed),
        )
    }

    /// Applies each change to a member and moves the result towards the other members. Returns the best of the
    /// resulting poses, and the member's distance from the other members in this pose.
    fn best_changed(
        &self,
        member: usize,
        motions: &[Similarity],
        changes: &[Similarity],
    ) -> Result<(Similarity, f64), Interrupted> {
        self.monitor.check()?;
        let others = self.seen(member, motions, |_| true);
        let moved = |change: &Similarity| {
            let start = motions[member].then(change);
            let motion = (0..CHANGED_STEPS).fold(start, |motion, _| self.step(member, &motion, &others));
            (motion, self.judged(member, &motion, motions, OTHERS).sqrt())
        };
        let found = changes.iter().map(moved).min_by(|a, b| a.1.total_cmp(&b.1));
        Ok(found.unwrap_or((motions[member], f64::INFINITY)))
    }
}
