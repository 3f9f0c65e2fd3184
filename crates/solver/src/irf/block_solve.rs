//! Solves the least-squares problem of one block (the basis functions of consecutive degrees): by a Cholesky factor of
//! the block's Gram matrix if that is accurate enough, otherwise by a rank-revealing factorisation.

use spharm_harmonics::product::Matrix;
use spharm_monitor::Monitor;

use super::blocks::columns;
use super::plan::{IrfPlan, SHARED_FROM, SHARED_ROWS, rank_revealing_bytes};
use super::report::BlockReport;
use super::stream::OpenBlock;
use super::workers::{Workers, pack};
use crate::SolverError;
use crate::dense::{self, MinimumNorm};
use crate::gram::GramMatrix;
use crate::operator::{BlockOperator, Scratch};
use crate::threaded::{Kernels, ThreadedKernels};

/// The normal equations of a block are used if the reciprocal condition number of its Gram matrix exceeds this value.
/// The condition number of the block itself is then at most 1e6. Beyond 1e6, the relative error of a Cholesky solve
/// could exceed 1e-4.
const SAFE_RECIPROCAL: f64 = 1e-12;

/// The solution for one block.
pub(super) struct Step {
    /// The change (k, c) of the block's coefficients, row-major.
    pub(super) x: Vec<f64>,
    /// Decrease (c) of the squared norm of each column of the residual, `|W^(1/2) A x|^2 = x^T A^T W r`. It is computed
    /// from the right-hand side, because the difference of the squared norms would lose all digits near the optimum.
    pub(super) energy: Vec<f64>,
}

/// Factorisation of a block, known after the block's first solve.
#[derive(Debug, Clone)]
enum BlockFactor {
    /// Lower Cholesky factor (k, k) of the Gram matrix, used for all right-hand sides, and the Gram matrix's reciprocal
    /// condition number.
    Cholesky(Vec<f64>, f64),
    /// The Gram matrix is too ill-conditioned for a Cholesky solve; the block is factorised again in each pass.
    RankRevealing {
        /// Condition number of the block; infinite if its rank is below its number of columns.
        condition: f64,
        /// Numerical rank of the block.
        rank: usize,
    },
}

/// Solves blocks, and keeps their factors from pass to pass.
pub(super) struct BlockSolver<'o> {
    operator: &'o dyn BlockOperator,
    /// Source of the blocks' Gram matrices; `None` if Gram matrices are summed over the rows of the basis.
    gram: Option<&'o dyn GramMatrix>,
    threads: usize,
    /// Whether to keep factors between passes.
    keep: bool,
    /// Factorisations, indexed by block.
    factors: Vec<Option<BlockFactor>>,
    reports: Vec<BlockReport>,
    /// Bytes of the memory budget that the plan leaves unused. They are available to rank-revealing solves, which the
    /// plan can't foresee.
    spare: usize,
    budget: usize,
}

impl<'o> BlockSolver<'o> {
    pub(super) fn new(
        operator: &'o dyn BlockOperator,
        gram: Option<&'o dyn GramMatrix>,
        blocks: usize,
        threads: usize,
        plan: &IrfPlan,
    ) -> Self {
        Self {
            operator,
            gram,
            threads,
            keep: plan.keep_factors,
            factors: vec![None; blocks],
            reports: Vec::new(),
            spare: plan.spare(),
            budget: plan.budget,
        }
    }

    /// Returns the reports on the blocks solved so far, in order.
    pub(super) fn reports(&self) -> &[BlockReport] {
        &self.reports
    }

    /// Returns whether any block was too ill-conditioned for a Cholesky solve.
    pub(super) fn has_rank_revealing(&self) -> bool {
        self.reports.iter().any(|block| block.solver != "cholesky")
    }

    /// Computes the block's solution `argmin_x | W^(1/2) (A_d..e x - r) |`, where A_d..e holds the block's columns and
    /// r is the residual held by the workers.
    pub(super) fn solve(
        &mut self,
        block: &OpenBlock<'_>,
        residual: &mut Workers<'_>,
        monitor: &dyn Monitor,
    ) -> Result<Step, SolverError> {
        // If the basis file was truncated in the meantime, the block appears singular; the check then reports the
        // actual error.
        self.step(block, residual, monitor).or_else(|error| block.data.check().and(Err(error)))
    }

    fn step(
        &mut self,
        block: &OpenBlock<'_>,
        residual: &mut Workers<'_>,
        monitor: &dyn Monitor,
    ) -> Result<Step, SolverError> {
        let k = columns(&block.degrees);
        let known = self.factors[block.index].as_ref();
        if let Some(BlockFactor::Cholesky(factor, _)) = known {
            return Ok(by_cholesky(factor, k, residual.right_hand_sides(block, k)?, residual.channels()));
        }
        // A block that was singular in an earlier pass is singular again. Its singular values aren't reused, because a
        // solve with them would start from `A^T W r`, which squares the condition number.
        if k <= self.operator.rows() && known.is_none() {
            let (right_hand_sides, mut gram) = self.normal_equations(block, residual, k, monitor)?;
            if let Some(reciprocal) = self.factorise(&mut gram, k) {
                let step = by_cholesky(&gram, k, right_hand_sides, residual.channels());
                self.remember(block, BlockFactor::Cholesky(gram, reciprocal));
                return Ok(step);
            }
            self.check_room_for_rank_revealing(block, k, residual.channels())?;
        }
        let (step, factor) = self.rank_revealing(block, residual, k)?;
        self.remember(block, factor);
        Ok(step)
    }

    /// Computes the normal equations of a block with the basis columns A: `A^T W r` (k, c), row-major, and the lower
    /// triangle of `A^T W A` (k, k).
    fn normal_equations(
        &self,
        block: &OpenBlock<'_>,
        residual: &mut Workers<'_>,
        k: usize,
        monitor: &dyn Monitor,
    ) -> Result<(Vec<f64>, Vec<f64>), SolverError> {
        if let Some(source) = self.gram {
            let right_hand_sides = residual.right_hand_sides(block, k)?;
            let mut gram = vec![0.0; k * k];
            source.tile(block.columns(), block.columns(), &mut gram, k)?;
            Ok((right_hand_sides, gram))
        } else if k >= SHARED_FROM {
            let right_hand_sides = residual.right_hand_sides(block, k)?;
            Ok((right_hand_sides, self.shared_gram(block, residual, k, monitor)?))
        } else {
            residual.normal_equations(block, k)
        }
    }

    /// Computes the Gram matrix of a wide block: a few chunks at a time are stacked for one threaded `dsyrk`.
    fn shared_gram(
        &self,
        block: &OpenBlock<'_>,
        residual: &Workers<'_>,
        k: usize,
        monitor: &dyn Monitor,
    ) -> Result<Vec<f64>, SolverError> {
        let operator = self.operator;
        let mut gram = vec![0.0; k * k];
        let together = (SHARED_ROWS / operator.chunk_rows()).max(1);
        let (mut chunk_values, mut scratch) = (Vec::new(), Scratch::default());
        let mut stacked = Vec::new();
        for first in (0..operator.chunk_count()).step_by(together) {
            // A wide block may take minutes, so check for cancellation here.
            monitor.check()?;
            let last = (first + together).min(operator.chunk_count());
            let rows: usize = (first..last).map(|chunk| operator.chunk_range(chunk).len()).sum();
            stacked.clear();
            stacked.resize(rows * k, 0.0);
            let mut at = 0;
            for chunk in first..last {
                let range = operator.chunk_range(chunk);
                let root_weights = residual.root_weights().map(|roots| &roots[range.clone()]);
                block.data.chunk(chunk, &mut scratch, &mut |parts| {
                    let packed = pack(parts, root_weights, &mut chunk_values);
                    for j in 0..k {
                        stacked[j * rows + at..][..range.len()].copy_from_slice(packed.column(j));
                    }
                })?;
                at += range.len();
            }
            let stacked = Matrix::new(&stacked, rows, k, rows);
            Kernels::with_threads(self.threads).accumulate_gram(stacked, &mut gram, k);
        }
        Ok(gram)
    }

    /// Computes the lower Cholesky factor of a Gram matrix (k, k), in place. Returns an estimate of the Gram matrix's
    /// reciprocal condition number, or `None` if the Gram matrix is too ill-conditioned.
    fn factorise(&self, gram: &mut [f64], k: usize) -> Option<f64> {
        let norm = dense::symmetric_norm(gram, k);
        let positive = if k >= SHARED_FROM {
            Kernels::with_threads(self.threads).cholesky(gram, k, k).is_ok()
        } else {
            dense::cholesky(gram, k)
        };
        let reciprocal = if positive { dense::reciprocal_condition(norm, gram, k) } else { 0.0 };
        (reciprocal > SAFE_RECIPROCAL).then_some(reciprocal)
    }

    fn check_room_for_rank_revealing(
        &self,
        block: &OpenBlock<'_>,
        k: usize,
        channels: usize,
    ) -> Result<(), SolverError> {
        let (rows, chunk_rows) = (self.operator.rows(), self.operator.chunk_rows());
        let needed = rank_revealing_bytes(k, channels, chunk_rows, self.threads, rows);
        if needed > self.spare {
            let needed = self.budget + needed - self.spare;
            return Err(SolverError::Singular { first: *block.degrees.start(), last: *block.degrees.end(), needed });
        }
        Ok(())
    }

    /// Computes the minimum-norm solution for a block, by a QR factorisation and the singular value decomposition of
    /// the triangular factor.
    fn rank_revealing(
        &self,
        block: &OpenBlock<'_>,
        residual: &mut Workers<'_>,
        k: usize,
    ) -> Result<(Step, BlockFactor), SolverError> {
        let (r, z, m) = residual.triangle(block, k)?.split(k);
        let right_hand_sides = transposed_product(&r, &z, m);
        let tolerance = f64::EPSILON * self.operator.rows().max(k) as f64;
        let MinimumNorm { x, rank, condition } = dense::minimum_norm(&r, &z, m, tolerance)
            .map_err(|_| SolverError::NoConvergence { first: *block.degrees.start(), last: *block.degrees.end() })?;
        let condition = if rank < k { f64::INFINITY } else { condition };
        let energy = inner_products(&x, &right_hand_sides, residual.channels());
        Ok((Step { x, energy }, BlockFactor::RankRevealing { condition, rank }))
    }

    /// Adds a report on a block when it is solved for the first time, and keeps its factor if the plan has memory for
    /// it.
    fn remember(&mut self, block: &OpenBlock<'_>, factor: BlockFactor) {
        if self.reports.len() == block.index {
            let columns = columns(&block.degrees);
            let (solver, rank, condition) = match factor {
                BlockFactor::Cholesky(_, reciprocal) => ("cholesky", columns, (1.0 / reciprocal).sqrt()),
                BlockFactor::RankRevealing { condition, rank } => ("rank-revealing", rank, condition),
            };
            let (first_degree, last_degree) = (*block.degrees.start(), *block.degrees.end());
            self.reports.push(BlockReport { first_degree, last_degree, columns, solver, rank, condition });
        }
        if self.keep {
            self.factors[block.index] = Some(factor);
        }
    }
}

fn by_cholesky(factor: &[f64], k: usize, right_hand_sides: Vec<f64>, channels: usize) -> Step {
    let mut x = right_hand_sides.clone();
    dense::cholesky_solve(factor, k, &mut x);
    let energy = inner_products(&x, &right_hand_sides, channels);
    Step { x, energy }
}

/// Returns the inner products of corresponding columns of two row-major arrays (k, c).
fn inner_products(a: &[f64], b: &[f64], channels: usize) -> Vec<f64> {
    let mut sums = vec![0.0; channels];
    for (a, b) in a.chunks_exact(channels.max(1)).zip(b.chunks_exact(channels.max(1))) {
        sums.iter_mut().zip(a).zip(b).for_each(|((sum, a), b)| *sum += a * b);
    }
    sums
}

/// Computes `R^T z` (k, c), row-major, from R (m, k) and z (m, c), both column-major. These are the right-hand sides of
/// the normal equations.
fn transposed_product(r: &[f64], z: &[f64], m: usize) -> Vec<f64> {
    let rows = r.chunks_exact(m).flat_map(|r| z.chunks_exact(m).map(move |z| (r, z)));
    rows.map(|(r, z)| r.iter().zip(z).map(|(r, z)| r * z).sum()).collect()
}
