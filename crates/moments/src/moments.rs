//! Defines [`Moments`]: the sums over samples that a fit needs, and a record of these samples.

use spharm_store::SchemeKey;
use spharm_transform::{Occupied, SampleSums};

use crate::MomentsError;

/// Largest number of shards into which a table may be divided.
pub const MOST_SHARDS: u32 = 1 << 24;

/// A shard: one of `of` nearly equal parts into which the samples are divided.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Shard {
    /// Index of the part, from 0.
    pub index: u32,
    /// Number of parts.
    pub of: u32,
}

impl Shard {
    /// The shard that contains all samples.
    pub const WHOLE: Self = Self { index: 0, of: 1 };

    /// Returns the part of the range `0..count` that belongs to this shard. The parts of all shards together cover the
    /// range without overlap.
    pub fn range(self, count: u64) -> std::ops::Range<u64> {
        let at = |index: u32| (u128::from(count) * u128::from(index) / u128::from(self.of)) as u64;
        at(self.index)..at(self.index + 1)
    }

    pub(crate) fn check(self) -> Result<(), MomentsError> {
        let Self { index, of } = self;
        if index < of && of <= MOST_SHARDS { Ok(()) } else { Err(MomentsError::Shard { index, of }) }
    }
}

/// Record of the samples from which moments were computed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Source {
    /// Hash that identifies the input: the names of its columns or its sampling scheme, and each file's name, size, and
    /// first and last bytes.
    pub key: [u8; 32],
    /// The part of the input that was read.
    pub shard: Shard,
    /// Number of samples in the part.
    pub rows: u64,
}

/// The sums over the samples of one part of the data, or of all data.
#[derive(Debug, Clone, PartialEq)]
pub struct Moments {
    /// Names of the c channels.
    pub channels: Vec<String>,
    /// The sums over samples of weights w and values f: moments to degree 2L, right-hand sides to degree L,
    /// `sum w f^2`, and the number of samples.
    pub sums: SampleSums,
    /// Number of samples, including those with weight 0.
    pub rows: u64,
    /// The cells of the sphere that contain samples of nonzero weight.
    pub occupied: Occupied,
    /// Key of the sampling scheme that gives the samples' directions, for scalar type f64. `None` if the table has
    /// columns for the positions.
    pub scheme: Option<SchemeKey>,
    /// Records of the samples from which the moments were computed, sorted by key and shard.
    pub sources: Vec<Source>,
}

impl Moments {
    /// Returns the name of the first channel whose sum of squares can't be used to compute the error of a fit: the sum
    /// is outside the range of f64, or so small that it lacks full precision even though the channel has nonzero
    /// values. Returns `of the weights` if the sums of the weights can't be used.
    pub fn out_of_range(&self) -> Option<&str> {
        let sums = &self.sums;
        let weights_are = sums.weight.is_normal() && sums.moments.iter().all(|moment| moment.is_finite());
        if !weights_are && (sums.weight != 0.0 || sums.count > 0) {
            return Some("of the weights");
        }
        let columns = sums.right_sides.columns().into_iter().zip(&sums.squares).zip(&self.channels);
        let mut beyond = columns.filter(|((right_sides, square), _)| {
            let has_values = right_sides.iter().any(|sum| *sum != 0.0);
            let finite = square.is_finite() && right_sides.iter().all(|sum| sum.is_finite());
            !finite || (has_values && !square.is_normal())
        });
        beyond.next().map(|(_, channel)| channel.as_str())
    }

    /// Returns a hash of the sums. Moments of the same samples have the same hash, whatever the name of the table.
    /// Returns `None` if all right-hand sides are zero, because different samples may then have the same sums.
    pub fn sums_hash(&self) -> Option<[u8; 32]> {
        let sums = &self.sums;
        let mut hash = blake3::Hasher::new();
        let values = sums.moments.iter().chain(&sums.right_sides).chain(&sums.squares);
        values.for_each(|value| {
            hash.update(&value.to_le_bytes());
        });
        sums.right_sides.iter().any(|sum| *sum != 0.0).then(|| *hash.finalize().as_bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_make_up_the_whole() {
        for (count, of) in [(0, 3), (1, 7), (100, 7), (u64::MAX, MOST_SHARDS)] {
            let ranges = |index| Shard { index, of }.range(count);
            assert_eq!((ranges(0).start, ranges(of - 1).end), (0, count));
            assert!((1..of.min(50)).all(|index| ranges(index).start == ranges(index - 1).end));
        }
        assert!(Shard { index: 3, of: 3 }.check().is_err() && Shard { index: 0, of: 0 }.check().is_err());
    }
}
