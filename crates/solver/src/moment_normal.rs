//! Computes the normal matrix of a sampling from its moments.

use std::sync::OnceLock;

use spharm_transform::{InverseDensity, MomentOperator};

use crate::SolverError;

/// The normal operator `A^T W A` computed from the moments of a sampling, and its approximate inverse, which is
/// computed on first use.
#[derive(Debug)]
pub struct MomentNormal {
    operator: MomentOperator,
    moments: Vec<f64>,
    inverse: OnceLock<Option<InverseDensity>>,
}

impl MomentNormal {
    /// Creates the operator up to degree L = `max_degree` from the `(2L + 1)^2` moments up to degree 2L, in canonical
    /// order.
    ///
    /// # Errors
    ///
    /// The errors of [`MomentOperator::new`].
    pub fn new(max_degree: usize, moments: Vec<f64>) -> Result<Self, SolverError> {
        let operator = MomentOperator::new(max_degree, &moments)?;
        Ok(Self { operator, moments, inverse: OnceLock::new() })
    }

    /// Returns the peak memory in bytes of the operator, its moments and its inverse; see [`MomentOperator::bytes`].
    pub const fn bytes(max_degree: usize, channels: usize, threads: usize) -> usize {
        let moments = 8 * (2 * max_degree + 1) * (2 * max_degree + 1);
        moments + InverseDensity::bytes_with_operator(max_degree, channels, threads)
    }

    /// Returns the normal operator.
    pub fn operator(&self) -> &MomentOperator {
        &self.operator
    }

    /// Returns the moments.
    pub fn moments(&self) -> &[f64] {
        &self.moments
    }

    /// Returns the approximate inverse; `None` if an inverse doesn't pay off for this sampling.
    pub fn inverse(&self) -> Option<&InverseDensity> {
        if self.inverse.get().is_none() {
            // Compute the inverse before the cell is initialised. Within the initialisation, a thread that waits for
            // other threads' parts of the work may steal a task that itself waits for the cell, which would be a
            // deadlock. Degree and moments were already validated by `new`.
            let made = InverseDensity::new(self.operator.max_degree(), &self.moments).unwrap_or_default();
            let _ = self.inverse.set(made);
        }
        self.inverse.get()?.as_ref()
    }
}
