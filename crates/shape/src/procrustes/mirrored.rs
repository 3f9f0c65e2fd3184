//! Detects members of a group that are mirror images of the other members.
//!
//! Each member and its mirror image are aligned to the mean of the *others*, because a mirrored member would resemble a
//! mean that includes it. The logarithm of the ratio of the two distances, x = ln(image / own), is positive if the
//! member matches the others unmirrored. x depends on the shape, and is 0 for a shape equal to its mirror image. If all
//! members differ from their mirror images by about the same amount, the value x of a mirrored member is about the
//! negative of the other members' x. A member is reported if
//!
//! ```text
//! x < -0.1,   median > 0.1,   median - x > 5 s
//! ```
//!
//! where s is the median absolute deviation of x from its median, divided by 0.6745. In generated groups of 6 and 20
//! bodies that differ from each other by as much as from an ellipsoid, x was 0.19 or above for unmirrored members, and
//! -0.16 or below for mirrored members. One or three of the 20 bodies were mirrored. For randomly perturbed ellipsoids,
//! x was -0.08 or above. Five unmirrored hippocampi have x from -0.2 to 0.5, and none is reported. A mirrored
//! hippocampus usually isn't reported either.

use std::borrow::Cow;

use spharm_monitor::OnlyCancel;

use super::{Group, ProcrustesWarning};
use crate::error::ShapeError;
use crate::group::{Pose, Round};
use crate::pair::object_only;
use crate::refine::{Space, Target};

/// Minimum size of a group in which mirrored members are detected. In a smaller group, the spread of x (see the
/// [module](self)) can't be estimated.
const LEAST: usize = 4;
/// A member is reported as mirrored only if its x ([`Judged::log`]) is at most minus this value, and the median of x
/// over all members is at least this value.
const CLEAR: f64 = 0.1;
/// A member is reported as mirrored only if its x = ln(image / own) is below the median by at least this multiple of
/// the spread s.
const FAR: f64 = 5.0;
/// Distances between surfaces of norm 1 are treated as rounding errors if they are below this value.
const SAME: f64 = 1e-7;

/// Returns the median of `numbers`, or zero for an empty list.
pub(super) fn median(mut numbers: Vec<f64>) -> f64 {
    numbers.sort_unstable_by(f64::total_cmp);
    let count = numbers.len();
    if count == 0 { 0.0 } else { 0.5 * (numbers[(count - 1) / 2] + numbers[count / 2]) }
}

/// Poses of a member and of its mirror image, each aligned to the mean of the other members.
pub(super) struct Judged {
    pub(super) own: Pose,
    image: Pose,
}

impl Judged {
    /// Returns x, the logarithm of the ratio of the distances, or `None` if both distances are rounding errors.
    pub(super) fn log(&self) -> Option<f64> {
        // If both distances are rounding errors, as for copies of one surface and for points, their ratio has no
        // meaning.
        let [own, image] = [&self.own, &self.image].map(|pose| pose.fit.distance);
        (own.max(image) > SAME).then(|| (image.max(SAME) / own.max(SAME)).ln())
    }
}

impl Group<'_> {
    /// Returns a warning for each member whose mirror image is nearer to the other members than the member itself. The
    /// second value is true if there are no such members, but the x of some member is below [`CLEAR`], so that mirrored
    /// members may have gone undetected.
    pub(super) fn mirrored(&self, round: &Round) -> Result<(Vec<ProcrustesWarning>, bool), ShapeError> {
        if self.units.len() < LEAST {
            return Ok((Vec::new(), false));
        }
        let judged = self.judged(round)?;
        let logs: Vec<Option<f64>> = judged.iter().map(Judged::log).collect();
        let known: Vec<f64> = logs.iter().copied().flatten().collect();
        let middle = median(known.clone());
        let spread = median(known.iter().map(|x| (x - middle).abs()).collect()) / 0.6745;
        let mut warnings = Vec::new();
        for (member, log) in logs.into_iter().enumerate() {
            if log.is_none_or(|log| -log < CLEAR || middle < CLEAR || middle - log < FAR * spread) {
                continue;
            }
            let rmsd = |pose: &Pose| round.rmsd_of(pose.fit.distance, self.sizes[member]);
            let (rmsd, mirrored) = (rmsd(&judged[member].own), rmsd(&judged[member].image));
            warnings.push(ProcrustesWarning::Mirrored { member, rmsd, mirrored });
        }
        let unclear = warnings.is_empty() && known.iter().any(|&log| log < CLEAR);
        Ok((warnings, unclear))
    }

    /// Aligns every member and its mirror image to the mean of the other members. If a member is mirrored in `round`,
    /// its mirrored form is treated as the member itself.
    pub(super) fn judged(&self, round: &Round) -> Result<Vec<Judged>, ShapeError> {
        let own = self.each(|index| self.continued(index, round.members[index].pose, &round.without(index)))?;
        let image = |index: usize| self.handed(index, !round.members[index].pose.mirrors(), &round.without(index));
        let images = self.each(image)?;
        Ok(own.into_iter().zip(images).map(|(own, image)| Judged { own, image }).collect())
    }

    /// Refines the alignment of a member to a target, starting from the member's current pose and keeping its
    /// handedness.
    fn continued(&self, index: usize, now: Pose, target: &Target) -> Pose {
        let (Some(plan), true) = (&self.plan, self.units[index].norm > 0.0) else {
            return self.handed(index, now.mirrors(), target);
        };
        let mut unit = Cow::Borrowed(&self.units[index]);
        if now.mirrors() {
            unit = Cow::Owned(unit.negative());
        }
        if now.antipodal {
            unit = Cow::Owned(unit.antipodal());
        }
        let fit = plan.continued(&unit, target, now.fit.rotation, Space::Turned, &OnlyCancel(self.monitor));
        Pose { fit, antipodal: now.antipodal }
    }

    /// Finds the pose that best aligns a member f(u) to the target. If `mirrored` is set, two mirror images of the
    /// member are tried instead of f(u): -f(-u), which is oriented outwards, and -f(u), which is inside out. If
    /// `mirrored` isn't set but the group matches mirror images, f(u) and f(-u), which is inside out, are tried. If two
    /// forms are tried, the pose of the form that is nearer to the target is returned.
    fn handed(&self, index: usize, mirrored: bool, target: &Target) -> Pose {
        let unit = &self.units[index];
        if unit.norm == 0.0 || !(mirrored || self.mirror) {
            return self.searched(index, target, false);
        }
        let inside_out = if mirrored { unit.negative() } else { unit.antipodal() };
        let Some(plan) = &self.plan else {
            let rows = if mirrored { &inside_out.rows } else { &unit.rows };
            return Pose { fit: object_only(rows, &target.rows, false), antipodal: false };
        };
        let search = |unit| plan.search(unit, target, Space::Turned, &OnlyCancel(self.monitor)).fit;
        let [outside, inside] = [&inside_out.antipodal(), &inside_out].map(search);
        let fit = if outside.distance <= inside.distance { outside } else { inside };
        Pose { fit, antipodal: false }
    }
}
