//! How to fit by iterative residual fitting.

use super::blocks::Method;

/// Parameters of iterative residual fitting.
#[derive(Debug, Clone)]
pub struct IrfParams {
    /// Highest degree, L, inclusive; default 100.
    pub max_degree: usize,
    /// Blocks and passes; default IRF in one pass with a granularity of 100.
    pub method: Method,
    /// Most passes after the last one that remove what rounding left over; they end early when they change nothing.
    /// Of use for [`Method::Nlsf`], whose one block may be ill-conditioned. Default 0.
    pub refinements: usize,
    /// Weight of each row (vertex) in the least squares, (n), finite and not negative; `None` weighs all alike.
    pub weights: Option<Vec<f64>>,
    /// Rows that the norms of residuals leave out, (n); none by default.
    pub unread: Option<Vec<bool>>,
    /// Most bytes of memory to take, mapped windows included; default 256 MiB.
    pub memory: usize,
    /// Bytes that the caller holds already, which count against `memory`; default 0.
    pub held: usize,
    /// Threads, on the rayon pool that the fit is called in; 0, the default, for all of that pool.
    pub threads: usize,
    /// Whether more fits will follow on the same [`IrfSolver`](super::IrfSolver), so that factors are worth keeping;
    /// default false.
    pub reuse: bool,
    /// Whether to run conjugate gradients over pairs of passes, which converge in far fewer of them; default false.
    pub accelerate: bool,
    /// Bytes held by the blocks' Gram matrix, for [`plan`](super::plan()) of a fit that is to have one.
    /// [`IrfSolver::new`](super::IrfSolver::new) and [`IrfSolver::with_gram`](super::IrfSolver::with_gram) set it to
    /// what they are given.
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
