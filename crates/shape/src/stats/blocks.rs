//! Defines exchangeability blocks: sets of observations that depend on each other, such as the visits of a subject or
//! the members of a family.
//!
//! A. M. Winkler, M. A. Webster, D. Vidaurre, T. E. Nichols and S. M. Smith, "Multi-level block permutation",
//! NeuroImage 123 (2015). Relabellings exchange observations within each block, or exchange whole blocks of the same
//! size.

use std::collections::BTreeMap;
use std::collections::HashMap;
use std::hash::Hash;

use ndarray::ArrayView2;

/// Relabellings that blocks allow.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Exchange {
    /// Observations are exchanged only within their block, and signs are flipped independently.
    Within,
    /// Whole blocks of the same size are exchanged, keeping the order of their observations, and all signs of a block
    /// are flipped together.
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

    /// Returns the relabellings that the blocks allow.
    #[must_use]
    pub fn exchange(&self) -> Exchange {
        self.exchange
    }

    /// Returns the sets of units that can be exchanged with each other. Each observation belongs to one unit.
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

/// Returns whether the observations of two units have equal rows, in order.
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
}
