//! Linear algebra by faer, in double precision and on the calling thread.
//!
//! faer's functions are generic, so the compiler would compile them again for each crate that calls them. This crate
//! wraps them in functions that aren't generic and are compiled once. The other crates call these wrappers, which
//! shortens compilation and makes programs smaller. Matrices are faer's own types.

mod dense;
mod householder;
mod sparse;

pub use dense::{
    Cholesky, NoConvergence, SymmetricEigen, ThinSvd, add_gram, cholesky_in_place, matmul, solve_lower, solve_upper,
};
pub use faer::{Accum, Mat, MatMut, MatRef};
pub use householder::triangularise;
pub use sparse::{SparseFactor, SparsePattern, SparseSum};

/// Error returned if a matrix isn't numerically positive definite.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NotPositiveDefinite {
    /// First column at which the factorisation failed, counted from 0.
    pub column: usize,
}

impl std::fmt::Display for NotPositiveDefinite {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "a matrix isn't positive definite at column {}, counted from 0", self.column)
    }
}

impl std::error::Error for NotPositiveDefinite {}
