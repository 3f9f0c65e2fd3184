//! Computes the basis blocks `A_l` of a run of directions, one degree after another. A block holds the values of the
//! harmonics of degree l, with a row for each direction and a column for each order.
//!
//! For a run of r rows the state consists of `q_{l-1,m}`, `q_{l-2,m}` and the azimuth factors `u^m cos m phi` and
//! `u^m sin m phi`, four arrays (r, L + 1). These arrays take `32 r (L + 1)` bytes, 1.7 MB for 512 rows at degree 100,
//! so the state stays in a core's L2 cache. Each pair (l, m > 0) and row costs 5 flops, 5 loads and 3 stores for two
//! values. Runs are independent, so each thread can work on its own.
//!
//! Rows next to the poles use the double-double recurrence of [`polar`](crate::polar).

use std::ops::{Add, Mul, Sub};

use multiversion::{multiversion, target::target_cfg_f};

use crate::double_double::{DoubleDouble, unit};
use crate::polar::Polar;
use crate::recurrence::{Recurrence, SCALE};

/// Evaluates the harmonics at one run of directions, one degree after another.
#[derive(Debug)]
pub struct Sweep<'r> {
    recurrence: &'r Recurrence,
    rows: usize,
    next: usize,
    /// Cosine of each row's colatitude.
    z: Vec<f64>,
    /// Azimuth factors `SCALE u^m cos(m phi)` and `SCALE u^m sin(m phi)`, with u the sine of the colatitude; each
    /// (rows, L + 1) in column-major order.
    azimuth_cos: Vec<f64>,
    azimuth_sin: Vec<f64>,
    /// Values `q_{l,m} / SCALE` of the [`Recurrence`] for the latest even and the latest odd l, each (rows, L + 1) in
    /// column-major order.
    q: [Vec<f64>; 2],
    polar: Polar,
}

impl<'r> Sweep<'r> {
    /// Starts a sweep at degree 0. `directions` are unit vectors (rows, 3), which are normalised once more in
    /// double-double.
    ///
    /// # Panics
    ///
    /// If `directions` is empty.
    pub fn new(recurrence: &'r Recurrence, directions: &[[f64; 3]]) -> Self {
        let (rows, orders) = (directions.len(), recurrence.max_degree() + 1);
        assert!(rows > 0, "expected at least one direction, found none");
        let zeros = || vec![0.0; rows * orders];
        let mut sweep = Self {
            recurrence,
            rows,
            next: 0,
            z: vec![0.0; rows],
            azimuth_cos: zeros(),
            azimuth_sin: zeros(),
            q: [zeros(), zeros()],
            polar: Polar::new(recurrence.max_degree(), directions),
        };
        azimuth_factors(directions, &mut sweep.z, &mut sweep.azimuth_cos, &mut sweep.azimuth_sin);
        sweep
    }

    /// Returns the size in bytes of a sweep of `rows` directions up to degree `max_degree`, without its recurrence.
    pub const fn bytes(rows: usize, max_degree: usize) -> usize {
        rows * (32 * (max_degree + 1) + 8)
    }

    /// Returns the degree that [`next_degree`](Self::next_degree) will write.
    pub fn degree(&self) -> usize {
        self.next
    }

    /// Writes the block `A_l` (rows, 2 l + 1) in column-major order, with the orders from -l to l, and advances to the
    /// next degree.
    ///
    /// # Panics
    ///
    /// If `block` isn't `rows * (2 l + 1)` long, or the degree is above the highest degree of the recurrence.
    pub fn next_degree(&mut self, block: &mut [f64]) {
        let l = self.next;
        assert_eq!(block.len(), self.rows * (2 * l + 1), "expected a block of degree {l} with {} rows", self.rows);
        self.advance();
        emit(block, self.rows, l, &self.q[l % 2], &self.azimuth_cos, &self.azimuth_sin);
        self.polar.write(block, self.rows, l);
    }

    /// Advances past a degree without writing it, at less than half of the cost.
    ///
    /// # Panics
    ///
    /// If the degree is above the highest degree of the recurrence.
    pub fn skip_degree(&mut self) {
        self.advance();
    }

    fn advance(&mut self) {
        let l = self.next;
        assert!(l <= self.recurrence.max_degree(), "degree {l} is above the highest degree of the recurrence");
        let (even, odd) = self.q.split_at_mut(1);
        let (newest, previous) = if l.is_multiple_of(2) { (&mut even[0], &odd[0]) } else { (&mut odd[0], &even[0]) };
        let (a, b) = self.recurrence.degree(l);
        recur(newest, previous, &self.z, a, b);
        newest[l * self.rows..(l + 1) * self.rows].fill(self.recurrence.seed(l));
        self.polar.advance(l);
        self.next += 1;
    }
}

/// Computes `z` and the azimuth factors of each direction. The factors are powers in double-double, so that their error
/// is one rounding for any m.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
fn azimuth_factors(directions: &[[f64; 3]], z: &mut [f64], cos: &mut [f64], sin: &mut [f64]) {
    if target_cfg_f!(any(target_feature = "fma", target_arch = "aarch64")) {
        azimuth_factors_of::<true>(directions, z, cos, sin);
    } else {
        azimuth_factors_of::<false>(directions, z, cos, sin);
    }
}

#[inline(always)]
fn azimuth_factors_of<const FMA: bool>(directions: &[[f64; 3]], z: &mut [f64], cos: &mut [f64], sin: &mut [f64]) {
    /// Number of rows processed together. The powers of their `x + i y` stay in registers and the L1 cache.
    const LANES: usize = 16;
    let rows = directions.len();
    for start in (0..rows).step_by(LANES) {
        let count = LANES.min(rows - start);
        let zero = [DoubleDouble::<FMA>::ZERO; LANES];
        let (mut x, mut y, mut power_x, mut power_y) = (zero, zero, zero, zero);
        for (lane, &direction) in directions[start..start + count].iter().enumerate() {
            let [ux, uy, uz] = unit::<FMA>(direction);
            (x[lane], y[lane]) = (ux, uy);
            power_x[lane] = DoubleDouble::new(SCALE);
            z[start + lane] = uz.value();
        }
        for (cos, sin) in cos.chunks_exact_mut(rows).zip(sin.chunks_exact_mut(rows)) {
            let (cos, sin) = (&mut cos[start..start + count], &mut sin[start..start + count]);
            for (lane, (cos, sin)) in cos.iter_mut().zip(sin).enumerate() {
                *cos = power_x[lane].value();
                *sin = power_y[lane].value();
            }
            for lane in 0..LANES {
                let (px, py) = (power_x[lane], power_y[lane]);
                power_x[lane] = px.mul(x[lane]).sub(py.mul(y[lane]));
                power_y[lane] = px.mul(y[lane]).add(py.mul(x[lane]));
            }
        }
    }
}

/// Computes `newest_m = a_m z previous_m - b_m newest_m` for every order m below the degree.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
fn recur(newest: &mut [f64], previous: &[f64], z: &[f64], a: &[f64], b: &[f64]) {
    let rows = z.len();
    let columns = newest.chunks_exact_mut(rows).zip(previous.chunks_exact(rows));
    for ((new, old), (&a, &b)) in columns.zip(a.iter().zip(b)) {
        for ((new, old), z) in new.iter_mut().zip(old).zip(z) {
            *new = if target_cfg_f!(any(target_feature = "fma", target_arch = "aarch64")) {
                a.mul_add(z * old, -(b * *new))
            } else {
                a * (z * old) - b * *new
            };
        }
    }
}

/// Writes the harmonics of degree l: `S_{l,m} = q_{l,m} u^m cos(m phi)`, `S_{l,-m} = q_{l,m} u^m sin(m phi)`, with q
/// from the [`Recurrence`] and u the sine of the colatitude.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
fn emit(block: &mut [f64], rows: usize, l: usize, q: &[f64], cos: &[f64], sin: &[f64]) {
    let (negative, rest) = block.split_at_mut(l * rows);
    let (zero, positive) = rest.split_at_mut(rows);
    for ((out, q), cos) in zero.iter_mut().zip(q).zip(cos) {
        *out = q * cos;
    }
    for m in 1..=l {
        let column = m * rows..(m + 1) * rows;
        let (q, cos, sin) = (&q[column.clone()], &cos[column.clone()], &sin[column]);
        let plus = &mut positive[(m - 1) * rows..m * rows];
        let minus = &mut negative[(l - m) * rows..(l - m + 1) * rows];
        for ((((plus, minus), q), cos), sin) in plus.iter_mut().zip(minus).zip(q).zip(cos).zip(sin) {
            *plus = q * cos;
            *minus = q * sin;
        }
    }
}
