//! Computes a Cholesky factor of the normal matrix N, or of N plus a multiple of the identity if N is singular.

use spharm_harmonics::index::{first_column, max_degree_of};
use spharm_monitor::Monitor;

use super::limits::SINGULAR_RECIPROCAL;
use crate::SolverError;
use crate::cholesky::{CholeskyFactor, FactorParams, MemoryFactor, factorise};
use crate::gram::{GramMatrix, Penalised};

/// A computed factor of `N + mu I`.
pub(super) struct MadeFactor {
    pub(super) factor: MemoryFactor,
    /// Shift mu, divided by the largest diagonal entry of N; zero if N isn't singular.
    pub(super) shift: f64,
    /// Column and degree at which the factorisation of N without a shift broke down; `None` if it succeeded.
    pub(super) breaks_at: Option<[usize; 2]>,
}

/// Factorises `G + diag(penalty)`. If this matrix is numerically singular, its diagonal is shifted: the shift is
/// increased by factors of 10 until the matrix is positive definite.
pub(super) fn factorise_shifted(
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
        Ok(factor) if factor.condition().reciprocal > SINGULAR_RECIPROCAL => {
            return Ok(MadeFactor { factor, shift: 0.0, breaks_at });
        }
        Ok(_) => {}
        Err(SolverError::NotPositiveDefinite { column, degree }) => breaks_at = Some([column, degree]),
        Err(error) => return Err(error),
    }
    // Begin with a shift that is about as large as the matrix's rounding errors.
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
    Ok(diagonal(gram)?.iter().zip(penalty).fold(0.0, |largest: f64, (value, p)| largest.max(value + p)))
}

/// Returns the diagonal (K) of a Gram matrix.
fn diagonal(gram: &dyn GramMatrix) -> Result<Vec<f64>, SolverError> {
    let mut values = Vec::with_capacity(gram.size());
    for l in 0..=max_degree_of(gram.size()).unwrap_or(0) {
        let columns = first_column(l)..first_column(l + 1);
        let k = columns.len();
        let mut tile = vec![0.0; k * k];
        gram.tile(columns.clone(), columns, &mut tile, k)?;
        values.extend(tile.iter().step_by(k + 1));
    }
    Ok(values)
}
