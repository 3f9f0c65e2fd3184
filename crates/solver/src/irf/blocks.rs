//! Defines the four fitting methods NLSF, SIRF, MIRF and IRF by their blocks of degrees and their numbers of passes.
//!
//! The methods are those of Shen and Chung (3DPVT 2006), section 3. NLSF has one block of all degrees. SIRF has a first
//! block of degrees 0 to s, followed by one block per degree. MIRF fits the blocks of SIRF in several passes. A block
//! of IRF has as many degrees as fit into g columns, where g is the granularity, but at least one degree.

use std::ops::RangeInclusive;

use spharm_harmonics::index::{basis_size, first_column};

use crate::SolverError;

/// The four fitting methods of Shen and Chung (3DPVT 2006).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// Iterative residual fitting: `passes` passes over blocks of at most `granularity` columns.
    Irf {
        /// Number of passes, p.
        passes: usize,
        /// Largest number of columns of a block, g. A block of a single degree may have more columns.
        granularity: usize,
    },
    /// Stepwise fitting: degrees 0 to `start_degree` together, then one degree at a time, in one pass.
    Sirf {
        /// Last degree of the first block, s.
        start_degree: usize,
    },
    /// Stepwise fitting repeated on the residual, in `passes` passes.
    Mirf {
        /// Number of passes, p.
        passes: usize,
        /// Last degree of the first block, s.
        start_degree: usize,
    },
    /// Full least squares: all degrees are fitted together.
    Nlsf,
}

impl Method {
    /// Returns the method's name in Shen and Chung's paper, in lower case: `irf`, `sirf`, `mirf` or `nlsf`.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Irf { .. } => "irf",
            Self::Sirf { .. } => "sirf",
            Self::Mirf { .. } => "mirf",
            Self::Nlsf => "nlsf",
        }
    }

    /// Returns the number of passes, p.
    pub fn passes(&self) -> usize {
        match *self {
            Self::Irf { passes, .. } | Self::Mirf { passes, .. } => passes,
            Self::Sirf { .. } | Self::Nlsf => 1,
        }
    }

    /// Returns the degrees of each block of a pass, in order; together they are `0..=max_degree`.
    ///
    /// # Errors
    ///
    /// [`SolverError::TooSmall`] for zero passes or a granularity of zero, [`SolverError::StartDegree`] for a start
    /// degree above `max_degree`.
    pub fn blocks(&self, max_degree: usize) -> Result<Vec<RangeInclusive<usize>>, SolverError> {
        if self.passes() == 0 {
            return Err(SolverError::TooSmall { what: "the number of passes", least: 1, found: 0 });
        }
        match *self {
            Self::Nlsf => Ok(vec![0..=max_degree]),
            Self::Irf { granularity: 0, .. } => {
                Err(SolverError::TooSmall { what: "the granularity", least: 1, found: 0 })
            }
            Self::Irf { granularity, .. } => Ok(by_granularity(max_degree, granularity)),
            Self::Sirf { start_degree } | Self::Mirf { start_degree, .. } => {
                if start_degree > max_degree {
                    return Err(SolverError::StartDegree { found: start_degree, max_degree });
                }
                Ok(std::iter::once(0..=start_degree).chain((start_degree + 1..=max_degree).map(|l| l..=l)).collect())
            }
        }
    }
}

fn by_granularity(max_degree: usize, granularity: usize) -> Vec<RangeInclusive<usize>> {
    let mut blocks = Vec::new();
    let mut first = 0;
    while first <= max_degree {
        let fits = |&last: &usize| basis_size(last) - first_column(first) <= granularity;
        let last = (first..=max_degree).take_while(fits).last().unwrap_or(first);
        blocks.push(first..=last);
        first = last + 1;
    }
    blocks
}

/// Returns the number of columns of a block of degrees.
pub fn columns(degrees: &RangeInclusive<usize>) -> usize {
    basis_size(*degrees.end()) - first_column(*degrees.start())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn irf(granularity: usize, max_degree: usize) -> Vec<RangeInclusive<usize>> {
        Method::Irf { passes: 1, granularity }.blocks(max_degree).unwrap()
    }

    #[test]
    fn blocks_hold_at_most_g_columns_and_at_least_one_degree() {
        assert_eq!(irf(1, 3), [0..=0, 1..=1, 2..=2, 3..=3]);
        assert_eq!(irf(4, 3), [0..=1, 2..=2, 3..=3]);
        assert_eq!(irf(9, 3), [0..=2, 3..=3]);
        // Degrees 10, 11, 12, 13 have 21 + 23 + 25 + 27 = 96 columns; with degree 14 they would have 125.
        assert_eq!(irf(100, 14), [0..=9, 10..=13, 14..=14]);
        assert_eq!(irf(usize::MAX, 100), [0..=100]);
        for g in [1, 7, 100, 400] {
            let blocks = irf(g, 100);
            assert_eq!(blocks.iter().map(columns).sum::<usize>(), basis_size(100));
            assert!(blocks.iter().all(|b| columns(b) <= g || b.start() == b.end()));
            // Except in the last block, another degree would exceed the granularity.
            assert!(blocks[..blocks.len() - 1].iter().all(|b| columns(&(*b.start()..=b.end() + 1)) > g));
        }
    }

    #[test]
    fn sirf_and_mirf_start_with_the_first_s_degrees() {
        let sirf = Method::Sirf { start_degree: 2 };
        assert_eq!(sirf.blocks(4).unwrap(), [0..=2, 3..=3, 4..=4]);
        assert_eq!(Method::Mirf { passes: 3, start_degree: 0 }.blocks(1).unwrap(), [0..=0, 1..=1]);
        assert_eq!(Method::Nlsf.blocks(7).unwrap(), [0..=7]);
    }

    #[test]
    fn nonsense_is_refused() {
        assert!(Method::Irf { passes: 1, granularity: 0 }.blocks(3).is_err());
        assert!(Method::Mirf { passes: 0, start_degree: 0 }.blocks(3).is_err());
        assert!(Method::Sirf { start_degree: 4 }.blocks(3).is_err());
    }
}
