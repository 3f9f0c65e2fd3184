//! Errors in directions, degrees and coefficients.

/// An invalid direction, degree or coefficient array.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum HarmonicsError {
    /// A degree above [`MAX_DEGREE`](crate::MAX_DEGREE).
    #[error("degree {degree} is above {max}, the highest supported degree")]
    DegreeTooHigh {
        /// The requested degree.
        degree: usize,
        /// The highest supported degree.
        max: usize,
    },
    /// A direction with a coordinate that is NaN or infinite.
    #[error("direction {index}: coordinates must be finite, found ({}, {}, {})", .found[0], .found[1], .found[2])]
    NotFinite {
        /// Position of the direction in the list, from 0.
        index: usize,
        /// The vector found.
        found: [f64; 3],
    },
    /// A vertex at the origin, which has no direction.
    #[error("vertex {index} lies at the origin, which has no direction; centre the sphere at the origin")]
    AtOrigin {
        /// Position of the vertex in the list, from 0.
        index: usize,
    },
    /// A vector that doesn't have unit length.
    #[error("direction {index}: expected a unit vector, found ({}, {}, {})", .found[0], .found[1], .found[2])]
    NotUnit {
        /// Position of the direction in the list, from 0.
        index: usize,
        /// The vector found.
        found: [f64; 3],
    },
    /// No directions at all.
    #[error("a sampling scheme needs at least one direction, found none")]
    Empty,
    /// A coefficient array whose number of rows is not (L + 1)^2.
    #[error("coefficients: expected (max_degree + 1)^2 rows, found {rows}")]
    NotABasisSize {
        /// Number of rows found.
        rows: usize,
    },
}
