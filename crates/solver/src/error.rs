//! Errors of fits and factors.

#[cfg(feature = "dense")]
use spharm_store::StoreError;

/// Errors of this crate. A fit that doesn't converge isn't an error: its report states the reason.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SolverError {
    /// The basis could not be read.
    #[cfg(feature = "dense")]
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The harmonics could not be evaluated.
    #[error(transparent)]
    Harmonics(#[from] spharm_harmonics::HarmonicsError),
    /// The fast transforms could not be planned or computed.
    #[error(transparent)]
    Transform(#[from] spharm_transform::TransformError),
    /// The memory budget is too small for the fit.
    #[error("a memory budget of {} is too small; at least {} MiB are needed", size(*.budget), .needed.div_ceil(1 << 20))]
    Budget {
        /// The budget in bytes.
        budget: usize,
        /// The smallest sufficient budget in bytes.
        needed: usize,
        /// Largest granularity of iterative residual fitting with which the fit would stay within the budget, if any.
        granularity: Option<usize>,
    },
    /// Computing a factor would exceed a limit of this process, such as the limit on data.
    #[error("this process's limit on {what} is {} MiB, but {} MiB are needed; raise the limit or use fewer threads", .limit >> 20, .needed.div_ceil(1 << 20))]
    Limit {
        /// Name of the limit.
        what: &'static str,
        /// Bytes allowed by the limit.
        limit: u64,
        /// Bytes that the process would need with the factor.
        needed: u64,
    },
    /// A parameter is below its minimum, such as a granularity or a number of passes of zero.
    #[error("{what} must be at least {least}, found {found}")]
    TooSmall {
        /// Name of the parameter.
        what: &'static str,
        /// Minimum of the parameter.
        least: usize,
        /// Given value of the parameter.
        found: usize,
    },
    /// The first block of stepwise fitting would end above the highest degree of the fit.
    #[error("the start degree {found} exceeds the highest degree of the fit, {max_degree}")]
    StartDegree {
        /// Requested last degree of the first block.
        found: usize,
        /// Highest degree of the fit.
        max_degree: usize,
    },
    /// A degree is above the operator's highest degree.
    #[error("degree {found} is above {max_degree}, the highest degree of the basis")]
    Degree {
        /// Requested degree.
        found: usize,
        /// Highest degree of the basis.
        max_degree: usize,
    },
    /// A degree is above the highest degree of the moments.
    #[error(
        "degree {found} is above {max_degree}, the highest degree of the moments; lower the degree, or compute the \
         moments again to degree {found}"
    )]
    MomentsDegree {
        /// Requested degree.
        found: usize,
        /// Highest degree of the moments.
        max_degree: usize,
    },
    /// Rounding errors of the sums over the samples hide the residual, because the mean of a column is too large.
    #[error(
        "the mean of column {column} is so large that rounding errors of the moments hide the residual; subtract a \
         constant, such as the mean, from the values and compute the moments again"
    )]
    LostResidual {
        /// Column, counted from 0.
        column: usize,
    },
    /// An array's number of rows isn't the number of directions.
    #[error("{what} has {found} rows, but the sampling scheme has {expected} directions")]
    Rows {
        /// Name of the array.
        what: &'static str,
        /// Number of directions.
        expected: usize,
        /// Number of rows found.
        found: usize,
    },
    /// The number of penalties isn't the number of degrees.
    #[error("expected a penalty for each of {expected} degrees, found {found}")]
    Penalties {
        /// Number of degrees, L + 1.
        expected: usize,
        /// Number of penalties.
        found: usize,
    },
    /// The targets contain a NaN or an infinity.
    #[error("column {column} of the targets has a NaN or infinite value at row {row}")]
    NotFinite {
        /// Row, counted from 0.
        row: usize,
        /// Column, counted from 0.
        column: usize,
    },
    /// A batch has more columns than planned.
    #[error("the batch has {found} columns, but the plan allows {planned}")]
    Channels {
        /// Number of columns planned.
        planned: usize,
        /// Number of columns of the targets.
        found: usize,
    },
    /// A weight is negative or not finite, or all weights are zero.
    #[error("weights must be finite, not negative and not all zero; row {row} has {found}")]
    Weight {
        /// Row, counted from 0.
        row: usize,
        /// The row's weight.
        found: f64,
    },
    /// A block is numerically singular and too wide for a rank-revealing solve within the budget.
    #[error("the block of degrees {first} to {last} is numerically singular on this sampling; solving it safely needs {} MiB of memory", .needed.div_ceil(1 << 20))]
    Singular {
        /// First degree of the block.
        first: usize,
        /// Last degree of the block.
        last: usize,
        /// The smallest sufficient budget in bytes.
        needed: usize,
    },
    /// The smoothness is negative or not finite.
    #[error("the smoothness must be finite and not negative, found {found}")]
    Smoothness {
        /// Given smoothness.
        found: f64,
    },
    /// The penalty of a degree is negative or not finite.
    #[error("the penalty of degree {degree} must be finite and not negative, found {found}")]
    Penalty {
        /// Degree whose penalty is invalid.
        degree: usize,
        /// Given penalty.
        found: f64,
    },
    /// There are too few samples to estimate the noise in addition to the coefficients.
    #[error(
        "denoising needs more vertices than coefficients, but there are {rows} vertices and {columns} coefficients; \
         choose a lower degree"
    )]
    NoResidual {
        /// Number of vertices with nonzero weight.
        rows: usize,
        /// Number of coefficients per column of the targets, K.
        columns: usize,
    },
    /// A factor is needed, but neither a factor nor a Gram matrix to compute one is available.
    #[error("this method needs a Cholesky factor or a Gram matrix, but neither is available")]
    NoGram,
    /// The sums over the samples include no samples, or only samples of weight 0.
    #[error("no sample has a positive weight (the sums contain {count} samples of total weight {weight})")]
    NoSamples {
        /// Number of samples with nonzero weight.
        count: u64,
        /// Sum of the weights.
        weight: f64,
    },
    /// An array of the sums over the samples doesn't match the degree or the number of columns.
    #[error("the sums over the samples are inconsistent: expected {expected} rows in {what}, found {found}")]
    Sums {
        /// Name of the array.
        what: &'static str,
        /// Number of rows expected.
        expected: usize,
        /// Number of rows found.
        found: usize,
    },
    /// The sums over the samples contain a NaN or an infinity.
    #[error("the sums over the samples contain NaN or infinite values; check the samples' values and weights")]
    SumsNotFinite,
    /// Standard errors can't be computed, because the samples don't determine the coefficients.
    #[error(
        "{rows} vertices don't determine {columns} coefficients on this sampling; standard errors need a lower degree or a smoothness penalty"
    )]
    Underdetermined {
        /// Number of rows with nonzero weight.
        rows: usize,
        /// Number of coefficients, K.
        columns: usize,
    },
    /// Standard errors can't be computed, because the samples and the penalty together don't determine the
    /// coefficients.
    #[error(
        "{rows} vertices with this smoothness penalty don't determine {columns} coefficients numerically; standard errors need a {needed} smoothness penalty"
    )]
    UnderdeterminedWithPenalty {
        /// Number of rows with nonzero weight.
        rows: usize,
        /// Number of coefficients, K.
        columns: usize,
        /// Required change of the penalty: `smaller` if the penalty dominates the data of the vertices, otherwise
        /// `larger`.
        needed: &'static str,
    },
    /// The Gram matrix isn't numerically positive definite, so it has no Cholesky factor.
    #[error(
        "the Gram matrix is not numerically positive definite: its factorisation breaks down at column {column} (degree {degree}). The sampling does not determine all coefficients of this and higher degrees; choose a lower degree or add a smoothness penalty"
    )]
    NotPositiveDefinite {
        /// Column, counted from 0.
        column: usize,
        /// Degree of the column.
        degree: usize,
    },
    /// The singular value decomposition of a block did not converge.
    #[error("degrees {first} to {last}: the singular value decomposition of their block did not converge")]
    NoConvergence {
        /// First degree of the block.
        first: usize,
        /// Last degree of the block.
        last: usize,
    },
    /// The monitor cancelled the computation.
    #[error(transparent)]
    Interrupted(#[from] spharm_monitor::Interrupted),
}

/// Formats a memory budget in MiB. A budget below 1 MiB is shown in bytes, because the user has probably forgotten the
/// unit.
fn size(bytes: usize) -> String {
    if bytes < 1 << 20 { format!("{bytes} bytes") } else { format!("{} MiB", bytes >> 20) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A required size is rounded up to MiB, so that the stated budget suffices. A budget below 1 MiB is shown in
    /// bytes.
    #[test]
    fn sizes_are_those_that_work() {
        let budget = |budget, needed| SolverError::Budget { budget, needed, granularity: None }.to_string();
        assert!(budget(512, 1).contains("a memory budget of 512 bytes is too small"));
        assert!(budget((1 << 20) - 1, 1).contains("budget of 1048575 bytes"));
        assert!(budget(1 << 20, 1).contains("budget of 1 MiB"));
        assert!(budget(3 << 20, (5 << 20) + 1).ends_with("at least 6 MiB are needed"));
        assert!(budget(3 << 20, 5 << 20).ends_with("at least 5 MiB are needed"));
    }
}
