//! The preconditioner of a strategy.

use spharm_harmonics::basis_size;
use spharm_transform::InverseDensity;

use super::params::Strategy;
use super::preconditioner::{ByMoments, Density, Diagonal, Preconditioner};
use super::solver::{LsqSolver, Source};

impl LsqSolver<'_> {
    pub(super) fn preconditioner(&self) -> Box<dyn Preconditioner + '_> {
        match (self.params.strategy, self.source, &self.params.areas) {
            (Strategy::DensityCg, Source::Samples(operator), Some(areas)) => {
                Box::new(Density::new(operator, areas, self.params.weights.as_deref()))
            }
            _ => match self.inverse_density() {
                Some(inverse) => Box::new(ByMoments(inverse)),
                None => Box::new(self.diagonal()),
            },
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
