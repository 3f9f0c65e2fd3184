//! Computes the exponentials in the responsibilities of coherent point drift, for the pairs of one point with each
//! point of a range.

use multiversion::multiversion;

/// Points with unit normals. Each coordinate has its own array.
#[derive(Default)]
pub(crate) struct Columns {
    pub(crate) x: [Vec<f64>; 3],
    pub(crate) n: [Vec<f64>; 3],
}

/// A point and its unit normal, with the weights of distances and of normals.
pub(crate) struct Probe {
    pub(crate) x: [f64; 3],
    pub(crate) n: [f64; 3],
    /// Factor 1 / (2 sigma^2) of the squared distances, where sigma is the width of the Gaussians.
    pub(crate) sharpness: f64,
    pub(crate) kappa: f64,
}

/// Writes `exp(-|x - y|^2 sharpness + kappa (n_x . n_y - 1))` to `out` for each point y of the range that begins at
/// `from`, and returns the sum. Takes about 25 flops per pair.
#[multiversion(targets("x86_64+avx512f", "x86_64+avx2+fma", "aarch64+neon"))]
pub(crate) fn exponentials(probe: &Probe, of: &Columns, from: usize, out: &mut [f64]) -> f64 {
    let to = from + out.len();
    let [x, y, z] = [&of.x[0][from..to], &of.x[1][from..to], &of.x[2][from..to]];
    let [nx, ny, nz] = [&of.n[0][from..to], &of.n[1][from..to], &of.n[2][from..to]];
    for i in 0..out.len() {
        let (dx, dy, dz) = (x[i] - probe.x[0], y[i] - probe.x[1], z[i] - probe.x[2]);
        let along = nx[i] * probe.n[0] + ny[i] * probe.n[1] + nz[i] * probe.n[2];
        out[i] = exp(probe.kappa * (along - 1.0) - (dx * dx + dy * dy + dz * dz) * probe.sharpness);
    }
    // Four independent sums, which a processor can compute in parallel.
    let mut sums = [0.0; 4];
    let chunks = out.chunks_exact(4);
    let rest: f64 = chunks.remainder().iter().sum();
    chunks.for_each(|chunk| (0..4).for_each(|k| sums[k] += chunk[k]));
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}

/// Returns e^t to a relative accuracy of 1e-13 for t from -700 to 700; other t are clamped to this range. The function
/// uses only arithmetic, so that compilers can vectorise it.
#[inline(always)]
fn exp(t: f64) -> f64 {
    // Adding 1.5 * 2^52 rounds to an integer, which is then in the lowest bits of the sum.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    const LN_2: [f64; 2] = [0.693_147_180_369_123_8, 1.908_214_929_270_587_7e-10];
    let t = t.clamp(-700.0, 700.0);
    let rounded = t * std::f64::consts::LOG2_E + ROUND;
    let k = rounded - ROUND;
    let r = (t - k * LN_2[0]) - k * LN_2[1];
    const TAYLOR: [f64; 11] = [
        1.0 / 39_916_800.0,
        1.0 / 3_628_800.0,
        1.0 / 362_880.0,
        1.0 / 40_320.0,
        1.0 / 5_040.0,
        1.0 / 720.0,
        1.0 / 120.0,
        1.0 / 24.0,
        1.0 / 6.0,
        0.5,
        1.0,
    ];
    let series = TAYLOR.iter().fold(0.0, |sum, c| sum * r + c) * r + 1.0;
    series * f64::from_bits(rounded.to_bits().wrapping_add(1023) << 52)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_exponential_is_that_of_the_library() {
        for k in -7000..=7000 {
            let t = 0.1 * f64::from(k) + 0.013;
            let t = t.clamp(-700.0, 700.0);
            assert!((exp(t) / t.exp() - 1.0).abs() < 1e-13, "{t}");
        }
        assert_eq!(exp(0.0), 1.0);
        assert!(exp(-1e300) < 1e-300);
    }

    #[test]
    fn pairs_are_what_their_formula_says() {
        let column = |k: usize| (0..11).map(|i| ((3 * i + k) as f64).sin()).collect::<Vec<f64>>();
        let of = Columns { x: std::array::from_fn(column), n: std::array::from_fn(|k| column(k + 5)) };
        let probe = Probe { x: [0.2, -0.4, 0.1], n: [0.6, 0.0, 0.8], sharpness: 1.7, kappa: 2.0 };
        let mut out = [0.0; 7];
        let sum = exponentials(&probe, &of, 3, &mut out);
        for (i, value) in out.iter().enumerate() {
            let square: f64 = (0..3).map(|k| (of.x[k][3 + i] - probe.x[k]).powi(2)).sum();
            let along: f64 = (0..3).map(|k| of.n[k][3 + i] * probe.n[k]).sum();
            let expected = (-1.7 * square + 2.0 * (along - 1.0)).exp();
            assert!((value / expected - 1.0).abs() < 1e-12, "{i}");
        }
        assert!((sum - out.iter().sum::<f64>()).abs() < 1e-14);
    }
}
