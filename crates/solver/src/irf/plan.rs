//! Plans the memory of a fit before the fit starts.

use std::ops::RangeInclusive;

use serde::Serialize;
use spharm_harmonics::basis_size;

use super::blocks::{Method, columns};
use super::params::IrfParams;
use crate::SolverError;
use crate::operator::{BlockOperator, Residency};
use crate::threaded::{Kernels, ThreadedKernels};

/// Smallest number of columns of a block for which all threads compute one shared Gram matrix by a threaded `dsyrk`.
/// For narrower blocks, each thread sums a Gram matrix of its own.
pub(super) const SHARED_FROM: usize = 1024;
/// Number of rows that one call of the shared `dsyrk` adds to the Gram matrix: enough for the memory traffic on that
/// matrix to be negligible.
pub(super) const SHARED_ROWS: usize = 2048;

/// Bytes per thread for the packed copies of matrices made by products with narrow blocks.
const PACKED: usize = 4 << 20;
/// Bytes of workspace per thread for computing a Gram matrix from moments.
const GRAM_WORK: usize = 1 << 20;

/// The memory plan of a fit. All sizes are in bytes.
#[derive(Debug, Clone, Serialize)]
pub struct IrfPlan {
    /// Bytes already held by the caller: program, surfaces, directions.
    pub held: usize,
    /// Bytes of the residual and the coefficients.
    pub arrays: usize,
    /// Bytes that all threads need for sums, packed chunks, and buffers of matrix products.
    pub work: usize,
    /// Bytes of the source of the blocks' Gram matrices; zero if Gram matrices are summed from the basis.
    pub grams: usize,
    /// Bytes of the factors kept between passes, or of the one factor in use.
    pub factors: usize,
    /// Bytes of the part of the basis that is in memory at a time: mapped windows, or decoded chunks.
    pub basis: usize,
    /// Total bytes: the sum of the fields above.
    pub total: usize,
    /// Memory budget in bytes.
    pub budget: usize,
    /// Bytes of address space that [`Kernels`] reserve in addition to `total`; they count towards the process's limit
    /// on data.
    pub reserved: usize,
    /// Whether to keep factors from the first pass on.
    pub keep_factors: bool,
    /// Whether to read the next block while one is being solved.
    pub read_ahead: bool,
    /// For each block, whether the entire block is in memory. Such a block is read once per pass, any other block
    /// twice.
    #[serde(skip)]
    pub whole: Vec<bool>,
}

impl IrfPlan {
    pub(super) fn residency(&self, block: usize) -> Residency {
        if self.whole[block] { Residency::Whole } else { Residency::Chunks }
    }

    /// Returns the unused bytes of the budget.
    pub(super) fn spare(&self) -> usize {
        self.budget - self.total
    }
}

/// Returns the fastest plan within the budget for a fit of `channels` columns.
///
/// # Errors
///
/// [`SolverError::Budget`] if no plan stays within the budget, and the errors of [`Method::blocks`].
pub fn plan(operator: &dyn BlockOperator, channels: usize, params: &IrfParams) -> Result<IrfPlan, SolverError> {
    let blocks = params.method.blocks(params.max_degree)?;
    let needs = Needs::of(operator, channels, params, &blocks);
    if needs.least() > params.memory {
        let granularity = match params.method {
            Method::Irf { .. } | Method::Nlsf => fitting_granularity(operator, channels, params),
            Method::Sirf { .. } | Method::Mirf { .. } => None,
        };
        return Err(SolverError::Budget { budget: params.memory, needed: needs.least(), granularity });
    }
    let sweeps = params.method.passes() + params.refinements;
    let keep_factors =
        (sweeps > 1 || params.reuse) && needs.least() - needs.one_factor + needs.all_factors <= params.memory;
    let factors = if keep_factors { needs.all_factors } else { needs.one_factor };
    let spare = params.memory - needs.fixed - factors;
    let whole: Vec<bool> = needs.resident.iter().map(|&bytes| bytes <= spare).collect();
    let pairs = (0..blocks.len()).map(|b| needs.resident[b] + needs.resident[(b + 1) % blocks.len()]);
    let widest_pair = if blocks.len() == 1 { needs.resident[0] } else { pairs.max().unwrap_or(0) };
    let read_ahead = widest_pair <= spare;
    let in_use = whole.iter().zip(&needs.resident).zip(&needs.chunkwise);
    let basis = match read_ahead {
        true => widest_pair,
        false => in_use.map(|((&whole, &resident), &chunks)| if whole { resident } else { chunks }).max().unwrap_or(0),
    };
    Ok(IrfPlan {
        held: params.held,
        arrays: needs.arrays,
        work: needs.fixed - needs.arrays - needs.grams - params.held,
        grams: needs.grams,
        factors,
        basis,
        total: needs.fixed + factors + basis,
        budget: params.memory,
        reserved: needs.reserved,
        keep_factors,
        read_ahead,
        whole,
    })
}

struct Needs {
    arrays: usize,
    grams: usize,
    /// Bytes of memory for everything except the factors and the basis.
    fixed: usize,
    /// Bytes of address space reserved by [`Kernels`]; 0 if all blocks are too narrow for these kernels.
    reserved: usize,
    one_factor: usize,
    all_factors: usize,
    /// Bytes of each block if the entire block is held in memory.
    resident: Vec<usize>,
    /// Bytes of each block if it is read chunk by chunk.
    chunkwise: Vec<usize>,
}

impl Needs {
    fn of(operator: &dyn BlockOperator, channels: usize, params: &IrfParams, blocks: &[RangeInclusive<usize>]) -> Self {
        let (n, threads, chunk_rows) = (operator.rows(), crate::threads(params.threads), operator.chunk_rows());
        let widest = blocks.iter().map(columns).max().unwrap_or(0);
        let shared = widest >= SHARED_FROM;
        // Each thread has its own sums for blocks that are too narrow for a shared Gram matrix.
        let narrow = blocks.iter().map(columns).filter(|&k| k < SHARED_FROM).max().unwrap_or(0);
        let weighted = params.weights.is_some();
        // Arrays of the fit: residual, coefficients, a block's right-hand sides and solution with the transposes of
        // both, and the roots of the weights.
        let size = basis_size(params.max_degree);
        // Accelerated fits also need the vectors s and q (n, channels), and z and p (K, channels): see `accelerated`.
        let more = if params.accelerate { 2 * (n + size) * channels } else { 0 };
        let arrays = 8 * (n * channels + (size + 4 * widest) * channels + if weighted { n } else { 0 } + more);
        // If a source provides the Gram matrices, threads don't sum Gram matrices and don't pack chunks for these sums.
        // But each thread then needs workspace for computing a Gram matrix.
        let from_basis = params.gram_bytes.is_none();
        let grams = params.gram_bytes.map_or(0, |bytes| bytes + threads * GRAM_WORK);
        let per_thread = 8
            * (if from_basis { narrow * narrow + chunk_rows * narrow } else { 0 }
                + widest * channels
                + if weighted { chunk_rows * channels } else { 0 });
        // Bytes of the stacked chunks from which all threads together compute a Gram matrix, and of the next chunk to
        // be stacked.
        let stacked = if shared && from_basis { 8 * widest * (SHARED_ROWS.max(chunk_rows) + chunk_rows) } else { 0 };
        let products = threads * if shared { Kernels::TOUCHED_PER_THREAD } else { PACKED };
        let singular = if widest > n { rank_revealing_bytes(widest, channels, chunk_rows, threads, n) } else { 0 };
        let factor = |degrees: &RangeInclusive<usize>| 8 * columns(degrees) * columns(degrees).min(n);
        let resident = |degrees| operator.resident_bytes(degrees, Residency::Whole, threads);
        let chunkwise = |degrees| operator.resident_bytes(degrees, Residency::Chunks, threads);
        Self {
            arrays,
            grams,
            fixed: params.held + arrays + grams + threads * per_thread + stacked + products + singular,
            reserved: if shared { threads * Kernels::RESERVED_PER_THREAD } else { 0 },
            one_factor: 8 * widest * widest.min(n),
            // With several blocks, one more matrix is needed for the factor being computed, because the factors of the
            // other blocks are in memory. The factor of a single block is computed in place.
            all_factors: blocks.iter().map(factor).sum::<usize>()
                + if blocks.len() > 1 { 8 * widest * widest.min(n) } else { 0 },
            resident: blocks.iter().map(resident).collect(),
            chunkwise: blocks.iter().map(chunkwise).collect(),
        }
    }

    fn least(&self) -> usize {
        let pairs = self.resident.iter().zip(&self.chunkwise);
        self.fixed + self.one_factor + pairs.map(|(&whole, &chunks)| whole.min(chunks)).max().unwrap_or(0)
    }
}

/// Returns the largest power of two that, used as the granularity, keeps the fit within the memory budget.
fn fitting_granularity(operator: &dyn BlockOperator, channels: usize, params: &IrfParams) -> Option<usize> {
    let passes = params.method.passes();
    let largest = basis_size(params.max_degree).next_power_of_two();
    std::iter::successors(Some(largest), |&g| (g > 1).then_some(g / 2)).find(|&granularity| {
        let method = Method::Irf { passes, granularity };
        let blocks = method.blocks(params.max_degree).unwrap_or_default();
        Needs::of(operator, channels, &IrfParams { method, ..params.clone() }, &blocks).least() <= params.memory
    })
}

/// Returns the additional bytes for a rank-revealing solve. This is the memory in which all threads fold rows into
/// their triangular factors, or the memory for the singular value decomposition if that is larger.
pub(super) fn rank_revealing_bytes(k: usize, channels: usize, chunk_rows: usize, threads: usize, rows: usize) -> usize {
    let width = k + channels;
    let height = width.min(rows);
    // Folding rows into a triangular factor R needs memory for R, the rows to fold, the stack of both, and the new R.
    let fold = width * (5 * height + 4 * chunk_rows) * 8;
    let decomposition = 8 * height * (6 * k + 2 * height);
    (threads * fold).max(decomposition + width * height * 8)
}
