//! Cholesky factors of the normal equations of a fit. A factor is computed once and used for any number of surfaces.
//!
//! The normal matrix is G = A^T diag(w) A + P, where A (n, K) is the basis, w (n) are the weights and P is a diagonal
//! penalty. Its factorisation G = C C^T, with C lower triangular, takes K^3 / 3 flops once. Solving for a right-hand
//! side then takes 2 K^2 flops. G is read tile by tile from a [`GramMatrix`](crate::GramMatrix). C is stored in tiles,
//! too, in memory ([`MemoryFactor`]) or in a store ([`StoredFactor`]). A factor that is larger than the budget is
//! computed out of core: finished columns are read back from the unfinished file.
//!
//! An f32 factor needs half the space of an f64 factor, and half the time for solves that are bound by memory
//! bandwidth. Solutions computed with an f32 factor have a relative error of 6e-8 times the condition number of G. Such
//! solutions should be refined with gradients computed by the operator, or the factor should serve only as a
//! preconditioner.
//!
//! | module | contents |
//! |---|---|
//! | `build` | memory and disk space of a factor; its computation in memory or into a store |
//! | `factorise` | the factorisation, panel by panel |
//! | `tiles` | tiles in memory, and tiles of an unfinished file |
//! | `stored` | tiles in a store |
//! | `triangular` | the triangular solves; `kernels` contains their SIMD code |
//! | `inverse` | the diagonals of G^-1 and G^-1 P G^-1 |

mod build;
mod factorise;
mod inverse;
mod kernels;
mod stored;
mod tiles;
mod triangular;

use ndarray::Array2;
use spharm_monitor::Monitor;
use spharm_store::Scalar;

pub use build::{
    DEFAULT_TILE, FactorParams, FactorPlan, FactorReport, MemoryFactor, build_factor, factorise, plan_factor,
    plan_stored_factor,
};
pub use spharm_store::factor::Condition;
pub use stored::StoredFactor;

use crate::SolverError;

/// The Cholesky factor of a normal matrix G = A^T diag(w) A + P (K, K), in memory or in a store.
pub trait CholeskyFactor: Sync {
    /// Returns the number of rows of the factor, K, which equals the number of columns.
    fn size(&self) -> usize;

    /// Returns the scalar type of the factor's values.
    fn scalar(&self) -> Scalar;

    /// Returns the norm and the estimated condition number of G.
    fn condition(&self) -> Condition;

    /// Solves G x = b for any number of columns: `x` (K, c) contains b on entry and the solution on return. The result
    /// is bit-identical for any number of threads.
    ///
    /// # Errors
    ///
    /// If the factor can't be read or is damaged; `x` is then unchanged.
    ///
    /// # Panics
    ///
    /// If `x` doesn't have K rows.
    fn solve(&self, x: &mut Array2<f64>) -> Result<(), SolverError>;

    /// Returns the diagonal (K) of G^-1: the squares of the coefficients' standard errors for data of variance 1. Takes
    /// K^3 / 3 flops.
    ///
    /// Reports one stage, `standard errors`, counted in columns, to the monitor.
    ///
    /// # Errors
    ///
    /// [`SolverError::Interrupted`] if the monitor cancels the computation, and an error if the factor can't be read or
    /// is damaged.
    fn inverse_diagonal(&self, monitor: &dyn Monitor) -> Result<Vec<f64>, SolverError>;

    /// Returns the diagonals (K) of G^-1 and of G^-1 P G^-1, with `penalty` (K) the diagonal of P. Takes 2 K^3 / 3
    /// flops.
    ///
    /// Reports one stage, `standard errors`, counted in columns, to the monitor.
    ///
    /// # Errors
    ///
    /// The errors of [`inverse_diagonal`](Self::inverse_diagonal).
    ///
    /// # Panics
    ///
    /// If `penalty` doesn't have K entries.
    fn penalised_diagonals(&self, penalty: &[f64], monitor: &dyn Monitor) -> Result<(Vec<f64>, Vec<f64>), SolverError>;
}
