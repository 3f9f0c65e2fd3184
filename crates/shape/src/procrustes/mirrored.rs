//! Members of a group that are mirror images of what they should be.
//!
//! Each member and its mirror image are brought to the mean of the *others*: in a mean that it is part of, a mirrored
//! member finds itself. Of the two distances the log of the ratio, x = ln(image / own), is above zero where the member
//! belongs to the others as it is. How far depends on the shape: 0 where it is its own mirror image, and of a group in
//! which left and right differ about the same for all, so that a mirrored member has about -x. A member is named where
//!
//! ```text
//! x < -0.1,   median > 0.1,   median - x > 5 s
//! ```
//!
//! with s the members' median absolute deviation from the median, over 0.6745. Measured over generated groups of 6 and
//! 20, of bodies that differ from each other by as much as from an ellipsoid: members as they are 0.19 or above,
//! mirrored ones -0.16 or below, one or three of 20; ellipsoids with as much at random, -0.08 or above. Five right
//! hippocampi have x from -0.2 to 0.5: none is named as they are, and of one that is mirrored among them mostly nothing
//! is said.

use std::borrow::Cow;

use spharm_monitor::OnlyCancel;

use super::{Group, ProcrustesWarning};
use crate::error::ShapeError;
use crate::group::{Pose, Round};
use crate::pair::object_only;
use crate::refine::{Space, Target};

/// Members whose spread means something, at least.
const LEAST: usize = 4;
/// How far from zero the logs of members and of mirrored ones are, at least.
const CLEAR: f64 = 0.1;
/// How far a mirrored member's is from the others', in their spread.
const FAR: f64 = 5.0;
/// Distances of surfaces of norm 1 below this are rounding.
const SAME: f64 = 1e-7;

/// The middle of numbers; zero of none.
pub(super) fn median(mut numbers: Vec<f64>) -> f64 {
    numbers.sort_unstable_by(f64::total_cmp);
    let count = numbers.len();
    if count == 0 { 0.0 } else { 0.5 * (numbers[(count - 1) / 2] + numbers[count / 2]) }
}

/// A member beside the others, as it is in a round and as its mirror image.
pub(super) struct Judged {
    pub(super) own: Pose,
    image: Pose,
}

impl Judged {
    /// The log of the ratio of the distances, image over own; none where there is nothing to tell.
    pub(super) fn log(&self) -> Option<f64> {
        // Copies of one surface, and points, tell nothing.
        let [own, image] = [&self.own, &self.image].map(|pose| pose.fit.distance);
        (own.max(image) > SAME).then(|| (image.max(SAME) / own.max(SAME)).ln())
    }
}

impl Group<'_> {
    /// The members that are nearer to the others as mirror images; and, where there are none, whether that is because
    /// members and mirror images are hardly told apart.
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

    /// Every member and its mirror image, brought to the mean of the others. One that the round has mirrored is judged
    /// as such.
    pub(super) fn judged(&self, round: &Round) -> Result<Vec<Judged>, ShapeError> {
        let own = self.each(|index| self.continued(index, round.members[index].pose, &round.without(index)))?;
        let image = |index: usize| self.handed(index, !round.members[index].pose.mirrors(), &round.without(index));
        let images = self.each(image)?;
        Ok(own.into_iter().zip(images).map(|(own, image)| Judged { own, image }).collect())
    }

    /// A member refined to a target from the pose that it has, of the hand that it has there.
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

    /// A member searched as it is, f(u), or as the nearer of its mirror images: -f(-u), whose outside is outside, and
    /// -f(u), which is inside out. In a group that may be mirrored f(-u), which is inside out, is searched besides
    /// f(u).
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
