//! Finds the body side (left or right) that a name states, and warns of groups that mix both sides.

use super::GroupPoseWarning;
use crate::hemisphere::Hemisphere;

/// A group may mix two sides if a quarter of its members, and at least this number of members, seem mirrored. The
/// second condition is needed because in a group of four, a single member is already a quarter.
const FEWEST: usize = 2;
/// Largest number of members that a warning names.
const MOST: usize = 12;

impl Hemisphere {
    /// Returns the side that a name states, and the rest of the name. For example, returns left and `s1` for `s1_L`,
    /// `lh.s1` and `left-s1`. The parts of a name consist of letters and digits. A single letter states a side only if
    /// no other part does. The side is `None` if no part states a side, or if parts state both sides.
    #[must_use]
    pub fn and_rest_of(name: &str) -> (Option<Self>, String) {
        let parts: Vec<&str> = name.split(|c: char| !c.is_alphanumeric()).filter(|part| !part.is_empty()).collect();
        let of_hemi = |at: usize| at > 0 && parts[at - 1].eq_ignore_ascii_case("hemi");
        let stated = |letters: bool| -> Vec<Option<Self>> {
            let is_letter = |at: usize| parts[at].len() == 1 && !of_hemi(at);
            (0..parts.len()).map(|at| Self::of_side(parts[at]).filter(|_| is_letter(at) == letters)).collect()
        };
        let mut sides = stated(false);
        if sides.iter().all(Option::is_none) {
            sides = stated(true);
        }
        let rest: Vec<&str> =
            parts.iter().zip(&sides).filter(|(_, side)| side.is_none()).map(|(part, _)| *part).collect();
        let mut found = sides.iter().flatten();
        let first = found.next().copied();
        (first.filter(|side| found.all(|other| other == side)), rest.join("_"))
    }
}

impl GroupPoseWarning {
    /// Returns a warning that the group seems to mix two sides, if the mirror images of a quarter or more of the
    /// members fit the others better. The members that are reported as mirrored may be from both sides in this case.
    /// `members` has the name of each member, and whether the member was mirrored.
    #[must_use]
    pub fn two_sides<'a>(warnings: impl IntoIterator<Item = &'a Self>, members: &[(&str, bool)]) -> Option<String> {
        let is_mirrored = |warning: &&Self| matches!(warning, Self::Mirrored { .. });
        let (count, of) = (warnings.into_iter().filter(is_mirrored).count(), members.len());
        if count < FEWEST || 4 * count < of {
            return None;
        }
        let of_side = |wanted: Hemisphere| -> Vec<&str> {
            let side = |(name, mirrored): &(&str, bool)| {
                let stated = Hemisphere::and_rest_of(name).0;
                if *mirrored { stated.map(Hemisphere::opposite) } else { stated }
            };
            members.iter().filter(|member| side(member) == Some(wanted)).map(|(name, _)| *name).collect()
        };
        let [left, right] = [Hemisphere::Left, Hemisphere::Right].map(of_side);
        let named = match (left.len(), right.len()) {
            (0, _) | (_, 0) => String::new(),
            // The list is left out if members were mirrored, because their names state the side before mirroring.
            _ if members.iter().any(|(_, mirrored)| *mirrored) => String::new(),
            (l, r) => {
                let (side, names) = if l < r { (Hemisphere::Left, left) } else { (Hemisphere::Right, right) };
                let more = match names.len().saturating_sub(MOST) {
                    0 => String::new(),
                    more => format!(" and {more} more"),
                };
                let first: Vec<&str> = names.iter().take(MOST).copied().collect();
                format!("; judging by their names, the members of the {side} side are {}{more}", first.join(", "))
            }
        };
        Some(format!(
            "the group seems to mix two sides, such as left and right: the mirror images of {count} of {of} members \
             fit better, but these members may be from both sides; mirror all members of one side, and no others \
             (--mirrored, in Python mirrored){named}"
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_state_sides() {
        let (left, right) = (Some(Hemisphere::Left), Some(Hemisphere::Right));
        for (name, side) in [
            ("s1_L", left),
            ("s1-R", right),
            ("s1.l", left),
            ("lh.s1", left),
            ("s1_rh", right),
            ("Left-s1", left),
            ("R_s1_lh", left),
            ("s1", None),
            ("rhs1", None),
            ("L_s1_R", None),
        ] {
            let (found, rest) = Hemisphere::and_rest_of(name);
            assert_eq!(found, side, "{name}");
            assert!(rest.ends_with("s1"), "{name}: {rest}");
        }
        assert_eq!(Hemisphere::and_rest_of("sub-01_hemi-R_pial"), (right, "sub_01_hemi_pial".to_owned()));
    }

    #[test]
    fn groups_of_two_sides_are_noticed() {
        let mirrored = |member| GroupPoseWarning::Mirrored { member, distance: 1.0, mirrored: 0.5 };
        let names = ["a_L", "a_R", "b_L", "b_R", "c_L", "c_R"];
        let members = names.map(|name| (name, false));
        let of = |warnings: &[GroupPoseWarning], members: &[(&str, bool)]| {
            GroupPoseWarning::two_sides(warnings, members).unwrap_or_default()
        };
        let found = of(&[0, 3].map(mirrored), &members);
        assert!(found.contains("2 of 6 members") && found.ends_with("of the right side are a_R, b_R, c_R"), "{found}");
        let fewer = of(&[0, 3].map(mirrored), &members[..5]);
        assert!(fewer.ends_with("of the right side are a_R, b_R"), "{fewer}");
        // All members with names of the right side have been mirrored, so now all members have the shape of one side.
        let done = names.map(|name| (name, name.ends_with('R')));
        assert!(of(&[0, 3].map(mirrored), &done).ends_with("mirrored)"));
        assert_eq!(of(&[mirrored(1)], &members[..4]), "");
        let many: Vec<(&str, bool)> = members.iter().cycle().take(12).copied().collect();
        assert_eq!(of(&[0, 3].map(mirrored), &many), "");
        let far = GroupPoseWarning::Far { member: 1, distance: 1.0, median: 0.1 };
        assert_eq!(of(&[mirrored(0), far], &members), "");
    }
}
