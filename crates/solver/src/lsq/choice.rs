//! The preconditioner of a strategy.

use spharm_harmonics::basis_size;
use spharm_transform::InverseDensity;

use super::params::Strategy;
use super::preconditioner::{Density, Diagonal, Preconditioner};
use super::solver::{Given, LsqSolver, Source};

impl LsqSolver<'_> {
    pub(super) fn preconditioner(&self) -> Box<dyn Preconditioner + '_> {
        match self.inverse_density() {
            Some(inverse) => Box::new(Density(inverse)),
            None => Box::new(self.diagonal()),
        }
    }

    /// The inverse of the density, where the strategy allows for it, there are moments and no penalty, and the rows
    /// determine the columns: where they don't, the solution of least norm is what iterations without a preconditioner
    /// tend to.
    pub(super) fn inverse_density(&self) -> Option<&InverseDensity> {
        let normal = match self.source {
            Source::Samples(_) => &*self.moments.as_ref()?.normal,
            Source::Moments(problem) => problem.normal(),
        };
        if !matches!(self.params.strategy, Strategy::Auto | Strategy::DensityCg) {
            return None;
        }
        let determined = self.rows_with_weight() >= 2 * basis_size(self.source.max_degree());
        if determined && self.penalty.is_none() { normal.inverse() } else { None }
    }

    /// Returns why iterations that are to use the density of the samples can't.
    pub(super) fn no_density(&self, given: Given<'_>) -> Option<String> {
        let made = self.moments.is_some() || matches!(given, Given::Sums(_));
        if self.params.strategy != Strategy::DensityCg || made {
            return None;
        }
        if self.make_moments.is_none() {
            return Some("there are no moments of them".to_owned());
        }
        let room = self.room();
        (self.params.moment_bytes > room)
            .then(|| format!("their moments don't fit the {} MiB of memory that are left", room >> 20))
    }

    /// Bytes of memory that aren't taken.
    pub(super) fn room(&self) -> usize {
        self.params.memory.saturating_sub(self.params.held)
    }

    pub(super) fn diagonal(&self) -> Diagonal {
        let weight = match self.source {
            Source::Samples(operator) => {
                self.params.weights.as_ref().map_or(operator.rows() as f64, |weights| weights.iter().sum())
            }
            Source::Moments(problem) => problem.weight(),
        };
        Diagonal::new(self.source.max_degree(), weight, self.penalty.as_deref())
    }
}
