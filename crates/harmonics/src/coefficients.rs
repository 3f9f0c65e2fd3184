//! Canonical coefficients, and their conversion to and from the complex coefficients of Shen and Chung.
//!
//! Shen and Chung (3DPVT 2006) expand functions in complex harmonics, orthonormal and with the Condon-Shortley phase,
//! `Y_{l,m} = (-1)^m N P_l^m e^{i m phi}`, `Y_{l,-m} = (-1)^m conj(Y_{l,m})`. For a real function, its complex
//! coefficients c and its canonical coefficients a are related by
//!
//! ```text
//! c_{l,m} = (-1)^m (a_{l,m} - i a_{l,-m}) / sqrt2,   c_{l,-m} = (-1)^m conj(c_{l,m}),   c_{l,0} = a_{l,0}.
//! ```

use ndarray::{Array2, ArrayView2, s};
use num_complex::Complex64;
use std::f64::consts::{FRAC_1_SQRT_2, SQRT_2};

use crate::HarmonicsError;
use crate::index::{basis_size, column, max_degree_of};

/// Canonical coefficients (K, c) of c functions, in the unit of the functions. Row `l^2 + l + m` has degree l and order
/// m.
#[derive(Debug, Clone, PartialEq)]
pub struct Coefficients {
    values: Array2<f64>,
    max_degree: usize,
}

impl Coefficients {
    /// Wraps an array (K, c) of canonical coefficients.
    ///
    /// # Errors
    ///
    /// [`HarmonicsError::NotABasisSize`] if K isn't `(L + 1)^2` for any L.
    pub fn new(values: Array2<f64>) -> Result<Self, HarmonicsError> {
        let rows = values.nrows();
        let max_degree = max_degree_of(rows).ok_or(HarmonicsError::NotABasisSize { rows })?;
        Ok(Self { values, max_degree })
    }

    /// Returns the highest degree, L.
    pub fn max_degree(&self) -> usize {
        self.max_degree
    }

    /// Returns the number of functions, c.
    pub fn channels(&self) -> usize {
        self.values.ncols()
    }

    /// Returns the array (K, c) of coefficients.
    pub fn values(&self) -> &Array2<f64> {
        &self.values
    }

    /// Returns the coefficients of degrees up to `degree`, inclusive; all coefficients if `degree` is above L.
    pub fn up_to(&self, degree: usize) -> ArrayView2<'_, f64> {
        self.values.slice(s![..basis_size(degree.min(self.max_degree)), ..])
    }

    /// Returns the complex coefficients (K, c) of Shen and Chung; see the [module](self).
    pub fn to_complex(&self) -> Array2<Complex64> {
        let mut complex = Array2::zeros(self.values.raw_dim());
        for channel in 0..self.channels() {
            for l in 0..=self.max_degree {
                complex[[column(l, 0), channel]] = Complex64::new(self.values[[column(l, 0), channel]], 0.0);
                for m in 1..=l as isize {
                    let a_plus = self.values[[column(l, m), channel]];
                    let a_minus = self.values[[column(l, -m), channel]];
                    let c = Complex64::new(a_plus, -a_minus) * (sign(m) / SQRT_2);
                    complex[[column(l, m), channel]] = c;
                    complex[[column(l, -m), channel]] = c.conj() * sign(m);
                }
            }
        }
        complex
    }

    /// Computes the canonical coefficients of the real part of `sum c_{l,m} Y_{l,m}`, for complex coefficients (K, c).
    ///
    /// The complex coefficients need not describe real functions. If they describe real functions, this conversion is
    /// the inverse of [`to_complex`](Self::to_complex).
    ///
    /// # Errors
    ///
    /// [`HarmonicsError::NotABasisSize`] if K isn't `(L + 1)^2` for any L.
    pub fn from_complex(complex: &Array2<Complex64>) -> Result<Self, HarmonicsError> {
        let mut coefficients = Self::new(complex.mapv(|c| c.re))?;
        for channel in 0..complex.ncols() {
            for l in 0..=coefficients.max_degree {
                for m in 1..=l as isize {
                    let plus = complex[[column(l, m), channel]] * sign(m);
                    let minus = complex[[column(l, -m), channel]];
                    coefficients.values[[column(l, m), channel]] = (plus.re + minus.re) * FRAC_1_SQRT_2;
                    coefficients.values[[column(l, -m), channel]] = (minus.im - plus.im) * FRAC_1_SQRT_2;
                }
            }
        }
        Ok(coefficients)
    }
}

fn sign(order: isize) -> f64 {
    if order % 2 == 0 { 1.0 } else { -1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::textbook::harmonic;

    fn sample() -> Coefficients {
        let values = Array2::from_shape_fn((basis_size(6), 2), |(k, c)| ((k * 7 + c * 3) as f64 * 0.37).sin());
        Coefficients::new(values).unwrap()
    }

    #[test]
    fn complex_and_back_is_the_identity() {
        let original = sample();
        let back = Coefficients::from_complex(&original.to_complex()).unwrap();
        for (a, b) in original.values().iter().zip(back.values()) {
            assert!((a - b).abs() < 1e-15);
        }
    }

    /// Checks that the real and the complex sum give the same function. The complex harmonics are written out from
    /// their definition.
    #[test]
    fn complex_coefficients_describe_the_same_function() {
        let coefficients = sample();
        let complex = coefficients.to_complex();
        let direction = [0.48, -0.6, 0.64];
        let phi = f64::atan2(direction[1], direction[0]);
        for channel in 0..2 {
            let (mut real, mut sum) = (0.0, Complex64::new(0.0, 0.0));
            for l in 0..=6usize {
                for m in -(l as isize)..=l as isize {
                    real += coefficients.values()[[column(l, m), channel]] * harmonic(l, m, direction);
                    // N P_l^|m| is harmonic(l, |m|) / (sqrt2 cos(m phi)).
                    let order = m.abs();
                    let np = match order {
                        0 => harmonic(l, 0, direction),
                        _ => harmonic(l, order, direction) / (SQRT_2 * (order as f64 * phi).cos()),
                    };
                    let y = Complex64::from_polar(np, m as f64 * phi) * if m > 0 { sign(m) } else { 1.0 };
                    sum += complex[[column(l, m), channel]] * y;
                }
            }
            assert!((real - sum.re).abs() < 1e-13 && sum.im.abs() < 1e-13, "{real} {sum}");
        }
    }

    #[test]
    fn a_number_of_rows_that_is_no_square_is_refused() {
        let found = Coefficients::new(Array2::zeros((8, 3)));
        assert_eq!(found, Err(HarmonicsError::NotABasisSize { rows: 8 }));
    }
}
