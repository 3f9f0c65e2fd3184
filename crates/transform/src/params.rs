//! Parameters of a transform.

/// Degree, accuracy and memory use of a [`Transform`](crate::Transform).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TransformParams {
    /// Highest degree, L, inclusive; at most twice [`MAX_DEGREE`](spharm_harmonics::MAX_DEGREE). Default 0.
    pub max_degree: usize,
    /// Relative accuracy: the root mean square error of the samples, or of the coefficients, divided by their root mean
    /// square. From [`FINEST`](crate::FINEST) (1e-13) to [`COARSEST`](crate::COARSEST) (1e-3); default 1e-12.
    pub accuracy: f64,
    /// Number of channels transformed together, at least 1; default 3. The channels of a group share the evaluation of
    /// Legendre functions and kernels; memory grows with their number.
    pub channels: usize,
}

impl Default for TransformParams {
    fn default() -> Self {
        Self { max_degree: 0, accuracy: 1e-12, channels: 3 }
    }
}
