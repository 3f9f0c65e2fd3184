//! Members of a group that are mirror images of what they should be.
//!
//! Each member and its mirror image are brought to the mean of the *others*: in a mean that it is part of, a mirrored member finds
//! itself. Of the two distances the log of the ratio, x = ln(image / own), is above zero where the member belongs to the others as
//! it is. How far depends on the shape: 0 where it is its own mirror image, and of a group in which left and right differ about
//! the same for all, so that a mirrored member has about -x. A member is named where
//!
//! ```text
//! x < -0.1,   median > 0.1,   median - x > 5 s
//! ```
//!
//! with s the members' median absolute deviation from the median, over 0.6745. Measured over generated groups of 6 and 20, of
//! bodies that differ from each other by as much as from an ellipsoid: members as they are 0.19 or above, mirrored ones -0.16 or
//! below, one or three of 20; ellipsoids with as much at random, -0.08 or above. Five right hippocampi have x from -0.2 to 0.5: none
//! is named as they are, and of one that is mirrored among them mostly nothing is said.

use spharm_monitor::OnlyCancel;

use super::{Group, ProcrustesWarning};
use crate::error::ShapeError;
use crate::group::{Pose, Round};
use crate::pair::object_only;
use crate::refine::Target;

/// Members whose spread means something, at least.
const LEAST: usize = 4;
/// How far from zero the logs of members and of mirrored ones are, at least.
const CLEAR: f64 = 0.1;
/// How far a mirrored member's is from the others', in their spread.
const FAR: f64 = 5.0;
/// Distances of surfaces of norm 1 below this are rounding.
const SAME: f64 = 1e-7;

/// The middle of numbers; zero of none.
fn median(mut numbers: Vec<f64>) -> f64 {
    numbers.sort_unstable_by(f64::total_cmp);
    let count = numbers.len();
    if count == 0 { 0.0 } else { 0.5 * (numbers[(count - 1) / 2] + numbers[count / 2]) }
}

impl Group<'_> {
    /// The members that are nearer to the others as mirror images.
    pub(super) fn mirrored(&self, round: &Round) -> Result<Vec<ProcrustesWarning>, ShapeError> {
        if self.units.len() < LEAST {
            return Ok(Vec::new());
        }
        let own = self.each(|index| self.continued(index, round.members[index].pose, &round.without(index)))?;
        let images = self.each(|index| self.as_image(index, &round.without(index)))?;
        let log = |(own, image): (&Pose, &Pose)| -> Option<f64> {
            // Copies of one surface, and points, tell nothing.
            let [own, image] = [own, image].map(|pose| pose.fit.distance);
            (own.max(image) > SAME).then(|| (image.max(SAME) / own.max(SAME)).ln())
        };
        let logs: Vec<Option<f64>> = own.iter().zip(&images).map(log).collect();
        let known: Vec<f64> = logs.iter().copied().flatten().collect();
        let middle = median(known.clone());
        let spread = median(known.iter().map(|x| (x - middle).abs()).collect()) / 0.6745;
        let mut warnings = Vec::new();
        for (member, log) in logs.into_iter().enumerate() {
            if log.is_none_or(|log| -log < CLEAR || middle < CLEAR || middle - log < FAR * spread) {
                continue;
            }
            let rmsd = |pose: &Pose| round.rmsd_of(pose.fit.distance, self.sizes[member]);
            let (rmsd, mirrored) = (rmsd(&own[member]), rmsd(&images[member]));
            warnings.push(ProcrustesWarning::Mirrored { member, rmsd, mirrored });
        }
        Ok(warnings)
    }

    /// A member refined to a target from the pose that it has.
    fn continued(&self, index: usize, now: Pose, target: &Target) -> Pose {
        let (Some(plan), true) = (&self.plan, self.units[index].norm > 0.0) else {
            return self.searched(index, target, false);
        };
        let other = now.antipodal.then(|| self.units[index].antipodal());
        let unit = other.as_ref().unwrap_or(&self.units[index]);
        let fit = plan.continued(unit, target, now.fit.rotation, false, &OnlyCancel(self.monitor));
        Pose { fit, antipodal: now.antipodal }
    }

    /// The nearer of a member's mirror images: -f(-u), whose outside is outside, and -f(u), which is inside out.
    fn as_image(&self, index: usize, target: &Target) -> Pose {
        if self.units[index].norm == 0.0 {
            return self.searched(index, target, false);
        }
        let inside_out = self.units[index].negative();
        let Some(plan) = &self.plan else {
            return Pose { fit: object_only(&inside_out.rows, &target.rows, false), antipodal: false };
        };
        let search = |image| plan.search(image, target, false, &OnlyCancel(self.monitor)).fit;
        let [outside, inside] = [&inside_out.antipodal(), &inside_out].map(search);
        let fit = if outside.distance <= inside.distance { outside } else { inside };
        Pose { fit, antipodal: false }
    }
}
