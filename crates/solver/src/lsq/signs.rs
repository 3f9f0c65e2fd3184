//! Generates independent random signs from a counter, for estimating traces and for generating noise. The signs are the
//! same on every machine and in any order of evaluation.

/// Returns the sign, 1 or -1, at a position of the sequence. The sign is given by the lowest bit of an output of
/// SplitMix64 (G. L. Steele, D. Lea, C. H. Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014).
pub(crate) fn sign(place: u64) -> f64 {
    let mut z = place.wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    if (z ^ (z >> 31)) & 1 == 0 { 1.0 } else { -1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first outputs of SplitMix64 with seed 0 are e220a8397b1dcdaf, 6e789e6aa1b965f4, 06c45d188009454f,
    /// f88bb8a8724c81ec, 1b39896a51a8749b, 53cb9f0c747ea2ea, 2c829abe1f4532e1, c584133ac916ab3c.
    #[test]
    fn signs_are_the_generators_and_balanced() {
        let found: Vec<f64> = (0..8).map(sign).collect();
        assert_eq!(found, [-1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0]);
        let sum: f64 = (0..10_000).map(sign).sum();
        let pairs: f64 = (0..10_000).map(|place| sign(place) * sign(place + 1)).sum();
        let far: f64 = (0..10_000).map(|place| sign(place) * sign(place + 64)).sum();
        // The absolute value of a sum of 10,000 independent signs is below three standard deviations, 300.
        assert!([sum, pairs, far].iter().all(|sum| sum.abs() < 300.0), "{sum} {pairs} {far}");
    }
}
