//! The errors of fits and factors.

#[cfg(feature = "dense")]
use spharm_store::StoreError;

/// Errors of this crate. Not converging is no error: it shows in the report.
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
    /// The fast transforms could not be made.
    #[error(transparent)]
    Transform(#[from] spharm_transform::TransformError),
    /// A memory budget below the least that the fit needs.
    #[error("a memory budget of {} is too small for this fit; the smallest that works is {} MiB", size(*.budget), .needed.div_ceil(1 << 20))]
    Budget {
        /// The budget, bytes.
        budget: usize,
        /// The least that works, bytes.
        needed: usize,
        /// The largest granularity that fits the budget, if there is one.
        granularity: Option<usize>,
    },
    /// A limit on the process that a factor would exceed.
    #[error("this process's limit on {what} is {} MiB, but {} MiB are needed; raise the limit or use fewer threads", .limit >> 20, .needed.div_ceil(1 << 20))]
    Limit {
        /// Which limit.
        what: &'static str,
        /// Bytes allowed.
        limit: u64,
        /// Bytes needed.
        needed: u64,
    },
    /// A granularity or number of passes of zero, or the like.
    #[error("{what} must be at least {least}, found {found}")]
    TooSmall {
        /// The parameter.
        what: &'static str,
        /// Its least value.
        least: usize,
        /// The value given.
        found: usize,
    },
    /// A first block that reaches above the highest degree.
    #[error("the first block ends at degree {found}, above the highest degree {max_degree}")]
    StartDegree {
        /// Degree given.
        found: usize,
        /// Highest degree of the fit.
        max_degree: usize,
    },
    /// A degree above the operator's highest.
    #[error("degree {found} is above {max_degree}, the highest degree of the basis")]
    Degree {
        /// Degree given.
        found: usize,
        /// Highest degree of the basis.
        max_degree: usize,
    },
    /// Arrays whose numbers of rows differ.
    #[error("{what} has {found} rows, the sampling scheme has {expected} directions")]
    Rows {
        /// Which array.
        what: &'static str,
        /// Directions.
        expected: usize,
        /// Rows found.
        found: usize,
    },
    /// Targets with a NaN or an infinity.
    #[error("column {column} of the targets has a NaN or infinite value at row {row}")]
    NotFinite {
        /// Row from 0.
        row: usize,
        /// Column from 0.
        column: usize,
    },
    /// A batch wider than the fit was planned for.
    #[error("the batch has {found} columns, but the plan allows {planned}")]
    Channels {
        /// Columns planned.
        planned: usize,
        /// Columns of the targets.
        found: usize,
    },
    /// Weights that are negative, not finite or all zero.
    #[error("weights must be finite, not negative and not all zero; row {row} has {found}")]
    Weight {
        /// Row from 0.
        row: usize,
        /// The weight.
        found: f64,
    },
    /// A block that is numerically singular and too wide for the budget to be solved the safe way.
    #[error("degrees {first} to {last} together are numerically singular on this sampling, and solving them safely needs {} MiB of memory", .needed.div_ceil(1 << 20))]
    Singular {
        /// First degree of the block.
        first: usize,
        /// Last degree of the block.
        last: usize,
        /// The least budget, bytes.
        needed: usize,
    },
    /// A smoothness that isn't a finite number from zero on.
    #[error("the smoothness must be finite and not negative, found {found}")]
    Smoothness {
        /// The value given.
        found: f64,
    },
    /// A penalty of a degree that isn't a finite number from zero on.
    #[error("the penalty of degree {degree} must be finite and not negative, found {found}")]
    Penalty {
        /// The degree.
        degree: usize,
        /// The value given.
        found: f64,
    },
    /// Samples that leave nothing beside the coefficients to tell the noise by.
    #[error(
        "{rows} vertices for {columns} coefficients leave no residual to estimate the noise from; denoising needs more vertices than coefficients: choose a lower degree"
    )]
    NoResidual {
        /// Vertices with weight.
        rows: usize,
        /// Coefficients of a column, K.
        columns: usize,
    },
    /// A factor is needed, and there is nothing to make it from.
    #[error("this strategy needs the Gram matrix or a factor, but has neither")]
    NoGram,
    /// Sums over no samples, or over samples without weight.
    #[error("no sample has a positive weight (the sums are over {count} samples of total weight {weight})")]
    NoSamples {
        /// Samples with weight.
        count: u64,
        /// Sum of the weights.
        weight: f64,
    },
    /// Sums whose arrays don't belong to their degree or number of columns.
    #[error("sums over the samples: expected {expected} rows in {what}, found {found}")]
    Sums {
        /// Which array.
        what: &'static str,
        /// Rows expected.
        expected: usize,
        /// Rows found.
        found: usize,
    },
    /// Sums over samples with a NaN or an infinity.
    #[error("the sums over the samples contain NaN or infinite values; check the samples' values and weights")]
    SumsNotFinite,
    /// Standard errors of coefficients that the samples don't determine.
    #[error(
        "{rows} vertices don't determine {columns} coefficients on this sampling; standard errors need a lower degree or a smoothness penalty"
    )]
    Underdetermined {
        /// Rows with weight.
        rows: usize,
        /// Columns.
        columns: usize,
    },
    /// A Gram matrix without a Cholesky factor.
    #[error(
        "the Gram matrix is not numerically positive definite: its factorisation breaks down at column {column}, of degree {degree}. The sampling does not determine the coefficients from there on; choose a lower degree, add a smoothness penalty, or use the minimum-norm solution"
    )]
    NotPositiveDefinite {
        /// Column from 0.
        column: usize,
        /// Its degree.
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
    /// The monitor asked for the computation to stop.
    #[error(transparent)]
    Interrupted(#[from] spharm_monitor::Interrupted),
}

/// In MiB, or in bytes where a unit was forgotten.
fn size(bytes: usize) -> String {
    if bytes < 1 << 20 { format!("{bytes} bytes") } else { format!("{} MiB", bytes >> 20) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sizes in MiB, rounded so that what is named works; bytes where a unit was forgotten.
    #[test]
    fn sizes_are_those_that_work() {
        let budget = |budget, needed| SolverError::Budget { budget, needed, granularity: None }.to_string();
        assert!(budget(512, 1).contains("a memory budget of 512 bytes is too small"));
        assert!(budget((1 << 20) - 1, 1).contains("budget of 1048575 bytes"));
        assert!(budget(1 << 20, 1).contains("budget of 1 MiB"));
        assert!(budget(3 << 20, (5 << 20) + 1).ends_with("the smallest that works is 6 MiB"));
        assert!(budget(3 << 20, 5 << 20).ends_with("the smallest that works is 5 MiB"));
    }
}
