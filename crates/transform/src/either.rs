//! Computes synthesis by direct sums or a transform, whichever is faster.

use ndarray::{Array2, ArrayView1, ArrayView2};
use spharm_harmonics::index::{basis_size, max_degree_of};
use spharm_harmonics::{Directions, HarmonicsError};

use crate::{FINEST, Transform, TransformError, TransformParams};

/// Direct sums are used if the number of directions times the number of coefficients is at most this number, because
/// they are then faster than planning a transform. At this size, direct sums and a transform both take a few
/// milliseconds.
const DIRECT: usize = 3_000_000;

/// If a function's largest coefficient is below this value, the coefficients are scaled up before a transform.
/// Otherwise they might lose digits by underflow, because a transform multiplies coefficients by Legendre functions
/// that were divided by 2^930.
const SAFE: f64 = power(-40);

/// Evaluates the c functions with the canonical `coefficients` (K, c) at n directions, and returns the samples (n, c).
/// The relative accuracy is [`FINEST`] or better.
///
/// For repeated synthesis at the same directions, plan a [`Transform`] once.
///
/// # Errors
///
/// - [`TransformError::Harmonics`] with [`HarmonicsError::NotABasisSize`] if K isn't `(L + 1)^2`.
/// - [`TransformError::Harmonics`] with [`HarmonicsError::DegreeTooHigh`] if L is above
///   [`MAX_DEGREE`](spharm_harmonics::MAX_DEGREE).
/// - [`TransformError::TooManyDirections`] if n is above 2^32 - 1.
pub fn synthesis(directions: &Directions, coefficients: ArrayView2<'_, f64>) -> Result<Array2<f64>, TransformError> {
    let (rows, channels) = coefficients.dim();
    let max_degree = max_degree_of(rows).ok_or(HarmonicsError::NotABasisSize { rows })?;
    if max_degree > spharm_harmonics::MAX_DEGREE || directions.len() * basis_size(max_degree) <= DIRECT {
        return Ok(spharm_harmonics::synthesis(directions, coefficients)?);
    }
    let params = TransformParams { max_degree, accuracy: FINEST, channels: channels.clamp(1, 3) };
    let transform = Transform::new(directions, &params)?;
    let raises: Vec<f64> = coefficients.columns().into_iter().map(raise).collect();
    if raises.iter().all(|&raise| raise == 1.0) {
        return transform.synthesis(coefficients);
    }
    let raises = ArrayView1::from(&raises);
    Ok(transform.synthesis((&coefficients * &raises).view())? / raises)
}

/// Returns the power of two by which to multiply the coefficients of a function so that they keep their digits: 1, or
/// the power that brings the largest coefficient near 1.
fn raise(coefficients: ArrayView1<'_, f64>) -> f64 {
    let largest = coefficients.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
    if largest == 0.0 || largest >= SAFE {
        return 1.0;
    }
    // The inverse of a subnormal number would overflow.
    let biased = (largest.to_bits() >> 52).max(1) as i32;
    power(1023 - biased)
}

/// Returns 2^exponent, for the exponent of a normal number.
const fn power(exponent: i32) -> f64 {
    f64::from_bits(((1023 + exponent) as u64) << 52)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_coefficients_keep_their_digits() {
        let (degree, n) = (30, 1 + DIRECT / basis_size(30));
        let angles = |i: usize| [(1.0 - (2 * i + 1) as f64 / n as f64).acos(), 2.4 * i as f64];
        let directions = Directions::from_angles(&(0..n).map(angles).collect::<Vec<_>>()).unwrap();
        let ordinary = Array2::from_shape_fn((basis_size(degree), 2), |(k, c)| ((3 * k + c) as f64).sin());
        let expected = synthesis(&directions, ordinary.view()).unwrap();
        for exponents in [[-150, -150], [-1000, 0], [0, -600]] {
            let scales = exponents.map(power);
            let scales = ArrayView1::from(&scales[..]);
            let scaled = &ordinary * &scales;
            let found = synthesis(&directions, scaled.view()).unwrap() / scales;
            assert!((found - &expected).iter().all(|off| off.abs() < 1e-11), "{exponents:?}");
        }
    }
}
