//! Finds values of a group that are far from the other values, members that dominate a mode, and duplicate members.
//!
//! The robust z of a value is its deviation from the median, divided by a measure s of the group's spread. A few
//! extreme values have little effect on s:
//!
//! ```text
//! z = (x - median) / s,  s = 1.4826 MAD
//! ```
//!
//! MAD is the median absolute deviation: the median of the distances from the median. With the factor 1.4826, s is the
//! standard deviation if the values are normally distributed. If more than half of the values are equal, s is 1.2533
//! times the mean distance from the median. (If all but one of seven or more values are equal, the remaining value is
//! then an outlier.) The method is from B. Iglewicz and D. Hoaglin, "How to Detect and Handle Outliers" (1993).

use std::collections::HashMap;

use spharm_harmonics::Coefficients;
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Absolute robust z above which a value is an outlier.
pub const FAR: f64 = 3.5;
/// Minimum number of values for which outliers are reported.
pub const LEAST: usize = 5;

/// A value that is far from the other values.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outlier {
    /// Index of the value, from 0.
    pub index: usize,
    /// Value of the outlier.
    pub value: f64,
    /// Median of all values.
    pub median: f64,
    /// Robust z of the value.
    pub z: f64,
}

/// Returns the robust z of each value; zeros if all values are equal.
#[must_use]
pub fn robust_z(values: &[f64]) -> Vec<f64> {
    let centre = median(values);
    let distances: Vec<f64> = values.iter().map(|value| (value - centre).abs()).collect();
    let of_mean = 1.2533 * distances.iter().sum::<f64>() / values.len().max(1) as f64;
    let spread = Some(1.4826 * median(&distances)).filter(|spread| *spread > 0.0).unwrap_or(of_mean);
    let z = |value: &f64| if spread > 0.0 { (value - centre) / spread } else { 0.0 };
    values.iter().map(z).collect()
}

/// Returns the values whose robust z is above [`FAR`] in absolute value, the farthest first; none for fewer than
/// [`LEAST`] values.
#[must_use]
pub fn outliers(values: &[f64]) -> Vec<Outlier> {
    if values.len() < LEAST {
        return Vec::new();
    }
    let centre = median(values);
    let all = robust_z(values).into_iter().enumerate();
    let mut found: Vec<Outlier> = all
        .filter(|(_, z)| z.abs() > FAR)
        .map(|(index, z)| Outlier { index, value: values[index], median: centre, z })
        .collect();
    found.sort_by(|a, b| b.z.abs().total_cmp(&a.z.abs()));
    found
}

/// A member that causes most of the variance of a mode.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Influence {
    /// Index of the member, from 0.
    pub index: usize,
    /// Fraction by which the variance along the mode decreases without the member; above 0.5, and at most 1.
    pub share: f64,
}

/// Significance level of Grubbs' test: the most extreme score is an outlier if its p value is below this level.
const IMPROBABLE: f64 = 1e-3;

/// Returns the member, if any, that dominates a mode, given the scores of all members along the mode. Without this
/// member the variance of the scores falls by more than half, and the member's score is an outlier by Grubbs' test at
/// the level 0.001.
///
/// F. Grubbs, "Procedures for Detecting Outlying Observations in Samples", Technometrics 11 (1969).
#[must_use]
pub fn influential(scores: &[f64]) -> Option<Influence> {
    if scores.len() < LEAST {
        return None;
    }
    let n = scores.len() as f64;
    let mean = scores.iter().sum::<f64>() / n;
    let squares: f64 = scores.iter().map(|score| (score - mean).powi(2)).sum();
    let (index, far) =
        scores.iter().map(|score| (score - mean).powi(2)).enumerate().max_by(|a, b| a.1.total_cmp(&b.1))?;
    if squares <= 0.0 {
        return None;
    }
    // If the member is left out, the mean moves too, so the sum of squares falls by `far` n / (n - 1).
    let left = (1.0 - far * n / (n - 1.0) / squares).max(0.0);
    let share = 1.0 - left * (n - 1.0) / (n - 2.0);
    // The member's deviation, divided by the standard deviation of the other members, has a t distribution with n - 2
    // degrees of freedom.
    let t = if left > 0.0 { ((1.0 - left) / left * (n - 2.0)).sqrt() } else { f64::INFINITY };
    let tail = StudentsT::new(0.0, 1.0, n - 2.0).map_or(0.0, |distribution| distribution.sf(t));
    (share > 0.5 && 2.0 * n * tail < IMPROBABLE).then_some(Influence { index, share })
}

/// Returns the sets of members of a group that are bitwise equal, each as a list of indices in the group's order.
#[must_use]
pub fn equal_members(members: &[Coefficients]) -> Vec<Vec<usize>> {
    let mut places: HashMap<Vec<u64>, usize> = HashMap::new();
    let mut sets: Vec<Vec<usize>> = Vec::new();
    for (index, member) in members.iter().enumerate() {
        // Members are first grouped by a key that consists of their first values. Different members normally have
        // different keys, so few members are compared completely.
        let key: Vec<u64> = member.values().iter().take(KEY).map(|value| value.to_bits()).collect();
        let set = *places.entry(key).or_insert_with(|| {
            sets.push(Vec::new());
            sets.len() - 1
        });
        sets[set].push(index);
    }
    let mut found = Vec::new();
    for set in sets.into_iter().filter(|set| set.len() > 1) {
        let mut rest = set;
        while let Some(&first) = rest.first() {
            let (equal, others): (Vec<usize>, Vec<usize>) =
                rest.into_iter().partition(|index| equal(&members[*index], &members[first]));
            found.extend((equal.len() > 1).then_some(equal));
            rest = others;
        }
    }
    found
}

fn equal(a: &Coefficients, b: &Coefficients) -> bool {
    let (a, b) = (a.values(), b.values());
    a.dim() == b.dim() && a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits())
}

/// Number of coefficients in the key by which members are first compared.
const KEY: usize = 12;

/// Returns the median; 0 for no values.
#[must_use]
pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    match sorted.len() {
        0 => 0.0,
        count => 0.5 * (sorted[(count - 1) / 2] + sorted[count / 2]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::samples::blob;

    #[test]
    fn a_wrong_voxel_size_is_far_from_the_others() {
        let volumes = [2002.0, 1175.0, 2806.0, 238_319.0, 1930.0, 2210.0, 2100.0, 1890.0, 2045.0];
        let [far, small] = outliers(&volumes)[..] else { panic!("{:?}", outliers(&volumes)) };
        assert_eq!((far.index, far.value, far.median), (3, 238_319.0, 2045.0));
        assert!(far.z > 900.0 && far.z < 1100.0, "{far:?}");
        // The second outlier is just above the threshold, with z = (1175 - 2045) / (1.4826 * 155).
        assert!(small.index == 1 && (small.z + 3.7859).abs() < 1e-4, "{small:?}");
        assert!(outliers(&volumes[..4]).is_empty(), "four values tell nothing");
    }

    #[test]
    fn z_is_that_of_normal_values() {
        // The values are quantiles of the normal distribution.
        let values = [-1.2816, -0.8416, -0.5244, -0.2533, 0.0, 0.2533, 0.5244, 0.8416, 1.2816];
        let z = robust_z(&values.map(|value| 40.0 + 3.0 * value));
        for (z, value) in z.iter().zip(values) {
            assert!((z / 1.2863 - value).abs() < 1e-3, "{z} {value}");
        }
        assert_eq!(robust_z(&[2.0; 6]), [0.0; 6]);
        // More than half of the values are equal.
        let [only] = outliers(&[1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 9.0])[..] else { panic!("one") };
        assert_eq!(only.index, 7);
        assert!(robust_z(&[]).is_empty());
    }

    #[test]
    fn a_member_that_makes_a_mode_is_found() {
        let scores = [3.0, -2.0, 1.0, 0.5, -1.5, 240.0, 2.2, -0.7, -2.5, 0.1];
        let found = influential(&scores).unwrap();
        let others: Vec<f64> = scores.iter().copied().filter(|score| *score < 100.0).collect();
        let variance = |scores: &[f64]| {
            let mean = scores.iter().sum::<f64>() / scores.len() as f64;
            scores.iter().map(|score| (score - mean).powi(2)).sum::<f64>() / (scores.len() - 1) as f64
        };
        assert_eq!(found.index, 5);
        assert!((found.share - (1.0 - variance(&others) / variance(&scores))).abs() < 1e-12, "{found:?}");
        // Without the outlier, no other member dominates the mode.
        assert_eq!(influential(&others), None);
        // With only five scores, one distant score isn't improbable enough to be an outlier. Equal scores have no
        // variance.
        assert_eq!(influential(&[0.0, 0.2, -0.1, 0.1, 1.0]), None);
        assert_eq!(influential(&[1.0; 6]), None);
        let all = influential(&[0.0, 0.0, 0.0, 0.0, 0.0, 1.0]).unwrap();
        assert!(all.index == 5 && (all.share - 1.0).abs() < 1e-12, "{all:?}");
    }

    #[test]
    fn members_that_are_there_twice_are_found() {
        let mut other = blob(3, 1).values().clone();
        other[[15, 2]] += 1e-9;
        let other = Coefficients::new(other).unwrap();
        let group = [blob(3, 1), blob(3, 2), blob(3, 1), other, blob(3, 2), blob(3, 1), blob(3, 4)];
        assert_eq!(equal_members(&group), [vec![0, 2, 5], vec![1, 4]]);
        let not_a_number = Coefficients::new(blob(3, 1).values().mapv(|_| f64::NAN)).unwrap();
        assert_eq!(equal_members(&[not_a_number.clone(), not_a_number]), [vec![0, 1]]);
        assert!(equal_members(&group[..2]).is_empty() && equal_members(&[]).is_empty());
    }
}
