//! Settings of the full least squares.

/// Method for solving the normal equations.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Strategy {
    /// Runs conjugate gradients, preconditioned with the inverse of the sampling density if moments of an uneven
    /// sampling are used. If the iterations are slow, switches to a Cholesky factor with refinement, shifted if the
    /// normal matrix is singular. If a factor is already available, uses that factor from the start in most cases.
    Auto,
    /// Runs conjugate gradients without a preconditioner.
    Cg,
    /// Runs conjugate gradients with products computed from moments, preconditioned with the inverse of the sampling
    /// density if the sampling is uneven. If moments aren't available or don't fit in memory, no preconditioner is
    /// used, and the report contains a warning.
    DensityCg,
    /// Uses a Cholesky factor with refinement, shifted if the normal matrix is singular. If there are fewer rows with
    /// nonzero weight than coefficients and there is no penalty, runs conjugate gradients instead, and the report
    /// contains a warning.
    Cholesky,
}

/// Parameters of a least-squares fit.
#[derive(Debug, Clone)]
pub struct LsqParams {
    /// Weights (n) of the rows (vertices), finite and not negative; default `None`, for equal weights.
    pub weights: Option<Vec<f64>>,
    /// Flags (n) of the rows that are excluded from the norms of residuals; default `None`, which includes all rows.
    pub unread: Option<Vec<bool>>,
    /// Smoothness penalty, lambda, at least 0; default 0. Adds `lambda sum (l (l + 1))^2 a^2` to the squared residual.
    pub smoothness: f64,
    /// Penalties (L + 1) of the degrees, finite and not negative; none by default. They add `sum_l p_l |a_l|^2` to the
    /// squared residual, with a_l the coefficients of degree l.
    pub penalty: Option<Vec<f64>>,
    /// Method; default [`Strategy::Auto`].
    pub strategy: Strategy,
    /// Optimality `|A^T W r - P x| / |A^T W f|` that every column must reach; default 1e-10.
    pub tolerance: f64,
    /// Maximum number of iterations; default 3000.
    pub max_iterations: usize,
    /// Memory budget for a factor in bytes, including `held`; default 2 GiB.
    pub memory: usize,
    /// Bytes of memory that are already in use; default 0.
    pub held: usize,
    /// Bytes of memory for computing the Gram matrix for a factor; default 0.
    pub gram_bytes: usize,
    /// Bytes of memory that the normal operator from moments needs in addition to `held`, mostly while it is computed;
    /// default 0.
    pub moment_bytes: usize,
    /// Number of threads for factors; default 0, which is the number of threads of the caller's rayon pool.
    pub threads: usize,
}

impl Default for LsqParams {
    fn default() -> Self {
        Self {
            weights: None,
            unread: None,
            smoothness: 0.0,
            penalty: None,
            strategy: Strategy::Auto,
            tolerance: 1e-10,
            max_iterations: 3000,
            memory: 2 << 30,
            held: 0,
            gram_bytes: 0,
            moment_bytes: 0,
            threads: 0,
        }
    }
}
