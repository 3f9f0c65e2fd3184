//! Detects groups that mix two sides: left and right members in about equal numbers.
//!
//! The mean of such a group belongs to neither side, so that each member is about as far from it as its mirror image,
//! and none stands out ([`mirrored`](super::mirrored)). So if members and their mirror images hardly differ, the group
//! is aligned once more, with mirror images matched: this brings all members to one side, and the members that were
//! mirrored for it are the other side. This mirrors near-symmetric shapes at random, because for each the handedness
//! that happens to fit better is taken. A group is treated as two-sided if mirroring matters,
//!
//! ```text
//! ln(spread / spread with mirror images) > 0.2
//! ```
//!
//! and its members' sides are known if, with x = ln(image / own) of each member against the others, all in their
//! resulting handedness,
//!
//! ```text
//! median > 0.5,   least > 0
//! ```
//!
//! In 300 groups of 4 to 20 ellipsoids with random differences, the logarithm of the ratio of spreads was -0.04 to
//! 0.06; it was 0.10 for five correct hippocampi, and 0.39 to 0.53 with any of them mirrored. The median of x was -0.04
//! to 0.23 for the ellipsoids, and 0.3 to 0.5 for hippocampi, whose own differences lead to a partition other than the
//! sides. docs/algorithms/alignment.md has a table of both quantities.

use super::mirrored::{Judged, median};
use super::{Group, ProcrustesWarning};
use crate::error::ShapeError;
use crate::group::Round;

/// Minimum log of the ratio of the spreads for a group of two sides.
const MATTERS: f64 = 0.2;
/// Minimum median of the members' logs for their sides to be known.
const KNOWN: f64 = 0.5;

impl Group<'_> {
    /// Returns a warning for a group of two sides, with the members of the smaller side; if both sides have the same
    /// size, of the side without the first member.
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
        // Which side was mirrored depends on the first member.
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
