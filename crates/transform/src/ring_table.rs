//! A table of Legendre values on a block of rings, for a chunk of degrees of one order.
//!
//! The values are those of the recurrence `r_l = alpha_l z r_{l-1} - r_{l-2}` (see [`legendre`](crate::legendre)), or
//! those of [pairs of degrees](crate::degree_pairs). The table takes 16 kB, so that it stays in the L1 cache while it
//! is used for all channels. The recurrence continues from chunk to chunk: the table keeps the last two values of each
//! ring.

use multiversion::{multiversion, target::target_cfg_f};
use spharm_harmonics::rings::SEED;

use crate::lanes::{fused, load};

/// Numbers of rings and of degrees in a table. The table and the block's sums must fit in the L1 cache together. The
/// number of degrees is even, so that every chunk starts with an even `l - m`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tiling {
    /// Number of rings of a block, a multiple of [`LANES`].
    pub(crate) block: usize,
    /// Number of degrees of a chunk, which is even.
    pub(crate) chunk: usize,
}

/// Tiling for sums over degrees. The sums stay in registers while a chunk is processed.
pub(crate) const SYNTHESIS: Tiling = Tiling { block: 128, chunk: 16 };
/// Tiling for sums over rings. Blocks are larger than for synthesis, because in every block each sum ends with an
/// addition across lanes, which costs as much as five products.
pub(crate) const ADJOINT: Tiling = Tiling { block: 256, chunk: 8 };
/// Number of lanes. The number of rings is padded to a multiple of this number.
pub(crate) const LANES: usize = 8;

/// Legendre values `r_l` (see the [module](self)) of a chunk of degrees, and the state from which the recurrence
/// continues in the next chunk.
#[derive(Debug)]
pub(crate) struct RingTable {
    pub(crate) tiling: Tiling,
    /// `r_{l-2}` and `r_{l-1}` of the block's rings.
    older: Vec<f64>,
    newest: Vec<f64>,
    /// Legendre values (rings of the block, degrees of the chunk), column-major, with columns `tiling.block` values
    /// apart.
    pub(crate) values: Vec<f64>,
}

impl RingTable {
    pub(crate) fn new() -> Self {
        Self {
            tiling: SYNTHESIS,
            older: vec![0.0; ADJOINT.block],
            newest: vec![0.0; ADJOINT.block],
            values: vec![0.0; SYNTHESIS.block * SYNTHESIS.chunk],
        }
    }

    /// Starts the recurrence on a block of `rings` rings. Its first step then gives the initial value `r_m = 2^-930`
    /// for any alpha.
    pub(crate) fn start(&mut self, tiling: Tiling, rings: usize) {
        self.tiling = tiling;
        self.newest[..rings].fill(0.0);
        self.older[..rings].fill(-SEED);
    }

    /// Computes the values of the next `alpha.len()` degrees on rings whose colatitudes have the cosines `z`.
    pub(crate) fn advance(&mut self, z: &[f64], alpha: &[f64]) {
        fill(z, alpha, self);
    }

    /// Computes the next `steps.len()` [pairs of degrees](crate::degree_pairs) on rings whose colatitudes have the
    /// squared cosines `squares`.
    pub(crate) fn advance_pairs(&mut self, squares: &[f64], steps: &[[f64; 2]]) {
        fill_pairs(squares, steps, self);
    }
}

macro_rules! fill_with {
    ($name:ident, $step:ty, $factor:ident) => {
        #[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
        fn $name(of_ring: &[f64], steps: &[$step], table: &mut RingTable) {
            let rings = of_ring.len();
            let mut at = 0;
            while at < rings {
                let step = match rings - at {
                    32.. => 32,
                    16.. => 16,
                    _ => 8,
                };
                match (step, target_cfg_f!(any(target_feature = "fma", target_arch = "aarch64"))) {
                    (32, true) => fill_lanes::<32, true, _>(of_ring, steps, table, at, $factor::<true>),
                    (16, true) => fill_lanes::<16, true, _>(of_ring, steps, table, at, $factor::<true>),
                    (_, true) => fill_lanes::<8, true, _>(of_ring, steps, table, at, $factor::<true>),
                    // Without fused products, on old processors, rings are processed in steps of eight.
                    (step, false) => (at..at + step)
                        .step_by(8)
                        .for_each(|at| fill_lanes::<8, false, _>(of_ring, steps, table, at, $factor::<false>)),
                }
                at += step;
            }
        }
    };
}
fill_with!(fill, f64, degree);
fill_with!(fill_pairs, [f64; 2], pair);

/// Returns the factor by which the step to the next degree multiplies the newest value.
#[inline(always)]
fn degree<const FMA: bool>(z: f64, alpha: &f64) -> f64 {
    alpha * z
}

/// Returns the factor `a z^2 + b` by which the recurrence multiplies its newest value in the step to the next pair of
/// degrees.
#[inline(always)]
fn pair<const FMA: bool>(square: f64, [a, b]: &[f64; 2]) -> f64 {
    fused::<FMA>(*a, square, *b)
}

#[inline(always)]
fn fill_lanes<const W: usize, const FMA: bool, S>(
    of_ring: &[f64],
    steps: &[S],
    table: &mut RingTable,
    at: usize,
    factor: impl Fn(f64, &S) -> f64,
) {
    let of_ring: [f64; W] = load(of_ring, at);
    let mut older: [f64; W] = load(&table.older, at);
    let mut newest: [f64; W] = load(&table.newest, at);
    for (step, column) in steps.iter().zip(table.values.chunks_exact_mut(table.tiling.block)) {
        let mut r = [0.0; W];
        for i in 0..W {
            r[i] = fused::<FMA>(factor(of_ring[i], step), newest[i], -older[i]);
        }
        column[at..at + W].copy_from_slice(&r);
        older = newest;
        newest = r;
    }
    table.older[at..at + W].copy_from_slice(&older);
    table.newest[at..at + W].copy_from_slice(&newest);
}
