//! Gram matrices of blocks from elsewhere than the basis.
//!
//! Summing `A_block^T W A_block` is what dominates a first pass: `n k (k + 1)` flops a block. The moments of the
//! sampling have the same matrix in time that doesn't depend on n ([`crate::lsq::moment_gram`]).
//!
//! It is the Gram matrix of the harmonics at the directions to 1e-13, the accuracy of the finest transform. That moves
//! the msd after a first pass by some 1e-10 of itself (5e-10 on a cortex, 6e-10 on an irregular head, L = 100); further
//! passes take it back, for the residual is exact where a step is a little off.
//!
//! A basis kept in f64 is those harmonics to rounding; one kept in f32 differs from them by 6e-8, and the exact solve of
//! a block would become an approximate one. So a source goes with f64 bases only.

use std::ops::RangeInclusive;

use spharm_transform::MomentGram;

/// A source of the Gram matrices `A_block^T W A_block`, for the basis and the weights of a fit.
pub trait BlockGrams: Sync {
    /// The highest degree that it has.
    fn max_degree(&self) -> usize;

    /// Bytes that it holds.
    fn bytes(&self) -> usize;

    /// Writes the Gram matrix of a run of degrees, both triangles, into `out`, (k, k).
    fn block(&self, degrees: RangeInclusive<usize>, out: &mut [f64]);
}

impl BlockGrams for MomentGram {
    fn max_degree(&self) -> usize {
        MomentGram::max_degree(self)
    }

    fn bytes(&self) -> usize {
        MomentGram::bytes(MomentGram::max_degree(self))
    }

    fn block(&self, degrees: RangeInclusive<usize>, out: &mut [f64]) {
        MomentGram::block(self, degrees, out);
    }
}
