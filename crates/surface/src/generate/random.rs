//! Generates deterministic random numbers, identical on every machine and in every version.

use crate::geometry::{Vec3, cross, unit};

/// The generator SplitMix64 of Steele, Lea and Flood (OOPSLA 2014). It is good enough for generating shapes, and takes
/// three lines of code.
#[derive(Debug, Clone)]
pub struct SplitMix64(u64);

impl SplitMix64 {
    /// Starts the sequence of numbers for a seed.
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut x = self.0;
        x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        x ^ (x >> 31)
    }

    /// Returns the next number, uniformly distributed in [low, high).
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        let unit = (self.next() >> 11) as f64 / (1_u64 << 53) as f64;
        low + (high - low) * unit
    }

    /// Returns a unit vector, uniform over the sphere (by Archimedes, height and azimuth are independent and uniform).
    pub(super) fn direction(&mut self) -> Vec3 {
        let z = self.between(-1.0, 1.0);
        let phi = self.between(0.0, std::f64::consts::TAU);
        let r = (1.0 - z * z).sqrt();
        [r * phi.cos(), r * phi.sin(), z]
    }

    /// Returns a random unit vector perpendicular to `k`.
    pub(super) fn square_to(&mut self, k: Vec3) -> Vec3 {
        loop {
            let e = cross(k, self.direction());
            // Any direction that isn't nearly parallel to k is suitable, so the first random direction nearly always
            // is.
            if e.iter().map(|x| x * x).sum::<f64>() > 1e-6 * k.iter().map(|x| x * x).sum::<f64>() {
                return unit(e);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::dot;

    /// The expected values are the first numbers of the published generator SplitMix64 for seed 0.
    #[test]
    fn numbers_are_those_of_splitmix64() {
        let mut random = SplitMix64::new(0);
        for expected in [0xe220_a839_7b1d_cdaf, 0x6e78_9e6a_a1b9_65f4, 0x06c4_5d18_8009_454f, 0xf88b_b8a8_724c_81ec] {
            assert_eq!(random.next(), expected);
        }
        let mut random = SplitMix64::new(0);
        // The upper 53 bits of the first value, divided by 2^53.
        assert_eq!(random.between(0.0, 1.0), 0.883_310_808_213_642_6);
        assert_eq!(random.between(-3.0, 5.0), -3.0 + 8.0 * 0.431_527_997_048_509_97);
    }

    #[test]
    fn directions_are_unit_vectors_all_over_the_sphere() {
        let mut random = SplitMix64::new(7);
        let (mut sum, mut squares) = ([0.0; 3], [0.0; 3]);
        for _ in 0..2000 {
            let d = random.direction();
            assert!((dot(d, d) - 1.0).abs() < 1e-14, "{d:?}");
            sum = std::array::from_fn(|k| sum[k] + d[k]);
            squares = std::array::from_fn(|k| squares[k] + d[k] * d[k]);
            let e = random.square_to([3.0 * d[0], 3.0 * d[1], 3.0 * d[2]]);
            assert!((dot(e, e) - 1.0).abs() < 1e-14 && dot(d, e).abs() < 1e-12, "{d:?} {e:?}");
        }
        // 105 is four standard deviations of the sum of 2000 random numbers that are uniformly distributed in [-1, 1].
        assert!(sum.iter().all(|sum| sum.abs() < 105.0), "{sum:?}");
        assert!(squares.iter().all(|sum| (sum - 2000.0 / 3.0).abs() < 55.0), "{squares:?}");
    }
}
