//! Computes the arc tangent without function calls or branches, so that compilers can vectorise loops that use it.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

/// tan(pi / 8). For arguments t above this value, atan(t) is computed as pi / 4 + atan((t - 1) / (t + 1)).
const TURN: f64 = 0.414_213_562_373_095_03;

/// For |x| <= 0.66, (atan(x) / x - 1) / x^2 is computed as a quotient of two polynomials in x^2 (S. Moshier, Cephes,
/// `atan.c`). These are the coefficients of the numerator, highest power first.
const ABOVE: [f64; 5] = [
    -8.750_608_600_031_904e-1,
    -1.615_753_718_733_365e1,
    -7.500_855_792_314_705e1,
    -1.228_866_684_490_136_2e2,
    -6.485_021_904_942_025e1,
];

/// Coefficients of the denominator (see [`ABOVE`]), highest power first, without the leading coefficient 1.
const BELOW: [f64; 5] = [
    2.485_846_490_142_306_3e1,
    1.650_270_098_316_988_5e2,
    4.328_810_604_912_902_7e2,
    4.853_903_996_359_137e2,
    1.945_506_571_482_614e2,
];

/// Returns atan2(y, x) for y >= 0, accurate to a few units in the last place; NaN if both arguments are 0.
#[inline(always)]
pub(crate) fn atan2_upper(y: f64, x: f64) -> f64 {
    let size = x.abs();
    let is_steep = y > size;
    let (low, high) = if is_steep { (size, y) } else { (y, size) };
    let is_turned = low > TURN * high;
    let (above, below) = if is_turned { (low - high, low + high) } else { (low, high) };
    let t = above / below;
    let z = t * t;
    let [a, b, c, d, e] = ABOVE;
    let numerator = (((a * z + b) * z + c) * z + d) * z + e;
    let [a, b, c, d, e] = BELOW;
    let denominator = ((((z + a) * z + b) * z + c) * z + d) * z + e;
    let angle = t + t * z * (numerator / denominator);
    let angle = if is_turned { angle + FRAC_PI_4 } else { angle };
    let angle = if is_steep { FRAC_PI_2 - angle } else { angle };
    if x < 0.0 { PI - angle } else { angle }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_library_s() {
        for k in 0..4000 {
            let angle = PI * f64::from(k) / 4000.0;
            for size in [1e-9, 0.3, 7e8] {
                let (y, x) = (size * angle.sin(), size * angle.cos());
                let found = atan2_upper(y, x);
                assert!((found - y.atan2(x)).abs() <= 4.0 * f64::EPSILON * angle.max(1e-300), "{angle} {found}");
            }
        }
        // Checks that the relative accuracy is also kept for very small angles.
        for exponent in 1..300 {
            let y = 0.7 * 10_f64.powi(-exponent);
            assert!((atan2_upper(y, 1.3) / y.atan2(1.3) - 1.0).abs() < 4.0 * f64::EPSILON);
        }
    }
}
