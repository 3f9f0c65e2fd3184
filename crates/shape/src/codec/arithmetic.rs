//! Implements a binary arithmetic coder, which codes a sequence of decisions, each 0 or 1, given their probabilities.
//! The state is an interval with 32-bit bounds. A leading byte is output as soon as both bounds share it, so no carry
//! occurs.
//!
//! The interval is `low..=high`. A decision whose probability of being 1 is p / 65,536 splits the interval at `middle =
//! low + ((high - low) p >> 16)`: 1 selects `low..=middle`, and 0 selects the rest. While the top bytes of `low` and
//! `high` are equal, that byte is written, and both are shifted by 8 bits. The decoder computes the same intervals, and
//! compares `middle` with a window of 32 bits of the stream. The decoder reads 4 bytes at the start and one byte for
//! each shift. Beyond the end of the stream, the decoder reads zeros.
//!
//! After Witten, Neal and Cleary, "Arithmetic coding for data compression", Communications of the ACM 30 (1987), in the
//! byte-oriented form of M. Mahoney's PAQ.

/// Denominator of all probabilities. Numerators are from 1 to `ONE - 1`.
pub(super) const ONE: u32 = 1 << 16;

/// Writer or reader of decisions. A probability model uses this interface, so that the same model works with a writer
/// and with a reader.
pub(super) trait Decisions {
    /// Codes a decision that is 1 with probability `one` / 65,536. A writer writes `bit`; a reader ignores it and
    /// returns the decision read.
    fn decide(&mut self, bit: bool, one: u32) -> Result<bool, Ended>;

    /// Codes the lower `count` bits of `bits` (at most 32), most significant first. Each bit has probability 1/2.
    fn plain(&mut self, bits: u32, count: u32) -> Result<u32, Ended> {
        let mut found = 0;
        for shift in (0..count).rev() {
            found = found << 1 | u32::from(self.decide(bits >> shift & 1 == 1, ONE / 2)?);
        }
        Ok(found)
    }
}

/// Error for a stream that ends before the requested decision.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Ended;

fn split(low: u32, high: u32, one: u32) -> u32 {
    // The result is below `high`, because `one` is below 65,536.
    low + ((u64::from(high - low) * u64::from(one)) >> 16) as u32
}

/// Writer of decisions.
pub(super) struct Encoder {
    low: u32,
    high: u32,
    bytes: Vec<u8>,
}

impl Encoder {
    pub(super) fn new() -> Self {
        Self { low: 0, high: u32::MAX, bytes: Vec::new() }
    }

    /// Returns the number of bytes that a decoder has read once it has decoded everything written so far.
    pub(super) fn reach(&self) -> usize {
        self.bytes.len() + 4
    }

    /// Returns the finished stream: the fewest bytes from which a decoder that reads zeros beyond the end obtains all
    /// decisions.
    pub(super) fn finish(mut self) -> Vec<u8> {
        for count in 0..=4 {
            let unit = 1u64 << (32 - 8 * count);
            let value = u64::from(self.low).div_ceil(unit) * unit;
            if value <= u64::from(self.high) {
                self.bytes.extend((value as u32).to_be_bytes().iter().take(count));
                break;
            }
        }
        self.bytes
    }
}

impl Decisions for Encoder {
    fn decide(&mut self, bit: bool, one: u32) -> Result<bool, Ended> {
        let middle = split(self.low, self.high, one);
        if bit {
            self.high = middle
        } else {
            self.low = middle + 1
        }
        while (self.low ^ self.high) >> 24 == 0 {
            self.bytes.push((self.high >> 24) as u8);
            self.low <<= 8;
            self.high = self.high << 8 | 255;
        }
        Ok(bit)
    }
}

/// Reader of decisions.
pub(super) struct Decoder<'a> {
    low: u32,
    high: u32,
    window: u32,
    bytes: &'a [u8],
    /// Number of bytes read, including the zeros beyond the end.
    read: usize,
}

impl<'a> Decoder<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        let mut decoder = Self { low: 0, high: u32::MAX, window: 0, bytes, read: 0 };
        (0..4).for_each(|_| decoder.shift());
        decoder
    }

    fn shift(&mut self) {
        self.window = self.window << 8 | u32::from(self.bytes.get(self.read).copied().unwrap_or(0));
        self.read += 1;
    }
}

impl Decisions for Decoder<'_> {
    fn decide(&mut self, _: bool, one: u32) -> Result<bool, Ended> {
        let middle = split(self.low, self.high, one);
        let bit = self.window <= middle;
        if bit {
            self.high = middle
        } else {
            self.low = middle + 1
        }
        while (self.low ^ self.high) >> 24 == 0 {
            self.low <<= 8;
            self.high = self.high << 8 | 255;
            self.shift();
        }
        // Decoding an encoder's output reads at most 4 zeros beyond its end. Without this check a short stream could
        // yield any number of decisions.
        if self.read > self.bytes.len() + 4 { Err(Ended) } else { Ok(bit) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn decisions_come_back(given in prop::collection::vec((any::<bool>(), 1..ONE), 0..2000)) {
            let mut encoder = Encoder::new();
            given.iter().for_each(|&(bit, one)| { encoder.decide(bit, one).unwrap(); });
            let bytes = encoder.finish();
            let mut decoder = Decoder::new(&bytes);
            for &(bit, one) in &given {
                prop_assert_eq!(decoder.decide(false, one), Ok(bit));
            }
        }

        /// The bytes that `reach` reports after n decisions are enough to decode these n decisions.
        #[test]
        fn a_prefix_is_enough(given in prop::collection::vec((any::<bool>(), 1..ONE), 1..600), at in 0.0..1.0) {
            let at = (at * given.len() as f64) as usize;
            let mut encoder = Encoder::new();
            given[..at].iter().for_each(|&(bit, one)| { encoder.decide(bit, one).unwrap(); });
            let reach = encoder.reach();
            given[at..].iter().for_each(|&(bit, one)| { encoder.decide(bit, one).unwrap(); });
            let bytes = encoder.finish();
            let mut cut = bytes[..reach.min(bytes.len())].to_vec();
            cut.resize(cut.len().max(reach), 0);
            cut.extend([0xa5; 8]);
            let mut decoder = Decoder::new(&cut);
            for &(bit, one) in &given[..at] {
                prop_assert_eq!(decoder.decide(false, one), Ok(bit));
            }
        }
    }

    /// The size of the stream is the entropy of its decisions plus a few bytes.
    #[test]
    fn it_takes_what_the_probabilities_say() {
        let mut encoder = Encoder::new();
        let mut bits = 0.0;
        for i in 0..100_000u32 {
            let (bit, one) = (i.wrapping_mul(2_654_435_761) >> 16 < 3000, 3000);
            let p = f64::from(one) / f64::from(ONE);
            bits -= (if bit { p } else { 1.0 - p }).log2();
            encoder.decide(bit, one).unwrap();
        }
        let bytes = encoder.finish().len() as f64;
        assert!((bytes - bits / 8.0).abs() < 8.0, "{bytes} {}", bits / 8.0);
    }

    #[test]
    fn a_stream_that_ends_says_so() {
        let mut decoder = Decoder::new(&[]);
        let found = (0..100_000).find_map(|_| decoder.decide(false, ONE / 2).err());
        assert_eq!(found, Some(Ended));
    }
}
