//! What can be wrong with the input of a transform.

use spharm_harmonics::HarmonicsError;

/// Errors of this crate; each says what was expected and what was found.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TransformError {
    /// A degree, or directions, that the harmonics refuse.
    #[error(transparent)]
    Harmonics(#[from] HarmonicsError),
    /// Moments that don't go to twice the degree.
    #[error("moments: expected {expected} values, to degree {degree}, found {found}")]
    MomentCount {
        /// The degree they should go to, `2 L`.
        degree: usize,
        /// `(2 L + 1)^2`.
        expected: usize,
        /// Values found.
        found: usize,
    },
    /// A moment that is NaN or infinite.
    #[error("moment {column}: expected a finite value, found {found}; check the weights and directions")]
    MomentNotFinite {
        /// Canonical column, from 0.
        column: usize,
        /// The value.
        found: f64,
    },
}
