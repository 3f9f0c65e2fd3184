//! Predicts the magnitude of a quantised coefficient before it is coded. The predictions select the contexts in which
//! the coder estimates probabilities.
//!
//! Coefficients of a smooth surface shrink with the degree, at about the same rate for all orders and channels.
//! Deviations from this trend are correlated. If a coefficient is large, three kinds of neighbours tend to be large as
//! well: the coefficients of the same order one and two degrees below, those of neighbouring orders, and those of the
//! other channels. Six expected magnitudes, in units of 1/256 of a step, are computed from these neighbours. Each
//! expected magnitude is a weighted mean of the magnitudes of coefficients that are already coded and of the running
//! mean of the current degree. Magnitudes are clamped to 2^20.

use spharm_harmonics::index::column;

use super::mixing::ESTIMATES;

/// Number of units per quantisation step in which expected magnitudes are measured.
pub(super) const UNIT: u64 = 256;

/// Number of classes of expected magnitudes. Four classes cover a factor of 2.
pub(super) const CLASSES: usize = 48;

/// Largest magnitude used in predictions; larger magnitudes are clamped to this value.
const LARGEST: u32 = 1 << 20;

/// Returns the class of an expected magnitude.
pub(super) fn class(expected: u64) -> usize {
    let class = match expected.checked_ilog2() {
        None | Some(0 | 1) => expected,
        Some(log) => 4 * (u64::from(log) - 1) + (expected >> (log - 2) & 3),
    };
    (class as usize).min(CLASSES - 1)
}

/// Returns the smallest expected magnitude of a class.
pub(super) fn bound(class: usize) -> u64 {
    if class < 4 { class as u64 } else { (4 + (class as u64 & 3)) << (class / 4 - 1) }
}

/// Weighted sum of magnitudes, with weights in eighths.
#[derive(Clone, Copy, Default)]
struct Sum {
    magnitudes: u64,
    weights: u64,
}

impl Sum {
    fn add(&mut self, weight: u64, magnitude: u64) {
        self.magnitudes += weight * magnitude;
        self.weights += weight;
    }

    fn and(self, other: Self) -> Self {
        Self { magnitudes: self.magnitudes + other.magnitudes, weights: self.weights + other.weights }
    }

    /// Returns the weighted mean of the summed magnitudes and of `guess`, which has the weight `weight`. The guess and
    /// the result are in units of 1 / [`UNIT`].
    fn mean(self, weight: u64, guess: u64) -> u64 {
        (UNIT * self.magnitudes + weight * guess) / (self.weights + weight)
    }
}

/// State of the contexts of one model, updated in the order of coding.
pub(super) struct Contexts {
    channels: usize,
    degree: usize,
    /// Mean magnitudes of the coefficients of the last two degrees. At degree 1 both are the guess from the header. At
    /// degree 2 both are the mean of degree 1.
    means: [u64; 2],
    /// Mean magnitude of each channel's coefficients at the previous degree.
    channel_means: Vec<u64>,
    /// For each channel, the sum of the magnitudes of the coefficients of the current degree; `sum` is the sum over all
    /// channels.
    channel_sums: Vec<u64>,
    sum: u64,
    /// Number of coefficients of the current degree coded so far, over all channels.
    count: u64,
}

impl Contexts {
    /// Creates the contexts for degree 1, for which `guess` is the assumed mean magnitude of the coefficients.
    pub(super) fn new(channels: usize, guess: u64) -> Self {
        let guess = UNIT * guess;
        Self {
            channels,
            degree: 1,
            means: [guess; 2],
            channel_means: vec![guess; channels],
            channel_sums: vec![0; channels],
            sum: 0,
            count: 0,
        }
    }

    /// Advances to the next degree.
    pub(super) fn next_degree(&mut self) {
        let orders = 2 * self.degree as u64 + 1;
        let mean = UNIT * self.sum / (orders * self.channels as u64);
        // `means` has the means of the last two degrees. No mean is known for degree 0, only a guess. After degree 1,
        // the guess is replaced by the mean of degree 1, because the difference between a mean and a guess says nothing
        // about the trend.
        self.means = [mean, if self.degree == 1 { mean } else { self.means[0] }];
        for (mean, sum) in self.channel_means.iter_mut().zip(&mut self.channel_sums) {
            *mean = UNIT * *sum / orders;
            *sum = 0;
        }
        (self.sum, self.count, self.degree) = (0, 0, self.degree + 1);
    }

    /// Records a coded magnitude.
    pub(super) fn push(&mut self, channel: usize, magnitude: u32) {
        let magnitude = u64::from(magnitude.min(LARGEST));
        self.sum += magnitude;
        self.channel_sums[channel] += magnitude;
        self.count += 1;
    }

    /// Returns the six expected magnitudes of the coefficient of order `m` in `channel`, in units of 1/256 of a step.
    /// `values` holds the quantised coefficients (K, c), of which only those before this coefficient have been coded.
    pub(super) fn expected(&self, values: &[i32], m: isize, channel: usize) -> [u64; ESTIMATES] {
        let (l, k) = (self.degree, m.unsigned_abs());
        let at = |degree: usize, order: isize, channel: usize| {
            u64::from(values[column(degree, order) * self.channels + channel].unsigned_abs().min(LARGEST))
        };
        let both =
            |degree: usize, order: usize| at(degree, order as isize, channel) + at(degree, -(order as isize), channel);
        let (mut beside, mut below, mut others) = (Sum::default(), Sum::default(), Sum::default());
        // The magnitudes of orders k and -k are added; order 0 is added twice.
        let pair = |sum: &mut Sum, weight: u64, magnitudes: u64| {
            sum.magnitudes += weight * magnitudes;
            sum.weights += 2 * weight;
        };
        for (distance, weight) in [(1, 8), (2, 5)] {
            if k >= distance {
                pair(&mut beside, weight, both(l, k - distance));
            }
        }
        if m < 0 {
            beside.add(7, at(l, k as isize, channel));
        }
        // The neighbour below order 0 is order -1, which belongs to the pair of orders 1 and -1.
        for (order, near) in [(k.abs_diff(1), false), (k, true), (k + 1, false)] {
            if order < l {
                pair(&mut below, if near { 4 } else { 3 }, both(l - 1, order));
            }
            if order + 1 < l {
                pair(&mut below, 3, both(l - 2, order));
            }
        }
        for other in channel.saturating_sub(2)..self.channels.min(channel + 3) {
            if other == channel {
                continue;
            }
            if other < channel {
                others.add(6, at(l, m, other));
            } else if m < 0 {
                others.add(4, at(l, k as isize, other));
            }
            if k < l {
                pair(&mut others, 2, at(l - 1, k as isize, other) + at(l - 1, -(k as isize), other));
            }
        }
        let before = (5 * self.means[0] + 3 * self.means[1]) / 8;
        let degree = (24 * before + UNIT * self.sum) / (24 + self.count);
        let own = (30 * self.channel_means[channel] + UNIT * self.channel_sums[channel])
            / (30 + self.count / self.channels as u64);
        [
            beside.and(below).and(others).mean(19, degree),
            degree,
            beside.and(below).mean(19, degree),
            below.mean(32, degree),
            others.mean(32, degree),
            own,
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classes_are_four_an_octave_without_gaps() {
        let mut last = 0;
        for expected in 0..100_000 {
            let class = class(expected);
            assert!(class == last || class == last + 1);
            last = class;
            assert!(bound(class) <= expected && (class + 1 == CLASSES || expected < bound(class + 1)), "{expected}");
        }
    }
}
