//! Sums over degrees and sums over rings of a [ring table](crate::ring_table), for two to six columns at a time.
//!
//! A column is the cosine or the sine coefficients of a channel. Rings are taken 8 or 16 at a time, with all columns'
//! sums in registers.

use multiversion::{multiversion, target::target_cfg_f};

use crate::lanes::{fused, load};
use crate::ring_table::{ADJOINT, LANES, SYNTHESIS};

/// Coefficients of a chunk's degrees: those of a degree are together, `stride` apart from the next degree's.
#[derive(Clone, Copy)]
pub(crate) struct Coefficients<'a> {
    pub(crate) values: &'a [f64],
    pub(crate) stride: usize,
}

macro_rules! sums_for {
    ($name:ident, $columns:literal) => {
        #[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
        pub(crate) fn $name(
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
        pub(crate) fn $name(
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

/// The sums over lanes, halves first. Not inlined: the optimiser then keeps the loop's sums in vectors, where it would
/// take them apart for what comes after the loop (measured: a quarter of the speed).
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
