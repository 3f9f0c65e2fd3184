//! Computes tail probabilities of Student's t and Fisher's F, and quantiles of t.
//!
//! A small tail is computed directly as a regularised incomplete beta function, not as one minus the other tail, so
//! that small p values keep their precision.

use statrs::distribution::{ContinuousCDF, StudentsT};
use statrs::function::beta::beta_reg;

/// Returns the two-sided p value of t with `freedom` > 0 degrees of freedom v: `I_{v / (v + t^2)}(v / 2, 1 / 2)`. The
/// result is NaN if t is NaN.
pub fn p_of_t(t: f64, freedom: f64) -> f64 {
    if t.is_nan() {
        return f64::NAN;
    }
    tail(freedom, t * t, 0.5 * freedom, 0.5)
}

/// Returns the upper tail probability of F with (`between`, `within`) degrees of freedom, both > 0. The result is NaN
/// if F is NaN.
pub fn p_of_f(f: f64, between: f64, within: f64) -> f64 {
    if f.is_nan() {
        return f64::NAN;
    }
    tail(within, between * f.max(0.0), 0.5 * within, 0.5 * between)
}

/// Returns the regularised incomplete beta function `I_x(a, b)` at `x = u / (u + v)`.
fn tail(u: f64, v: f64, a: f64, b: f64) -> f64 {
    if v.is_infinite() {
        return 0.0;
    }
    let (x, rest) = (u / (u + v), v / (u + v));
    // This x is near the mean of the beta distribution. Above it the result isn't small, and `rest` is more precise
    // than `1 - x`. `beta_reg` changes between its two continued fractions at the same x.
    if x <= (a + 1.0) / (a + b + 2.0) { beta_reg(a, b, x) } else { 1.0 - beta_reg(b, a, rest) }
}

/// Returns the two-sided quantile of t: the value that |t| exceeds with probability `1 - coverage`, for a coverage in
/// (0, 1) and `freedom` > 0 degrees of freedom. The result is NaN if an argument is out of range.
pub fn quantile_of_t(coverage: f64, freedom: f64) -> f64 {
    let Ok(distribution) = StudentsT::new(0.0, 1.0, freedom) else { return f64::NAN };
    if !(coverage > 0.0 && coverage < 1.0) {
        return f64::NAN;
    }
    -distribution.inverse_cdf(0.5 * (1.0 - coverage))
}

#[cfg(test)]
mod tests {
    use super::*;

    // Reference values of 2 * scipy.stats.t.sf(t, v) and scipy.stats.f.sf(f, a, b).
    const TAILS_OF_T: [(f64, f64, f64); 8] = [
        (0.0, 8.0, 1.0),
        (0.3, 1.0, 0.8144528418445154),
        (2.306004135204166, 8.0, 0.05000000000000003),
        (3.861, 8.0, 0.004802118047164337),
        (12.5, 8.0, 1.5697770737012795e-06),
        (40.0, 98.0, 1.6633877203685833e-62),
        (0.001, 3.7, 0.9992536770590863),
        (7.0, 2.25, 0.014350238105395798),
    ];
    const TAILS_OF_F: [(f64, f64, f64, f64); 5] = [
        (0.5, 2.0, 8.0, 0.6242950769699741),
        (48.85, 3.0, 6.0, 0.00013111728391865515),
        (3.0, 3.0, 96.0, 0.034371017399502324),
        (250.0, 3.0, 96.0, 3.2069972233504983e-45),
        (0.01, 1.0, 5.0, 0.9242301411546604),
    ];

    // Tail probabilities for many degrees of freedom, where t^2 is smaller than v; computed by mpmath with 50 digits.
    const FAR_TAILS_OF_T: [(f64, f64, f64); 6] = [
        (8.5, 98.0, 2.1500343038896949e-13),
        (9.5, 98.0, 1.4734304035394667e-15),
        (10.0, 1000.0, 1.6670702958600066e-22),
        (25.0, 1000.0, 1.5203541383321279e-107),
        (1.0, 1e6, 0.31731074983357813),
        (20.0, 1e6, 5.733087047390372e-89),
    ];
    const FAR_TAILS_OF_F: [(f64, f64, f64, f64); 3] = [
        (30.0, 3.0, 996.0, 1.4296795470849671e-18),
        (60.0, 6.0, 5000.0, 4.650573232319591e-72),
        (1.0, 5.0, 300.0, 0.4178968970846832),
    ];

    #[test]
    fn small_tails_keep_their_precision_with_many_degrees_of_freedom() {
        // Both x^a and the beta function amplify rounding errors in proportion to the number of degrees of freedom.
        let close = |found: f64, p: f64, freedom: f64| {
            assert!((found / p - 1.0).abs() < 1e-14 * freedom.max(100.0), "{found:e}, {p:e}")
        };
        for (t, v, p) in FAR_TAILS_OF_T {
            close(p_of_t(t, v), p, v);
        }
        for (f, a, b, p) in FAR_TAILS_OF_F {
            close(p_of_f(f, a, b), p, b);
        }
    }

    #[test]
    fn tails_are_scipys() {
        for (t, v, p) in TAILS_OF_T {
            let found = p_of_t(t, v);
            assert!((found / p - 1.0).abs() < 1e-12, "t {t}, {v}: {found:e}, {p:e}");
        }
        for (f, a, b, p) in TAILS_OF_F {
            let found = p_of_f(f, a, b);
            assert!((found / p - 1.0).abs() < 1e-12, "F {f}, {a}, {b}: {found:e}, {p:e}");
        }
    }

    #[test]
    fn quantiles_have_the_coverage() {
        for v in [1.0, 3.5, 8.0, 97.0] {
            for coverage in [0.5, 0.9, 0.95, 0.999] {
                let found = 1.0 - p_of_t(quantile_of_t(coverage, v), v);
                assert!((found - coverage).abs() < 1e-9, "{v} {coverage} {found}");
            }
        }
    }
}
