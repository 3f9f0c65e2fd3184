//! Gauss-Legendre rings: the colatitudes and weights that integrate polynomials in `cos theta` exactly.
//!
//! The nodes are the zeros `x_j` of the Legendre polynomial `P_n`. The weights `w_j` and the integration rule are
//!
//! ```text
//! w_j = 2 / ((1 - x_j^2) P_n'(x_j)^2),    sum_j w_j p(x_j) = integral over -1..1 of p(x) dx
//! ```
//!
//! The rule is exact for every polynomial p of degree up to `2n - 1`. On the sphere, n rings of more than 2n - 1
//! equidistant azimuths integrate every function of degree up to `2n - 1`.
//!
//! Nodes are computed by Newton's method, from F. G. Tricomi's guess, `(1 - (n - 1)/(8 n^3)) cos(pi (4j + 3)/(4n + 2))`
//! (Ann. Mat. Pura Appl. 31 (1950)). The last step is computed in double-double, all others in doubles. Next to the
//! poles the sine determines the colatitude, and there the three-term recurrence of `P_n` in doubles gives the sine a
//! relative error of about n^1.5 eps. Nodes, sines and weights have a relative error of a few eps at any practical n;
//! this is tested up to n = 4,001.
//!
//! Cost: about 35 n^2 flops and 32 n bytes of tables; 0.05 s for 4,001 rings.

use std::ops::{Add, Div, Mul, Sub};

use multiversion::{multiversion, target::target_cfg_f};

use crate::double_double::DoubleDouble;

/// Number of nodes computed together. 16 nodes are enough to hide the latency of the recurrence's dependent operations.
const LANES: usize = 16;
/// Number of steps of Newton's method in doubles. The guess is worst at the first node, where its error is about 1 % of
/// the spacing. Even at this node, 4 steps are enough, so the fifth step is a margin.
const STEPS: usize = 5;

/// Nodes and weights of Gauss-Legendre quadrature as rings of the sphere, from north to south.
#[derive(Debug, Clone, PartialEq)]
pub struct GaussLegendre {
    /// Values of `cos theta_j` (n) in decreasing order.
    pub cosines: Vec<f64>,
    /// Values of `sin theta_j` (n); the relative error is a few eps, even next to the poles.
    pub sines: Vec<f64>,
    /// Weights (n) of the integral over `cos theta`; the sum of the weights is 2.
    pub weights: Vec<f64>,
}

impl GaussLegendre {
    /// Returns the colatitude of ring `j` in radians.
    ///
    /// # Panics
    ///
    /// If there is no ring `j`.
    pub fn colatitude(&self, j: usize) -> f64 {
        self.sines[j].atan2(self.cosines[j])
    }

    /// Returns the direction of ring `j` at azimuth 0.
    ///
    /// # Panics
    ///
    /// If there is no ring `j`.
    pub fn direction(&self, j: usize) -> [f64; 3] {
        [self.sines[j], 0.0, self.cosines[j]]
    }

    /// Returns the number of rings, n.
    pub fn len(&self) -> usize {
        self.weights.len()
    }

    /// Returns whether there are no rings.
    pub fn is_empty(&self) -> bool {
        self.weights.is_empty()
    }
}

/// Returns the `n` Gauss-Legendre rings. The southern half mirrors the northern half bit for bit.
pub fn gauss_legendre(n: usize) -> GaussLegendre {
    let mut rings = GaussLegendre { cosines: vec![0.0; n], sines: vec![0.0; n], weights: vec![0.0; n] };
    let north = n.div_ceil(2);
    for first in (0..north).step_by(LANES) {
        for (lane, [cosine, sine, weight]) in nodes(n, first).into_iter().enumerate().take(north - first) {
            let (j, mirror) = (first + lane, n - 1 - first - lane);
            rings.cosines[mirror] = -cosine;
            // The northern cosine is written after its mirror image, so that the equator gets +0.
            rings.cosines[j] = cosine;
            (rings.sines[j], rings.sines[mirror]) = (sine, sine);
            (rings.weights[j], rings.weights[mirror]) = (weight, weight);
        }
    }
    rings
}

/// Returns (cosine, sine, weight) of the nodes from `first` on. Values for nodes south of the equator are meaningless.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
fn nodes(n: usize, first: usize) -> [[f64; 3]; LANES] {
    if target_cfg_f!(any(target_feature = "fma", target_arch = "aarch64")) {
        nodes_of::<true>(n, first)
    } else {
        nodes_of::<false>(n, first)
    }
}

#[inline(always)]
fn nodes_of<const FMA: bool>(n: usize, first: usize) -> [[f64; 3]; LANES] {
    let degree = n as f64;
    let mut x: [f64; LANES] = std::array::from_fn(|lane| {
        let j = (first + lane).min(n - 1);
        if 2 * j + 1 == n {
            return 0.0;
        }
        let angle = std::f64::consts::PI * (4 * j + 3) as f64 / (4 * n + 2) as f64;
        (1.0 - (degree - 1.0) / (8.0 * degree * degree * degree)) * angle.cos()
    });
    for _ in 0..STEPS {
        let (previous, value) = legendre(n, &x);
        for lane in 0..LANES {
            let slope = degree * (previous[lane] - x[lane] * value[lane]) / ((1.0 - x[lane]) * (1.0 + x[lane]));
            x[lane] -= value[lane] / slope;
        }
    }
    let (previous, value) = legendre_exact::<FMA>(n, &x);
    std::array::from_fn(|lane| {
        let (p, x) = (value[lane].value(), x[lane]);
        let one_minus = |square: DoubleDouble<FMA>| DoubleDouble::new(1.0).sub(square);
        let sine2 = one_minus(DoubleDouble::product(x, x)).value();
        let slope = degree * (previous[lane].value() - x * p) / sine2;
        // The second derivative, from Legendre's equation. Near a pole the error of x, a few eps, is a large part of
        // 1 - x^2, so the slope is corrected as well.
        let curvature = (2.0 * x * slope - degree * (degree + 1.0) * p) / sine2;
        let step = -p / slope;
        let node = DoubleDouble::new(x).add(DoubleDouble::new(step));
        let sine2 = one_minus(node.mul(node));
        let slope = slope + step * curvature;
        [node.value(), sine2.sqrt().value(), 2.0 / (sine2.value() * slope * slope)]
    })
}

/// Returns `P_{n-1}(x)` and `P_n(x)`, from `P_{k+1} = x P_k + k/(k+1) (x P_k - P_{k-1})`.
#[inline(always)]
fn legendre(n: usize, x: &[f64; LANES]) -> ([f64; LANES], [f64; LANES]) {
    let (mut older, mut old) = ([0.0; LANES], [1.0; LANES]);
    for k in 0..n {
        let ratio = k as f64 / (k + 1) as f64;
        for lane in 0..LANES {
            let product = x[lane] * old[lane];
            (older[lane], old[lane]) = (old[lane], product + ratio * (product - older[lane]));
        }
    }
    (older, old)
}

/// Returns `P_{n-1}(x)` and `P_n(x)` as `legendre` does, but in double-double.
#[inline(always)]
fn legendre_exact<const FMA: bool>(
    n: usize,
    x: &[f64; LANES],
) -> ([DoubleDouble<FMA>; LANES], [DoubleDouble<FMA>; LANES]) {
    let (mut older, mut old) = ([DoubleDouble::ZERO; LANES], [DoubleDouble::new(1.0); LANES]);
    for k in 0..n {
        let ratio = DoubleDouble::<FMA>::new(k as f64).div(DoubleDouble::new((k + 1) as f64));
        for lane in 0..LANES {
            let product = old[lane].mul(DoubleDouble::new(x[lane]));
            (older[lane], old[lane]) = (old[lane], product.add(ratio.mul(product.sub(older[lane]))));
        }
    }
    (older, old)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Number of rings, index of the ring, and its [cosine, sine, weight] computed by mpmath with 45 digits.
    const KNOWN: [(usize, usize, [f64; 3]); 15] = [
        (100, 0, [0.999_713_726_773_441_3, 0.023_926_230_391_712_11, 0.000_734_634_490_505_671_7]),
        (100, 1, [0.998_491_950_639_595_8, 0.054_898_310_610_937_27, 0.001_709_392_653_518_105_2]),
        (100, 17, [0.849_964_527_879_591_3, 0.526_839_920_038_737_7, 0.016_468_086_176_145_213]),
        (100, 25, [0.693_149_199_355_802, 0.720_794_136_652_352_8, 0.022_531_220_256_336_273]),
        (100, 49, [0.015_628_984_421_543_084, 0.999_877_859_963_881_3, 0.031_255_423_453_863_354]),
        (401, 0, [0.999_982_062_391_548_9, 0.005_989_565_522_181_306, 4.603_355_824_737_915_5e-5]),
        (401, 1, [0.999_905_489_015_789_4, 0.013_748_201_194_889_877, 0.000_107_154_625_969_067_01]),
        (401, 17, [0.990_369_878_568_092_6, 0.138_446_753_754_003_3, 0.001_083_252_100_407_368_7]),
        (401, 100, [0.705_028_372_664_308_3, 0.709_179_098_492_276, 0.005_549_062_044_594_183]),
        (401, 199, [0.007_824_553_325_864_306, 0.999_969_387_714_069_3, 0.007_824_393_639_174_346]),
        (4001, 0, [0.999_999_819_410_912_2, 0.000_600_980_983_800_111_9, 4.634_499_027_812_270_6e-7]),
        (4001, 1, [0.999_999_048_486_976_3, 0.001_379_501_773_113_341_6, 1.078_822_879_043_373_4e-6]),
        (4001, 17, [0.999_902_893_411_007_5, 0.013_935_700_495_325_627, 1.094_053_114_142_947_5e-5]),
        (4001, 1000, [0.706_898_562_955_752, 0.707_314_938_122_398_7, 0.000_555_315_601_325_966_3]),
        (4001, 1999, [0.000_785_103_662_707_625_4, 0.999_999_691_806_072, 0.000_785_103_501_398_153_5]),
    ];

    #[test]
    fn nodes_sines_and_weights_keep_their_digits_at_any_count() {
        for (n, j, known) in KNOWN {
            let rings = gauss_legendre(n);
            for (found, known) in [rings.cosines[j], rings.sines[j], rings.weights[j]].into_iter().zip(known) {
                assert!((found / known - 1.0).abs() <= 4.0 * f64::EPSILON, "{n} {j}: {found} {known}");
            }
        }
    }

    #[test]
    fn monomials_are_integrated_exactly_and_south_mirrors_north() {
        for n in 0..70 {
            let rings = gauss_legendre(n);
            assert_eq!((rings.len(), rings.is_empty()), (n, n == 0));
            for power in 0..2 * n as i32 {
                let sum: f64 = rings.cosines.iter().zip(&rings.weights).map(|(x, w)| w * x.powi(power)).sum();
                let exact = if power % 2 == 0 { 2.0 / f64::from(power + 1) } else { 0.0 };
                assert!((sum - exact).abs() < 2e-15, "{n} {power}: {sum} {exact}");
            }
            for j in 0..n {
                assert_eq!(rings.cosines[j], -rings.cosines[n - 1 - j]);
                assert!(rings.weights[j] > 0.0 && (j == 0 || rings.colatitude(j) > rings.colatitude(j - 1)));
            }
        }
    }

    #[test]
    fn the_weights_of_4001_rings_sum_to_two() {
        let sum: f64 = gauss_legendre(4_001).weights.iter().sum();
        assert!((sum - 2.0).abs() < 2e-14, "{sum}");
    }
}
