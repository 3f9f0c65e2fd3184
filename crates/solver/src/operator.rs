//! Representations of the basis for solvers, which need its products with vectors and, for iterative residual fitting,
//! its blocks of columns.
//!
//! An [`Operator`] represents the matrix A (n, K): rows are vertices, columns are basis functions. A [`BlockOperator`]
//! also gives access to the entries of A, block by block. A block consists of the columns of consecutive degrees. After
//! a block has been opened, several threads can read it in chunks of rows.
//!
//! | operator | the basis |
//! |---|---|
//! | [`MatrixFreeOperator`], [`DeferredOperator`] | not stored: fast transforms |
//! | [`MemoryOperator`] | in memory |
//! | [`DiskOperator`] | in a store |

#[cfg(feature = "dense")]
mod blocks;
#[cfg(feature = "dense")]
mod disk;
mod matrix_free;
#[cfg(feature = "dense")]
mod memory;
#[cfg(feature = "dense")]
mod products;

use ndarray::{Array2, ArrayView2};

use crate::SolverError;

#[cfg(feature = "dense")]
pub use blocks::{Block, BlockOperator, Residency, Scratch};
#[cfg(feature = "dense")]
pub use disk::DiskOperator;
pub use matrix_free::{DeferredOperator, MatrixFreeOperator};
#[cfg(feature = "dense")]
pub use memory::MemoryOperator;

/// A basis matrix A (n, K), given by its products with vectors.
pub trait Operator: Sync {
    /// Returns the number of rows (vertices), n.
    fn rows(&self) -> usize;

    /// Returns the highest degree, L; the matrix has `(L + 1)^2` columns.
    fn max_degree(&self) -> usize;

    /// Computes the synthesis `A x` (n, c), where x (K', c) contains the coefficients of all degrees up to some degree.
    ///
    /// # Errors
    ///
    /// If the basis can't be read.
    ///
    /// # Panics
    ///
    /// If K' isn't the square of an integer, or exceeds the operator's number of columns.
    fn apply(&self, x: ArrayView2<'_, f64>) -> Result<Array2<f64>, SolverError>;

    /// Computes the adjoint synthesis `A^T r` (K, c) of r (n, c).
    ///
    /// # Errors
    ///
    /// If the basis can't be read.
    ///
    /// # Panics
    ///
    /// If r doesn't have n rows.
    fn apply_adjoint(&self, r: ArrayView2<'_, f64>) -> Result<Array2<f64>, SolverError>;

    /// Computes `A^T diag(w) A x` (K, c) for x (K, c) and weights w (n), which are all 1 by default.
    ///
    /// # Errors
    ///
    /// If the basis can't be read.
    fn normal(&self, x: ArrayView2<'_, f64>, weights: Option<&[f64]>) -> Result<Array2<f64>, SolverError> {
        let mut samples = self.apply(x)?;
        if let Some(weights) = weights {
            for (mut row, weight) in samples.rows_mut().into_iter().zip(weights) {
                row *= *weight;
            }
        }
        self.apply_adjoint(samples.view())
    }
}
