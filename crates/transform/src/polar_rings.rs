//! The Legendre recurrence in double-double, for the rings next to the poles.
//!
//! Rounding errors of the plain recurrence, and those of its inputs `z = cos theta` and `alpha`, grow like `min(l, 1 /
//! sin theta)` from the degree at which they arise. At degree 2,000 these errors reach about 1e-11 next to the poles.
//! Only a few rings are next to the poles, and all but the low orders are negligible on them. Therefore the tenfold
//! cost of double-double on these rings isn't noticeable. As for single directions,
//! [`is_polar`](spharm_harmonics::polar::is_polar) decides which rings are polar.

use std::ops::{Mul, Range, Sub};

use multiversion::{multiversion, target::target_cfg_f};
use spharm_harmonics::double_double::{DoubleDouble, unit};
use spharm_harmonics::polar::is_polar;
use spharm_harmonics::rings::{MonicRecurrence, SEED};

use crate::lanes::load;
use crate::ring_table::{LANES, Tiling};

/// Double-doubles, stored as an array of leading parts and an array of remainders, so that rings are the lanes of a
/// vector.
type Pairs = [Vec<f64>; 2];

/// The rings next to the north pole.
#[derive(Debug)]
pub(crate) struct PolarRings {
    z: Pairs,
    /// Coefficients `alpha_l` of the [recurrence](crate::legendre) from degree m on, for each order m that isn't
    /// negligible on the polar rings.
    alpha: Vec<Vec<[f64; 2]>>,
}

/// Values `r_{l-2}` and `r_{l-1}` of the [recurrence](crate::legendre) on a block of rings.
#[derive(Debug, Default)]
pub(crate) struct PolarState {
    older: Pairs,
    newest: Pairs,
}

impl PolarRings {
    pub(crate) fn new(recurrence: &MonicRecurrence, angles: &[[f64; 2]], first_ring: &[usize]) -> Self {
        let max_degree = recurrence.max_degree();
        let polar = angles.iter().take_while(|[_, sine]| is_polar(*sine, max_degree)).count();
        let count = polar.next_multiple_of(LANES).min(angles.len() / LANES * LANES);
        let pair = |d: DoubleDouble<false>| [d.hi, d.lo];
        let z: Vec<[f64; 2]> =
            angles[..count].iter().map(|&[cosine, sine]| pair(unit([sine, 0.0, cosine])[2])).collect();
        let z = [0, 1].map(|part| z.iter().map(|z| z[part]).collect());
        let orders = first_ring.iter().take_while(|&&first| first < count).count();
        let alpha = (0..orders).map(|m| recurrence.exact_order(m).into_iter().map(pair).collect()).collect();
        Self { z, alpha }
    }

    /// Returns the number of polar rings, a multiple of [`LANES`].
    pub(crate) fn count(&self) -> usize {
        self.z[0].len()
    }

    /// Writes the values `r_l` of the [recurrence](crate::legendre) for a chunk of degrees and a block of polar rings
    /// to `table` (`tiling.block`, degrees), column-major. Chunks must be computed in order; chunk 0 starts the
    /// recurrence.
    pub(crate) fn fill(
        &self,
        m: usize,
        chunk: usize,
        rings: Range<usize>,
        tiling: Tiling,
        state: &mut PolarState,
        table: &mut [f64],
    ) {
        if chunk == 0 {
            for (values, start) in state.newest.iter_mut().chain(&mut state.older).zip([0.0, 0.0, -SEED, 0.0]) {
                values.clear();
                values.resize(rings.len(), start);
            }
        }
        let alpha = &self.alpha[m][chunk * tiling.chunk..];
        let z = [&self.z[0][rings.clone()], &self.z[1][rings]];
        recur(z, &alpha[..tiling.chunk.min(alpha.len())], state, table, tiling.block);
    }
}

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
fn recur(z: [&[f64]; 2], alpha: &[[f64; 2]], state: &mut PolarState, table: &mut [f64], block: usize) {
    for at in (0..z[0].len()).step_by(LANES) {
        if target_cfg_f!(any(target_feature = "fma", target_arch = "aarch64")) {
            recur_lanes::<true>(z, alpha, state, table, block, at);
        } else {
            recur_lanes::<false>(z, alpha, state, table, block, at);
        }
    }
}

#[inline(always)]
fn recur_lanes<const FMA: bool>(
    z: [&[f64]; 2],
    alpha: &[[f64; 2]],
    state: &mut PolarState,
    table: &mut [f64],
    block: usize,
    at: usize,
) {
    let z: [[f64; LANES]; 2] = z.map(|part| load(part, at));
    let [mut older, mut newest]: [[[f64; LANES]; 2]; 2] =
        [&state.older, &state.newest].map(|pairs| [load(&pairs[0], at), load(&pairs[1], at)]);
    let number = |pairs: &[[f64; LANES]; 2], i: usize| DoubleDouble::<FMA> { hi: pairs[0][i], lo: pairs[1][i] };
    for (&[hi, lo], column) in alpha.iter().zip(table.chunks_exact_mut(block)) {
        let alpha = DoubleDouble::<FMA> { hi, lo };
        let mut r = [[0.0; LANES]; 2];
        let [leading, rest] = &mut r;
        for (i, (leading, rest)) in leading.iter_mut().zip(rest).enumerate() {
            let next = alpha.mul(number(&z, i)).mul(number(&newest, i)).sub(number(&older, i));
            (*leading, *rest) = (next.hi, next.lo);
        }
        column[at..at + LANES].copy_from_slice(&r[0]);
        (older, newest) = (newest, r);
    }
    for (pairs, values) in [(&mut state.older, older), (&mut state.newest, newest)] {
        for (part, values) in pairs.iter_mut().zip(values) {
            part[at..at + LANES].copy_from_slice(&values);
        }
    }
}
