//! How to solve the full least squares.

/// How to solve the normal equations.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Strategy {
    /// Conjugate gradients first, by moments of an uneven sampling preconditioned with its density; if they are slow, a
    /// Cholesky factor with refinement, shifted if the normal matrix is singular.
    Auto,
    /// Conjugate gradients without a preconditioner.
    Cg,
    /// Conjugate gradients by moments, preconditioned with the density of an uneven sampling; without a preconditioner,
    /// and with a warning, if there is no memory for moments.
    DensityCg,
    /// A Cholesky factor with refinement, shifted where the normal matrix is singular.
    Cholesky,
}

/// Parameters of a least-squares fit.
#[derive(Debug, Clone)]
pub struct LsqParams {
    /// Weight of each row (vertex), (n), finite and not negative; `None` weighs all alike.
    pub weights: Option<Vec<f64>>,
    /// Rows that the norms of residuals leave out, (n); none by default.
    pub unread: Option<Vec<bool>>,
    /// Smoothness penalty, lambda, from 0, the default, on: adds `lambda sum (l (l + 1))^2 a^2` to the squared
    /// residual.
    pub smoothness: f64,
    /// Penalty of each degree, (L + 1), finite and not negative, default none: adds `sum_l p_l |a_l|^2` to the squared
    /// residual, with a_l the coefficients of degree l.
    pub penalty: Option<Vec<f64>>,
    /// How to solve; default [`Strategy::Auto`].
    pub strategy: Strategy,
    /// Optimality to reach, `|A^T W r - P x| / |A^T W f|`, of every column; default 1e-10.
    pub tolerance: f64,
    /// Most iterations; default 3000.
    pub max_iterations: usize,
    /// Most bytes of memory to take for a factor, `held` among them; default 2 GiB.
    pub memory: usize,
    /// Bytes of memory that are taken already; default 0.
    pub held: usize,
    /// Bytes of memory that the Gram matrix takes while it is made, for a factor; default 0.
    pub gram_bytes: usize,
    /// Bytes of memory that the normal operator from moments takes beside what is held, most of them while it is made;
    /// default 0.
    pub moment_bytes: usize,
    /// Threads for factors; 0, the default, for those of the rayon pool that the fit is called in.
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
