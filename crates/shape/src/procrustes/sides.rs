//! Groups of both sides: left members and right ones, about as many of each.
//!
//! The mean of such a group is of neither side, so that each member is about as far from it as its mirror image, and
//! none stands out ([`mirrored`](super::mirrored)). So where members and their mirror images are hardly told apart the
//! group is brought together once more, with mirror images matched: then all members are on one side, and those that
//! were mirrored for it are the other one. Near-symmetric shapes are mirrored at random by that, and of each the hand
//! that happens to fit better is taken. A group is of two sides where it matters,
//!
//! ```text
//! ln(spread / spread with mirror images) > 0.2
//! ```
//!
//! and its members' sides are known where, with x = ln(image / own) of each beside the others, all in the hand that
//! they have then,
//!
//! ```text
//! median > 0.5,   least > 0
//! ```
//!
//! Measured over 300 groups of 4 to 20 ellipsoids with differences at random the first is -0.04 to 0.06, of five right
//! hippocampi as they are 0.10, of any of them mirrored 0.39 to 0.53; the median is -0.04 to 0.23, and 0.3 to 0.5 for
//! hippocampi, whose own differences lead to another parting than that of the sides. docs/algorithms/alignment.md has a
//! table of both.

use super::mirrored::{Judged, median};
use super::{Group, ProcrustesWarning};
use crate::error::ShapeError;
use crate::group::Round;

/// The least log of the spreads' ratio of a group of two sides.
const MATTERS: f64 = 0.2;
/// The least median of the members' logs where their sides are known.
const KNOWN: f64 = 0.5;

impl Group<'_> {
    /// What to say of a group of two sides: the members of the smaller one; of two that are alike, of the one that the
    /// first member isn't on.
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
        // Which of them were mirrored is up to the first member.
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
