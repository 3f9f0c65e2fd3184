//! Legendre transforms of one order: coefficients to rings, and rings to coefficients.
//!
//! For order m and rings at colatitudes theta_j, with `u = sin theta` and `z = cos theta`,
//!
//! ```text
//! F_m(theta_j) = sum_{l >= m} P_{l,m}(theta_j) x_l = u_j^m sum_l r_l(z_j) s_l x_l
//! r_l = alpha_l z r_{l-1} - r_{l-2},   r_m = 2^-930,   alpha_l = a_l s_{l-1} / s_l,   s_l = b_l s_{l-2}
//! ```
//!
//! with a, b and the scale of 2^930, by which `u^m` is multiplied, from [`spharm_harmonics::rings`]. The factors `s`
//! make the second coefficient of the recurrence one, so that a step is a product and a fused product. The coefficients
//! x are multiplied by `s` once. Rings come in pairs. The values on the southern ring are `(-1)^(l-m)` times the values
//! on the northern ring. Therefore the sums over even and over odd `l - m` are kept separately, and the values on both
//! rings follow from them.
//!
//! The work is cut into blocks of rings and chunks of degrees. The values of r for a block and a chunk are stored in a
//! [table](crate::ring_table) that stays in the L1 cache and serves all channels. A value costs two fused products,
//! plus one for the cosine and one for the sine of each channel. With three channels, eight rings take 8 vector
//! instructions for fused products in 4 cycles, six of them for the sums. From degree 256 on, one value serves a [pair
//! of degrees](crate::degree_pairs) on most rings, at half that cost. Next to the equator, degrees are processed one at
//! a time. Next to the poles, values are computed in [double-double](crate::polar_rings).
//!
//! Close to a pole, the factor `u^m` makes all `P_{l,m}` of a high order m negligible. Sums of order m skip the rings
//! on which this is the case (`first_ring`).

use std::ops::Range;

use ndarray::{ArrayViewMut2, Axis};
use rayon::prelude::*;
use spharm_harmonics::index::{degree_order, first_column};
use spharm_harmonics::rings::{MonicRecurrence, sine_powers};

use crate::degree_pairs::{self, DegreePairs};
use crate::polar_rings::{PolarRings, PolarState};
use crate::ring_sums::{
    Coefficients, pair_projections, pair_sums, projections_2, projections_4, projections_6, sums_2, sums_4, sums_6,
};
use crate::ring_table::{ADJOINT, LANES, RingTable, SYNTHESIS};

/// Number of coefficients that one task brings into canonical order.
const RUN: usize = 1024;

/// A matrix of coefficients in canonical order, `values` (K, all), row-major, of which the columns from `first` on are
/// used.
#[derive(Clone, Copy)]
pub(crate) struct SomeColumns<'a> {
    pub(crate) values: &'a [f64],
    pub(crate) all: usize,
    pub(crate) first: usize,
}

/// The recurrences of all orders, and the pairs of rings on which they are evaluated.
#[derive(Debug)]
pub(crate) struct Legendre {
    max_degree: usize,
    /// Factors `alpha_{l,m}` of the [`MonicRecurrence`], at index `start(m) + l - m`; `scale` contains `s_{l,m}` in the
    /// same layout.
    alpha: Vec<f64>,
    scale: Vec<f64>,
    /// `cos theta` of the northern rings from the pole to the equator, padded.
    z: Vec<f64>,
    /// Values `2^930 sin^m theta` of each ring and order m (rings, L + 1), column-major.
    power: Vec<f64>,
    /// Index of the first ring on which each order isn't negligible, rounded down to a multiple of [`LANES`].
    first_ring: Vec<usize>,
    /// The rings next to the pole; their number is a multiple of [`LANES`].
    polar: PolarRings,
    /// Index of the first ring next to the equator: a multiple of [`LANES`], at or after the end of the polar rings.
    equatorial: usize,
    /// Tables for pairs of degrees, if rings exist between the polar rings and the equatorial rings.
    pairs: Option<DegreePairs>,
    /// `cos^2 theta` of the rings.
    squares: Vec<f64>,
}

impl Legendre {
    /// Prepares the transforms for rings of the northern hemisphere, in order from the pole; the last ring may be the
    /// equator. `angles` (rings, 2) are the cosines and sines of their colatitudes. Values of `P_{l,m}` below
    /// `negligible` need not be computed.
    pub(crate) fn new(recurrence: &MonicRecurrence, angles: &[[f64; 2]], negligible: f64) -> Self {
        let max_degree = recurrence.max_degree();
        let rings = angles.len().next_multiple_of(LANES);
        let mut z: Vec<f64> = angles.iter().map(|[cosine, _]| *cosine).collect();
        let mut power = vec![0.0; rings * (max_degree + 1)];
        let columns: Vec<Vec<f64>> = angles
            .par_iter()
            .map(|&[cosine, sine]| {
                let mut column = vec![0.0; max_degree + 1];
                sine_powers(cosine, sine, &mut column);
                column
            })
            .collect();
        power.par_chunks_mut(rings).enumerate().for_each(|(m, power)| {
            for (power, column) in power.iter_mut().zip(&columns) {
                *power = column[m];
            }
        });
        drop(columns);
        // If an order is negligible on a ring, higher orders are negligible there, too. Therefore `first` never
        // decreases.
        let mut first = 0;
        let first_ring: Vec<usize> = (0..=max_degree)
            .map(|m| {
                while first < angles.len() && decay(m, max_degree, z[first]) >= -negligible.ln() {
                    first += 1;
                }
                first / LANES * LANES
            })
            .collect();
        let polar = PolarRings::new(recurrence, angles, &first_ring);
        let equatorial = degree_pairs::end(max_degree, &z) / LANES * LANES;
        // Next to a pole, the square of the cosine is computed from the sine, so that it is rounded only once. Its
        // error accumulates in the steps of the recurrence.
        let square = |[cosine, sine]: &[f64; 2]| if sine < cosine { 1.0 - sine * sine } else { cosine * cosine };
        let mut squares: Vec<f64> = angles.iter().map(square).collect();
        z.resize(rings, 0.0);
        squares.resize(rings, 0.0);
        let orders: Vec<(Vec<f64>, Vec<f64>)> = (0..=max_degree)
            .into_par_iter()
            .map(|m| {
                let (mut alpha, mut scale) = (Vec::with_capacity(max_degree + 1 - m), Vec::new());
                recurrence.order(m, &mut alpha, &mut scale);
                (alpha, scale)
            })
            .collect();
        let count = (max_degree + 1) * (max_degree + 2) / 2;
        let (mut alpha, mut scale) = (Vec::with_capacity(count), Vec::with_capacity(count));
        for (of_alpha, of_scale) in orders {
            alpha.extend_from_slice(&of_alpha);
            scale.extend_from_slice(&of_scale);
        }
        let of_order = |m: usize| &alpha[m * (2 * max_degree + 3 - m) / 2..][..max_degree + 1 - m];
        let by_pairs = equatorial > polar.count();
        let pairs = by_pairs.then(|| DegreePairs::new(max_degree, of_order));
        let equatorial = if by_pairs { equatorial } else { polar.count() };
        Self { max_degree, alpha, scale, z, power, first_ring, polar, equatorial, pairs, squares }
    }

    /// Returns the number of pairs of rings, padded to a multiple of [`LANES`].
    pub(crate) fn rings(&self) -> usize {
        self.z.len()
    }

    /// Returns the first ring on which order m isn't negligible, rounded down to a multiple of [`LANES`].
    pub(crate) fn first_ring(&self, m: usize) -> usize {
        self.first_ring[m]
    }

    /// Returns the number of orders, from 0 on, that aren't negligible on a ring.
    pub(crate) fn orders(&self, ring: usize) -> usize {
        self.first_ring.partition_point(|first| *first <= ring)
    }

    /// Returns the index of degree m and order m in a list of pairs (degree, order) that is sorted by order, then by
    /// degree.
    fn start(&self, m: usize) -> usize {
        m * (2 * self.max_degree + 3 - m) / 2
    }

    /// Returns the factors `alpha` and `s` of the recurrence of order m, from degree m on.
    fn order(&self, m: usize) -> (&[f64], &[f64]) {
        let start = self.start(m);
        let count = self.max_degree + 1 - m;
        (&self.alpha[start..start + count], &self.scale[start..start + count])
    }

    /// Returns the factors `s` of order m, from degree m on. The caller multiplies the coefficients by these factors:
    /// before calling [`synthesis`](Self::synthesis), and after calling [`adjoint`](Self::adjoint).
    pub(crate) fn scale(&self, m: usize) -> &[f64] {
        self.order(m).1
    }

    /// Writes the coefficients of order m in `channels` columns, multiplied by [`scale`](Self::scale) and `factor`, to
    /// `x`, as [`synthesis`](Self::synthesis) expects: (L + 1 - m, 2 c) row-major, with cosine and sine of each
    /// channel. Sines of order 0 are 0.
    pub(crate) fn scaled(&self, m: usize, factor: f64, from: SomeColumns<'_>, channels: usize, x: &mut [f64]) {
        let SomeColumns { values, all, first } = from;
        for ((x, scale), l) in x.chunks_exact_mut(2 * channels).zip(self.scale(m)).zip(m..) {
            let cosines = (first_column(l) + l + m) * all + first;
            let sines = (first_column(l) + l - m) * all + first;
            for channel in 0..channels {
                x[2 * channel] = factor * scale * values[cosines + channel];
                x[2 * channel + 1] = if m == 0 { 0.0 } else { factor * scale * values[sines + channel] };
            }
        }
    }

    /// Brings coefficients that are sorted by order into canonical order, and writes them to `out` (K, c). For each m,
    /// `by_order` contains a row-major array (L + 1 - m, 2 c).
    pub(crate) fn to_canonical(&self, by_order: &[f64], mut out: ArrayViewMut2<'_, f64>) {
        let columns = 2 * out.ncols();
        out.axis_chunks_iter_mut(Axis(0), RUN).into_par_iter().enumerate().for_each(|(run, mut rows)| {
            let (mut l, mut order) = degree_order(run * RUN);
            for row in rows.rows_mut() {
                let m = order.unsigned_abs();
                let at = (self.start(m) + l - m) * columns + usize::from(order < 0);
                for (value, channel) in row.into_iter().zip(0..) {
                    *value = by_order[at + 2 * channel];
                }
                (l, order) = if m == l && order >= 0 { (l + 1, -(l as isize) - 1) } else { (l, order + 1) };
            }
        });
    }

    /// Computes the sums over even and over odd `l - m` on the rings. `x` (L + 1 - m, columns) is row-major, and
    /// already multiplied by [`scale`](Self::scale). `even` and `odd` (rings, columns) are column-major, and are
    /// overwritten.
    pub(crate) fn synthesis(
        &self,
        m: usize,
        x: &[f64],
        columns: usize,
        even: &mut [f64],
        odd: &mut [f64],
        work: &mut Work,
    ) {
        let (alpha, rings) = (self.order(m).0, self.rings());
        even[..rings * columns].fill(0.0);
        odd[..rings * columns].fill(0.0);
        let mut mixed = std::mem::take(&mut work.mixed);
        let steps = self.pairs.as_ref().map_or(&[][..], |pairs| {
            pairs.mix(m, &x[..alpha.len() * columns], columns, &mut mixed);
            pairs.steps(m)
        });
        self.blocks(m, SYNTHESIS.block, |first, count, zone| {
            work.table.start(SYNTHESIS, count);
            if zone == Zone::Middle {
                for (chunk, steps) in steps.chunks(SYNTHESIS.chunk).enumerate() {
                    work.table.advance_pairs(&self.squares[first..first + count], steps);
                    let rows = &mixed[chunk * SYNTHESIS.chunk * 2 * columns..];
                    for column in (0..columns).step_by(2) {
                        let x = Coefficients { values: &rows[2 * column..], stride: 2 * columns };
                        let even = &mut even[column * rings + first..];
                        let odd = &mut odd[column * rings + first..];
                        pair_sums(&work.table.values, count, steps.len(), x, even, odd, rings);
                    }
                }
                return;
            }
            for (chunk, alpha) in alpha.chunks(SYNTHESIS.chunk).enumerate() {
                self.fill(m, chunk, first..first + count, zone, alpha, work);
                let degrees = alpha.len();
                for column in (0..columns).step_by(6) {
                    let x = Coefficients { values: &x[chunk * SYNTHESIS.chunk * columns + column..], stride: columns };
                    let even = &mut even[column * rings + first..];
                    let odd = &mut odd[column * rings + first..];
                    let table = &work.table.values;
                    match columns - column {
                        2 => sums_2(table, count, degrees, x, even, odd, rings),
                        4 => sums_4(table, count, degrees, x, even, odd, rings),
                        _ => sums_6(table, count, degrees, x, even, odd, rings),
                    }
                }
            }
        });
        work.mixed = mixed;
        self.weigh(m, columns, even, odd);
    }

    /// Applies the transpose of [`synthesis`](Self::synthesis). `even` and `odd` (rings, columns), column-major, are
    /// modified; `x` is overwritten.
    pub(crate) fn adjoint(
        &self,
        m: usize,
        even: &mut [f64],
        odd: &mut [f64],
        columns: usize,
        x: &mut [f64],
        work: &mut Work,
    ) {
        let (alpha, rings) = (self.order(m).0, self.rings());
        self.weigh(m, columns, even, odd);
        x[..alpha.len() * columns].fill(0.0);
        let mut mixed = std::mem::take(&mut work.mixed);
        let steps = self.pairs.as_ref().map_or(&[][..], |pairs| pairs.steps(m));
        mixed.clear();
        mixed.resize(steps.len() * 2 * columns, 0.0);
        self.blocks(m, ADJOINT.block, |first, count, zone| {
            work.table.start(ADJOINT, count);
            if zone == Zone::Middle {
                for (chunk, steps) in steps.chunks(ADJOINT.chunk).enumerate() {
                    work.table.advance_pairs(&self.squares[first..first + count], steps);
                    let rows = &mut mixed[chunk * ADJOINT.chunk * 2 * columns..];
                    for column in (0..columns).step_by(2) {
                        let x = &mut rows[2 * column..];
                        let even = &even[column * rings + first..];
                        let odd = &odd[column * rings + first..];
                        pair_projections(&work.table.values, count, steps.len(), x, 2 * columns, even, odd, rings);
                    }
                }
                return;
            }
            for (chunk, alpha) in alpha.chunks(ADJOINT.chunk).enumerate() {
                self.fill(m, chunk, first..first + count, zone, alpha, work);
                let degrees = alpha.len();
                for column in (0..columns).step_by(6) {
                    let x = &mut x[chunk * ADJOINT.chunk * columns + column..];
                    let even = &even[column * rings + first..];
                    let odd = &odd[column * rings + first..];
                    let table = &work.table.values;
                    match columns - column {
                        2 => projections_2(table, count, degrees, x, columns, even, odd, rings),
                        4 => projections_4(table, count, degrees, x, columns, even, odd, rings),
                        _ => projections_6(table, count, degrees, x, columns, even, odd, rings),
                    }
                }
            }
        });
        if let Some(pairs) = &self.pairs {
            pairs.unmix(m, &mixed, columns, &mut x[..alpha.len() * columns]);
        }
        work.mixed = mixed;
    }

    /// Multiplies the columns by `u^m`, with `u = sin theta` of each ring. On rings that are computed by pairs of
    /// degrees, the sums over odd `l - m` lack a factor z, so the columns of these sums are also multiplied by z.
    fn weigh(&self, m: usize, columns: usize, even: &mut [f64], odd: &mut [f64]) {
        let rings = self.rings();
        let power = &self.power[m * rings..(m + 1) * rings];
        for column in even.chunks_exact_mut(rings).take(columns) {
            column.iter_mut().zip(power).for_each(|(value, power)| *value *= power);
        }
        let middle = self.polar.count()..self.equatorial;
        for column in odd.chunks_exact_mut(rings).take(columns) {
            column.iter_mut().zip(power).for_each(|(value, power)| *value *= power);
            column[middle.clone()].iter_mut().zip(&self.z[middle.clone()]).for_each(|(value, z)| *value *= z);
        }
    }

    /// Calls `block` with the first ring, the number of rings and the zone of each block on which order m isn't
    /// negligible.
    fn blocks(&self, m: usize, size: usize, mut block: impl FnMut(usize, usize, Zone)) {
        let mut first = self.first_ring[m];
        let ends = [self.polar.count(), self.equatorial, self.rings()];
        for (end, zone) in ends.into_iter().zip([Zone::Polar, Zone::Middle, Zone::Equatorial]) {
            while first < end {
                let count = size.min(end - first);
                block(first, count, zone);
                first += count;
            }
        }
    }

    /// Fills the table with the values of a chunk of degrees on a block of rings in the polar or the equatorial zone.
    fn fill(&self, m: usize, chunk: usize, rings: Range<usize>, zone: Zone, alpha: &[f64], work: &mut Work) {
        let Work { polar, table, .. } = work;
        if zone == Zone::Polar {
            self.polar.fill(m, chunk, rings, table.tiling, polar, &mut table.values);
        } else {
            table.advance(&self.z[rings], alpha);
        }
    }
}

/// The zone of a ring, which determines how its Legendre functions are computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Zone {
    /// Next to a pole: values are computed in double-double.
    Polar,
    /// Away from poles and equator: values are computed by pairs of degrees.
    Middle,
    /// Next to the equator: values are computed one degree at a time.
    Equatorial,
}

/// Scratch space of one thread.
#[derive(Debug)]
pub(crate) struct Work {
    polar: PolarState,
    table: RingTable,
    /// Coefficients of an order after [mixing](crate::degree_pairs), an array (pairs of degrees, 2 columns): for each
    /// channel, first the coefficients of even degrees, then those of odd degrees.
    mixed: Vec<f64>,
}

impl Work {
    pub(crate) fn new() -> Self {
        Self { polar: PolarState::default(), table: RingTable::new(), mixed: Vec::new() }
    }
}

/// Returns a lower bound on `-ln P_{l,m}`, l <= L, at colatitude `acos z`: the WKB action across the classically
/// forbidden zone `sin theta < m / L`; zero outside that zone.
fn decay(m: usize, max_degree: usize, z: f64) -> f64 {
    let (m, l) = (m as f64, max_degree as f64 + 0.5);
    let k = m / l;
    let square = k * k - (1.0 - z * z);
    if square <= 0.0 || m == 0.0 {
        return 0.0;
    }
    let d = square.sqrt();
    l * (k * (d / (k * z)).min(1.0).atanh() - (d / z).min(1.0).atanh())
}
