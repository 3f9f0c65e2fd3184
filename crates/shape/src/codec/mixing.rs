//! Mixes several adaptive estimates of the probability of a decision (a coded bit) into one probability, in integer
//! arithmetic.
//!
//! Each estimate is a probability that moves towards the decisions that are coded in its context. After n decisions,
//! the next decision moves the estimate by 1 / (n + 8) of the difference between the decision and the estimate.
//! Logistic mixing (Mahoney, "Adaptive weighing of context models for lossless data compression", 2005) sums the
//! estimates' `ln(p / (1 - p))` with weights that are adapted by gradient descent on the coding cost.
//!
//! Encoder and decoder must agree in every bit, on any machine and in any language. Therefore all numbers are integers.
//! An estimate has 22 bits, and a probability has 16 bits. A logarithm is a multiple of 1/256, and a weight is a
//! multiple of 1/65,536. The operator `>>` rounds down. `docs/sphz-format.md` specifies the arithmetic.

/// Number of estimates per decision.
pub(super) const ESTIMATES: usize = 6;

/// Fixed-point representation of probability 1 in an estimate.
const WHOLE: i64 = 1 << 22;

/// Largest magnitude of a logarithm `ln(p / (1 - p))`, in units of 1/256: just below 8.
const FARTHEST: i64 = 2047;

/// Table of the logistic function: 65,536 / (1 + exp(-k / 2)) for k from -16 to 16, rounded.
const LOGISTIC: [i64; 33] = [
    22, 36, 60, 98, 162, 267, 439, 720, 1179, 1921, 3108, 4971, 7812, 11955, 17625, 24743, 32768, 40793, 47911, 53581,
    57724, 60565, 62428, 63615, 64357, 64816, 65097, 65269, 65374, 65438, 65476, 65500, 65514,
];

/// Returns the probability p, in units of 1/65,536, for a given `ln(p / (1 - p))` in units of 1/256, by linear
/// interpolation between 33 knots.
fn squash(logarithm: i64) -> i64 {
    let at = logarithm.clamp(-FARTHEST, FARTHEST) + 2048;
    let (knot, part) = ((at >> 7) as usize, at & 127);
    (LOGISTIC[knot] * (128 - part) + LOGISTIC[knot + 1] * part) >> 7
}

/// Returns a table of the inverse of `squash`. The table is indexed by the upper 12 bits of a probability. An entry is
/// the smallest logarithm for which `squash` returns at least the midpoint of the probabilities with these upper bits.
fn stretches() -> Vec<i16> {
    let mut logarithm = -FARTHEST;
    let entry = |i: i64| {
        while logarithm < FARTHEST && squash(logarithm) < 16 * i + 8 {
            logarithm += 1;
        }
        logarithm as i16
    };
    (0..4096).map(entry).collect()
}

/// Adaptive estimate of a probability in one context.
#[derive(Debug, Clone, Copy)]
pub(super) struct Estimate {
    /// Probability that the decision is 1, in units of 2^-22.
    one: u32,
    /// Number of updates so far, at most [`MOST_SEEN`].
    seen: u32,
}

/// Number of updates after which an estimate adapts at a constant rate.
const MOST_SEEN: u32 = 250;

impl Estimate {
    /// Returns the estimate `numerator / denominator`, clamped to the range from 1/256 to 63/64.
    pub(super) fn new(numerator: u64, denominator: u64) -> Self {
        let one = ((numerator << 22) / denominator).clamp(1 << 14, (1 << 22) - (1 << 16));
        Self { one: one as u32, seen: 0 }
    }

    /// Moves the estimate towards the coded decision `bit`.
    pub(super) fn update(&mut self, bit: bool) {
        let target = if bit { WHOLE } else { 0 };
        let rate = 65_536 / (i64::from(self.seen) + 8);
        let one = i64::from(self.one) + (((target - i64::from(self.one)) * rate) >> 16);
        self.one = one.clamp(1 << 10, WHOLE - (1 << 10)) as u32;
        self.seen = MOST_SEEN.min(self.seen + 1);
    }
}

/// Weights of the estimates for one kind of decision, in units of 1/65,536.
#[derive(Debug, Clone, Copy)]
pub(super) struct Weights([i64; ESTIMATES]);

impl Weights {
    /// Returns initial weights of 0.15 each. Their sum is less than 1 because the estimates are correlated.
    pub(super) fn new() -> Self {
        Self([9830; ESTIMATES])
    }
}

/// Mixer of several estimates of the probability that a decision is 1. It keeps the estimates' logarithms for the
/// update of the weights.
pub(super) struct Mixer {
    stretches: Vec<i16>,
    logarithms: [i64; ESTIMATES],
    one: i64,
}

impl Mixer {
    pub(super) fn new() -> Self {
        Self { stretches: stretches(), logarithms: [0; ESTIMATES], one: 0 }
    }

    /// Returns the mixed probability that the decision is 1, in units of 1/65,536, from 16 to 65,520.
    pub(super) fn mix(&mut self, estimates: [&Estimate; ESTIMATES], weights: &Weights) -> u32 {
        let mut sum = 0;
        for ((logarithm, estimate), weight) in self.logarithms.iter_mut().zip(estimates).zip(weights.0) {
            *logarithm = i64::from(self.stretches[(estimate.one >> 10) as usize]);
            sum += weight * *logarithm;
        }
        self.one = squash(sum >> 16).clamp(16, 65_520);
        self.one as u32
    }

    /// Updates the weights after the decision `bit` was coded.
    pub(super) fn update(&self, bit: bool, weights: &mut Weights) {
        let error = if bit { 65_536 - self.one } else { -self.one };
        for (weight, logarithm) in weights.0.iter_mut().zip(self.logarithms) {
            *weight = (*weight + ((error * logarithm + 32_768) >> 16)).clamp(-(1 << 20), 1 << 20);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_are_what_their_formulas_say() {
        for (at, &value) in LOGISTIC.iter().enumerate() {
            let exact = 65_536.0 / (1.0 + (-(at as f64 - 16.0) / 2.0).exp());
            assert_eq!(value, exact.round() as i64);
        }
        for (i, &found) in stretches().iter().enumerate() {
            let middle = 16 * i as i64 + 8;
            let expected = (-FARTHEST..=FARTHEST).find(|&s| squash(s) >= middle).unwrap_or(FARTHEST);
            assert_eq!(i64::from(found), expected);
            let exact = (middle as f64 / (65_536.0 - middle as f64)).ln() * 256.0;
            assert!((expected as f64 - exact).abs() < 20.0 || exact.abs() > 1900.0, "{i} {expected} {exact}");
        }
    }

    #[test]
    fn estimates_and_weights_learn() {
        let mut mixer = Mixer::new();
        let mut estimates = [Estimate::new(1, 2); ESTIMATES];
        let mut weights = Weights::new();
        let mut one = 0;
        for i in 0..2000 {
            one = mixer.mix(estimates.each_ref(), &weights);
            let bit = i % 10 == 0;
            mixer.update(bit, &mut weights);
            estimates.iter_mut().for_each(|estimate| estimate.update(bit));
        }
        assert!((f64::from(one) / 65_536.0 - 0.1).abs() < 0.03, "{one}");
    }
}
