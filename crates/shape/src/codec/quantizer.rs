//! Quantises coefficients to integer multiples of a step, and reconstructs them.
//!
//! Harmonics are orthonormal, so an error in a coefficient has the same effect on the mean square error at any degree
//! and order. Therefore a single step for all coefficients minimises the mean square error. Fractions of 0.62 and above
//! are rounded up, instead of fractions of 0.5 and above. This widens the zone that is rounded to 0 and shifts
//! magnitudes towards 0, because smaller magnitudes need fewer bits (Sullivan, "Efficient scalar quantization of
//! exponential and Laplacian random variables", IEEE Transactions on Information Theory 42, 1996). A magnitude is
//! reconstructed as the mean of the values that were rounded to it. The shift from a magnitude to this mean is stored
//! once for magnitude 1, and once for all magnitudes of 2 and more.
//!
//! The coefficients of degree 0, the surface's position, are rounded to the nearest multiple. These multiples may be
//! much larger than the multiples at other degrees.

use ndarray::{Array2, ArrayView2};

use super::error::CodecError;
use super::stream::LARGEST;

/// Offset added to a magnitude before it is rounded down.
const ROUNDING: f64 = 0.38;

/// Largest multiple of the step that may be stored for a coefficient of degree 0. Above this number, f64 can't
/// represent all integers.
const MOST_AT_DEGREE_0: f64 = (1u64 << 53) as f64;

/// Quantised coefficients.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Quantised {
    /// Steps of the channels, greater than 0; a surface has a single step for all channels.
    pub(super) steps: Vec<f64>,
    /// The coefficient of degree 0 of each channel, as a multiple of the channel's step.
    pub(super) first: Vec<i64>,
    /// Amounts by which reconstructed magnitudes are reduced, in 256ths of a step: the first for magnitude 1, the
    /// second for magnitudes of 2 and more.
    pub(super) shifts: [i8; 2],
    /// Multiples of the step for all coefficients (K, c); the row of degree 0 is zero.
    pub(super) values: Vec<i32>,
}

impl Quantised {
    /// Quantises finite coefficients (K, c) with one step per channel, or a single step for all channels.
    pub(super) fn new(coefficients: ArrayView2<'_, f64>, steps: Vec<f64>) -> Result<Self, CodecError> {
        let channels = coefficients.ncols();
        let step = |channel: usize| steps[channel % steps.len()];
        let too_fine = |channel: usize, value: f64, most: f64| CodecError::TooFine { step: step(channel), value, most };
        let mut first = Vec::with_capacity(channels);
        for (channel, &value) in coefficients.row(0).iter().enumerate() {
            let count = (value / step(channel)).round();
            if count.abs() > MOST_AT_DEGREE_0 {
                return Err(too_fine(channel, value, MOST_AT_DEGREE_0));
            }
            first.push(count as i64);
        }
        let mut values = vec![0; coefficients.len()];
        let mut means = [(0.0, 0u64); 2];
        for (at, &value) in coefficients.iter().enumerate().skip(channels) {
            let exact = value.abs() / step(at % channels);
            let count = (exact + ROUNDING).floor();
            if count > f64::from(LARGEST) {
                return Err(too_fine(at % channels, value, f64::from(LARGEST)));
            }
            if count > 0.0 {
                let (sum, number) = &mut means[usize::from(count > 1.0)];
                *sum += count - exact;
                *number += 1;
                values[at] = if value < 0.0 { -count } else { count } as i32;
            }
        }
        let shifts = means.map(|(sum, number)| (256.0 * sum / number.max(1) as f64).round() as i8);
        Ok(Self { steps, first, shifts, values })
    }

    /// Returns the highest degree that has a nonzero coefficient.
    pub(super) fn top(&self) -> usize {
        let last = self.values.iter().rposition(|&value| value != 0);
        last.map_or(0, |last| (last / self.first.len()).isqrt())
    }

    /// Returns the reconstructed coefficients (K, c).
    pub(super) fn coefficients(&self) -> Array2<f64> {
        let channels = self.first.len();
        let step = |channel: usize| self.steps[channel % self.steps.len()];
        let lean = self.shifts.map(|shift| f64::from(shift) / 256.0);
        Array2::from_shape_fn((self.values.len() / channels, channels), |(row, channel)| match row {
            0 => self.first[channel] as f64 * step(channel),
            _ => {
                let value = self.values[row * channels + channel];
                let magnitude = match value.unsigned_abs() {
                    0 => 0.0,
                    1 => 1.0 - lean[0],
                    more => f64::from(more) - lean[1],
                };
                f64::from(value.signum()) * magnitude * step(channel)
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Rounding changes a coefficient by at most 0.62 of a step, and the shift of its reconstructed magnitude adds
        /// at most half a step.
        #[test]
        fn nothing_is_far_off(values in prop::collection::vec(-1e3..1e3f64, 18), step in 0.01..100.0f64) {
            let given = Array2::from_shape_vec((9, 2), values).unwrap();
            let found = Quantised::new(given.view(), vec![step]).unwrap().coefficients();
            for (a, b) in given.iter().zip(&found) {
                prop_assert!((a - b).abs() <= 1.13 * step, "{a} {b}");
            }
        }
    }

    #[test]
    fn what_is_too_fine_is_said() {
        let mut given = Array2::from_elem((4, 1), 1.0);
        let error = Quantised::new(given.view(), vec![1e-10]).unwrap_err();
        assert!(matches!(error, CodecError::TooFine { value: 1.0, .. }), "{error}");
        given.fill(0.0);
        given[[0, 0]] = 1.0;
        let found = Quantised::new(given.view(), vec![1e-10]).unwrap();
        assert_eq!((found.first.as_slice(), found.top()), (&[10_000_000_000][..], 0));
        assert!(Quantised::new(given.view(), vec![1e-17]).is_err());
    }
}
