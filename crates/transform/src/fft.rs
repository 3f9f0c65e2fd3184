//! Plans complex Fourier transforms with rustfft, for other crates. The planner of rustfft is generic, so each crate
//! that calls the planner directly would contain another copy of its code.

use std::sync::Arc;

pub use rustfft::Fft;
pub use rustfft::num_complex::Complex64;

/// Plans the transform `y_k = sum_j x_j e^{-2 pi i j k / n}` of length n.
pub fn plan_forward(length: usize) -> Arc<dyn Fft<f64>> {
    rustfft::FftPlanner::new().plan_fft_forward(length)
}
