//! Evaluates the Legendre recurrence over pairs of degrees, so that one value serves two degrees.
//!
//! Let r and alpha be the values of [`legendre`](crate::legendre) for order m, `k = l - m` and `A_k = alpha_{m+k}`. The
//! values `r_{m+k}` of odd k are z times polynomials t in `z^2`, and each value of even k is a linear combination of
//! two successive polynomials t:
//!
//! ```text
//! r_{m+2j+1} = z sigma_j t_j,   r_{m+2j} = (sigma_j t_j + sigma_{j-1} t_{j-1}) / A_{2j+1},   t_0 = r_m
//! t_{j+1} = (a_j z^2 + b_j) t_j - t_{j-1},
//! a_j = A_{2j+2} A_{2j+3} sigma_j / sigma_{j+1},   b_j = -(1 + A_{2j+3} / A_{2j+1}) sigma_j / sigma_{j+1}
//! sigma_0 = sigma_1 = 1,   sigma_{j+1} = sigma_{j-1} A_{2j+3} / A_{2j+1}
//! ```
//!
//! Sums over degrees with coefficients `x_k` are therefore sums of t with mixed coefficients:
//!
//! ```text
//! sum_k x_k r_{m+k} = sum_j t_j sigma_j (x_{2j} / A_{2j+1} + x_{2j+2} / A_{2j+3})  +  z sum_j t_j sigma_j x_{2j+1}
//! ```
//!
//! A value `t_j` costs two fused products and serves two degrees, whereas a value of r costs a product and a fused
//! product and serves one degree. This saves a quarter of the time for the Legendre sums of one channel. K. Ishioka, "A
//! new recurrence formula for efficient computation of spherical harmonic transform", J. Meteorol. Soc. Japan 96
//! (2018).
//!
//! Next to the equator, where z is near zero, the two terms of `r_{m+2j}` nearly cancel, and rounding errors grow like
//! `1 / z`, as they grow like `1 / sin theta` next to the poles. Rings next to the equator are therefore computed one
//! degree at a time.

use rayon::prelude::*;
use spharm_harmonics::double_double::DoubleDouble;

/// Pairs of degrees save time only from this degree on. At lower degrees the saving is smaller than two fixed costs:
/// mixing the coefficients and processing an additional zone of rings. Each takes as long as computing about ten rings.
const PAIRS_FROM: usize = 256;
/// A ring is regarded as next to the equator if the cosine of its colatitude is below
/// `EQUATORIAL_COSINE + EQUATORIAL_COSINE_PER_DEGREE L`. On such rings, pairs of degrees lose a digit of accuracy, and
/// more than a digit at high degrees.
const EQUATORIAL_COSINE: f64 = 0.05;
const EQUATORIAL_COSINE_PER_DEGREE: f64 = 5e-5;

/// Returns the number of rings, from the pole on, that aren't next to the equator, or 0 if the degree is too low for
/// pairs of degrees. `cosines` are the cosines of the rings' colatitudes, from the pole to the equator.
pub(crate) fn end(max_degree: usize, cosines: &[f64]) -> usize {
    let least = EQUATORIAL_COSINE + EQUATORIAL_COSINE_PER_DEGREE * max_degree as f64;
    if max_degree < PAIRS_FROM { 0 } else { cosines.partition_point(|z| *z >= least) }
}

/// The factors `a` and `b` of the recurrence, and the mixing factors, of all orders; see the module.
#[derive(Debug)]
pub(crate) struct DegreePairs {
    orders: Vec<Order>,
}

#[derive(Debug)]
struct Order {
    /// For each j, the coefficients `a_{j-1}` and `b_{j-1}` by which the polynomial t_j is computed from t_{j-1} and
    /// t_{j-2}; zero for j = 0.
    steps: Vec<[f64; 2]>,
    /// For each j, the factors `sigma_j / A_{2j+1}`, `sigma_j / A_{2j+3}` and `sigma_j` by which coefficients are
    /// mixed; see the [module](self).
    mixing: Vec<[f64; 3]>,
}

impl DegreePairs {
    /// Computes the tables to degree L. `alpha` returns the values `alpha_l` of an order m, from degree m on.
    pub(crate) fn new<'a>(max_degree: usize, alpha: impl Fn(usize) -> &'a [f64] + Sync) -> Self {
        Self { orders: (0..=max_degree).into_par_iter().map(|m| order(m, alpha(m))).collect() }
    }

    /// Returns, for each pair of degrees j, the factors `a_{j-1}` and `b_{j-1}` of the recurrence of order m (see the
    /// module).
    pub(crate) fn steps(&self, m: usize) -> &[[f64; 2]] {
        &self.orders[m].steps
    }

    /// Computes the factors `mixed` (pairs, 2 columns) of the polynomials t (see the module) from the coefficients `x`
    /// (L + 1 - m, columns) of order m, both row-major. `mixed` contains, for each channel, cosine and sine of even
    /// degrees, then cosine and sine of odd degrees.
    pub(crate) fn mix(&self, m: usize, x: &[f64], columns: usize, mixed: &mut Vec<f64>) {
        let Order { mixing, .. } = &self.orders[m];
        mixed.clear();
        mixed.resize(mixing.len() * 2 * columns, 0.0);
        for ((j, factors), mixed) in mixing.iter().enumerate().zip(mixed.chunks_exact_mut(2 * columns)) {
            for (k, even_factor) in [(2 * j, factors[0]), (2 * j + 2, factors[1])] {
                let row = x.get(k * columns..(k + 1) * columns).unwrap_or_default();
                for (x, mixed) in row.as_chunks::<2>().0.iter().zip(mixed.as_chunks_mut::<4>().0) {
                    mixed[0] += even_factor * x[0];
                    mixed[1] += even_factor * x[1];
                }
            }
            let row = x.get((2 * j + 1) * columns..(2 * j + 2) * columns).unwrap_or_default();
            for (x, mixed) in row.as_chunks::<2>().0.iter().zip(mixed.as_chunks_mut::<4>().0) {
                mixed[2] = factors[2] * x[0];
                mixed[3] = factors[2] * x[1];
            }
        }
    }

    /// Applies the transpose of [`mix`](Self::mix) to `mixed`, and adds the result to `x`.
    pub(crate) fn unmix(&self, m: usize, mixed: &[f64], columns: usize, x: &mut [f64]) {
        let Order { mixing, .. } = &self.orders[m];
        for ((j, factors), mixed) in mixing.iter().enumerate().zip(mixed.chunks_exact(2 * columns)) {
            for (k, factor, first) in [(2 * j, factors[0], 0), (2 * j + 1, factors[2], 2), (2 * j + 2, factors[1], 0)] {
                let row = x.get_mut(k * columns..(k + 1) * columns).unwrap_or_default();
                for (x, mixed) in row.as_chunks_mut::<2>().0.iter_mut().zip(mixed.as_chunks::<4>().0) {
                    x[0] += factor * mixed[first];
                    x[1] += factor * mixed[first + 1];
                }
            }
        }
    }
}

/// Computes the tables of one order. With `l = m + 2j`, `alpha_l alpha_{l+1} = (4 l^2 - 1) / (l^2 - m^2)`. From this
/// equation, the recurrence's factors a and b are computed with errors in the last bit only. Larger errors would
/// accumulate from step to step.
fn order(m: usize, alpha: &[f64]) -> Order {
    let count = alpha.len().div_ceil(2);
    let mut order = Order { steps: Vec::with_capacity(count), mixing: Vec::with_capacity(count) };
    let square = |l: usize| {
        let (l, m) = (l as f64, m as f64);
        (4.0 * l * l - 1.0, l * l - m * m)
    };
    // Numerator and denominator of kappa = A_{2j+1} / A_{2j-1}.
    let kappa = |j: usize| {
        let ((above, below), (above_before, below_before)) = (square(m + 2 * j), square(m + 2 * j - 1));
        (above * below_before, below * above_before)
    };
    // Returns A_{2j+1}, the factor alpha of degree m + 2j + 1. If this degree is above the highest degree, the factor
    // is computed from A_{2j-1}.
    let odd = |j: usize| match (alpha.get(2 * j + 1), j) {
        (Some(alpha), _) => *alpha,
        (None, 0) => 1.0,
        (None, _) => alpha[2 * j - 1] * (kappa(j).0 / kappa(j).1),
    };
    let (mut before, mut sigma) = (1.0, 1.0);
    for j in 0..count {
        if j == 0 {
            order.steps.push([0.0; 2]);
        } else {
            let ((above, below), kappa) = (square(m + 2 * j), kappa(j));
            let next = if j == 1 { 1.0 } else { before * (kappa.0 / kappa.1) };
            let ratio = quotient(sigma, next);
            let a = product(quotient(above, below), ratio);
            let b = product(quotient(kappa.0 + kappa.1, kappa.1), ratio);
            order.steps.push([a, -b]);
            (before, sigma) = (sigma, next);
        }
        // There is no coefficient beyond the highest degree.
        let next = if 2 * j + 2 < alpha.len() { sigma / odd(j + 1) } else { 0.0 };
        order.mixing.push([sigma / odd(j), next, sigma]);
    }
    order
}

/// Returns a quotient and its rounding error.
#[inline(always)]
fn quotient(a: f64, b: f64) -> [f64; 2] {
    let q = a / b;
    let back = DoubleDouble::<false>::product(q, b);
    [q, ((a - back.hi) - back.lo) / b]
}

#[inline(always)]
fn product([a, rest_of_a]: [f64; 2], [b, rest_of_b]: [f64; 2]) -> f64 {
    let exact = DoubleDouble::<false>::product(a, b);
    exact.hi + (exact.lo + (a * rest_of_b + b * rest_of_a))
}

#[cfg(test)]
mod tests {
    use spharm_harmonics::double_double::unit;
    use spharm_harmonics::rings::MonicRecurrence;

    use super::*;

    struct Problem {
        alpha: Vec<f64>,
        scale: Vec<f64>,
        pairs: DegreePairs,
    }

    /// Prepares the tables of all orders; only order m is tested.
    fn problem(max_degree: usize, m: usize) -> Problem {
        let recurrence = MonicRecurrence::new(max_degree).unwrap();
        let of = |m: usize| {
            let (mut alpha, mut scale) = (Vec::new(), Vec::new());
            recurrence.order(m, &mut alpha, &mut scale);
            (alpha, scale)
        };
        let all: Vec<_> = (0..=max_degree).map(of).collect();
        let pairs = DegreePairs::new(max_degree, |m| &all[m].0);
        let (alpha, scale) = all[m].clone();
        Problem { alpha, scale, pairs }
    }

    /// Computes `r_l` times its scale in double-double for all degrees at a colatitude. This product is the Legendre
    /// function P without its factor `sin^m theta`.
    fn exact(max_degree: usize, m: usize, theta: f64, scale: &[f64]) -> Vec<f64> {
        let alpha = MonicRecurrence::new(max_degree).unwrap().exact_order::<false>(m);
        let z = unit::<false>([theta.sin(), 0.0, theta.cos()])[2];
        let (mut older, mut newest) = (DoubleDouble::new(-1.0), alpha[0]);
        let step = |alpha: &_| {
            let r = *alpha * z * newest - older;
            (older, newest) = (newest, r);
            r.value()
        };
        alpha.iter().map(step).zip(scale).map(|(r, s): (f64, _)| r * s).collect()
    }

    /// Returns the values t_j, computed by the recurrence.
    fn values(pairs: &DegreePairs, m: usize, square: f64) -> Vec<f64> {
        let (mut older, mut newest) = (-1.0, 0.0);
        let step = |&[a, b]: &[f64; 2]| {
            let t = a.mul_add(square, b).mul_add(newest, -older);
            (older, newest) = (newest, t);
            t
        };
        pairs.steps(m).iter().map(step).collect()
    }

    /// Computes each function of order m from mixed coefficients, and compares it with the function computed in
    /// double-double. Returns the largest error relative to the largest value.
    fn off(max_degree: usize, m: usize, theta: f64) -> f64 {
        let Problem { alpha, scale, pairs } = problem(max_degree, m);
        let expected = exact(max_degree, m, theta, &scale);
        let square = if theta < 0.8 { 1.0 - theta.sin().powi(2) } else { theta.cos().powi(2) };
        let t = values(&pairs, m, square);
        let mut mixed = Vec::new();
        let found = (0..alpha.len()).map(|k| {
            let mut x = vec![0.0; 2 * alpha.len()];
            x[2 * k + 1] = scale[k];
            pairs.mix(m, &x, 2, &mut mixed);
            mixed.chunks_exact(4).zip(&t).map(|(x, t)| t * (x[1] + theta.cos() * x[3])).sum::<f64>()
        });
        let largest = expected.iter().fold(0.0f64, |most, value| most.max(value.abs()));
        found.zip(&expected).fold(0.0f64, |most, (found, expected)| most.max((found - expected).abs())) / largest
    }

    #[test]
    fn functions_are_those_of_double_double() {
        for (max_degree, m) in [(0, 0), (1, 0), (1, 1), (2, 0), (7, 3), (8, 3), (60, 0), (61, 2), (90, 40)] {
            for theta in [0.02, 0.3, 0.8, 1.2, 1.5] {
                let off = off(max_degree, m, theta);
                assert!(off < 4e-14, "L = {max_degree}, m = {m}, theta = {theta}: {off:e}");
            }
        }
    }

    /// Errors grow with the degree and towards poles and equator, like the effect of a rounding error of z on the
    /// phase `l theta`.
    #[test]
    fn high_degrees_keep_their_digits() {
        const DEGREE: usize = 1000;
        for (m, theta) in [(0, 0.06), (5, 0.06), (0, 0.5), (30, 1.0), (0, 1.45)] {
            let off = off(DEGREE, m, theta);
            let most = 0.3 * f64::EPSILON * DEGREE as f64 / (2.0 * theta).sin();
            assert!(off < most, "m = {m}, theta = {theta}: {off:e}");
        }
    }

    #[test]
    fn unmixing_is_the_transpose() {
        for (max_degree, m, columns) in [(9, 2, 2), (10, 2, 4), (5, 5, 2)] {
            let Problem { alpha, pairs, .. } = problem(max_degree, m);
            let numbers =
                |count: usize, seed: f64| -> Vec<f64> { (0..count).map(|i| (seed * i as f64).sin()).collect() };
            let x = numbers(alpha.len() * columns, 1.3);
            let mut mixed = Vec::new();
            pairs.mix(m, &x, columns, &mut mixed);
            let y = numbers(mixed.len(), 0.7);
            let mut back = vec![0.0; x.len()];
            pairs.unmix(m, &y, columns, &mut back);
            let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            assert!((dot(&mixed, &y) - dot(&x, &back)).abs() < 1e-13 * dot(&mixed, &mixed).sqrt() * dot(&y, &y).sqrt());
        }
    }
}
