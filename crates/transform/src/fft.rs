//! Complex Fourier transforms by rustfft, for other crates. Its planner is generic, so each crate that calls it
//! contains another copy of its kernels.

use std::sync::Arc;

pub use rustfft::Fft;
pub use rustfft::num_complex::Complex64;

/// Plans the transform `y_k = sum_j x_j e^{-2 pi i j k / n}` of a length n.
pub fn plan_forward(length: usize) -> Arc<dyn Fft<f64>> {
    rustfft::FftPlanner::new().plan_fft_forward(length)
}
