//! Chooses the smoothness for targets at samples.

use ndarray::Array2;
use spharm_monitor::Monitor;

use super::cost::Cost;
use super::gcv::{Gcv, Samples, search};
use super::limits::ITERATIONS_BEFORE_FACTOR;
use super::normal_equations::NormalEquations;
use super::plan::Moments;
use super::problem::{Problem, Sampled};
use super::solver::{Given, LsqSolver, Source};
use crate::{SolverError, check};

impl LsqSolver<'_> {
    /// Chooses the smoothness lambda for targets, (n, c), by generalised cross-validation. The solver's own smoothness
    /// and penalty are ignored.
    ///
    /// Reports one stage, `smoothness`, counted in values of lambda, to the monitor.
    ///
    /// # Errors
    ///
    /// [`SolverError::Rows`] and [`SolverError::NotFinite`] for invalid targets, [`SolverError::Interrupted`], and
    /// errors of the operator and the moments.
    pub fn choose_smoothness(&mut self, targets: &Array2<f64>, monitor: &dyn Monitor) -> Result<Gcv, SolverError> {
        let Source::Samples(operator) = self.source else { return Err(SolverError::NoGram) };
        check::targets(targets, operator.rows())?;
        // The search takes hundreds of products: some 25 values of lambda, and several iterations for each.
        let cost = Cost { rows: operator.rows(), max_degree: operator.max_degree(), channels: targets.ncols() };
        let makeable = self.available(Given::Targets(operator, targets)).moments == Moments::Makeable;
        if makeable && cost.paid_after() <= ITERATIONS_BEFORE_FACTOR as f64 {
            self.take_moments(None, monitor)?;
        }
        let equations = NormalEquations { operator, weights: self.params.weights.as_deref(), penalty: None };
        let sampled = Sampled { equations, targets, moments: self.moments.as_ref() };
        search(&Samples(sampled), sampled.right_sides()?, monitor)
    }
}
