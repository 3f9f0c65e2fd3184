//! Computes sums over the degrees and sums over the rings of a [ring table](crate::ring_table), for two to six columns
//! at a time.
//!
//! A column contains the cosine or the sine coefficients of a channel. Rings are processed 8 or 16 at a time, with the
//! sums of all columns in registers. The table's values belong to single degrees, alternately even and odd, or to
//! [pairs of degrees](crate::degree_pairs). The value of a pair is multiplied by the coefficients of both degrees.

use multiversion::{multiversion, target::target_cfg_f};

use crate::lanes::{fused, load};
use crate::ring_table::{ADJOINT, LANES, SYNTHESIS};

/// Whether to process 16 rings at once in sums, and two rows at once in the transposed sums. On ARM64, each of the 32
/// registers holds only two numbers, so the registers hold the sums of only half as many rings or rows. With more rings
/// or rows, a sixth of the instructions would move sums to memory and back.
const WIDE: bool = cfg!(not(target_arch = "aarch64"));

/// Coefficients of the degrees, or pairs of degrees, of a chunk. The coefficients of a degree or pair are contiguous,
/// and start `stride` values after those of the previous degree or pair.
#[derive(Clone, Copy)]
pub(crate) struct Coefficients<'a> {
    pub(crate) values: &'a [f64],
    pub(crate) stride: usize,
}

/// Values of a table, for every `step`-th degree or pair from `first` to `end`.
#[derive(Clone, Copy)]
struct Rows<'a> {
    table: &'a [f64],
    first: usize,
    step: usize,
    end: usize,
}

/// Defines a function that computes the sums of a fixed number of columns, on 8 or 16 rings at a time.
macro_rules! sums_for {
    ($degrees:ident, $columns:literal) => {
        /// Adds sums over even `l - m` to `even`, and sums over odd `l - m` to `odd`.
        #[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
        pub(crate) fn $degrees(
            table: &[f64],
            rings: usize,
            degrees: usize,
            x: Coefficients<'_>,
            even: &mut [f64],
            odd: &mut [f64],
            leading: usize,
        ) {
            for (first, out) in [&mut *even, &mut *odd].into_iter().enumerate() {
                let rows = Rows { table, first, step: 2, end: degrees };
                if target_cfg_f!(any(target_feature = "fma", target_arch = "aarch64")) {
                    sums_of_rings::<$columns, true, _>(rows, rings, x, [out], leading);
                } else {
                    sums_of_rings::<$columns, false, _>(rows, rings, x, [out], leading);
                }
            }
        }
    };
}
sums_for!(sums_2, 2);
sums_for!(sums_4, 4);
sums_for!(sums_6, 6);

/// Adds sums over pairs of degrees for one channel: the cosine and the sine sum of even `l - m` to `even`, and the
/// cosine and the sine sum of odd `l - m` to `odd`.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
pub(crate) fn pair_sums(
    table: &[f64],
    rings: usize,
    pairs: usize,
    x: Coefficients<'_>,
    even: &mut [f64],
    odd: &mut [f64],
    leading: usize,
) {
    let rows = Rows { table, first: 0, step: 1, end: pairs };
    if target_cfg_f!(any(target_feature = "fma", target_arch = "aarch64")) {
        sums_of_rings::<4, true, _>(rows, rings, x, [even, odd], leading);
    } else {
        sums_of_rings::<4, false, _>(rows, rings, x, [even, odd], leading);
    }
}

/// Computes the sums on all rings; the columns are divided evenly among the arrays `out`.
#[inline(always)]
fn sums_of_rings<const C: usize, const FMA: bool, const N: usize>(
    rows: Rows<'_>,
    rings: usize,
    x: Coefficients<'_>,
    mut out: [&mut [f64]; N],
    leading: usize,
) {
    let mut at = 0;
    while at < rings {
        // Without fused products, on old processors, the wider kernel isn't worth its code size.
        if FMA && WIDE && rings - at >= 16 {
            sums::<16, C, FMA, N>(rows, at, x, &mut out, leading);
            at += 16;
        } else {
            sums::<8, C, FMA, N>(rows, at, x, &mut out, leading);
            at += 8;
        }
    }
}

#[inline(always)]
fn sums<const W: usize, const C: usize, const FMA: bool, const N: usize>(
    rows: Rows<'_>,
    at: usize,
    x: Coefficients<'_>,
    out: &mut [&mut [f64]; N],
    leading: usize,
) {
    let mut sums = [[0.0; W]; C];
    let mut k = rows.first;
    while k < rows.end {
        let r: [f64; W] = load(rows.table, k * SYNTHESIS.block + at);
        let x: [f64; C] = load(x.values, k * x.stride);
        for c in 0..C {
            for i in 0..W {
                sums[c][i] = fused::<FMA>(r[i], x[c], sums[c][i]);
            }
        }
        k += rows.step;
    }
    for (out, sums) in out.iter_mut().zip(sums.chunks_exact(C / N)) {
        for (c, sums) in sums.iter().enumerate() {
            for (out, sum) in out[c * leading + at..][..W].iter_mut().zip(sums) {
                *out += sum;
            }
        }
    }
}

macro_rules! projections_for {
    ($degrees:ident, $columns:literal) => {
        /// For each row of the table, which belongs to one degree, adds to `x` the sum over rings of the row's values
        /// times `even` (rows 0, 2, 4, ...) or times `odd` (rows 1, 3, 5, ...).
        #[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
        #[allow(clippy::too_many_arguments, reason = "a kernel")]
        pub(crate) fn $degrees(
            table: &[f64],
            rings: usize,
            degrees: usize,
            x: &mut [f64],
            stride: usize,
            even: &[f64],
            odd: &[f64],
            leading: usize,
        ) {
            for (first, h) in [even, odd].into_iter().enumerate() {
                let h: [&[f64]; $columns] = std::array::from_fn(|c| &h[c * leading..][..rings]);
                let rows = Rows { table, first, step: 2, end: degrees };
                if target_cfg_f!(any(target_feature = "fma", target_arch = "aarch64")) {
                    projections_to::<$columns, true>(rows, rings, x, stride, h);
                } else {
                    projections_to::<$columns, false>(rows, rings, x, stride, h);
                }
            }
        }
    };
}
projections_for!(projections_2, 2);
projections_for!(projections_4, 4);
projections_for!(projections_6, 6);

/// Multiplies each row of a table of pairs of degrees by the two columns `even` and the two columns `odd` of a channel,
/// and adds the sums over the rings to `x`.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
#[allow(clippy::too_many_arguments, reason = "a kernel")]
pub(crate) fn pair_projections(
    table: &[f64],
    rings: usize,
    pairs: usize,
    x: &mut [f64],
    stride: usize,
    even: &[f64],
    odd: &[f64],
    leading: usize,
) {
    let h: [&[f64]; 4] = std::array::from_fn(|c| &[even, odd][c / 2][(c % 2) * leading..][..rings]);
    let rows = Rows { table, first: 0, step: 1, end: pairs };
    if target_cfg_f!(any(target_feature = "fma", target_arch = "aarch64")) {
        projections_to::<4, true>(rows, rings, x, stride, h);
    } else {
        projections_to::<4, false>(rows, rings, x, stride, h);
    }
}

#[inline(always)]
fn projections_to<const C: usize, const FMA: bool>(
    rows: Rows<'_>,
    rings: usize,
    x: &mut [f64],
    stride: usize,
    h: [&[f64]; C],
) {
    let mut k = rows.first;
    while k < rows.end {
        let twin = k + rows.step;
        // Two rows are processed together, so that each value of the columns `h` is loaded once for both rows.
        if WIDE && twin < rows.end {
            let [first, second] = projections::<C, FMA, 2>(rows.table, [k, twin], rings, h);
            add(&mut x[k * stride..], first);
            add(&mut x[twin * stride..], second);
            k = twin + rows.step;
        } else {
            let [sums] = projections::<C, FMA, 1>(rows.table, [k], rings, h);
            add(&mut x[k * stride..], sums);
            k = twin;
        }
    }
}

#[inline(always)]
fn projections<const C: usize, const FMA: bool, const R: usize>(
    table: &[f64],
    rows: [usize; R],
    rings: usize,
    h: [&[f64]; C],
) -> [[f64; C]; R] {
    let mut lanes = [[[0.0; LANES]; C]; R];
    let mut at = 0;
    while at < rings {
        let r: [[f64; LANES]; R] = rows.map(|k| load(table, k * ADJOINT.block + at));
        for c in 0..C {
            let h: [f64; LANES] = load(h[c], at);
            for (lanes, r) in lanes.iter_mut().zip(&r) {
                for i in 0..LANES {
                    lanes[c][i] = fused::<FMA>(r[i], h[i], lanes[c][i]);
                }
            }
        }
        at += LANES;
    }
    // The sums are copied here, so that the originals can stay in registers.
    across(&std::hint::black_box(lanes))
}

#[inline(always)]
fn add<const C: usize>(x: &mut [f64], sums: [f64; C]) {
    x[..C].iter_mut().zip(sums).for_each(|(x, sum)| *x += sum);
}

/// Returns the sums over lanes, adding halves first. The function isn't inlined, so that the optimiser keeps the loop's
/// sums in vectors. If it is inlined, the optimiser splits these vectors for the code after the loop, which reduced the
/// measured speed to a quarter.
#[inline(never)]
fn across<const C: usize, const R: usize>(lanes: &[[[f64; LANES]; C]; R]) -> [[f64; C]; R] {
    let mut sums = [[0.0; C]; R];
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
