//! Legendre transforms for one order: coefficients to rings, and rings to coefficients.
//!
//! For order m and rings at colatitude theta_j,
//!
//! ```text
//! F_m(theta_j) = sum_{l >= m} P_{l,m}(theta_j) x_l = u_j^m sum_l r_l(z_j) s_l x_l,     u = sin theta, z = cos theta
//! r_l = alpha_l z r_{l-1} - r_{l-2},   r_m = 2^-930,   alpha_l = a_l s_{l-1} / s_l,   s_l = b_l s_{l-2}
//! ```
//!
//! with a, b and the scale of 2^930, which `u^m` carries the other way, those of [`spharm_harmonics::rings`]. `s` makes the second coefficient of the recurrence one, so a step is a product and a fused product; it goes to the
//! coefficients once. Rings come in pairs: one south of the equator has `(-1)^(l-m)` times its northern twin's values,
//! so the sums over even and over odd `l - m` are kept apart and give both.
//!
//! The work goes by blocks of rings and chunks of degrees: the values of r go to a table that stays in the L1 cache and
//! serves all channels. A value costs 2 flop-pairs and one more for each channel's cosine and sine: with three channels
//! 8 fused products in 4 cycles for eight rings, of which six are the sums.
//!
//! Where `u` is so small that `P_{l,m}` is below anything that counts, rings and degrees are skipped (`first_ring`).

use std::ops::Range;

use multiversion::{multiversion, target::target_cfg_f};
use spharm_harmonics::rings::{MonicRecurrence, SEED, sine_powers};

use crate::polar::{PolarRings, PolarState};

/// Rings of a block and degrees of a chunk: the table of their values is 16 kB, and beside it the L1 cache has to hold the
/// block's sums. An even number of degrees, so that a chunk starts with an even `l - m`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tiling {
    pub(crate) block: usize,
    pub(crate) chunk: usize,
}

/// Sums over degrees stay in registers for a chunk.
const SYNTHESIS: Tiling = Tiling { block: 128, chunk: 16 };
/// Sums over rings end with one across lanes for each block, which costs as much as five products.
const ADJOINT: Tiling = Tiling { block: 256, chunk: 8 };
/// Lanes that rings are padded to.
pub(crate) const LANES: usize = 8;

/// Recurrences for all orders and the pairs of rings that they are evaluated on.
#[derive(Debug)]
pub(crate) struct Legendre {
    max_degree: usize,
    /// `alpha_{l,m}` and `s_{l,m}` at `offset(m) + l - m`.
    alpha: Vec<f64>,
    scale: Vec<f64>,
    /// `cos theta` of the northern rings from the pole to the equator, padded.
    z: Vec<f64>,
    /// `2^930 u^m`, (rings, L + 1) column-major.
    power: Vec<f64>,
    /// For each order, the first ring that counts; a multiple of [`LANES`].
    first_ring: Vec<usize>,
    /// The rings next to the pole, a multiple of [`LANES`] of them.
    polar: PolarRings,
}

impl Legendre {
    /// For rings with these cosines and sines of the colatitude, from the north pole to the equator at most; `negligible` is the size of a value of
    /// `P_{l,m}` that needn't be computed.
    pub(crate) fn new(recurrence: &MonicRecurrence, angles: &[[f64; 2]], negligible: f64) -> Self {
        let max_degree = recurrence.max_degree();
        let rings = angles.len().next_multiple_of(LANES);
        let mut z: Vec<f64> = angles.iter().map(|[cosine, _]| *cosine).collect();
        let mut power = vec![0.0; rings * (max_degree + 1)];
        let mut column = vec![0.0; max_degree + 1];
        for (j, &[cosine, sine]) in angles.iter().enumerate() {
            sine_powers(cosine, sine, &mut column);
            for (m, value) in column.iter().enumerate() {
                power[m * rings + j] = *value;
            }
        }
        let first_ring: Vec<usize> = (0..=max_degree)
            .map(|m| {
                let counts = |z: &f64| decay(m, max_degree, *z) < -negligible.ln();
                let first = z.iter().position(counts).unwrap_or(angles.len());
                first / LANES * LANES
            })
            .collect();
        let polar = PolarRings::new(recurrence, angles, &first_ring);
        z.resize(rings, 0.0);
        let (mut alpha, mut scale) = (Vec::new(), Vec::new());
        for m in 0..=max_degree {
            recurrence.order(m, &mut alpha, &mut scale);
        }
        Self { max_degree, alpha, scale, z, power, first_ring, polar }
    }

    /// Pairs of rings, padded.
    pub(crate) fn rings(&self) -> usize {
        self.z.len()
    }

    /// The scale `s` of order m's coefficients from degree m on, and their recurrence.
    fn order(&self, m: usize) -> (&[f64], &[f64]) {
        let start = m * (2 * self.max_degree + 3 - m) / 2;
        let count = self.max_degree + 1 - m;
        (&self.alpha[start..start + count], &self.scale[start..start + count])
    }

    /// Scale of order m's coefficients from degree m on; what the sums below take and give is to be multiplied by it.
    pub(crate) fn scale(&self, m: usize) -> &[f64] {
        self.order(m).1
    }

    /// Sums over even and odd `l - m`: x (L + 1 - m, columns) row-major, scaled; even and odd (rings, columns)
    /// column-major, overwritten.
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
        work.tiling = SYNTHESIS;
        self.blocks(m, SYNTHESIS.block, |first, count| {
            work.start(count);
            for (chunk, alpha) in alpha.chunks(SYNTHESIS.chunk).enumerate() {
                self.fill(m, chunk, first..first + count, alpha, work);
                let degrees = alpha.len();
                for column in (0..columns).step_by(6) {
                    let x = Coefficients { values: &x[chunk * SYNTHESIS.chunk * columns + column..], stride: columns };
                    let even = &mut even[column * rings + first..];
                    let odd = &mut odd[column * rings + first..];
                    let table = &work.table;
                    match columns - column {
                        2 => sums_2(table, count, degrees, x, even, odd, rings),
                        4 => sums_4(table, count, degrees, x, even, odd, rings),
                        _ => sums_6(table, count, degrees, x, even, odd, rings),
                    }
                }
            }
        });
        let power = &self.power[m * rings..(m + 1) * rings];
        for column in even.chunks_exact_mut(rings).chain(odd.chunks_exact_mut(rings)).take(2 * columns) {
            for (value, power) in column.iter_mut().zip(power) {
                *value *= power;
            }
        }
    }

    /// The transpose of [`synthesis`](Self::synthesis): even and odd, (rings, columns) column-major, are used up; x is
    /// overwritten.
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
        let power = &self.power[m * rings..(m + 1) * rings];
        for column in even.chunks_exact_mut(rings).chain(odd.chunks_exact_mut(rings)).take(2 * columns) {
            for (value, power) in column.iter_mut().zip(power) {
                *value *= power;
            }
        }
        x[..alpha.len() * columns].fill(0.0);
        work.tiling = ADJOINT;
        self.blocks(m, ADJOINT.block, |first, count| {
            work.start(count);
            for (chunk, alpha) in alpha.chunks(ADJOINT.chunk).enumerate() {
                self.fill(m, chunk, first..first + count, alpha, work);
                let degrees = alpha.len();
                for column in (0..columns).step_by(6) {
                    let x = &mut x[chunk * ADJOINT.chunk * columns + column..];
                    let even = &even[column * rings + first..];
                    let odd = &odd[column * rings + first..];
                    let table = &work.table;
                    match columns - column {
                        2 => projections_2(table, count, degrees, x, columns, even, odd, rings),
                        4 => projections_4(table, count, degrees, x, columns, even, odd, rings),
                        _ => projections_6(table, count, degrees, x, columns, even, odd, rings),
                    }
                }
            }
        });
    }

    fn blocks(&self, m: usize, size: usize, mut block: impl FnMut(usize, usize)) {
        let mut first = self.first_ring[m];
        for end in [self.polar.count(), self.rings()] {
            while first < end {
                let count = size.min(end - first);
                block(first, count);
                first += count;
            }
        }
    }

    /// The table of a chunk's degrees for a block of rings.
    fn fill(&self, m: usize, chunk: usize, rings: Range<usize>, alpha: &[f64], work: &mut Work) {
        if rings.start < self.polar.count() {
            self.polar.fill(m, chunk, rings, work.tiling, &mut work.polar, &mut work.table);
        } else {
            fill(&self.z[rings], alpha, work);
        }
    }
}

/// Scratch space of one thread.
#[derive(Debug)]
pub(crate) struct Work {
    polar: PolarState,
    older: Vec<f64>,
    newest: Vec<f64>,
    tiling: Tiling,
    /// Values of r, (rings of the block, degrees of the chunk) column-major with a whole block between the columns.
    table: Vec<f64>,
}

impl Work {
    pub(crate) fn new() -> Self {
        Self {
            polar: PolarState::default(),
            tiling: SYNTHESIS,
            older: vec![0.0; ADJOINT.block],
            newest: vec![0.0; ADJOINT.block],
            table: vec![0.0; SYNTHESIS.block * SYNTHESIS.chunk],
        }
    }

    /// So that the step to degree m gives `r_m = 2^-930`, whatever alpha is.
    fn start(&mut self, rings: usize) {
        self.newest[..rings].fill(0.0);
        self.older[..rings].fill(-SEED);
    }
}

/// How far below one, in natural logarithms, the values `P_{l,m}`, l <= L, are at colatitude `acos z`; the action of the
/// classically forbidden zone `sin theta < m / L`.
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

/// The next degrees of r for a block of rings.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
fn fill(z: &[f64], alpha: &[f64], work: &mut Work) {
    let rings = z.len();
    let mut at = 0;
    while at < rings {
        let step = match rings - at {
            32.. => 32,
            16.. => 16,
            _ => 8,
        };
        let fma = target_cfg_f!(target_feature = "fma");
        match (step, fma) {
            (32, true) => fill_lanes::<32, true>(z, alpha, work, at),
            (16, true) => fill_lanes::<16, true>(z, alpha, work, at),
            (_, true) => fill_lanes::<8, true>(z, alpha, work, at),
            (32, false) => fill_lanes::<32, false>(z, alpha, work, at),
            (16, false) => fill_lanes::<16, false>(z, alpha, work, at),
            (_, false) => fill_lanes::<8, false>(z, alpha, work, at),
        }
        at += step;
    }
}

#[inline(always)]
fn fill_lanes<const W: usize, const FMA: bool>(z: &[f64], alpha: &[f64], work: &mut Work, at: usize) {
    let z: [f64; W] = load(z, at);
    let mut older: [f64; W] = load(&work.older, at);
    let mut newest: [f64; W] = load(&work.newest, at);
    for (alpha, column) in alpha.iter().zip(work.table.chunks_exact_mut(work.tiling.block)) {
        let mut r = [0.0; W];
        for i in 0..W {
            r[i] = fused::<FMA>(alpha * z[i], newest[i], -older[i]);
        }
        column[at..at + W].copy_from_slice(&r);
        older = newest;
        newest = r;
    }
    work.older[at..at + W].copy_from_slice(&older);
    work.newest[at..at + W].copy_from_slice(&newest);
}

/// Coefficients of a chunk's degrees: those of a degree are together, `stride` apart from the next degree's.
#[derive(Clone, Copy)]
struct Coefficients<'a> {
    values: &'a [f64],
    stride: usize,
}

macro_rules! sums_for {
    ($name:ident, $columns:literal) => {
        #[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
        fn $name(
            table: &[f64],
            rings: usize,
            degrees: usize,
            x: Coefficients<'_>,
            even: &mut [f64],
            odd: &mut [f64],
            leading: usize,
        ) {
            let mut at = 0;
            while at < rings {
                let wide = rings - at >= 16;
                for (parity, out) in [&mut *even, &mut *odd].into_iter().enumerate() {
                    match (wide, target_cfg_f!(target_feature = "fma")) {
                        (true, true) => sums::<16, $columns, true>(table, at, parity, degrees, x, out, leading),
                        (false, true) => sums::<8, $columns, true>(table, at, parity, degrees, x, out, leading),
                        (true, false) => sums::<16, $columns, false>(table, at, parity, degrees, x, out, leading),
                        (false, false) => sums::<8, $columns, false>(table, at, parity, degrees, x, out, leading),
                    }
                }
                at += if wide { 16 } else { 8 };
            }
        }
    };
}
sums_for!(sums_2, 2);
sums_for!(sums_4, 4);
sums_for!(sums_6, 6);

#[inline(always)]
fn sums<const W: usize, const C: usize, const FMA: bool>(
    table: &[f64],
    at: usize,
    parity: usize,
    degrees: usize,
    x: Coefficients<'_>,
    out: &mut [f64],
    leading: usize,
) {
    let mut sums = [[0.0; W]; C];
    let mut k = parity;
    while k < degrees {
        let r: [f64; W] = load(table, k * SYNTHESIS.block + at);
        let x: [f64; C] = load(x.values, k * x.stride);
        for c in 0..C {
            for i in 0..W {
                sums[c][i] = fused::<FMA>(r[i], x[c], sums[c][i]);
            }
        }
        k += 2;
    }
    for (c, sums) in sums.iter().enumerate() {
        for (out, sum) in out[c * leading + at..][..W].iter_mut().zip(sums) {
            *out += sum;
        }
    }
}

macro_rules! projections_for {
    ($name:ident, $columns:literal) => {
        #[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
        #[allow(clippy::too_many_arguments, reason = "a kernel")]
        fn $name(
            table: &[f64],
            rings: usize,
            degrees: usize,
            x: &mut [f64],
            stride: usize,
            even: &[f64],
            odd: &[f64],
            leading: usize,
        ) {
            for (parity, h) in [even, odd].into_iter().enumerate() {
                let mut k = parity;
                while k < degrees {
                    // Two degrees of the same parity share the loads of h.
                    let twin = if k + 2 < degrees { k + 2 } else { k };
                    let sums = if target_cfg_f!(target_feature = "fma") {
                        projections::<$columns, true>(table, [k, twin], rings, h, leading)
                    } else {
                        projections::<$columns, false>(table, [k, twin], rings, h, leading)
                    };
                    for c in 0..$columns {
                        x[k * stride + c] += sums[0][c];
                    }
                    if twin > k {
                        for c in 0..$columns {
                            x[twin * stride + c] += sums[1][c];
                        }
                    }
                    k += 4;
                }
            }
        }
    };
}
projections_for!(projections_2, 2);
projections_for!(projections_4, 4);
projections_for!(projections_6, 6);

#[inline(always)]
fn projections<const C: usize, const FMA: bool>(
    table: &[f64],
    degrees: [usize; 2],
    rings: usize,
    h: &[f64],
    leading: usize,
) -> [[f64; C]; 2] {
    let mut lanes = [[[0.0; LANES]; C]; 2];
    let mut at = 0;
    while at < rings {
        let r: [[f64; LANES]; 2] =
            [load(table, degrees[0] * ADJOINT.block + at), load(table, degrees[1] * ADJOINT.block + at)];
        for c in 0..C {
            let h: [f64; LANES] = load(h, c * leading + at);
            for (lanes, r) in lanes.iter_mut().zip(&r) {
                for i in 0..LANES {
                    lanes[c][i] = fused::<FMA>(r[i], h[i], lanes[c][i]);
                }
            }
        }
        at += LANES;
    }
    // A copy: the sums themselves never have an address.
    across(&std::hint::black_box(lanes))
}

/// The sums over lanes, halves first. Not inlined: the optimiser then keeps the loop's sums in vectors, where it would take
/// them apart for what comes after the loop (measured: a quarter of the speed).
#[inline(never)]
fn across<const C: usize>(lanes: &[[[f64; LANES]; C]; 2]) -> [[f64; C]; 2] {
    let mut sums = [[0.0; C]; 2];
    for (sums, lanes) in sums.iter_mut().zip(lanes) {
        for (sum, v) in sums.iter_mut().zip(lanes) {
            let mut four = [0.0; 4];
            for i in 0..4 {
                four[i] = v[i] + v[i + 4];
            }
            *sum = (four[0] + four[2]) + (four[1] + four[3]);
        }
    }
    sums
}

#[inline(always)]
fn load<const W: usize>(values: &[f64], at: usize) -> [f64; W] {
    let mut lanes = [0.0; W];
    lanes.copy_from_slice(&values[at..at + W]);
    lanes
}

#[inline(always)]
fn fused<const FMA: bool>(a: f64, b: f64, c: f64) -> f64 {
    if FMA { a.mul_add(b, c) } else { a * b + c }
}
