//! The Legendre recurrence in double-double, for the rings next to the poles.
//!
//! Rounding errors of the plain recurrence, and those of `z` and `alpha`, grow like `min(l, 1 / sin theta)` from each
//! degree on: at degree 2,000 to some 1e-11 next to the poles. Few rings are there, and only low orders count on them,
//! so ten times the work for them is not noticeable. Which rings are polar is decided by
//! [`is_polar`](spharm_harmonics::polar::is_polar), as for single directions.

use std::ops::{Mul, Range, Sub};

use multiversion::{multiversion, target::target_cfg_f};
use spharm_harmonics::double_double::{DoubleDouble, unit};
use spharm_harmonics::polar::is_polar;
use spharm_harmonics::rings::{MonicRecurrence, SEED};

use crate::ring_table::{LANES, Tiling};

/// A double-double as (hi, lo), the same on any processor.
type Pair = [f64; 2];

/// The rings next to the north pole.
#[derive(Debug)]
pub(crate) struct PolarRings {
    z: Vec<Pair>,
    /// For each order that counts on these rings: `alpha_l` from degree m on.
    alpha: Vec<Vec<Pair>>,
}

/// `r_{l-2}` and `r_{l-1}` of a block of rings.
#[derive(Debug, Default)]
pub(crate) struct PolarState {
    older: Vec<Pair>,
    newest: Vec<Pair>,
}

impl PolarRings {
    pub(crate) fn new(recurrence: &MonicRecurrence, angles: &[[f64; 2]], first_ring: &[usize]) -> Self {
        let max_degree = recurrence.max_degree();
        let polar = angles.iter().take_while(|[_, sine]| is_polar(*sine, max_degree)).count();
        let count = polar.next_multiple_of(LANES).min(angles.len() / LANES * LANES);
        let pair = |d: DoubleDouble<false>| [d.hi, d.lo];
        let z = angles[..count].iter().map(|&[cosine, sine]| pair(unit([sine, 0.0, cosine])[2])).collect();
        let orders = first_ring.iter().take_while(|&&first| first < count).count();
        let alpha = (0..orders).map(|m| recurrence.exact_order(m).into_iter().map(pair).collect()).collect();
        Self { z, alpha }
    }

    /// Number of polar rings; a multiple of [`LANES`].
    pub(crate) fn count(&self) -> usize {
        self.z.len()
    }

    /// Writes the values of r for a chunk of degrees and a block of these rings to `table`, (tiling.block, degrees)
    /// column-major. Chunks have to come in order; chunk 0 starts the recurrence.
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
            state.newest = vec![[0.0; 2]; rings.len()];
            state.older = vec![[-SEED, 0.0]; rings.len()];
        }
        let alpha = &self.alpha[m][chunk * tiling.chunk..];
        recur(&self.z[rings], &alpha[..tiling.chunk.min(alpha.len())], state, table, tiling.block);
    }
}

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
fn recur(z: &[Pair], alpha: &[Pair], state: &mut PolarState, table: &mut [f64], block: usize) {
    if target_cfg_f!(target_feature = "fma") {
        recur_of::<true>(z, alpha, state, table, block);
    } else {
        recur_of::<false>(z, alpha, state, table, block);
    }
}

#[inline(always)]
fn recur_of<const FMA: bool>(z: &[Pair], alpha: &[Pair], state: &mut PolarState, table: &mut [f64], block: usize) {
    let number = |[hi, lo]: Pair| DoubleDouble::<FMA> { hi, lo };
    for (alpha, column) in alpha.iter().zip(table.chunks_exact_mut(block)) {
        let alpha = number(*alpha);
        for (((z, newest), older), out) in z.iter().zip(&mut state.newest).zip(&mut state.older).zip(column) {
            let r = alpha.mul(number(*z)).mul(number(*newest)).sub(number(*older));
            *out = r.hi;
            *older = std::mem::replace(newest, [r.hi, r.lo]);
        }
    }
}
