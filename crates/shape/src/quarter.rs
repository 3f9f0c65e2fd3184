//! Computes the quarter of Wigner's d matrix of degree l at pi/2 with nonnegative indices, `Delta_{i,k} =
//! d^l_{i,k}(pi/2)`, `0 <= i, k <= l`, row by row.
//!
//! The recurrence is from S. Trapani and J. Navaza, "Calculation of spherical harmonics and Wigner d functions by FFT",
//! Acta Cryst. A62 (2006). With the signs of the canonical basis, it is
//!
//! ```text
//! Delta_{0,l}^2 = prod_{j=1..l} (2j-1)/(2j),   Delta_{i,l}^2 = Delta_{i-1,l}^2 (l-i+1)/(l+i)
//! Delta_{i,k} = -2i/sqrt(q) Delta_{i,k+1} - sqrt((l-k-1)(l+k+2)/q) Delta_{i,k+2}
//! q = (l-k)(l+k+1),   k = l-1, ..., 0
//! ```
//!
//! A row starts with its smallest values, which may be as small as 2^-l. The values grow until `i^2 + k^2 <= l^2`, and
//! then oscillate. The recurrence is stable in both parts. **Each row has its own exponent.** Without it, the first
//! values would underflow, and all later values of the row would be wrong. At degree 3,000, the error of a column's
//! norm would be 27 %. While a row's values are tiny, the row is *hidden* and treated as zero. The row becomes visible
//! at the first check of its exponent at which its values exceed 2^-120. At degree 3,000 the last row starts at
//! 2^-3000.
//!
//! Rows are independent, so several are computed together, one per SIMD lane. Cost: 3 flops per value; `O(l)` memory.

use spharm_harmonics::double_double::DoubleDouble;

/// Number of steps between two checks of the exponents. Up to degree 30,000, a row grows by less than 2^60 in this
/// number of steps.
pub(crate) const BLOCK: usize = 8;
/// Number of rows that [`dense`] computes together.
pub(crate) const LANES: usize = 8;
/// The values of hidden rows (see the [module](self)) are multiplied by this factor, 2^512, once or repeatedly, before
/// they are stored.
const HIDDEN_SCALE: f64 = f64::from_bits((1023 + 512) << 52);
const HIDDEN_INVERSE: f64 = f64::from_bits((1023 - 512) << 52);
/// Stored values of hidden rows are scaled down when they exceed this threshold. At the last scaling, by which the row
/// becomes visible, the threshold corresponds to a value of 2^-120.
const LARGE: f64 = f64::from_bits((1023 + 392) << 52);
/// A row whose first value is below this threshold, 2^-120, starts as hidden: it is treated as zero at first.
const SMALL: f64 = f64::from_bits((1023 - 120) << 52);

/// Squares of the corner elements, `Delta_{0,l}^2`, for the degrees l from 0 to L.
#[derive(Debug, Clone)]
pub(crate) struct Centre(Vec<f64>);

impl Centre {
    pub(crate) fn new(max_degree: usize) -> Self {
        let exact = |v: usize| DoubleDouble::<false>::new(v as f64);
        let mut square = exact(1);
        let squares = (0..=max_degree).map(|l| {
            if l > 0 {
                square = square * exact(2 * l - 1) / exact(2 * l);
            }
            square.value()
        });
        Self(squares.collect())
    }
}

/// Factors of the recurrence that all rows of one degree share, and the first value of each row. Step t computes the
/// element k = l - t.
#[derive(Debug, Clone, Default)]
pub(crate) struct Quarter {
    /// Degree l of the rows.
    pub(crate) degree: usize,
    /// Factors `1/sqrt(q)` of the recurrence (see the [module](self)), one for the step from each t to t + 1. Factors
    /// from t = l on are zero and pad the array to a multiple of [`BLOCK`].
    pub(crate) first: Vec<f64>,
    /// Factors `sqrt((l-k-1)(l+k+2)/q)` (see the [module](self)) of the step from t to t + 1. This array is as long as
    /// `first`.
    pub(crate) second: Vec<f64>,
    /// Stored first values `Delta_{i,l}` of the rows i: an array for even i and an array for odd i, each padded with
    /// zeros to a multiple of [`LANES`].
    pub(crate) starts: [Vec<f64>; 2],
    /// For each value in `starts`, the number of times that it was multiplied by 2^512.
    pub(crate) exponents: [Vec<i32>; 2],
}

/// Returns the number of steps of the recurrence for a degree, rounded up to a multiple of [`BLOCK`].
pub(crate) const fn steps(degree: usize) -> usize {
    (degree + 1).next_multiple_of(BLOCK)
}

/// Returns the number of rows of the quarter `Delta_{i,k}` (see the [module](self)) whose index i, 0 <= i <= `degree`,
/// has the given parity. The number is rounded up to a multiple of `width`.
pub(crate) const fn rows(degree: usize, parity: usize, width: usize) -> usize {
    ((degree + 2 - parity) / 2).next_multiple_of(width)
}

impl Quarter {
    /// Prepares the recurrence for the rows of a degree, reusing the memory of the previous degree.
    pub(crate) fn set(&mut self, degree: usize, centre: &Centre, width: usize) {
        let l = degree;
        self.degree = l;
        for steps_of in [&mut self.first, &mut self.second] {
            steps_of.clear();
            steps_of.resize(steps(l), 0.0);
        }
        // In terms of the step's number t = l - k, the factors of the recurrence are q = t (2l + 1 - t) and
        // (l-k-1)(l+k+2) = (t - 1)(2l + 2 - t).
        let sum = (2 * l + 1) as f64;
        for (i, (first, second)) in self.first.iter_mut().zip(&mut self.second).take(l).enumerate() {
            let t = (i + 1) as f64;
            let q = t * (sum - t);
            *first = 1.0 / q.sqrt();
            *second = ((t - 1.0) * (sum + 1.0 - t) / q).sqrt();
        }
        for parity in 0..2 {
            let count = rows(l, parity, width);
            self.starts[parity].clear();
            self.starts[parity].resize(count, 0.0);
            self.exponents[parity].clear();
            self.exponents[parity].resize(count, 0);
        }
        let (mut square, mut exponent) = (centre.0[l], 0);
        for i in 0..=l {
            if i > 0 {
                square *= (l - i + 1) as f64 / (l + i) as f64;
            }
            if square < SMALL * SMALL {
                square = square * HIDDEN_SCALE * HIDDEN_SCALE;
                exponent += 1;
            }
            self.starts[i % 2][i / 2] = square.sqrt();
            self.exponents[i % 2][i / 2] = exponent;
        }
    }
}

/// Whether all, some or none of the rows that are computed together are hidden. Hidden rows are treated as zero,
/// because their values are still tiny.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Hidden {
    /// All rows are hidden.
    All,
    /// Some rows are hidden, but not all.
    Some,
    /// No row is hidden.
    None,
}

/// State of the recurrence for `W` rows i, which are all even or all odd.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rows<const W: usize> {
    /// Factor `-2i` of the recurrence for each row i.
    pub(crate) order: [f64; W],
    /// Stored values at step t.
    pub(crate) now: [f64; W],
    /// Stored values at step t - 1.
    pub(crate) before: [f64; W],
    exponents: [i32; W],
}

impl<const W: usize> Rows<W> {
    /// Starts, at step t = 0, the recurrence of the rows `i = parity + 2 (at + lane)`, one for each lane from 0 to W -
    /// 1.
    #[inline(always)]
    pub(crate) fn start(quarter: &Quarter, parity: usize, at: usize) -> Self {
        let (mut now, mut exponents) = ([0.0; W], [0; W]);
        now.copy_from_slice(&quarter.starts[parity][at..at + W]);
        exponents.copy_from_slice(&quarter.exponents[parity][at..at + W]);
        let order = std::array::from_fn(|lane| -2.0 * (parity + 2 * (at + lane)) as f64);
        Self { order, now, before: [0.0; W], exponents }
    }

    /// Computes the next element of each row. `first` and `second` are the factors of this step from the [`Quarter`].
    #[inline(always)]
    pub(crate) fn step(&mut self, first: f64, second: f64) {
        for lane in 0..W {
            let next = first * self.order[lane] * self.now[lane] - second * self.before[lane];
            self.before[lane] = self.now[lane];
            self.now[lane] = next;
        }
    }

    /// Returns whether all, some or none of the rows are hidden.
    #[inline(always)]
    pub(crate) fn hidden(&self) -> Hidden {
        match self.exponents.iter().filter(|&&e| e > 0).count() {
            0 => Hidden::None,
            count if count == W => Hidden::All,
            _ => Hidden::Some,
        }
    }

    /// Returns 1 for visible rows and 0 for hidden rows.
    #[inline(always)]
    pub(crate) fn visible(&self) -> [f64; W] {
        self.exponents.map(|e| if e == 0 { 1.0 } else { 0.0 })
    }

    /// Scales down values of hidden rows that have grown. Must be called every [`BLOCK`] steps while rows are hidden,
    /// that is, treated as zero because their values are tiny.
    #[inline(always)]
    pub(crate) fn rescale(&mut self) {
        for lane in 0..W {
            if self.exponents[lane] > 0 && self.now[lane].abs().max(self.before[lane].abs()) > LARGE {
                self.now[lane] *= HIDDEN_INVERSE;
                self.before[lane] *= HIDDEN_INVERSE;
                self.exponents[lane] -= 1;
            }
        }
    }
}

/// Returns the quarter of Wigner's matrix (see the [module](self)) of degree l as an (l+1) x (l+1) matrix, row by row.
/// The matrix takes `8 (l+1)^2` bytes. It is used for searches at low degrees, and as the reference in tests.
pub(crate) fn dense(degree: usize, centre: &Centre) -> Vec<f64> {
    let mut quarter = Quarter::default();
    quarter.set(degree, centre, LANES);
    let side = degree + 1;
    let mut values = vec![0.0; side * side];
    for parity in 0..2 {
        for at in (0..rows(degree, parity, LANES)).step_by(LANES) {
            let mut rows = Rows::<LANES>::start(&quarter, parity, at);
            for t in 0..=degree {
                let visible = rows.visible();
                for (lane, visible) in visible.iter().enumerate() {
                    let i = parity + 2 * (at + lane);
                    if i <= degree {
                        values[i * side + degree - t] = rows.now[lane] * visible;
                    }
                }
                rows.step(quarter.first[t], quarter.second[t]);
                if (t + 1) % BLOCK == 0 {
                    rows.rescale();
                }
            }
        }
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the largest deviation of a row's norm from 1. The norm includes the elements at k < 0, which equal those
    /// at k > 0 except for the sign.
    fn worst_norm(degree: usize) -> f64 {
        let delta = dense(degree, &Centre::new(degree));
        let row_norm = |row: &[f64]| row[0] * row[0] + 2.0 * row[1..].iter().map(|v| v * v).sum::<f64>();
        delta.chunks_exact(degree + 1).map(|row| (row_norm(row).sqrt() - 1.0).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn rows_have_norm_one_beyond_the_range_of_doubles() {
        for degree in [0, 1, 2, 7, 8, 9, 60, 500, 1_500, 3_000] {
            let worst = worst_norm(degree);
            // The row with the largest error has i near l, for which the recurrence is worst conditioned. The mean
            // error of the rows is a tenth of the largest error.
            assert!(worst < 1e-16 * degree.max(20) as f64, "degree {degree}: {worst:e}");
        }
    }

    #[test]
    fn it_is_symmetric_but_for_the_sign() {
        for degree in [5, 40, 333] {
            let (delta, side) = (dense(degree, &Centre::new(degree)), degree + 1);
            for i in 0..side {
                for k in 0..i {
                    let sign = if (i + k) % 2 == 0 { 1.0 } else { -1.0 };
                    assert!((delta[i * side + k] - sign * delta[k * side + i]).abs() < 1e-14, "{degree} {i} {k}");
                }
            }
        }
    }

    /// Compares d^1 and d^2 at pi/2 with values from the literature.
    #[test]
    fn low_degrees_are_the_textbooks() {
        let root = |v: f64| v.sqrt();
        let one = dense(1, &Centre::new(1));
        let two = dense(2, &Centre::new(2));
        let expected_one = [0.0, root(0.5), -root(0.5), 0.5];
        let expected_two = [-0.5, 0.0, root(0.375), 0.0, -0.5, 0.5, root(0.375), -0.5, 0.25];
        for (found, expected) in one.iter().chain(&two).zip(expected_one.iter().chain(&expected_two)) {
            assert!((found - expected).abs() < 1e-15, "{one:?} {two:?}");
        }
    }
}
