//! Double-double arithmetic: a number is the unevaluated sum of two doubles, with about 32 decimal digits.
//!
//! Double-double arithmetic is used in recurrences that would amplify the rounding errors of doubles too much: next to
//! the poles, and for the powers of `x + i y`, whose real and imaginary parts are the azimuth factors. Source: T. J.
//! Dekker, "A floating-point technique for extending the available precision", Numer. Math. 18 (1971). Fused products
//! are used if the processor has them.

use std::ops::{Add, Div, Mul, Neg, Sub};

/// The number `hi + lo` with `|lo| <= ulp(hi) / 2`.
///
/// With `FMA` the rounding error of a product is computed by `f64::mul_add`, which should be one instruction; without
/// `FMA`, it is computed by Dekker's splitting, which gives the same bits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DoubleDouble<const FMA: bool> {
    /// The leading double: the number rounded to a double.
    pub hi: f64,
    /// The trailing double: the remainder.
    pub lo: f64,
}

#[inline(always)]
fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let s = a + b;
    let t = s - a;
    (s, (a - (s - t)) + (b - t))
}

/// Returns the rounded sum of two doubles and its rounding error. Needs `|a| >= |b|` or `a == 0`.
#[inline(always)]
fn quick_two_sum(a: f64, b: f64) -> (f64, f64) {
    let s = a + b;
    (s, b - (s - a))
}

#[inline(always)]
fn two_product<const FMA: bool>(a: f64, b: f64) -> (f64, f64) {
    let p = a * b;
    if FMA {
        (p, a.mul_add(b, -p))
    } else {
        let (ah, al) = split(a);
        let (bh, bl) = split(b);
        (p, ((ah * bh - p) + ah * bl + al * bh) + al * bl)
    }
}

#[inline(always)]
fn split(a: f64) -> (f64, f64) {
    const SPLITTER: f64 = 134_217_729.0; // 2^27 + 1
    // Above `LARGE`, the product with `SPLITTER` would overflow. Larger numbers are therefore multiplied by the power
    // of two `DOWN`, which is exact.
    const LARGE: f64 = 6.696_928_794_914_17e299;
    const DOWN: f64 = 1.0 / (1u64 << 28) as f64;
    if a.abs() > LARGE {
        let t = SPLITTER * (a * DOWN);
        let hi = t - (t - a * DOWN);
        (hi / DOWN, (a * DOWN - hi) / DOWN)
    } else {
        let t = SPLITTER * a;
        let hi = t - (t - a);
        (hi, a - hi)
    }
}

impl<const FMA: bool> DoubleDouble<FMA> {
    /// Zero.
    pub const ZERO: Self = Self { hi: 0.0, lo: 0.0 };

    /// Returns a double as a double-double.
    #[inline(always)]
    #[must_use]
    pub fn new(value: f64) -> Self {
        Self { hi: value, lo: 0.0 }
    }

    /// Returns the exact product of two doubles.
    #[inline(always)]
    pub fn product(a: f64, b: f64) -> Self {
        let (hi, lo) = two_product::<FMA>(a, b);
        Self { hi, lo }
    }

    /// Returns the square root; zero for negative numbers.
    #[inline(always)]
    #[must_use]
    pub fn sqrt(self) -> Self {
        if self.hi <= 0.0 {
            return Self::ZERO;
        }
        let approx = self.hi.sqrt();
        let r = self.sub(Self::product(approx, approx));
        let (hi, lo) = quick_two_sum(approx, r.hi / (2.0 * approx));
        Self { hi, lo }
    }

    /// Returns the nearest double.
    #[inline(always)]
    #[must_use]
    pub fn value(self) -> f64 {
        self.hi + self.lo
    }
}

impl<const FMA: bool> std::ops::Add for DoubleDouble<FMA> {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        let (s, e) = two_sum(self.hi, other.hi);
        let (t, f) = two_sum(self.lo, other.lo);
        let (s, e) = quick_two_sum(s, e + t);
        let (hi, lo) = quick_two_sum(s, e + f);
        Self { hi, lo }
    }
}

impl<const FMA: bool> std::ops::Neg for DoubleDouble<FMA> {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        Self { hi: -self.hi, lo: -self.lo }
    }
}

impl<const FMA: bool> std::ops::Sub for DoubleDouble<FMA> {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.add(other.neg())
    }
}

impl<const FMA: bool> std::ops::Mul for DoubleDouble<FMA> {
    type Output = Self;

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        let (p, e) = two_product::<FMA>(self.hi, other.hi);
        let (hi, lo) = quick_two_sum(p, e + (self.hi * other.lo + self.lo * other.hi));
        Self { hi, lo }
    }
}

impl<const FMA: bool> std::ops::Div for DoubleDouble<FMA> {
    type Output = Self;

    #[inline(always)]
    fn div(self, other: Self) -> Self {
        let q1 = self.hi / other.hi;
        let r = self.sub(other.mul(Self::new(q1)));
        let q2 = r.hi / other.hi;
        let r = r.sub(other.mul(Self::new(q2)));
        let (hi, lo) = quick_two_sum(q1, q2);
        Self { hi, lo }.add(Self::new(r.hi / other.hi))
    }
}

/// Returns the vector divided by its length, in double-double.
#[inline(always)]
pub fn unit<const FMA: bool>(direction: [f64; 3]) -> [DoubleDouble<FMA>; 3] {
    let [x, y, z] = direction;
    let square = |c| DoubleDouble::<FMA>::product(c, c);
    let r = square(x).add(square(y)).add(square(z)).sqrt();
    [x, y, z].map(|c| DoubleDouble::new(c).div(r))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check<const FMA: bool>() {
        type D<const F: bool> = DoubleDouble<F>;
        let third = D::<FMA>::new(1.0).div(D::new(3.0));
        let one = third.add(third).add(third);
        assert!((one.hi - 1.0).abs() + one.lo.abs() < 1e-31);
        let two = D::<FMA>::new(2.0).sqrt();
        let back = two.mul(two).sub(D::new(2.0));
        assert!(back.hi.abs() < 1e-31, "{back:?}");
        let large = D::<FMA>::product(1e300, 1.0 + f64::EPSILON);
        assert_eq!((large.hi, large.lo), (1e300 * (1.0 + f64::EPSILON), large.lo));
        assert!(large.lo.is_finite());
    }

    #[test]
    fn keeps_thirty_digits_with_and_without_fused_products() {
        check::<true>();
        check::<false>();
    }

    /// If the processor has no instruction for fused products, `f64::mul_add` calls a function of the C library, and
    /// MinGW's version of this function rounds twice. This test therefore isn't compiled for MinGW.
    #[cfg(not(all(windows, target_env = "gnu")))]
    #[test]
    fn both_products_give_the_same_bits() {
        let mut x = 0.123_456_789_f64;
        for _ in 0..1000 {
            let y = (x * 1e3).sin() * 1e5;
            assert_eq!(two_product::<true>(x, y), two_product::<false>(x, y));
            x = (x * 3.9).sin();
        }
    }
}
