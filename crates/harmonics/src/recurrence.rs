//! The normalised Legendre recurrence, scaled so that it neither underflows nor overflows.
//!
//! With `u = sin theta`, `z = cos theta` and `P_{l,m}` the associated Legendre function including the normalisation of
//! the [canonical basis](crate#conventions), the functions `q_{l,m} = P_{l,m} / u^m` satisfy, for fixed m,
//!
//! ```text
//! q_{m,m} = sqrt(2 - delta_{m0}) sqrt( (2m + 1)/(4 pi) prod_{k=1..m} (2k - 1)/(2k) )
//! q_{l,m} = a_{l,m} z q_{l-1,m} - b_{l,m} q_{l-2,m}
//! a_{l,m} = sqrt( (4 l^2 - 1) / (l^2 - m^2) )
//! b_{l,m} = sqrt( (2l + 1) (l + m - 1) (l - m - 1) / ((2l - 3) (l^2 - m^2)) )
//! ```
//!
//! and `S_{l,m} + i S_{l,-m} = q_{l,m} u^m e^{i m phi}`. Seeds don't depend on the direction, so nothing underflows in
//! the recurrence. `u^m` could underflow, so it is multiplied by 2^930, and the seeds are divided by 2^930, after S. A.
//! Holmes and W. E. Featherstone, "A unified approach to the Clenshaw summation and the recursive computation of very
//! high degree and order normalised associated Legendre functions", J. Geodesy 76 (2002), section 2.4. This is safe up
//! to degree 2,700; [`MAX_DEGREE`] is the highest degree that is tested.
//!
//! Cost: 3 flops for each value of q, and one flop for each of the two harmonics computed from it.

use std::ops::{Div, Mul};

use crate::HarmonicsError;
use crate::double_double::DoubleDouble;

/// The highest degree for which accuracy is guaranteed and tested: absolute errors are below
/// `1e-12 sqrt((2l + 1) / (4 pi))`.
pub const MAX_DEGREE: usize = 2_000;

/// The factor `2^930`, close to the 1e280 of Holmes and Featherstone. It is a power of two, so scaling is exact.
pub(crate) const SCALE: f64 = f64::from_bits((1023 + 930) << 52);

/// Coefficients `a` and `b` and seeds of the recurrence up to a degree, computed once and shared by all threads.
#[derive(Debug, Clone)]
pub struct Recurrence {
    max_degree: usize,
    /// Coefficients `a_{l,m}` for `m < l`, at index `l (l - 1) / 2 + m`; `b` has the same layout.
    a: Vec<f64>,
    b: Vec<f64>,
    /// Seeds `q_{m,m} / SCALE` for each m.
    seeds: Vec<f64>,
}

impl Recurrence {
    /// Computes the coefficients up to `max_degree`, inclusive; they take `8 (L + 1)^2` bytes.
    ///
    /// # Errors
    ///
    /// [`HarmonicsError::DegreeTooHigh`] if `max_degree` is above [`MAX_DEGREE`].
    pub fn new(max_degree: usize) -> Result<Self, HarmonicsError> {
        if max_degree > MAX_DEGREE {
            return Err(HarmonicsError::DegreeTooHigh { degree: max_degree, max: MAX_DEGREE });
        }
        let pairs = max_degree * (max_degree + 1) / 2;
        let (mut a, mut b) = (Vec::with_capacity(pairs), Vec::with_capacity(pairs));
        for l in 1..=max_degree {
            for m in 0..l {
                let [an, ad, bn, bd] = squares(l, m);
                a.push((an / ad).sqrt());
                b.push((bn / bd).sqrt());
            }
        }
        let seeds = seeds::<false>(max_degree).iter().map(|s| s.value()).collect();
        Ok(Self { max_degree, a, b, seeds })
    }

    /// Returns the size in bytes of a recurrence up to degree `max_degree`.
    pub const fn bytes(max_degree: usize) -> usize {
        8 * (max_degree + 1) * (max_degree + 1)
    }

    /// Returns the highest degree.
    pub fn max_degree(&self) -> usize {
        self.max_degree
    }

    /// Returns `a_{l,m}` and `b_{l,m}` for `m = 0..l`.
    pub(crate) fn degree(&self, l: usize) -> (&[f64], &[f64]) {
        let start = l * l.saturating_sub(1) / 2;
        (&self.a[start..start + l], &self.b[start..start + l])
    }

    pub(crate) fn seed(&self, m: usize) -> f64 {
        self.seeds[m]
    }
}

/// Returns the numerators and denominators of `a^2` and `b^2`, which are integers below 2^53 and therefore exact.
pub(crate) fn squares(l: usize, m: usize) -> [f64; 4] {
    let (l, m) = (l as f64, m as f64);
    let denominator = (l - m) * (l + m);
    // For l = m + 1, b is 0, because there is no q_{l-2,m}.
    let b_numerator = ((2.0 * l + 1.0) * (l + m - 1.0) * (l - m - 1.0)).max(0.0);
    [4.0 * l * l - 1.0, denominator, b_numerator, (2.0 * l - 3.0).abs() * denominator]
}

/// Returns `q_{m,m} / SCALE` for `m = 0..=max_degree`, in double-double, because it is a product of up to `max_degree`
/// factors.
pub(crate) fn seeds<const FMA: bool>(max_degree: usize) -> Vec<DoubleDouble<FMA>> {
    // 1 / (4 pi) to 32 digits.
    let inverse_sphere = DoubleDouble { hi: 0.079_577_471_545_947_67, lo: -4.919_669_168_795_621_5e-18 };
    let exact = |v: usize| DoubleDouble::<FMA>::new(v as f64);
    let mut square = inverse_sphere;
    let mut seeds = Vec::with_capacity(max_degree + 1);
    for m in 0..=max_degree {
        if m == 1 {
            square = square.mul(exact(3));
        } else if m > 1 {
            square = square.mul(exact(2 * m + 1)).div(exact(2 * m));
        }
        let root = square.sqrt();
        seeds.push(DoubleDouble { hi: root.hi / SCALE, lo: root.lo / SCALE });
    }
    seeds
}

#[cfg(test)]
mod tests {
    use std::ops::Sub;

    use super::*;

    #[test]
    fn the_sphere_constant_is_exact_to_double_double() {
        // The harmonic of degree 0 is 1 / sqrt(4 pi), so its square times 4 pi must be 1. Here pi is a double-double.
        let pi = DoubleDouble::<false> { hi: std::f64::consts::PI, lo: 1.224_646_799_147_353_2e-16 };
        let product = seeds::<false>(0)[0];
        let scaled = DoubleDouble::<false> { hi: product.hi * SCALE, lo: product.lo * SCALE };
        let one = scaled.mul(scaled).mul(pi).mul(DoubleDouble::new(4.0)).sub(DoubleDouble::new(1.0));
        assert!(one.hi.abs() < 1e-31, "{one:?}");
    }

    #[test]
    fn degrees_above_the_promise_are_refused() {
        assert!(Recurrence::new(MAX_DEGREE + 1).is_err());
        assert_eq!(Recurrence::new(0).unwrap().max_degree(), 0);
    }
}
