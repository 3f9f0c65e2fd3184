//! Collects the data from which the steps of a least-squares fit are chosen, and creates the preconditioner of a step.

use spharm_transform::InverseDensity;

use super::plan::{Available, Factor, Moments, Precondition, Request, Sizes};
use super::preconditioner::{Density, Diagonal, Preconditioner};
use super::solver::{Given, LsqSolver, Source};

impl LsqSolver<'_> {
    pub(super) fn sizes(&self, columns: usize) -> Sizes {
        Sizes {
            rows: self.source.rows(),
            rows_with_weight: self.rows_with_weight(),
            max_degree: self.source.max_degree(),
            columns,
        }
    }

    pub(super) fn request(&self) -> Request {
        Request {
            strategy: self.params.strategy,
            tolerance: self.params.tolerance,
            max_iterations: self.params.max_iterations,
            penalised: self.penalty.is_some(),
        }
    }

    pub(super) fn available(&self, given: Given<'_>) -> Available {
        let makeable = self.make_moments.is_some() && self.params.moment_bytes <= self.room();
        let moments = match given {
            Given::Targets(..) if self.moments.is_none() && makeable => Moments::Makeable,
            Given::Targets(..) if self.moments.is_none() => Moments::None,
            _ => Moments::Made { uneven: self.inverse_density().is_some() },
        };
        let factor = match (self.stored, &self.made) {
            (Some(factor), _) => Factor::Stored { reciprocal: factor.condition().reciprocal },
            (None, Some(_)) => Factor::Made,
            (None, None) if self.make_gram.is_some() => Factor::Makeable,
            (None, None) => Factor::None,
        };
        Available { moments, factor }
    }

    /// Returns the number of unused bytes of the memory budget.
    pub(super) fn room(&self) -> usize {
        self.params.memory.saturating_sub(self.params.held)
    }

    /// Returns a message that explains why moments aren't available.
    pub(super) fn why_no_moments(&self) -> String {
        match self.make_moments {
            Some(_) => format!("moments of the samples don't fit in the remaining {} MiB of memory", self.room() >> 20),
            None => "there are no moments of the samples".to_owned(),
        }
    }

    pub(super) fn preconditioner(&self, precondition: Precondition) -> Box<dyn Preconditioner + '_> {
        match self.inverse_density().filter(|_| precondition == Precondition::Density) {
            Some(inverse) => Box::new(Density(inverse)),
            None => Box::new(self.diagonal()),
        }
    }

    /// Returns the inverse of the sampling density, for use as a preconditioner. Returns `None` if there are no
    /// moments, if the samples are evenly distributed, or if the density must not be used as a preconditioner.
    pub(super) fn inverse_density(&self) -> Option<&InverseDensity> {
        let normal = match self.source {
            Source::Samples(_) => &*self.moments.as_ref()?.normal,
            Source::Moments(problem) => problem.normal(),
        };
        // The number of columns, 0 here, doesn't influence the decision.
        if self.sizes(0).allow_density(&self.request()) { normal.inverse() } else { None }
    }

    fn diagonal(&self) -> Diagonal {
        let weight = match self.source {
            Source::Samples(operator) => {
                self.params.weights.as_ref().map_or(operator.rows() as f64, |weights| weights.iter().sum())
            }
            Source::Moments(problem) => problem.weight(),
        };
        Diagonal::new(self.source.max_degree(), weight, self.penalty.as_deref())
    }
}
