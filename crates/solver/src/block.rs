//! One block's least squares: the Gram matrix and Cholesky where that is safe, a rank-revealing factor otherwise.

use std::ops::RangeInclusive;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::SolverError;
use crate::dense;
use crate::grams::BlockGrams;
use crate::operator::{Block, BlockOperator, Scratch};
use crate::schedule::columns;
use crate::workers::{Worker, normal_equations, pack, triangular};

/// Below this reciprocal condition number of a Gram matrix (1e6 for the block itself) the normal equations are not
/// used: a Cholesky solve of them then loses more than four digits of a pass.
const SAFE_RECIPROCAL: f64 = 1e-12;

/// From this many columns on, threads share one Gram matrix and a threaded `dsyrk` instead of summing one each.
pub(crate) const SHARED_FROM: usize = 1024;
/// Rows of a shared `dsyrk`: enough for its traffic on the Gram matrix not to matter.
pub(crate) const SHARED_ROWS: usize = 2048;

/// What is known of a block's matrix once it has been solved.
#[derive(Debug, Clone)]
pub(crate) enum Factor {
    /// Upper Cholesky factor of the Gram matrix, (k, k), and the reciprocal condition number of that matrix: serves any
    /// right-hand side.
    Cholesky(Vec<f64>, f64),
    /// The Gram matrix is of no use; the block is to be factorised anew each time.
    RankRevealing {
        /// Condition number of the block; infinite when its rank is less than its columns.
        condition: f64,
        /// Numerical rank.
        rank: usize,
    },
}

impl Factor {
    /// Estimated condition number of the block.
    pub(crate) fn condition(&self) -> f64 {
        match self {
            Self::Cholesky(_, reciprocal) => (1.0 / reciprocal).sqrt(),
            Self::RankRevealing { condition, .. } => *condition,
        }
    }

    pub(crate) fn rank(&self, columns: usize) -> usize {
        match self {
            Self::Cholesky(..) => columns,
            Self::RankRevealing { rank, .. } => *rank,
        }
    }

    pub(crate) fn name(&self) -> &'static str {
        match self {
            Self::Cholesky(..) => "cholesky",
            Self::RankRevealing { .. } => "rank-revealing",
        }
    }
}

/// What stays the same from block to block.
pub(crate) struct Context<'a> {
    pub(crate) operator: &'a dyn BlockOperator,
    /// Square roots of the weights, (n), when there are weights.
    pub(crate) roots: Option<&'a [f64]>,
    /// Where Gram matrices come from, when it isn't the basis.
    pub(crate) grams: Option<&'a dyn BlockGrams>,
    pub(crate) channels: usize,
    pub(crate) threads: usize,
    /// Bytes of the budget that the plan has left over, for a rank-revealing solve that it couldn't foresee.
    pub(crate) spare: usize,
    pub(crate) budget: usize,
    /// Set when the fit is to stop; looked at between the chunks of a wide block, which may take minutes.
    pub(crate) cancel: &'a AtomicBool,
}

/// Bytes that a rank-revealing solve takes beside the rest: each thread's triangle twice while it is folded, a chunk,
/// and the singular value decomposition.
pub(crate) fn rank_revealing_bytes(k: usize, channels: usize, chunk_rows: usize, threads: usize, rows: usize) -> usize {
    let width = k + channels;
    let height = width.min(rows);
    // R, the rows that wait, both stacked, and R again as it comes out.
    let fold = width * (5 * height + 4 * chunk_rows) * 8;
    let decomposition = 8 * height * (6 * k + 2 * height);
    (threads * fold).max(decomposition + width * height * 8)
}

/// What came out for a block.
pub(crate) struct Solved {
    /// The solution, (k, c) row-major.
    pub(crate) x: Vec<f64>,
    /// The factor, where one was made.
    pub(crate) factor: Option<Factor>,
    /// By how much the step shortens each column of the residual, `|W^(1/2) A x|^2 = x^T A^T W r`, (c). Formed from the
    /// right-hand side, for the difference of the squared norms has lost these digits near the optimum.
    pub(crate) energy: Vec<f64>,
}

/// Solves a block for the residual that the workers hold.
///
/// Without a factor one is made and returned along; with one only `A^T W r` is computed.
pub(crate) fn solve(
    context: &Context<'_>,
    block: &dyn Block,
    degrees: &RangeInclusive<usize>,
    workers: &mut [Worker<'_>],
    factor: Option<&Factor>,
) -> Result<Solved, SolverError> {
    let (k, channels) = (columns(degrees), context.channels);
    if let Some(Factor::Cholesky(factor, _)) = factor {
        let (right_hand_sides, _) = normal_equations(block, workers, k, false)?;
        return Ok(by_cholesky(factor, k, right_hand_sides, channels));
    }
    let (rows, threads) = (context.operator.rows(), context.threads);
    // A block that was singular once is so again; its spectrum is not reused, since that would square its condition.
    if k <= rows && factor.is_none() {
        let shared = k >= SHARED_FROM;
        let (right_hand_sides, gram) = normal_equations(block, workers, k, !shared && context.grams.is_none())?;
        let mut gram = match (gram, context.grams) {
            (Some(gram), _) => gram,
            (None, Some(grams)) => {
                let mut gram = vec![0.0; k * k];
                grams.block(degrees.clone(), &mut gram);
                gram
            }
            (None, None) => shared_gram(context, block, k)?,
        };
        dense::set_blas_threads(if shared { threads } else { 1 });
        let reciprocal = dense::cholesky(&mut gram, k);
        dense::set_blas_threads(1);
        if let Some(reciprocal) = reciprocal.filter(|&reciprocal| reciprocal > SAFE_RECIPROCAL) {
            let solved = by_cholesky(&gram, k, right_hand_sides, channels);
            return Ok(Solved { factor: Some(Factor::Cholesky(gram, reciprocal)), ..solved });
        }
        let needed = rank_revealing_bytes(k, context.channels, context.operator.chunk_rows(), threads, rows);
        if needed > context.spare {
            let needed = context.budget + needed - context.spare;
            return Err(SolverError::Singular { first: *degrees.start(), last: *degrees.end(), needed });
        }
    }
    let (r, z, m) = triangular(block, workers, k)?.split(k);
    let right_hand_sides = transposed_product(&r, &z, m);
    let tolerance = f64::EPSILON * rows.max(k) as f64;
    dense::set_blas_threads(if k >= SHARED_FROM { threads } else { 1 });
    let solved = dense::minimum_norm(r, z, m, tolerance);
    dense::set_blas_threads(1);
    let (x, rank, condition) = solved.map_err(|error| SolverError::NoConvergence {
        first: *degrees.start(),
        last: *degrees.end(),
        message: error.to_string(),
    })?;
    let condition = if rank < k { f64::INFINITY } else { condition };
    let energy = inner_products(&x, &right_hand_sides, channels);
    Ok(Solved { x, factor: Some(Factor::RankRevealing { condition, rank }), energy })
}

fn by_cholesky(factor: &[f64], k: usize, right_hand_sides: Vec<f64>, channels: usize) -> Solved {
    let mut x = right_hand_sides.clone();
    dense::cholesky_solve(factor, k, &mut x);
    let energy = inner_products(&x, &right_hand_sides, channels);
    Solved { x, factor: None, energy }
}

/// Column by column, of two (k, c) row-major.
fn inner_products(a: &[f64], b: &[f64], channels: usize) -> Vec<f64> {
    let mut sums = vec![0.0; channels];
    for (a, b) in a.chunks_exact(channels.max(1)).zip(b.chunks_exact(channels.max(1))) {
        sums.iter_mut().zip(a).zip(b).for_each(|((sum, a), b)| *sum += a * b);
    }
    sums
}

/// `R^T z`, (k, c) row-major, for R (m, k) and z (m, c) column-major: the right-hand sides of the normal equations.
fn transposed_product(r: &[f64], z: &[f64], m: usize) -> Vec<f64> {
    let rows = r.chunks_exact(m).flat_map(|r| z.chunks_exact(m).map(move |z| (r, z)));
    rows.map(|(r, z)| r.iter().zip(z).map(|(r, z)| r * z).sum()).collect()
}

/// The Gram matrix of a wide block: a few chunks at a time side by side, one threaded `dsyrk` for each.
fn shared_gram(context: &Context<'_>, block: &dyn Block, k: usize) -> Result<Vec<f64>, SolverError> {
    let &Context { operator, roots, threads, cancel, .. } = context;
    let mut gram = vec![0.0; k * k];
    let together = (SHARED_ROWS / operator.chunk_rows()).max(1);
    let (mut chunk_values, mut scratch) = (Vec::new(), Scratch::default());
    let mut stacked = Vec::new();
    dense::set_blas_threads(threads);
    for first in (0..operator.chunk_count()).step_by(together) {
        if cancel.load(Ordering::Relaxed) {
            dense::set_blas_threads(1);
            return Err(SolverError::Interrupted);
        }
        let last = (first + together).min(operator.chunk_count());
        let rows: usize = (first..last).map(|chunk| operator.chunk_range(chunk).len()).sum();
        stacked.clear();
        stacked.resize(rows * k, 0.0);
        let mut at = 0;
        for chunk in first..last {
            let range = operator.chunk_range(chunk);
            let root = roots.map(|roots| &roots[range.clone()]);
            block.chunk(chunk, &mut scratch, &mut |parts| {
                let packed = pack(parts, root, &mut chunk_values);
                for j in 0..k {
                    stacked[j * rows + at..][..range.len()].copy_from_slice(packed.column(j));
                }
            })?;
            at += range.len();
        }
        dense::accumulate_gram(spharm_harmonics::product::Matrix::new(&stacked, rows, k, rows), &mut gram, k);
    }
    dense::set_blas_threads(1);
    Ok(gram)
}
