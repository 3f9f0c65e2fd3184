//! The factor of the normal equations, made when it is needed: whole, or of the low degrees alone.

use std::time::Instant;

use spharm_harmonics::basis_size;
use spharm_harmonics::index::{first_column, max_degree_of};
use spharm_monitor::Monitor;

use super::preconditioner::LowDegrees;
use super::report::LsqWarning;
use super::solver::{FIT, LsqSolver};
use crate::cholesky::{CholeskyFactor, FactorParams, MemoryFactor, factorise, plan_factor};
use crate::gram::{GramMatrix, Penalised};
use crate::{SolverError, dense};

/// Below this reciprocal condition number a matrix counts as singular: nothing is left of a solve's digits.
const SINGULAR: f64 = 1e-14;

/// The factor of `N + mu I`.
pub(super) struct MadeFactor {
    pub(super) factor: MemoryFactor,
    /// mu relative to the largest diagonal entry of N; zero where N isn't singular.
    pub(super) shift: f64,
    /// The column and degree at which the factorisation of N itself broke down.
    pub(super) breaks_at: Option<[usize; 2]>,
}

impl LsqSolver<'_> {
    /// The factor to solve with: the stored one, else the one that was made.
    pub(super) fn factor(&self) -> Result<&dyn CholeskyFactor, SolverError> {
        match (self.stored, &self.made) {
            (Some(factor), _) => Ok(factor),
            (None, Some(made)) => Ok(&made.factor),
            (None, None) => Err(SolverError::NoGram),
        }
    }

    /// Makes a factor unless there is one. False where memory doesn't allow for one; an error then where it is
    /// `required`.
    pub(super) fn make_factor(&mut self, required: bool, monitor: &dyn Monitor) -> Result<bool, SolverError> {
        if self.stored.is_some() || self.made.is_some() {
            return Ok(true);
        }
        let Some(make_gram) = self.make_gram else { return Err(SolverError::NoGram) };
        let started = Instant::now();
        let params = FactorParams {
            memory: self.params.memory,
            held: self.params.held,
            threads: self.params.threads,
            ..FactorParams::default()
        };
        let size = basis_size(self.operator.max_degree());
        if let Err(error) = plan_factor(size, &params, false) {
            if required {
                return Err(error);
            }
            self.warnings.push(LsqWarning::NoFactor { reason: error.to_string() });
            return Ok(false);
        }
        let zero = vec![0.0; size];
        let penalty = self.penalty.as_deref().unwrap_or(&zero);
        self.made = Some(factorise_shifted(&*make_gram()?, penalty, &params, monitor)?);
        monitor.begin(FIT, 0);
        self.factor_seconds += started.elapsed().as_secs_f64();
        Ok(true)
    }

    /// The preconditioner of the degrees up to `degree`.
    pub(super) fn make_low_degrees(&self, degree: usize) -> Result<LowDegrees, SolverError> {
        let degree = degree.min(self.operator.max_degree());
        let make_gram = self.make_gram.ok_or(SolverError::NoGram)?;
        let size = basis_size(degree);
        let mut gram = vec![0.0; size * size];
        make_gram()?.tile(0..size, 0..size, &mut gram, size)?;
        if let Some(penalty) = &self.penalty {
            (0..size).for_each(|j| gram[j * size + j] += penalty[j]);
        }
        let norm = dense::symmetric_norm(&gram, size);
        if !dense::cholesky(&mut gram, size) || dense::reciprocal_condition(norm, &gram, size) < SINGULAR {
            return Err(SolverError::LowDegrees { degree });
        }
        Ok(LowDegrees::new(gram, first_column(degree + 1), self.equations().diagonal()))
    }
}

/// Factorises `G + diag(penalty)`; where that is numerically singular, with as small a shift of its diagonal as makes it
/// definite.
fn factorise_shifted(
    gram: &dyn GramMatrix,
    penalty: &[f64],
    params: &FactorParams,
    monitor: &dyn Monitor,
) -> Result<MadeFactor, SolverError> {
    let factor = |shift: f64| {
        let penalised = Penalised::new(gram, penalty.iter().map(|p| p + shift).collect());
        factorise(&penalised, params, monitor)
    };
    let mut breaks_at = None;
    match factor(0.0) {
        Ok(factor) if factor.condition().reciprocal > SINGULAR => {
            return Ok(MadeFactor { factor, shift: 0.0, breaks_at });
        }
        Ok(_) => {}
        Err(SolverError::NotPositiveDefinite { column, degree }) => breaks_at = Some([column, degree]),
        Err(error) => return Err(error),
    }
    // As small as rounding errors of the matrix allow.
    let largest = largest_diagonal(gram, penalty)?;
    let mut shift = f64::EPSILON * gram.size() as f64;
    loop {
        match factor(shift * largest) {
            Ok(factor) => return Ok(MadeFactor { factor, shift, breaks_at }),
            Err(SolverError::NotPositiveDefinite { .. }) if shift < 1e-3 => shift *= 10.0,
            Err(error) => return Err(error),
        }
    }
}

fn largest_diagonal(gram: &dyn GramMatrix, penalty: &[f64]) -> Result<f64, SolverError> {
    let mut largest = 0.0f64;
    for l in 0..=max_degree_of(gram.size()).unwrap_or(0) {
        let columns = first_column(l)..first_column(l + 1);
        let k = columns.len();
        let mut tile = vec![0.0; k * k];
        gram.tile(columns.clone(), columns.clone(), &mut tile, k)?;
        for (i, column) in columns.enumerate() {
            largest = largest.max(tile[i * k + i] + penalty[column]);
        }
    }
    Ok(largest)
}
