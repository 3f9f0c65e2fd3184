//! Codes quantised coefficients as a stream of decisions, each 0 or 1. The same code writes and reads streams.
//!
//! Degrees are coded in ascending order from 1. The orders of a degree are coded in the sequence 0, 1, -1, 2, -2, and
//! so on. The channels of an order are coded one after another. A magnitude is divided by 2^s, with s chosen so that
//! the expected quotient is at most 6. The quotient is coded in unary, and each decision has the mixed probability of
//! its contexts. The remainder and the sign are coded as raw bits.

use spharm_harmonics::index::column;

use super::arithmetic::{Decisions, Ended};
use super::contexts::{CLASSES, Contexts, UNIT, bound, class};
use super::mixing::{ESTIMATES, Estimate, Mixer, Weights};

/// Maximum number of unary decisions per quotient, each with its own probability. The rest of a larger quotient is
/// coded in Exp-Golomb form.
const UNARY: usize = 20;

/// Number of kinds of contexts. The context of an estimate combines the class of the expected magnitude with a kind.
/// Depending on the estimate, the kind is the region of the order, the channel modulo `KINDS`, or always 0.
const KINDS: usize = 4;

/// Number of classes of the shift s: 0, 1, and 2 or more. A magnitude is divided by 2^s before the quotient is coded.
/// Each class has its own mixing weights.
const SIZES: usize = 3;

/// The largest magnitude of a quantised coefficient.
pub(super) const LARGEST: u32 = 1 << 30;

/// Writer or reader of the quantised coefficients, one degree at a time.
pub(super) struct Stream {
    channels: usize,
    degree: usize,
    contexts: Contexts,
    /// Adaptive estimates of probabilities, indexed by (estimate, class, kind, decision).
    estimates: Vec<Estimate>,
    /// Mixing weights, indexed by (decision, class of the shift s); see [`SIZES`].
    weights: Vec<Weights>,
    mixer: Mixer,
}

impl Stream {
    /// Creates a stream that starts at degree 1, with `2^guess` as the assumed mean magnitude.
    pub(super) fn new(channels: usize, guess: u32) -> Self {
        let of_class = |class: usize| {
            // Twice the midpoint of the class of expected magnitudes.
            let mean = bound(class) + bound(class + 1);
            (0..KINDS * UNARY).map(move |i| {
                // Initial estimates assume an exponential distribution, with a dead zone for the decision between 0
                // and larger magnitudes.
                let over = if i % UNARY == 0 { 3 * UNIT / 2 } else { 2 * UNIT };
                Estimate::new(mean, mean + over)
            })
        };
        Self {
            channels,
            degree: 1,
            contexts: Contexts::new(channels, 1 << guess),
            estimates: (0..ESTIMATES).flat_map(|_| (0..CLASSES).flat_map(of_class)).collect(),
            weights: vec![Weights::new(); UNARY * SIZES],
            mixer: Mixer::new(),
        }
    }

    /// Writes or reads the next degree. `values` holds the coefficients (K, c) up to this degree: the input of a
    /// writer, the output of a reader.
    pub(super) fn degree(&mut self, values: &mut [i32], decisions: &mut impl Decisions) -> Result<(), Ended> {
        let l = self.degree;
        for place in 0..2 * l + 1 {
            let order = place.div_ceil(2);
            let m = if place % 2 == 1 { order as isize } else { -(order as isize) };
            let region = (4 * order / (l + 1)).min(KINDS - 1);
            for channel in 0..self.channels {
                let at = column(l, m) * self.channels + channel;
                let expected = self.contexts.expected(values, m, channel);
                let magnitude = self.magnitude(values[at].unsigned_abs(), expected, region, channel, decisions)?;
                let negative = magnitude > 0 && decisions.plain(u32::from(values[at] < 0), 1)? == 1;
                // The magnitude is below 2^31, so the cast is exact.
                values[at] = if negative { -(magnitude as i32) } else { magnitude as i32 };
                self.contexts.push(channel, magnitude);
            }
        }
        self.contexts.next_degree();
        self.degree += 1;
        Ok(())
    }

    fn magnitude(
        &mut self,
        magnitude: u32,
        expected: [u64; ESTIMATES],
        region: usize,
        channel: usize,
        decisions: &mut impl Decisions,
    ) -> Result<u32, Ended> {
        let shift = (0..24).find(|shift| expected[0] >> shift <= 6 * UNIT).unwrap_or(24);
        let kinds = [0, region, 0, 0, channel % KINDS, 0];
        let contexts: [usize; ESTIMATES] =
            std::array::from_fn(|i| ((i * CLASSES + class(expected[i] >> shift)) * KINDS + kinds[i]) * UNARY);
        let size = (shift as usize).min(SIZES - 1);
        let quotient = magnitude >> shift;
        let mut found = 0;
        while (found as usize) < UNARY {
            let decision = found as usize;
            let estimates = contexts.map(|context| &self.estimates[context + decision]);
            let weights = &mut self.weights[decision * SIZES + size];
            let one = self.mixer.mix(estimates, weights);
            let more = decisions.decide(quotient > found, one)?;
            self.mixer.update(more, weights);
            contexts.iter().for_each(|context| self.estimates[context + decision].update(more));
            if !more {
                break;
            }
            found += 1;
        }
        if found as usize == UNARY {
            found = found.saturating_add(golomb(quotient.saturating_sub(found), decisions)?);
        }
        let rest = decisions.plain(magnitude & ((1 << shift) - 1), shift)?;
        // Only a forged stream contains a magnitude above the limit.
        Ok((u64::from(found) << shift | u64::from(rest)).min(u64::from(LARGEST)) as u32)
    }
}

/// Codes a number in Exp-Golomb form. If `value + 1` has n bits after its leading bit, the code is n ones, a zero, and
/// these n bits.
fn golomb(value: u32, decisions: &mut impl Decisions) -> Result<u32, Ended> {
    let wanted = value.saturating_add(1).ilog2();
    let mut bits = 0;
    while bits < 31 && decisions.plain(u32::from(bits < wanted), 1)? == 1 {
        bits += 1;
    }
    let rest = decisions.plain(value.saturating_add(1) & ((1 << bits) - 1), bits)?;
    Ok(((1 << bits) | rest) - 1)
}

#[cfg(test)]
mod tests {
    use super::super::arithmetic::{Decoder, Encoder};
    use super::*;
    use proptest::prelude::*;

    /// Returns quantised coefficients that decay with the degree, except for some outliers.
    fn values(max_degree: usize, channels: usize, size: f64, seed: u64) -> Vec<i32> {
        let mut state = seed;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as f64 / (1u64 << 31) as f64
        };
        let mut values = vec![0; channels];
        for l in 1..=max_degree {
            for _ in 0..(2 * l + 1) * channels {
                let scale = size / (l * l) as f64 * if random() < 0.01 { 100.0 } else { 1.0 };
                values.push(((random() - 0.5) * scale).round().clamp(-1e9, 1e9) as i32);
            }
        }
        values
    }

    fn round_trip(values: &[i32], max_degree: usize, channels: usize, guess: u32) -> (Vec<i32>, usize) {
        let (mut stream, mut encoder) = (Stream::new(channels, guess), Encoder::new());
        let mut given = values.to_vec();
        (0..max_degree).for_each(|_| stream.degree(&mut given, &mut encoder).unwrap());
        let bytes = encoder.finish();
        let (mut stream, mut decoder) = (Stream::new(channels, guess), Decoder::new(&bytes));
        let mut found = vec![0; values.len()];
        (0..max_degree).for_each(|_| stream.degree(&mut found, &mut decoder).unwrap());
        (found, bytes.len())
    }

    proptest! {
        #[test]
        fn coefficients_come_back(l in 1..12usize, c in 1..7usize, size in 0.0..40.0, seed: u64, guess in 0..20u32) {
            let given = values(l, c, f64::exp2(size), seed);
            prop_assert_eq!(&round_trip(&given, l, c, guess).0, &given);
        }
    }

    #[test]
    fn extremes_come_back() {
        for extreme in [LARGEST as i32, -(LARGEST as i32), 1] {
            let mut given = vec![0; 49];
            given[30] = extreme;
            assert_eq!(round_trip(&given, 6, 1, 0).0, given);
        }
    }

    #[test]
    fn next_to_nothing_takes_next_to_nothing() {
        let (_, bytes) = round_trip(&vec![0; 3 * 101 * 101], 100, 3, 0);
        assert!(bytes < 40, "{bytes}");
    }
}
