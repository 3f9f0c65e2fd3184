//! Iterative residual fitting, accelerated by conjugate gradients that are preconditioned by a forward and a backward
//! pass over the blocks.
//!
//! For a basis A, weights W (diagonal) and targets f, a pass is one step of block Gauss-Seidel on the normal equations
//! `N x = A^T W f`, `N = A^T W A`. If blocks are far from orthogonal, the error decreases slowly from pass to pass.
//! However, a forward and a backward pass together apply a symmetric positive definite matrix `M` close to `N^-1`,
//! which conjugate gradients use as a preconditioner.
//!
//! # In sample space
//!
//! For the residual `r = f - A x` let `s = r`, `z = 0`, and for each block, first in order and then in reverse order,
//!
//! ```text
//! y = G_j^-1 A_j^T W s      z_j += y      s -= A_j y           G_j = A_j^T W A_j
//! ```
//!
//! Then `z = M A^T W r` with the preconditioner M of symmetric block Gauss-Seidel (Saad, section 10.2). The product
//! `A z = r - s` follows without the gradient, and without products with A other than those of the passes. On
//! `W^(1/2) s`, the step of block j is an orthogonal projection `I - P_j`. The projection of the last block would be
//! applied twice in a row. This projection is applied only once, because `(I - P)^2 = I - P`. This saves reading one
//! block. For a rank-deficient block, `G_j^-1` denotes the operator that returns the minimum-norm solution. This
//! operator is symmetric and gives the same projection. All iterates then stay in the span of minimum-norm solutions.
//!
//! # The iteration
//!
//! ```text
//! gamma = (A^T W r)^T z     beta = gamma / gamma'     p = z + beta p     q = A z + beta q
//! alpha = gamma / q^T W q   x += alpha p              r -= alpha q
//! ```
//!
//! Here `gamma'` is the gamma of the previous iteration. Each column has its own alpha and beta. Let E = (I - P_B) ..
//! (I - P_1) be the forward pass over the B blocks. Then `gamma = |W^(1/2) r|^2 - |W^(1/2) E r|^2` is the decrease of
//! the squared residual by the forward pass. Gamma is summed over the steps of the pass. Each step contributes
//! `y^T A_j^T W s`, which is never negative. Therefore gamma is accurate down to rounding, whereas `r^T W (r - s)`
//! would lose digits by cancellation, because `|r|^2` doesn't go to zero.
//!
//! A column is finished when `gamma^(1/2) <= 1e-13 |W^(1/2) f|`, and isn't changed after that.
//!
//! # Cost
//!
//! An iteration consists of two passes, the second of which omits the last block. An iteration takes `8 n K c` flops
//! and reads the basis twice. In addition to the arrays of plain passes, it needs s and q (n, c), and z and p (K, c).
//! If the number of passes is odd, the first pass is a plain pass.
//!
//! Y. Saad, "Iterative methods for sparse linear systems", second edition, SIAM 2003, sections 9.2 and 10.2; M. R.
//! Hestenes and E. Stiefel, "Methods of conjugate gradients for solving linear systems", 1952.

use ndarray::{Array2, Zip};
use rayon::prelude::*;

use super::IrfSolver;
use super::blocks::columns;
use super::report::Recorder;
use super::stream::Order;
use crate::SolverError;
use crate::chunked_rows::ChunkedRows;

/// A column is finished when the square root of its gamma (see the [module](self)) is at most this multiple of the norm
/// of its targets. The multiple can't be much smaller, because of rounding errors of `A^T W s`.
const CONVERGED: f64 = 1e-13;

impl IrfSolver<'_> {
    /// Fits the coefficients x (K, c), zero on entry, to r (n, c), which contains the targets on entry and their
    /// residual on return.
    pub(super) fn accelerated(
        &mut self,
        r: &mut ChunkedRows,
        x: &mut Array2<f64>,
        log: &mut Recorder<'_>,
    ) -> Result<(), SolverError> {
        let (passes, c) = (self.params.method.passes(), r.channels());
        let floor: Vec<f64> = self.inner(r, r).into_iter().map(|square| CONVERGED * CONVERGED * square).collect();
        if passes % 2 == 1 {
            log.begin_pass(1, false);
            let pass = self.pass(Order::Forward, r, x, log)?;
            log.end_pass(r, pass.bytes_read);
        }
        let zeros = || ChunkedRows::zeros(r.rows(), c, self.operator.chunk_rows());
        let (mut s, mut q) = (zeros(), zeros());
        let (mut z, mut p) = (Array2::<f64>::zeros(x.dim()), Array2::<f64>::zeros(x.dim()));
        let mut before = vec![0.0; c];
        let mut finished = vec![false; c];
        for last in (passes % 2 + 2..=passes).step_by(2) {
            log.begin_pass(last, false);
            s.copy_from(r);
            z.fill(0.0);
            let forward = self.pass(Order::Forward, &mut s, &mut z, log)?;
            // The backward pass skips the last block, so the progress for that block is reported here.
            log.end_block(self.blocks.last().map_or(0, columns));
            let backward = self.pass(Order::Backward, &mut s, &mut z, log)?;
            let gamma = forward.energy;
            for ((finished, gamma), floor) in finished.iter_mut().zip(&gamma).zip(&floor) {
                *finished |= *gamma <= *floor;
            }
            let live = |column: usize, value: f64| if finished[column] { 0.0 } else { value };
            let beta: Vec<f64> =
                (0..c).map(|j| live(j, if before[j] > 0.0 { gamma[j] / before[j] } else { 0.0 })).collect();
            // s began as a copy of r, and the forward and the backward pass together subtracted A z from it. Therefore
            // A z = r - s; s is reused to store A z.
            s.combine(r, |_, s, r| r - s);
            q.combine(&s, |j, q, az| az + beta[j] * q);
            Zip::indexed(&mut p).and(&z).for_each(|(_, j), p, z| *p = z + beta[j] * *p);
            let squares = self.inner(&q, &q);
            let alpha: Vec<f64> =
                (0..c).map(|j| live(j, if squares[j] > 0.0 { gamma[j] / squares[j] } else { 0.0 })).collect();
            r.combine(&q, |j, r, q| r - alpha[j] * q);
            Zip::indexed(&mut *x).and(&p).for_each(|(_, j), x, p| *x += alpha[j] * p);
            log.end_pass(r, forward.bytes_read + backward.bytes_read);
            if finished.iter().all(|&finished| finished) {
                break;
            }
            before = gamma;
        }
        Ok(())
    }

    /// Computes the inner products `a^T W b` (c) of corresponding columns.
    fn inner(&self, a: &ChunkedRows, b: &ChunkedRows) -> Vec<f64> {
        let of_chunk = |chunk: usize| -> Vec<f64> {
            let range = self.operator.chunk_range(chunk);
            let columns = a.chunk(chunk).chunks_exact(range.len()).zip(b.chunk(chunk).chunks_exact(range.len()));
            let sum = |(a, b): (&[f64], &[f64])| match &self.root_weights {
                None => a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>(),
                Some(roots) => {
                    a.iter().zip(b).zip(&roots[range.clone()]).map(|((a, b), root)| a * b * root * root).sum()
                }
            };
            columns.map(sum).collect()
        };
        let parts: Vec<Vec<f64>> = (0..self.operator.chunk_count()).into_par_iter().map(of_chunk).collect();
        // Add in the order of the chunks, so that the sums don't depend on the number of threads.
        let mut sums = vec![0.0; a.channels()];
        for part in parts {
            sums.iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
        }
        sums
    }
}
