//! The Legendre recurrence for one order at a time and all degrees, for transforms over rings of constant colatitude.
//!
//! For a fixed order m, the values `q_l` of [`recurrence`](crate::recurrence) are divided by factors `s_l` that make
//! the second coefficient of the recurrence one. With `r_l = q_l / s_l` and the coefficients `a_l`, `b_l` of order m,
//!
//! ```text
//! P_{l,m}(theta) = s_l u^m r_l(z),   r_m = 1,   r_l = alpha_l z r_{l-1} - r_{l-2}
//! s_m = q_{m,m},  s_{m+1} = a_{m+1} s_m,  s_l = b_l s_{l-2},  alpha_l = a_l s_{l-1} / s_l
//! ```
//!
//! Here `u = sin theta` and `z = cos theta`, and P has the normalisation of the canonical basis. r starts at [`SEED`]
//! and `u^m` at its inverse, as in Holmes and Featherstone (2002), so that neither leaves the range of doubles.

use std::ops::{Div, Mul};

use crate::HarmonicsError;
use crate::double_double::{DoubleDouble, unit};
use crate::recurrence::{MAX_DEGREE, SCALE, seeds, squares};

type Dd = DoubleDouble<false>;

/// The start value of r: `2^-930` instead of 1.
pub const SEED: f64 = 1.0 / SCALE;

/// The recurrences of all orders up to a degree.
#[derive(Debug, Clone)]
pub struct MonicRecurrence {
    /// Seeds `q_{m,m}` for each m.
    seeds: Vec<f64>,
}

impl MonicRecurrence {
    /// Prepares the recurrences up to `max_degree`, inclusive.
    ///
    /// # Errors
    ///
    /// [`HarmonicsError::DegreeTooHigh`] if `max_degree` is above twice [`MAX_DEGREE`]. (The moments of a Gram matrix
    /// have degrees up to twice the matrix's degree.)
    pub fn new(max_degree: usize) -> Result<Self, HarmonicsError> {
        if max_degree > 2 * MAX_DEGREE {
            return Err(HarmonicsError::DegreeTooHigh { degree: max_degree, max: 2 * MAX_DEGREE });
        }
        let seeds = seeds::<false>(max_degree).iter().map(|s| s.value() * SCALE).collect();
        Ok(Self { seeds })
    }

    /// Returns the highest degree.
    pub fn max_degree(&self) -> usize {
        self.seeds.len() - 1
    }

    /// Appends the factors `alpha_l` and `s_l` (see the [module](self)) of order m, for `l = m..=L`, to `alpha` and
    /// `scale`. `alpha_m` is zero and `alpha_{m+1}` is one.
    ///
    /// # Panics
    ///
    /// If m is above the highest degree.
    pub fn order(&self, m: usize, alpha: &mut Vec<f64>, scale: &mut Vec<f64>) {
        let (mut older, mut newest) = (0.0, self.seeds[m]);
        alpha.push(0.0);
        scale.push(newest);
        for l in m + 1..=self.max_degree() {
            let [an, ad, bn, bd] = squares(l, m);
            let a = (an / ad).sqrt();
            let s = if l == m + 1 { a * newest } else { (bn / bd).sqrt() * older };
            alpha.push(a * newest / s);
            scale.push(s);
            (older, newest) = (newest, s);
        }
    }

    /// Returns `alpha_l` of order m for `l = m..=L` in double-double, for the rings next to the poles, where the errors
    /// of the doubles from [`order`](Self::order) would accumulate.
    ///
    /// # Panics
    ///
    /// If m is above the highest degree.
    pub fn exact_order<const FMA: bool>(&self, m: usize) -> Vec<DoubleDouble<FMA>> {
        let root = |n: f64, d: f64| DoubleDouble::<FMA>::new(n).div(DoubleDouble::new(d)).sqrt();
        let (mut older, mut newest) = (DoubleDouble::ZERO, DoubleDouble::new(self.seeds[m]));
        let mut alpha = vec![DoubleDouble::ZERO];
        for l in m + 1..=self.max_degree() {
            let [an, ad, bn, bd] = squares(l, m);
            let a = root(an, ad);
            let s = if l == m + 1 { a.mul(newest) } else { root(bn, bd).mul(older) };
            alpha.push(a.mul(newest).div(s));
            (older, newest) = (newest, s);
        }
        alpha
    }
}

/// Writes `u^m / SEED` to `powers[m]`, where u is the sine of the colatitude with the given cosine and sine. Cosine and
/// sine are normalised in double-double, and the powers are accurate to one rounding for any m.
pub fn sine_powers(cosine: f64, sine: f64, powers: &mut [f64]) {
    let [u, _, _] = unit::<false>([sine, 0.0, cosine]);
    let mut power = Dd::new(SCALE);
    for value in powers {
        *value = power.value();
        power = power.mul(u);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::textbook;

    #[test]
    fn rings_have_the_values_of_the_textbook() {
        let recurrence = MonicRecurrence::new(12).unwrap();
        let theta: f64 = 0.7;
        let mut powers = vec![0.0; 13];
        sine_powers(theta.cos(), theta.sin(), &mut powers);
        for m in 0..=12 {
            let (mut alpha, mut scale) = (Vec::new(), Vec::new());
            recurrence.order(m, &mut alpha, &mut scale);
            let (mut older, mut newest) = (-SEED, 0.0);
            for l in m..=12 {
                let r = alpha[l - m] * theta.cos() * newest - older;
                (older, newest) = (newest, r);
                let expected = textbook::harmonic(l, m as isize, [theta.sin(), 0.0, theta.cos()]);
                let found = r * powers[m] * scale[l - m];
                assert!((found - expected).abs() < 1e-14, "{l} {m}: {found} {expected}");
            }
        }
    }
}
