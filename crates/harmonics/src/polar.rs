//! The recurrence in double-double, for the rows next to the poles.
//!
//! Near a pole the plain recurrence loses digits in two ways. First, `cos theta` as a double determines theta only to
//! `eps / sin theta`. Second, a rounding error at one degree grows like `min(l, 1 / sin theta)` in the following
//! degrees, and the errors of all degrees add up to about `eps l^1.5`. At degree 2,000 this sum is a relative error of
//! 1e-11. Very few directions of a sampling scheme are near a pole, so ten times the work for each of them isn't
//! noticeable.

use std::ops::{Add, Div, Mul, Sub};

use crate::double_double::{DoubleDouble, unit};
use crate::recurrence::{SCALE, seeds, squares};

type Dd = DoubleDouble<false>;

/// Limit on the ratio of a row's `sin theta` to the highest degree. A row with a smaller ratio is polar: the relative
/// error of the plain recurrence, measured as about `0.2 eps l / sin theta` for order 0, would be about 1e-12 or more.
const POLAR_SINE_PER_DEGREE: f64 = 5e-5;
/// Up to this degree, no row is treated as polar, because the plain recurrence's error at the poles, about `eps l^1.5`,
/// is 3e-13 at most.
const PLAIN_DEGREE: usize = 100;

/// Returns whether the plain recurrence to `max_degree` is too inaccurate at colatitudes with this `sine`.
pub fn is_polar(sine: f64, max_degree: usize) -> bool {
    max_degree > PLAIN_DEGREE && sine < POLAR_SINE_PER_DEGREE * max_degree as f64
}

/// The directions next to a pole ([`is_polar`]) among a run of directions, and the state of the recurrence for each.
#[derive(Debug)]
pub(crate) struct Polar {
    rows: Vec<Row>,
    /// Seeds of the recurrence, `q_{m,m} / SCALE` for each m.
    seeds: Vec<Dd>,
}

#[derive(Debug)]
struct Row {
    index: usize,
    z: Dd,
    /// `SCALE u^m cos(m phi)` and `SCALE u^m sin(m phi)`, with `u = sin theta`, for m from 0 until both underflow to
    /// zero.
    azimuth: Vec<[f64; 2]>,
    /// Values `q_{l,m} / SCALE` (see [`recurrence`](crate::recurrence)) for the latest even and the latest odd l.
    q: [Vec<Dd>; 2],
}

impl Polar {
    pub(crate) fn new(max_degree: usize, directions: &[[f64; 3]]) -> Self {
        let mut rows = Vec::new();
        for (index, &direction) in directions.iter().enumerate() {
            if is_polar(direction[0].hypot(direction[1]), max_degree) {
                rows.push(Row::new(index, direction, max_degree));
            }
        }
        let seeds = if rows.is_empty() { Vec::new() } else { seeds(max_degree) };
        Self { rows, seeds }
    }

    pub(crate) fn advance(&mut self, l: usize) {
        let Some(orders) = self.rows.iter().map(|row| row.azimuth.len()).max() else { return };
        for m in 0..orders.min(l + 1) {
            let [an, ad, bn, bd] = if m < l { squares(l, m) } else { [0.0, 1.0, 0.0, 1.0] };
            let a = Dd::new(an).div(Dd::new(ad)).sqrt();
            let b = Dd::new(bn).div(Dd::new(bd)).sqrt();
            for row in &mut self.rows {
                if m < row.azimuth.len() {
                    row.q[l % 2][m] = if m == l {
                        self.seeds[m]
                    } else {
                        let old = a.mul(row.z.mul(row.q[1 - l % 2][m]));
                        old.sub(b.mul(row.q[l % 2][m]))
                    };
                }
            }
        }
    }

    pub(crate) fn write(&self, block: &mut [f64], rows: usize, l: usize) {
        for row in &self.rows {
            for m in 0..=l {
                let (q, [cos, sin]) = match row.azimuth.get(m) {
                    Some(&azimuth) => (row.q[l % 2][m].value(), azimuth),
                    None => (0.0, [0.0; 2]),
                };
                block[(l + m) * rows + row.index] = q * cos;
                if m > 0 {
                    block[(l - m) * rows + row.index] = q * sin;
                }
            }
        }
    }
}

impl Row {
    fn new(index: usize, direction: [f64; 3], max_degree: usize) -> Self {
        let [x, y, z] = unit::<false>(direction);
        let (mut px, mut py) = (Dd::new(SCALE), Dd::ZERO);
        let mut azimuth = Vec::new();
        while azimuth.len() <= max_degree && (px.hi != 0.0 || py.hi != 0.0) {
            azimuth.push([px.value(), py.value()]);
            (px, py) = (px.mul(x).sub(py.mul(y)), px.mul(y).add(py.mul(x)));
        }
        let orders = azimuth.len();
        Self { index, z, azimuth, q: [vec![Dd::ZERO; orders], vec![Dd::ZERO; orders]] }
    }
}
