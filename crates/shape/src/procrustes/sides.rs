//! Detects groups that mix two sides: left and right members in about equal numbers.
//!
//! The mean of such a group belongs to neither side. Each member is then about as far from the mean as its mirror
//! image, so the search for single mirrored members ([`mirrored`](super::mirrored)) finds none. If members and their
//! mirror images are about equally far from the mean, the group is therefore aligned once more, with mirror images
//! matched. This alignment brings all members to one side. The members that it mirrored belong to the other side.
//! Nearly symmetric shapes are mirrored at random, because either handedness may fit slightly better. A group is
//! therefore treated as two-sided only if mirroring matters,
//!
//! ```text
//! ln(spread / spread with mirror images) > 0.2
//! ```
//!
//! The second alignment mirrors members as needed. For each member, the logarithm x = ln(image / own) is then computed,
//! where `own` is the member's distance from the mean of the other members, and `image` is the distance of its mirror
//! image. The sides of the members are known only if these logarithms satisfy
//!
//! ```text
//! median > 0.5,   minimum > 0
//! ```
//!
//! In 300 groups of 4 to 20 ellipsoids with random differences, the logarithm of the ratio of spreads was -0.04 to
//! 0.06. It was 0.10 for five unmirrored hippocampi, and 0.39 to 0.53 if one to four of them were mirrored. The median
//! of x was -0.04 to 0.23 for the ellipsoids, and 0.3 to 0.5 for hippocampi. Hippocampi differ so much from each other
//! that the alignment doesn't separate left from right. See docs/algorithms/alignment.md for a table of both
//! quantities.

use super::mirrored::{Judged, median};
use super::{Group, ProcrustesWarning};
use crate::error::ShapeError;
use crate::group::Round;

/// A group is two-sided if ln(spread / spread with mirror images) exceeds this value.
const MATTERS: f64 = 0.2;
/// The members' sides are known only if the median of the members' logarithms x (see the [module](self)) exceeds this
/// value.
const KNOWN: f64 = 0.5;

impl Group<'_> {
    /// Returns a warning if the group mixes two sides. The warning lists the members of the smaller side. If both sides
    /// have the same size, it lists the members of the side without the first member.
    pub(super) fn sides(&mut self, plain: &Round) -> Result<Option<ProcrustesWarning>, ShapeError> {
        self.mirror = true;
        let found = self.matched(plain);
        self.mirror = false;
        found
    }

    fn matched(&self, plain: &Round) -> Result<Option<ProcrustesWarning>, ShapeError> {
        let (round, ..) = self.settle(self.brought_to(0)?)?;
        if (plain.spread / round.spread.max(f64::MIN_POSITIVE)).ln() <= MATTERS {
            return Ok(None);
        }
        // All members were aligned to the first member, so its handedness determines which side was mirrored.
        let hand = |member: usize| round.members[member].pose.mirrors();
        let (first, second): (Vec<usize>, Vec<usize>) =
            (0..self.units.len()).partition(|member| hand(*member) == hand(0));
        if second.is_empty() {
            return Ok(None);
        }
        let logs: Vec<f64> = self.judged(&round)?.iter().filter_map(Judged::log).collect();
        let known = logs.iter().all(|log| *log > 0.0) && median(logs) > KNOWN;
        let smaller = if first.len() < second.len() { first } else { second };
        Ok(Some(ProcrustesWarning::Sides {
            members: if known { smaller } else { Vec::new() },
            of: self.units.len(),
            spread: plain.spread,
            mirrored: round.spread,
        }))
    }
}
