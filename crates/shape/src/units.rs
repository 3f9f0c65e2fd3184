//! Finds members of a group whose lengths seem to be in a different unit from those of the other members.
//!
//! The size of a member is its root mean square radius: the norm of its coefficients without row 0, divided by
//! `sqrt(4 pi)`. Let the quotient of a member be its size divided by the median size. A member is reported if two
//! conditions hold. First, its quotient is near the ratio of two common units. Second, the absolute value of the
//! quotient's logarithm is above [`FAR`] times the group's spread. The spread is 1.4826 times the median of these
//! absolute values over all members.

use std::fmt;

use spharm_harmonics::Coefficients;
use spharm_monitor::number;

use crate::outliers::{FAR, LEAST, median};
use crate::transform::SQRT_4_PI;

/// Ratios of common units of length, each with the phrase that describes the ratio in messages.
const FACTORS: [(f64, &str); 6] = [
    (1e-3, "1/1000 of"),
    (1.0 / 25.4, "1/25.4 of"),
    (0.1, "1/10 of"),
    (10.0, "10 times"),
    (25.4, "25.4 times"),
    (1e3, "1000 times"),
];

/// Returns the ratio of two units of length as a phrase, such as `10 times`, if `ratio` indicates a wrong unit. `ratio`
/// is a length divided by the usual length.
#[must_use]
pub fn unit_factor(ratio: f64) -> Option<&'static str> {
    FACTORS.into_iter().find(|(factor, _)| (0.75..1.33).contains(&(ratio / factor))).map(|(_, text)| text)
}

/// Warning that the lengths of a member seem to be in a different unit from those of the other members.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OtherUnit {
    /// Index of the member, from 0.
    pub member: usize,
    /// Root mean square radius of the member.
    pub radius: f64,
    /// Median of the members' radii.
    pub median: f64,
    /// Ratio of the units as a phrase, such as `10 times`.
    pub factor: &'static str,
}

impl OtherUnit {
    /// Returns the warning's text without the member's number.
    #[must_use]
    pub fn of_member(&self) -> String {
        let Self { radius, median, factor, .. } = self;
        format!(
            "the root mean square radius is {}, but the median is {}: the lengths may be in another unit, because they \
             are about {factor} the lengths of the others; use the same unit for all models",
            number(*radius),
            number(*median)
        )
    }
}

impl fmt::Display for OtherUnit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "member {}: {}", self.member, self.of_member())
    }
}

/// Returns the members whose lengths seem to be in a different unit from those of the others, in the group's order. A
/// group of fewer than [`LEAST`] members has no such members.
#[must_use]
pub fn other_units(members: &[Coefficients]) -> Vec<OtherUnit> {
    if members.len() < LEAST {
        return Vec::new();
    }
    let radii: Vec<f64> = members.iter().map(radius).collect();
    let middle = median(&radii);
    let apart: Vec<f64> = radii.iter().map(|radius| (radius / middle).ln().abs()).collect();
    let limit = FAR * 1.4826 * median(&apart);
    let of = |(member, (&radius, &apart)): (usize, (&f64, &f64))| {
        let factor = unit_factor(radius / middle).filter(|_| apart > limit)?;
        Some(OtherUnit { member, radius, median: middle, factor })
    };
    radii.iter().zip(&apart).enumerate().filter_map(of).collect()
}

fn radius(member: &Coefficients) -> f64 {
    let values = || member.values().iter().skip(member.channels());
    // Values are scaled by the largest one, so that squares stay in range for any unit.
    let largest = values().fold(0.0_f64, |largest, value| largest.max(value.abs()));
    let square: f64 = values().map(|value| (value / largest).powi(2)).sum();
    if largest > 0.0 { largest * square.sqrt() / SQRT_4_PI } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::samples::blob;

    fn group(factors: &[f64]) -> Vec<Coefficients> {
        let member = |(seed, factor): (u32, &f64)| Coefficients::new(blob(3, seed).values() * *factor).unwrap();
        (0..).zip(factors).map(member).collect()
    }

    #[test]
    fn members_in_other_units_are_found() {
        let found = other_units(&group(&[1.0, 1e3, 1.1, 0.95, 10.0, 1.05, 1.0, 0.9]));
        let named: Vec<_> = found.iter().map(|of| (of.member, of.factor)).collect();
        assert_eq!(named, [(1, "1000 times"), (4, "10 times")]);
        let text = found[1].to_string();
        assert!(text.starts_with("member 4: ") && text.contains("about 10 times the lengths of the others"), "{text}");
        let found = other_units(&group(&[1.0, 1.0, 1.0, 1.0, 0.1]));
        assert!(matches!(found[..], [OtherUnit { member: 4, factor: "1/10 of", .. }]), "{found:?}");
    }

    #[test]
    fn groups_of_one_unit_are_not_warned_of() {
        assert!(other_units(&group(&[1.0, 1.2, 0.8, 4.0, 1.1])).is_empty());
        // The sizes in this group vary as much as units of length do, so no size indicates another unit.
        assert!(other_units(&group(&[1.0, 3.0, 10.0, 0.3, 0.1])).is_empty());
        // A group of four members is too small to detect another unit, and points have no size.
        assert!(other_units(&group(&[1.0, 1.0, 1.0, 10.0])).is_empty());
        assert!(other_units(&group(&[0.0; 6])).is_empty() && other_units(&[]).is_empty());
    }

    #[test]
    fn only_ratios_of_units_are_taken_for_wrong_units() {
        assert_eq!(
            [9.0, 24.0, 1.0 / 1100.0].map(unit_factor),
            [Some("10 times"), Some("25.4 times"), Some("1/1000 of")]
        );
        assert_eq!([1.5, 100.0, f64::NAN, f64::INFINITY].map(unit_factor), [None; 4]);
    }
}
