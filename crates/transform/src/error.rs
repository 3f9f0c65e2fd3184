//! Errors of transforms and Gram matrices; all are detected before any work is done.

use spharm_harmonics::HarmonicsError;

/// An invalid argument of a transform or a Gram matrix.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TransformError {
    /// Invalid degree or coefficients.
    #[error(transparent)]
    Harmonics(#[from] HarmonicsError),
    /// A degree above the highest degree of the plan whose sorted directions are to be shared.
    #[error("degree: expected at most {max}, found {found}")]
    Degree {
        /// The requested degree.
        found: usize,
        /// The plan's highest degree.
        max: usize,
    },
    /// An accuracy out of range.
    #[error("accuracy: expected a value from {min:e} to {max:e}, found {found:e}")]
    Accuracy {
        /// The requested accuracy.
        found: f64,
        /// The finest possible accuracy, [`FINEST`](crate::FINEST).
        min: f64,
        /// The coarsest possible accuracy, [`COARSEST`](crate::COARSEST).
        max: f64,
    },
    /// More directions than a plan can hold.
    #[error("directions: expected at most {max}, found {found}")]
    TooManyDirections {
        /// Number of directions.
        found: usize,
        /// Largest possible number of directions.
        max: usize,
    },
    /// An array with the wrong number of rows.
    #[error("{what}: expected {expected} rows, found {found}")]
    Shape {
        /// Name of the argument.
        what: &'static str,
        /// Number of rows expected.
        expected: usize,
        /// Number of rows found.
        found: usize,
    },
    /// A number of moments that doesn't match twice the degree.
    #[error("moments: expected {expected} values (degree {degree}), found {found}")]
    MomentCount {
        /// The degree of the moments, `2 L`.
        degree: usize,
        /// Number of values expected, `(2 L + 1)^2`.
        expected: usize,
        /// Number of values found.
        found: usize,
    },
    /// A moment that is NaN or infinite.
    #[error("moment {column}: expected a finite value, found {found}; check the weights and directions")]
    MomentNotFinite {
        /// Canonical column of the moment, from 0.
        column: usize,
        /// The value found.
        found: f64,
    },
}
