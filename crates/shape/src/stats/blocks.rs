//! Defines exchangeability blocks: sets of observations that depend on each other, such as the visits of a subject or
//! the members of a family.
//!
//! Relabellings exchange observations within each block, or exchange whole blocks of the same size (A. M. Winkler, M.
//! A. Webster, D. Vidaurre, T. E. Nichols and S. M. Smith, "Multi-level block permutation", NeuroImage 123, 2015).

use std::collections::BTreeMap;
use std::collections::HashMap;
use std::hash::Hash;

use ndarray::{ArrayView2, Axis};

use super::design::{Design, dot, orthonormalise};

/// Kind of relabelling that blocks allow.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Exchange {
    /// Observations are exchanged only within their block, and signs are flipped independently.
    Within,
    /// Whole blocks of the same size are exchanged, and all signs of a block are flipped together. Three rules
    /// determine which observations of two blocks correspond. If blocks have equal values in columns of the design that
    /// vary within blocks, such as the visit, observations with equal values correspond. Otherwise, if a single column
    /// varies within blocks, such as the age, observations correspond by their rank in this column. The same holds for
    /// several columns that are proportional to each other within each block. In all other cases, observations
    /// correspond by their order in the table.
    Whole,
}

/// Assignment of observations to exchangeability blocks.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Blocks {
    /// Index of each observation's block (n), counted from 0.
    of: Vec<usize>,
    exchange: Exchange,
}

/// Observations that are exchanged together, or whose signs are flipped together.
pub(crate) type Unit = Vec<u32>;

impl Blocks {
    /// Creates blocks from the block names (n) of the observations.
    ///
    /// ```
    /// use spharm_shape::stats::{Blocks, Exchange};
    /// assert_eq!(Blocks::new(["s1", "s1", "s2", "s2"], Exchange::Within).count(), 2);
    /// ```
    pub fn new<T: Eq + Hash>(names: impl IntoIterator<Item = T>, exchange: Exchange) -> Self {
        Self { of: numbered(names), exchange }
    }

    /// Returns the number of observations, n.
    #[must_use]
    pub fn observations(&self) -> usize {
        self.of.len()
    }

    /// Returns the number of blocks.
    #[must_use]
    pub fn count(&self) -> usize {
        self.of.iter().max().map_or(0, |last| last + 1)
    }

    /// Returns the kind of relabelling that the blocks allow.
    #[must_use]
    pub fn exchange(&self) -> Exchange {
        self.exchange
    }

    /// Returns the index of each observation's block (n), counted from 0.
    pub(crate) fn of(&self) -> &[usize] {
        &self.of
    }

    /// Returns whether the design has a separate level for each block of several observations, that is, whether the
    /// span of its columns contains the indicator of each such block. The errors of such a design don't include the
    /// differences between blocks.
    pub(crate) fn are_in(&self, design: &Design) -> bool {
        let (basis, _) = orthonormalise(design.matrix());
        (0..self.count()).all(|block| {
            let members: Vec<usize> = (0..self.of.len()).filter(|i| self.of[*i] == block).collect();
            let along: f64 = basis.select(Axis(0), &members).sum_axis(Axis(0)).iter().map(|sum| sum * sum).sum();
            members.len() == 1 || along > members.len() as f64 - 1e-6
        })
    }

    /// Returns the sets of units that can be exchanged with each other. A unit consists of observations that stay
    /// together. Each observation belongs to one unit.
    pub(crate) fn sets(&self) -> Vec<Vec<Unit>> {
        let mut blocks: Vec<Unit> = vec![Vec::new(); self.count()];
        self.of.iter().enumerate().for_each(|(i, block)| blocks[*block].push(i as u32));
        match self.exchange {
            Exchange::Within => blocks.into_iter().map(|block| block.into_iter().map(|i| vec![i]).collect()).collect(),
            Exchange::Whole => {
                let mut by_size: BTreeMap<usize, Vec<Unit>> = BTreeMap::new();
                blocks.into_iter().for_each(|block| by_size.entry(block.len()).or_default().push(block));
                by_size.into_values().collect()
            }
        }
    }
}

/// Sorts the observations within each block, so that corresponding observations of all blocks of a set have the same
/// position. `x` (n, p) is the design. Also returns whether, in some set, the design varies within blocks but doesn't
/// determine which observations correspond. These observations correspond only by their order.
pub(crate) fn aligned(mut sets: Vec<Vec<Unit>>, x: ArrayView2<'_, f64>) -> (Vec<Vec<Unit>>, bool) {
    let varies = |column: &usize| sets.iter().flatten().any(|unit| varies_in(unit, x, *column));
    let columns: Vec<usize> = (0..x.ncols()).filter(varies).collect();
    // If the design has a column for the slope of each level, an observation is zero in the columns of the other
    // levels. Therefore compare the sums of these columns, which don't depend on the level.
    let sum = |i: u32| vec![columns.iter().map(|column| x[[i as usize, *column]]).sum::<f64>()];
    let mut by_order = false;
    for set in &mut sets {
        let varying =
            |unit: &Unit| columns.iter().copied().filter(|column| varies_in(unit, x, *column)).collect::<Vec<usize>>();
        let varying: Vec<Vec<usize>> = set.iter().map(varying).collect();
        if set.len() == 1 || varying.iter().all(Vec::is_empty) {
            continue;
        }
        // Columns whose values differ between blocks, such as the age, don't determine which observations correspond.
        // The same holds for columns that are constant within all blocks of this set, and vary only in blocks of other
        // sets.
        let is_shared = |column: &usize| {
            varying.iter().any(|columns| columns.contains(column)) && has_equal_values(set, x, *column)
        };
        let shared: Vec<usize> = columns.iter().copied().filter(is_shared).collect();
        let is_sorted = if shared.is_empty() {
            sort_by(set, sum) || sort_by_rank(set, x, &varying)
        } else {
            sort_by(set, |i| shared.iter().map(|column| x[[i as usize, *column]]).collect())
        };
        by_order |= !is_sorted;
    }
    (sets, by_order)
}

fn varies_in(unit: &Unit, x: ArrayView2<'_, f64>, column: usize) -> bool {
    unit.iter().any(|i| x[[*i as usize, column]] != x[[unit[0] as usize, column]])
}

/// Sorts the observations of each unit by the column that varies in the unit, such as the age. Each group may have a
/// separate column for its slope. If several columns vary, they must be proportional to each other within the unit.
/// This is the case if they are a column and its interactions with columns that are constant in the unit. Returns
/// whether the observations were sorted.
fn sort_by_rank(set: &mut [Unit], x: ArrayView2<'_, f64>, varying: &[Vec<usize>]) -> bool {
    let first = varying[0].first();
    let is_common = varying.iter().all(|columns| columns.first() == first);
    let is_ranked = set.iter().zip(varying).all(|(unit, columns)| match columns[..] {
        [_] => true,
        [first, ref others @ ..] => is_common && others.iter().all(|other| is_proportional(unit, x, [first, *other])),
        [] => false,
    });
    if is_ranked {
        for (unit, columns) in set.iter_mut().zip(varying) {
            unit.sort_by(|a, b| x[[*a as usize, columns[0]]].total_cmp(&x[[*b as usize, columns[0]]]));
        }
    }
    is_ranked
}

/// Returns whether two columns are proportional within a unit. The columns aren't centred, because any two centred
/// columns of two numbers are proportional.
fn is_proportional(unit: &Unit, x: ArrayView2<'_, f64>, columns: [usize; 2]) -> bool {
    let [a, b] = columns.map(|column| unit.iter().map(|i| x[[*i as usize, column]]).collect::<Vec<_>>());
    let (ratio, tolerance) = (dot(&a, &b) / dot(&a, &a), 1e-9 * dot(&b, &b).sqrt());
    a.iter().zip(&b).all(|(a, b)| (b - ratio * a).abs() <= tolerance)
}

/// Returns whether all units have the same values in a column, in any order.
fn has_equal_values(set: &[Unit], x: ArrayView2<'_, f64>, column: usize) -> bool {
    let values = |unit: &Unit| {
        let mut values: Vec<f64> = unit.iter().map(|i| x[[*i as usize, column]]).collect();
        values.sort_unstable_by(f64::total_cmp);
        values
    };
    let first = set.first().map(values).unwrap_or_default();
    set.iter().all(|unit| values(unit).iter().zip(&first).all(|(a, b)| close(*a, *b)))
}

fn close(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-9 * a.abs().max(1.0)
}

/// Sorts the observations of each unit by a key, if all units have the same keys. Returns whether this is the case.
fn sort_by(set: &mut [Unit], key: impl Fn(u32) -> Vec<f64>) -> bool {
    let order = |a: &Vec<f64>, b: &Vec<f64>| {
        a.iter().zip(b).map(|(a, b)| a.total_cmp(b)).find(|order| order.is_ne()).unwrap_or(std::cmp::Ordering::Equal)
    };
    let sorted: Vec<Vec<(Vec<f64>, u32)>> = set
        .iter()
        .map(|unit| {
            let mut keyed: Vec<(Vec<f64>, u32)> = unit.iter().map(|i| (key(*i), *i)).collect();
            keyed.sort_by(|a, b| order(&a.0, &b.0));
            keyed
        })
        .collect();
    let all_close = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| close(*a, *b));
    let equal = |unit: &Vec<(Vec<f64>, u32)>| unit.iter().zip(&sorted[0]).all(|(a, b)| all_close(&a.0, &b.0));
    let are_equal = sorted.iter().all(equal);
    if are_equal {
        set.iter_mut().zip(sorted).for_each(|(unit, sorted)| *unit = sorted.into_iter().map(|(_, i)| i).collect());
    }
    are_equal
}

/// Numbers names from 0 in the order of their first occurrence, for example to define variance groups.
///
/// ```
/// assert_eq!(spharm_shape::stats::numbered(["f", "m", "f"]), [0, 1, 0]);
/// ```
#[must_use]
pub fn numbered<T: Eq + Hash>(names: impl IntoIterator<Item = T>) -> Vec<usize> {
    let mut numbers = HashMap::new();
    let of = |name| {
        let next = numbers.len();
        *numbers.entry(name).or_insert(next)
    };
    names.into_iter().map(of).collect()
}

/// Returns whether the i-th observations of two units have equal rows in `rows`, for every i.
pub(crate) fn are_equal(a: &Unit, b: &Unit, rows: ArrayView2<'_, f64>) -> bool {
    let equal = |(a, b): (&u32, &u32)| {
        rows.row(*a as usize).iter().zip(rows.row(*b as usize)).all(|(a, b)| (a - b).abs() <= 1e-12)
    };
    a.iter().zip(b).all(equal)
}

/// Returns a single set of n observations, all of which can be exchanged with each other.
pub(crate) fn free(observations: usize) -> Vec<Vec<Unit>> {
    vec![(0..observations as u32).map(|i| vec![i]).collect()]
}

#[cfg(test)]
mod tests {
    use ndarray::Array2;

    use super::*;

    #[test]
    fn units_are_observations_or_blocks_of_the_same_size() {
        let names = ["a", "b", "a", "c", "c", "d", "d", "d"];
        let within = Blocks::new(names, Exchange::Within).sets();
        assert_eq!(within[0], [vec![0], vec![2]]);
        assert_eq!(within.iter().map(Vec::len).collect::<Vec<_>>(), [2, 1, 2, 3]);
        let whole = Blocks::new(names, Exchange::Whole).sets();
        assert_eq!(whole, [vec![vec![1]], vec![vec![0, 2], vec![3, 4]], vec![vec![5, 6, 7]]]);
    }

    #[test]
    fn observations_correspond_by_the_columns_that_vary_within_blocks() {
        let names = ["a", "a", "b", "b", "c", "c"];
        let sets = || Blocks::new(names, Exchange::Whole).sets();
        let matrix = |rows: [[f64; 2]; 6]| Array2::from_shape_fn((6, 2), |(i, k)| rows[i][k]);
        // The first column is the group, the second one the visit.
        let visits = matrix([[1.0, 0.5], [1.0, -0.5], [0.0, -0.5], [0.0, 0.5], [0.0, 0.5], [0.0, -0.5]]);
        let by_visit = (vec![vec![vec![1, 0], vec![2, 3], vec![5, 4]]], false);
        assert_eq!(aligned(sets(), visits.view()), by_visit);
        // Each column is the slope of a group.
        let slopes = matrix([[1.0, 0.0], [-1.0, 0.0], [0.0, -1.0], [0.0, 1.0], [0.0, 1.0], [0.0, -1.0]]);
        assert_eq!(aligned(sets(), slopes.view()), by_visit);
        // The first column is the visit, the second one the age.
        let aged = matrix([[0.5, 33.0], [-0.5, 30.0], [-0.5, 51.0], [0.5, 54.0], [0.5, 70.0], [-0.5, 67.0]]);
        assert_eq!(aligned(sets(), aged.view()), by_visit);
        // If the ages differ between all blocks, the rows of different blocks are matched by the rank of their age.
        // This is also the case if each group has its own slope of age, or if another column is the product of the
        // group and the age.
        let ages = matrix([[1.0, 33.0], [1.0, 30.0], [0.0, 51.0], [0.0, 54.0], [0.0, 70.0], [0.0, 71.0]]);
        let by_rank = (vec![vec![vec![1, 0], vec![2, 3], vec![4, 5]]], false);
        assert_eq!(aligned(sets(), ages.view()), by_rank);
        let slopes = matrix([[3.0, 0.0], [0.0, 0.0], [0.0, 51.0], [0.0, 54.0], [0.0, 70.0], [0.0, 71.0]]);
        assert_eq!(aligned(sets(), slopes.view()), by_rank);
        let product = matrix([[33.0, 9.9], [30.0, 9.0], [51.0, -51.0], [54.0, -54.0], [70.0, 7.0], [71.0, 7.1]]);
        assert_eq!(aligned(sets(), product.view()), by_rank);
        // All blocks of two rows are in one group, and all blocks of three rows are in the other group.
        let slopes = ndarray::array![
            [33.0, 0.0],
            [30.0, 0.0],
            [40.0, 0.0],
            [47.0, 0.0],
            [0.0, 51.0],
            [0.0, 54.0],
            [0.0, 57.0],
            [0.0, 70.0],
            [0.0, 60.0],
            [0.0, 65.0]
        ];
        let by_size = Blocks::new(["a", "a", "b", "b", "c", "c", "c", "d", "d", "d"], Exchange::Whole).sets();
        let sorted = vec![vec![vec![1, 0], vec![2, 3]], vec![vec![4, 5, 6], vec![8, 9, 7]]];
        assert_eq!(aligned(by_size, slopes.view()), (sorted, false));
        // If two columns vary and aren't proportional, rows stay in the order of the table, also in blocks of two rows.
        let doses = matrix([[33.0, 2.0], [30.0, 9.0], [51.0, 4.0], [54.0, 1.0], [70.0, 7.0], [71.0, 3.0]]);
        assert_eq!(aligned(sets(), doses.view()), (sets(), true));
        let doses = matrix([[33.0, 2.0], [30.0, 9.0], [31.0, 4.0], [51.0, 4.0], [54.0, 1.0], [57.0, 7.0]]);
        let sets = || Blocks::new(["a", "a", "a", "b", "b", "b"], Exchange::Whole).sets();
        assert_eq!(aligned(sets(), doses.view()), (sets(), true));
    }

    #[test]
    fn blocks_are_in_a_design_that_has_their_levels() {
        let blocks = Blocks::new(["a", "a", "b", "b", "c"], Exchange::Within);
        assert!(!blocks.are_in(&Design::groups(&[2, 3]).unwrap()));
        assert!(blocks.are_in(&Design::groups(&[2, 2, 1]).unwrap()));
    }
}
