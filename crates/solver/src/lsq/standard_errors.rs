//! Computes standard errors of the coefficients.

use ndarray::{Array2, ArrayView1};
use spharm_harmonics::basis_size;
use spharm_monitor::Monitor;

use super::solver::{LsqSolver, Source};
use crate::SolverError;
use crate::gram::smoothness_penalty;

impl LsqSolver<'_> {
    /// Computes the standard errors (K, c) of the coefficients: `sigma sqrt(diag N^-1)` without a smoothness penalty.
    /// With a smoothness penalty P, the standard errors are the standard deviations over repeated measurements,
    /// `sigma sqrt(diag(N^-1 - N^-1 P N^-1))`, which don't include the penalty's bias. Penalties by degree
    /// ([`LsqParams::penalty`](crate::LsqParams::penalty)) are interpreted as sigma^2 divided by the variances of a
    /// prior. The bias of these penalties is included. Without a smoothness penalty, the standard errors are then the
    /// standard deviations of the posterior.
    ///
    /// `sigma^2` is the weighted sum of squares of the residual (n, c), divided by the degrees of freedom. The degrees
    /// of freedom are the number of rows with nonzero weight minus the trace of the hat matrix `A N^-1 A^T W`. This
    /// trace is K without a penalty. The diagonals need the entire factor, and `K^3 / 3` flops, or `2 K^3 / 3` with a
    /// smoothness penalty.
    ///
    /// # Errors
    ///
    /// [`SolverError::Underdetermined`] if the samples don't determine the coefficients,
    /// [`SolverError::UnderdeterminedWithPenalty`] if a penalty leaves them undetermined, [`SolverError::NoGram`] if
    /// there is neither a factor nor a Gram matrix, [`SolverError::Interrupted`] if the monitor cancels the
    /// computation, and the errors of computing a factor.
    pub fn standard_errors(
        &mut self,
        residual: &Array2<f64>,
        monitor: &dyn Monitor,
    ) -> Result<Array2<f64>, SolverError> {
        let weight = |i: usize| self.params.weights.as_ref().map_or(1.0, |w| w[i]);
        let square = |r: ArrayView1<'_, f64>| r.iter().enumerate().map(|(i, r)| weight(i) * r * r).sum();
        let squares: Vec<f64> = residual.columns().into_iter().map(square).collect();
        self.standard_errors_of(&squares, monitor)
    }

    /// Computes the standard errors (K, c) from the weighted sums of squares (c) of the residual's columns.
    pub(super) fn standard_errors_of(
        &mut self,
        squares: &[f64],
        monitor: &dyn Monitor,
    ) -> Result<Array2<f64>, SolverError> {
        let columns = basis_size(self.source.max_degree());
        let rows = self.rows_with_weight();
        if rows <= columns && self.penalty.is_none() {
            return Err(SolverError::Underdetermined { rows, columns });
        }
        self.make_factor(true, monitor)?;
        if self.stored.is_none() && self.made.as_ref().is_some_and(|made| made.shift > 0.0) {
            return Err(self.undetermined(rows, columns));
        }
        let factor = self.factor()?;
        let (diagonal, variances) = if self.params.smoothness > 0.0 {
            let smoothness = smoothness_penalty(self.source.max_degree(), self.params.smoothness);
            let (diagonal, penalised) = factor.penalised_diagonals(&smoothness, monitor)?;
            let variances = diagonal.iter().zip(penalised).map(|(all, bias)| all - bias).collect::<Vec<f64>>();
            (diagonal, variances)
        } else {
            let diagonal = factor.inverse_diagonal(monitor)?;
            (diagonal.clone(), diagonal)
        };
        // The trace of the hat matrix is tr H = K - tr(P N^-1), and P is diagonal.
        let penalised = self.penalty.iter().flatten().zip(&diagonal).map(|(p, d)| p * d).sum::<f64>();
        let degrees_of_freedom = rows as f64 - (columns as f64 - penalised);
        if degrees_of_freedom <= 0.0 {
            return Err(self.undetermined(rows, columns));
        }
        let sigma: Vec<f64> = squares.iter().map(|square| (square / degrees_of_freedom).sqrt()).collect();
        Ok(Array2::from_shape_fn((columns, squares.len()), |(k, c)| sigma[c] * variances[k].max(0.0).sqrt()))
    }

    /// Returns the [`SolverError`] for coefficients that aren't determined. With a penalty, the error states whether a
    /// smaller or a larger penalty is needed.
    fn undetermined(&self, rows: usize, columns: usize) -> SolverError {
        let Some(penalty) = &self.penalty else { return SolverError::Underdetermined { rows, columns } };
        let sampled = match (self.source, &self.params.weights) {
            (Source::Moments(problem), _) => problem.weight(),
            (_, Some(weights)) => weights.iter().sum(),
            (_, None) => rows as f64,
        };
        let largest = penalty.iter().copied().fold(0.0, f64::max);
        // A smaller penalty is needed if the penalty exceeds the diagonal of A^T W A, which is about the sum of the
        // weights divided by 4 pi.
        let needed = if largest > sampled / (4.0 * std::f64::consts::PI) { "smaller" } else { "larger" };
        SolverError::UnderdeterminedWithPenalty { rows, columns, needed }
    }
}
