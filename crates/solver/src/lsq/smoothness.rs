//! Chooses the smoothness for targets at samples.

use ndarray::{Array2, ArrayView1, ArrayView2};
use spharm_monitor::Monitor;

use super::cg::Cg;
use super::cost::{Cost, moment_accuracy};
use super::gcv::{CG, Gcv, PROBES, Validated, search};
use super::limits::{LEAST_ITERATIONS_OF_SEARCH, MOMENT_ACCURACY_OF_SEARCH};
use super::normal_equations::NormalEquations;
use super::plan::Moments;
use super::problem::{Problem, Sampled};
use super::solver::{Given, LsqSolver, Source};
use crate::{SolverError, check};

impl LsqSolver<'_> {
    /// Chooses the smoothness lambda for targets (n, c) by generalised cross-validation. The solver's own smoothness
    /// and penalty are ignored. Moments that are computed for the search are kept for the following fit.
    ///
    /// Reports one stage, `smoothness`, counted in values of lambda, to the monitor.
    ///
    /// # Errors
    ///
    /// [`SolverError::Rows`] or [`SolverError::NotFinite`] if the targets are invalid, [`SolverError::Interrupted`] if
    /// the monitor cancels the search, and the errors of the operator and the moments.
    pub fn choose_smoothness(&mut self, targets: &Array2<f64>, monitor: &dyn Monitor) -> Result<Gcv, SolverError> {
        let Source::Samples(operator) = self.source else { return Err(SolverError::NoGram) };
        check::targets(targets, operator.rows())?;
        let channels = targets.ncols() + PROBES;
        let (rows, rows_with_weight, max_degree) = (operator.rows(), self.rows_with_weight(), operator.max_degree());
        let cost = Cost { rows, rows_with_weight, max_degree, channels };
        let accuracy = MOMENT_ACCURACY_OF_SEARCH.min(moment_accuracy(self.params.tolerance));
        let coarse = self.moments.take_if(|moments| moments.accuracy > accuracy);
        let makeable = self.available(Given::Targets(operator, targets)).moments == Moments::Makeable;
        if makeable && cost.paid_after() <= LEAST_ITERATIONS_OF_SEARCH {
            self.take_moments(accuracy, None, monitor)?;
        }
        let weights = self.params.weights.as_deref();
        let centred = centred(targets, weights);
        let equations = NormalEquations { operator, weights, penalty: None };
        let sampled = Sampled { equations, targets: &centred, moments: self.moments.as_ref() };
        let chosen = search(&Samples(sampled), sampled.right_sides()?, monitor)?;
        // Moments that are too coarse for the search may suffice for the fit.
        self.moments = self.moments.take().or(coarse);
        Ok(chosen)
    }
}

/// Returns targets (n, c) minus the weighted mean of their column.
fn centred(targets: &Array2<f64>, weights: Option<&[f64]>) -> Array2<f64> {
    let mut centred = targets.clone();
    for mut column in centred.columns_mut() {
        let mean = mean(column.view(), weights);
        column -= mean;
    }
    centred
}

fn mean(column: ArrayView1<'_, f64>, weights: Option<&[f64]>) -> f64 {
    match weights {
        None => column.sum() / column.len() as f64,
        Some(weights) => column.iter().zip(weights).map(|(f, w)| w * f).sum::<f64>() / weights.iter().sum::<f64>(),
    }
}

/// The cross-validation problem for targets at samples. Its equations contain no penalty; the search adds the penalties
/// to try.
struct Samples<'a>(Sampled<'a>);

impl Validated for Samples<'_> {
    fn max_degree(&self) -> usize {
        self.0.equations.operator.max_degree()
    }

    fn rows(&self) -> usize {
        let NormalEquations { operator, weights, .. } = self.0.equations;
        weights.map_or(operator.rows(), |w| w.iter().filter(|w| **w > 0.0).count())
    }

    fn weight(&self) -> f64 {
        let NormalEquations { operator, weights, .. } = self.0.equations;
        weights.map_or(operator.rows() as f64, |w| w.iter().sum())
    }

    fn solve(&self, right: Array2<f64>, penalty: &[f64], monitor: &dyn Monitor) -> Result<Array2<f64>, SolverError> {
        let equations = NormalEquations { penalty: Some(penalty), ..self.0.equations };
        let mut cg = Cg::from_right_sides(right);
        cg.run(&Sampled { equations, ..self.0 }, &equations.diagonal(), &CG, monitor)?;
        Ok(cg.x)
    }

    fn square(&self, x: ArrayView2<'_, f64>) -> Result<f64, SolverError> {
        let NormalEquations { operator, weights, .. } = self.0.equations;
        let residual = self.0.targets - &operator.apply(x)?;
        let rows = residual.rows().into_iter().enumerate();
        Ok(rows.map(|(i, row)| weights.map_or(1.0, |w| w[i]) * row.dot(&row)).sum())
    }
}
