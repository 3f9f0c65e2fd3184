//! Settings of iterative residual fitting.

use super::blocks::Method;

/// Parameters of iterative residual fitting.
#[derive(Debug, Clone)]
pub struct IrfParams {
    /// Highest degree, L, inclusive; default 100.
    pub max_degree: usize,
    /// Method, which determines the blocks and the number of passes; default IRF in one pass with a granularity of 100.
    pub method: Method,
    /// Maximum number of additional passes that remove rounding errors; default 0. These passes end early when a pass
    /// changes the coefficients by almost nothing. They are useful for [`Method::Nlsf`], whose single block may be
    /// ill-conditioned.
    pub refinements: usize,
    /// Weights (n) of the rows (vertices) in the least squares, finite and not negative; default `None`, for equal
    /// weights.
    pub weights: Option<Vec<f64>>,
    /// Flags (n) of the rows that are excluded from the norms of residuals; default `None`, which includes all rows.
    pub unread: Option<Vec<bool>>,
    /// Memory budget in bytes, which includes memory-mapped parts of the basis; default 256 MiB.
    pub memory: usize,
    /// Bytes of `memory` that the caller already holds; default 0.
    pub held: usize,
    /// Number of threads of the caller's rayon pool to use; default 0, which uses all of them.
    pub threads: usize,
    /// Whether more fits will follow on the same [`IrfSolver`](super::IrfSolver), so that factors are worth keeping;
    /// default false.
    pub reuse: bool,
    /// Whether to accelerate the fit by conjugate gradients over pairs of passes, which reduces the number of passes
    /// needed; default false.
    pub accelerate: bool,
    /// Bytes held by the source of the blocks' Gram matrices, if the fit has such a source; used by
    /// [`plan`](super::plan()). [`IrfSolver::new`](super::IrfSolver::new) and
    /// [`IrfSolver::with_gram`](super::IrfSolver::with_gram) overwrite this number with one computed from their
    /// arguments.
    pub gram_bytes: Option<usize>,
}

impl Default for IrfParams {
    fn default() -> Self {
        Self {
            max_degree: 100,
            method: Method::Irf { passes: 1, granularity: 100 },
            refinements: 0,
            weights: None,
            unread: None,
            memory: 256 << 20,
            held: 0,
            threads: 0,
            reuse: false,
            accelerate: false,
            gram_bytes: None,
        }
    }
}
