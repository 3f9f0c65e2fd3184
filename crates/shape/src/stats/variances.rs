//! Detects groups of unequal size and variance, for which pooled variances give wrong p values.

use ndarray::{ArrayView1, ArrayView2};

use super::design::{Contrast, Design, orthonormalise};
use super::projection::without;
use super::{Remedy, TestWarning};

/// Threshold for a warning about two groups: the ratio of their sizes and the ratio of their variances must both exceed
/// this number. In a design of g > 2 groups, the largest ratio of variances of all pairs is larger by chance. Therefore
/// the ratio of variances must exceed this number to the power of g - 1.
const RATIO: f64 = 1.5;
/// A group's variance is compared only if the group's errors have at least this number of degrees of freedom.
const LEAST_FREEDOM: f64 = 2.0;
/// Maximum number of groups that are compared. A column with more distinct values is treated as a continuous effect.
const MOST_GROUPS: usize = 12;

/// Subjects with equal values in the tested columns.
struct Group {
    name: String,
    members: Vec<usize>,
    variance: f64,
}

/// Compares the residual variances of groups of subjects, summed over all columns of `values` (n, V d), which has a row
/// for each of the n subjects and d columns for each of the V vertices. A group consists of the subjects with equal
/// values in the columns that the contrast tests, which must be columns of zeros and ones (levels) or a single column
/// with two distinct values. Of all pairs of groups whose sizes and variances both differ by more than the thresholds
/// (see [`RATIO`]), returns a warning about the pair with the largest ratio of variances.
pub(crate) fn unequal(
    values: ArrayView2<'_, f64>,
    components: usize,
    design: &Design,
    contrast: &Contrast,
) -> Option<TestWarning> {
    let mut groups = groups(design, contrast)?;
    let x = design.matrix();
    let (basis, _) = orthonormalise(x);
    let residuals = without(basis.view(), values.to_owned());
    for group in &mut groups {
        let (mut squares, mut freedom) = (0.0, 0.0);
        for &i in &group.members {
            squares += residuals.row(i).iter().map(|value| value * value).sum::<f64>();
            freedom += 1.0 - basis.row(i).iter().map(|value| value * value).sum::<f64>();
        }
        // The variance of a group with too few degrees of freedom is NaN. No comparison with NaN is true, so the group
        // is ignored.
        group.variance = if freedom > LEAST_FREEDOM - 1e-9 { squares / freedom } else { f64::NAN };
    }
    let more = |a: f64, b: f64| a > RATIO * b;
    let wider = |a: f64, b: f64| a > RATIO.powi(groups.len() as i32 - 1) * b;
    let size = |group: &Group| group.members.len() as f64;
    let differ = |a: &Group, b: &Group| more(size(a), size(b)) || more(size(b), size(a));
    let pairs = groups.iter().flat_map(|wide| groups.iter().map(move |narrow| (wide, narrow)));
    let pairs = pairs.filter(|(wide, narrow)| wider(wide.variance, narrow.variance) && differ(wide, narrow));
    let (wide, narrow) =
        pairs.max_by(|a, b| (a.0.variance / a.1.variance).total_cmp(&(b.0.variance / b.1.variance)))?;
    Some(TestWarning::UnequalVariances {
        wide: wide.name.clone(),
        wide_subjects: wide.members.len(),
        narrow: narrow.name.clone(),
        narrow_subjects: narrow.members.len(),
        ratio: wide.variance / narrow.variance,
        remedy: match (design.two_groups().is_some(), components) {
            (true, _) => Some(Remedy::Welch),
            (false, 1) => Some(Remedy::VarianceGroups),
            (false, _) => None,
        },
    })
}

/// Returns the groups of subjects with equal values in the tested columns; `None` if these columns hold a continuous
/// effect or a mean and therefore define no groups.
fn groups(design: &Design, contrast: &Contrast) -> Option<Vec<Group>> {
    let (x, weights) = (design.matrix(), &contrast.weights);
    let columns: Vec<usize> = (0..x.ncols()).filter(|at| weights.column(*at).iter().any(|w| *w != 0.0)).collect();
    let tested = x.select(ndarray::Axis(1), &columns);
    let mut groups: Vec<(usize, Group)> = Vec::new();
    for (i, row) in tested.rows().into_iter().enumerate() {
        let equal = groups.iter().position(|(first, _)| tested.row(*first) == row);
        match equal {
            Some(group) => groups[group].1.members.push(i),
            None if groups.len() == MOST_GROUPS => return None,
            None => groups.push((i, Group { name: String::new(), members: vec![i], variance: f64::NAN })),
        }
    }
    let indicate = tested.iter().all(|value| *value == 0.0 || *value == 1.0);
    let two_numbers = columns.len() == 1 && groups.len() == 2;
    if groups.len() < 2 || !(indicate || two_numbers) {
        return None;
    }
    let least = tested.iter().copied().fold(f64::INFINITY, f64::min);
    for (first, group) in &mut groups {
        group.name = match indicate {
            true => level(tested.row(*first), &columns, design),
            false if tested[[*first, 0]] == least => format!("subjects with the lower {}", design.names()[columns[0]]),
            false => format!("subjects with the higher {}", design.names()[columns[0]]),
        };
    }
    Some(groups.into_iter().map(|(_, group)| group).collect())
}

/// Returns the name of the level that a row of ones and zeros indicates.
fn level(row: ArrayView1<'_, f64>, columns: &[usize], design: &Design) -> String {
    let ones = row.iter().zip(columns).filter(|(value, _)| **value == 1.0);
    let names: Vec<&str> = ones.map(|(_, column)| design.names()[*column].as_str()).collect();
    if names.is_empty() { "the other subjects".to_owned() } else { names.join(" and ") }
}
