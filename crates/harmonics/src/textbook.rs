//! Computes harmonics from the angles by the textbook formulas, one value at a time.
//!
//! The tests compare [`sweep`](crate::sweep) with this implementation; the two share no code. This implementation is
//! usable up to a degree of about 150; at higher degrees `sin(theta)^m` underflows next to the poles.

use crate::directions::angles;

/// Returns `S_{l,m}` at a direction.
///
/// # Panics
///
/// If `|order| > degree`.
pub fn harmonic(degree: usize, order: isize, direction: [f64; 3]) -> f64 {
    let m = order.unsigned_abs();
    assert!(m <= degree, "order {order} is outside -{degree}..={degree}");
    let [theta, phi] = angles(direction);
    let legendre = normalised_legendre(degree, m, theta);
    let angle = m as f64 * phi;
    match order {
        0 => legendre,
        1.. => std::f64::consts::SQRT_2 * legendre * angle.cos(),
        _ => std::f64::consts::SQRT_2 * legendre * angle.sin(),
    }
}

/// Returns `N P_l^m(cos theta)` without the Condon-Shortley phase. The recurrence first increases degree and order
/// together up to m, and then increases the degree alone.
fn normalised_legendre(degree: usize, m: usize, theta: f64) -> f64 {
    let (sine, cosine) = theta.sin_cos();
    let mut diagonal = (1.0 / (4.0 * std::f64::consts::PI)).sqrt();
    for k in 1..=m {
        let k = k as f64;
        diagonal *= ((2.0 * k + 1.0) / (2.0 * k)).sqrt() * sine;
    }
    let mut older = 0.0;
    let mut old = diagonal;
    let m = m as f64;
    for l in m as usize + 1..=degree {
        let l = l as f64;
        let a = ((4.0 * l * l - 1.0) / (l * l - m * m)).sqrt();
        let previous = (((l - 1.0) * (l - 1.0) - m * m) / (4.0 * (l - 1.0) * (l - 1.0) - 1.0)).sqrt();
        (older, old) = (old, a * (cosine * old - previous * older));
    }
    old
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compares the harmonics of the first degrees with their polynomials in x, y, z.
    #[test]
    fn low_degrees_are_the_known_polynomials() {
        let pi = std::f64::consts::PI;
        let [x, y, z] = [2.0f64 / 7.0, -3.0 / 7.0, 6.0 / 7.0];
        let s = |l, m| harmonic(l, m, [x, y, z]);
        let known = [
            (s(0, 0), (0.25 / pi).sqrt()),
            (s(1, -1), (0.75 / pi).sqrt() * y),
            (s(1, 0), (0.75 / pi).sqrt() * z),
            (s(1, 1), (0.75 / pi).sqrt() * x),
            (s(2, -2), (15.0 / pi).sqrt() / 2.0 * x * y),
            (s(2, -1), (15.0 / pi).sqrt() / 2.0 * y * z),
            (s(2, 0), (5.0 / pi).sqrt() / 4.0 * (3.0 * z * z - 1.0)),
            (s(2, 1), (15.0 / pi).sqrt() / 2.0 * x * z),
            (s(2, 2), (15.0 / pi).sqrt() / 4.0 * (x * x - y * y)),
        ];
        // harmonic(2, -2) is sqrt2 N P_2^2 sin(2 phi) = sqrt(15/pi)/2 x y, because sin(2 phi) = 2 sin(phi) cos(phi).
        for (found, expected) in known {
            assert!((found - expected).abs() < 1e-15, "{found} {expected}");
        }
    }
}
