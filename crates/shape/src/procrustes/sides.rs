//! Detects groups that mix two sides: left and right members in about equal numbers.
//!
//! The mean of such a group belongs to neither side. Each member is then about as far from the mean as its mirror
//! image, and no member stands out ([`mirrored`](super::mirrored)). So if members and their mirror images hardly
//! differ, the group is aligned once more, with mirror images matched. This brings all members to one side; the members
//! that had to be mirrored belong to the other side. Nearly symmetric shapes are mirrored at random, depending on which
//! handedness happens to fit better. A group is therefore treated as two-sided only if mirroring matters,
//!
//! ```text
//! ln(spread / spread with mirror images) > 0.2
//! ```
//!
//! The sides of its members are known only if the logarithms x = ln(image / own), computed for each member against the
//! others after the members have been mirrored as needed, satisfy
//!
//! ```text
//! median > 0.5,   least > 0
//! ```
//!
//! In 300 groups of 4 to 20 ellipsoids with random differences, the logarithm of the ratio of spreads was -0.04 to
//! 0.06. It was 0.10 for five correct hippocampi, and 0.39 to 0.53 if one to four of them were mirrored. The median of
//! x was -0.04 to 0.23 for the ellipsoids, and 0.3 to 0.5 for hippocampi, whose differences from each other lead to a
//! partition other than into left and right. See docs/algorithms/alignment.md for a table of both quantities.

use super::mirrored::{Judged, median};
use super::{Group, ProcrustesWarning};
use crate::error::ShapeError;
use crate::group::Round;

/// A group is two-sided if ln(spread / spread with mirror images) exceeds this value.
const MATTERS: f64 = 0.2;
/// Median of the logarithms x above which the members' sides are known.
const KNOWN: f64 = 0.5;

impl Group<'_> {
    /// Returns a warning if the group mixes two sides. The warning lists the members of the smaller side; if both sides
    /// have the same size, those of the side without the first member.
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
