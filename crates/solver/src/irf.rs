//! Iterative residual fitting (IRF) over a basis that is read block by block, in bounded memory.
//!
//! L. Shen and M. K. Chung, "Large-scale modeling of parametric surfaces using spherical harmonics", 3DPVT 2006,
//! section 3.3. The functions f are sampled at n directions. The basis matrix A, (n, K), is divided into blocks, each
//! with the columns of some degrees d to e:
//!
//! ```text
//! r = f, a = 0
//! for each pass
//!     for each block A_d..e
//!         x = argmin | W^(1/2) (A_d..e x - r) |
//!         a_d..e += x
//!         r -= A_d..e x
//! ```
//!
//! Here r is the residual, a are the coefficients (a_d..e those of the block), and W is the diagonal matrix of the
//! weights. Solving for a block is one step of block Gauss-Seidel on the normal equations. Therefore, with more passes,
//! the fit converges to the full least-squares solution for any division into blocks.
//!
//! For c columns, the first pass takes `n k (k + 1)` flops for the Gram matrix of each block of k columns, and
//! `4 n K c` flops for right-hand sides and updates. The first pass reads every byte of the basis once, or twice if a
//! block doesn't fit the budget. Later passes compute only right-hand sides and updates, and are bound by memory
//! bandwidth.
//!
//! | module | contents |
//! |---|---|
//! | `blocks` | NLSF, SIRF, MIRF, IRF: the degrees that are solved together |
//! | `params`, `solver` | [`IrfParams`], [`IrfSolver`]: checks and the report |
//! | `stream` | opens the blocks in order, and reads the next block ahead |
//! | `block_solve` | one block's least squares, by Cholesky or a rank-revealing factorisation (`triangle`) |
//! | `workers` | the residual, divided among threads |
//! | `accelerated` | conjugate gradients over pairs of passes |
//! | `plan` | the memory plan of a fit |
//! | `report` | reports on fits |

mod accelerated;
mod block_solve;
mod blocks;
mod params;
mod plan;
mod report;
mod solver;
mod stream;
mod triangle;
mod workers;

use ndarray::{Array2, s};

use crate::SolverError;
use crate::chunked_rows::ChunkedRows;
use block_solve::Step;
use report::{Recorder, timed};
use stream::{Order, Stream};
use workers::Workers;

pub use blocks::{Method, columns};
pub use params::IrfParams;
pub use plan::{IrfPlan, plan};
pub use report::{BlockReport, IrfReport, IrfSeconds, PassReport};
pub use solver::{IrfFit, IrfSolver, solve};

/// Refinement ends once a refinement changes the coefficients by less than this fraction of their norm.
const REFINED: f64 = 1e-14;

impl IrfSolver<'_> {
    /// Fits the coefficients `a` (K, c), zero on entry, to `r` (n, c), which contains the targets on entry and their
    /// residual on return.
    fn passes(&mut self, r: &mut ChunkedRows, a: &mut Array2<f64>, log: &mut Recorder<'_>) -> Result<(), SolverError> {
        let passes = self.params.method.passes();
        let mut last_change = f64::INFINITY;
        for number in 1..=passes + self.params.refinements {
            log.begin_pass(number.min(passes), number > passes);
            let pass = self.pass(Order::Forward, r, a, log)?;
            log.end_pass(r, pass.bytes_read);
            // Refinements end when rounding errors dominate. This is the case when a refinement changes the
            // coefficients by almost nothing, or by at least half as much as the previous pass. Rank-revealing solves
            // need no refinement, because the condition number of the Gram matrix doesn't affect them.
            let change = pass.relative_change(a);
            let refined = number > passes && (change < REFINED || change >= 0.5 * last_change);
            if refined || (number >= passes && self.block_solver.has_rank_revealing()) {
                break;
            }
            last_change = change;
        }
        Ok(())
    }

    /// Runs one pass over the blocks.
    fn pass(
        &mut self,
        order: Order,
        r: &mut ChunkedRows,
        a: &mut Array2<f64>,
        log: &mut Recorder<'_>,
    ) -> Result<PassSummary, SolverError> {
        let mut summary = PassSummary::new(r.channels());
        let mut stream = Stream::new(self.operator, &self.blocks, &self.plan, order);
        let mut r = Workers::new(self.operator, r, self.root_weights.as_deref(), self.params.threads);
        while let Some(block) = timed(&mut log.seconds.open, || stream.next())? {
            log.begin_block(&block.degrees)?;
            // x = argmin | W^(1/2) (A_d..e x - r) |
            let step = timed(&mut log.seconds.solve, || self.block_solver.solve(&block, &mut r, log.monitor))?;
            // a_d..e += x
            a.slice_mut(s![block.columns(), ..]).iter_mut().zip(&step.x).for_each(|(a, x)| *a += x);
            // r -= A_d..e x
            timed(&mut log.seconds.update, || r.subtract(&block, &step.x))?;
            log.end_block(block.columns().len());
            summary.add(&step, block.close()?);
        }
        Ok(summary)
    }
}

/// The effects of a pass on the coefficients and the residual, for each of c columns of targets.
struct PassSummary {
    /// Squared norms (c) of the coefficients' changes.
    change: Vec<f64>,
    /// Amounts (c) by which the pass decreases the residual's weighted squared norms.
    energy: Vec<f64>,
    /// Bytes read from the store.
    bytes_read: u64,
}

impl PassSummary {
    fn new(channels: usize) -> Self {
        Self { change: vec![0.0; channels], energy: vec![0.0; channels], bytes_read: 0 }
    }

    fn add(&mut self, step: &Step, bytes_read: u64) {
        for row in step.x.chunks_exact(self.change.len().max(1)) {
            self.change.iter_mut().zip(row).for_each(|(sum, x)| *sum += x * x);
        }
        self.energy.iter_mut().zip(&step.energy).for_each(|(sum, energy)| *sum += energy);
        self.bytes_read += bytes_read;
    }

    /// Returns the norm of the change divided by the norm of the coefficients: the maximum over all columns.
    fn relative_change(&self, a: &Array2<f64>) -> f64 {
        let norms = a.columns().into_iter().map(|column| column.iter().map(|a| a * a).sum::<f64>());
        let relative =
            self.change.iter().zip(norms).map(|(change, norm)| (change / norm.max(f64::MIN_POSITIVE)).sqrt());
        relative.fold(0.0, f64::max)
    }
}
