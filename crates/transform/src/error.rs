//! What can go wrong before a transform starts.

use spharm_harmonics::HarmonicsError;

/// Why a transform can't be made or given its arguments.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TransformError {
    /// The harmonics refuse, say the degree.
    #[error(transparent)]
    Harmonics(#[from] HarmonicsError),
    /// The accuracy asked for isn't on offer.
    #[error("accuracy {found:e} is outside {min:e} to {max:e}; choose one that is inside")]
    Accuracy {
        /// What was asked for.
        found: f64,
        /// The finest.
        min: f64,
        /// The coarsest.
        max: f64,
    },
    /// More directions than a plan can number.
    #[error("{found} directions; a plan serves at most {max}")]
    TooManyDirections {
        /// How many there are.
        found: usize,
        /// How many there may be.
        max: usize,
    },
    /// An array hasn't the shape that is needed.
    #[error("{what}: expected {expected} rows, found {found}")]
    Shape {
        /// Which array.
        what: &'static str,
        /// Rows that it should have.
        expected: usize,
        /// Rows that it has.
        found: usize,
    },
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
