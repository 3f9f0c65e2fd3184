//! Deterministic random numbers, the same on every machine and in every version.

use crate::geometry::{Vec3, cross, unit};

/// Steele, Lea and Flood's splitmix64 (OOPSLA 2014): enough for shapes, and three lines.
#[derive(Debug, Clone)]
pub struct SplitMix64(u64);

impl SplitMix64 {
    /// Starts the sequence of a seed.
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

    /// Returns the next number, uniform in [low, high).
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        let unit = (self.next() >> 11) as f64 / (1_u64 << 53) as f64;
        low + (high - low) * unit
    }

    /// Uniform over the unit sphere (Archimedes: height and azimuth are independent and uniform).
    pub(super) fn direction(&mut self) -> Vec3 {
        let z = self.between(-1.0, 1.0);
        let phi = self.between(0.0, std::f64::consts::TAU);
        let r = (1.0 - z * z).sqrt();
        [r * phi.cos(), r * phi.sin(), z]
    }

    /// A unit vector square to `k`, in a random direction.
    pub(super) fn square_to(&mut self, k: Vec3) -> Vec3 {
        loop {
            let e = cross(k, self.direction());
            // All but parallel to k: nearly certain at the first try.
            if e.iter().map(|x| x * x).sum::<f64>() > 1e-6 * k.iter().map(|x| x * x).sum::<f64>() {
                return unit(e);
            }
        }
    }
}
