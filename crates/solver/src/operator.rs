//! The basis as solvers use it: its products with vectors, and, for iterative residual fitting, its blocks.
//!
//! An [`Operator`] is the matrix A, (n, K): rows are vertices, columns basis functions. A [`BlockOperator`] can also be
//! read: a block is a run of degrees, and so of A's columns; it is opened and read chunk by chunk from several threads.
//!
//! | operator | the basis |
//! |---|---|
//! | [`MatrixFreeOperator`] | nowhere: fast transforms |
//! | [`MemoryOperator`] | in memory |
//! | [`DiskOperator`] | in a store |

mod disk;
mod matrix_free;
mod memory;
mod products;

use std::ops::{Range, RangeInclusive};

use ndarray::{Array2, ArrayView2};
use spharm_harmonics::product::Matrix;

use crate::SolverError;

pub use disk::DiskOperator;
pub use matrix_free::MatrixFreeOperator;
pub use memory::MemoryOperator;

/// How much of an open block is held.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Residency {
    /// All of it, so that a second look costs no reading.
    Whole,
    /// The chunks in use: the block is read again for each look.
    Chunks,
}

/// Scratch space of one thread for one block: a buffer for each degree that needs decoding.
#[derive(Debug, Default)]
pub struct Scratch {
    pub(crate) buffers: Vec<Vec<f64>>,
}

/// A basis matrix A, (n, K), known by its products.
pub trait Operator: Sync {
    /// Number of rows (vertices), n.
    fn rows(&self) -> usize;

    /// Highest degree, L; the matrix has `(L + 1)^2` columns.
    fn max_degree(&self) -> usize;

    /// Synthesis `A x`: x (K', c) of the degrees that K' stands for, result (n, c).
    ///
    /// # Errors
    ///
    /// When the basis can't be read.
    ///
    /// # Panics
    ///
    /// If K' isn't a basis size up to the operator's.
    fn apply(&self, x: ArrayView2<'_, f64>) -> Result<Array2<f64>, SolverError>;

    /// Adjoint synthesis `A^T r`: r (n, c), result (K, c).
    ///
    /// # Errors
    ///
    /// When the basis can't be read.
    ///
    /// # Panics
    ///
    /// If r hasn't n rows.
    fn apply_adjoint(&self, r: ArrayView2<'_, f64>) -> Result<Array2<f64>, SolverError>;

    /// The normal operator `A^T diag(w) A x`, x (K, c), w = 1 without weights, (n).
    ///
    /// # Errors
    ///
    /// When the basis can't be read.
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

/// A basis matrix that can be read by blocks of degrees and chunks of rows.
pub trait BlockOperator: Operator {
    /// Rows of every chunk but the last.
    fn chunk_rows(&self) -> usize;

    /// Bytes that a block takes while it is open, beside the scratch space.
    fn resident_bytes(&self, degrees: &RangeInclusive<usize>, residency: Residency, threads: usize) -> usize;

    /// Opens the block of a run of degrees.
    ///
    /// # Errors
    ///
    /// When the basis can't be read.
    fn open<'a>(
        &'a self,
        degrees: RangeInclusive<usize>,
        residency: Residency,
    ) -> Result<Box<dyn Block + 'a>, SolverError>;

    /// Number of chunks.
    fn chunk_count(&self) -> usize {
        self.rows().div_ceil(self.chunk_rows())
    }

    /// Rows of a chunk.
    fn chunk_range(&self, chunk: usize) -> Range<usize> {
        chunk * self.chunk_rows()..((chunk + 1) * self.chunk_rows()).min(self.rows())
    }
}

/// An open block: the columns of a run of degrees.
pub trait Block: Sync {
    /// Calls `read` with the chunk's matrices, one for each degree in order, each (rows, 2 l + 1).
    ///
    /// # Errors
    ///
    /// When the chunk can't be read or is damaged.
    fn chunk(
        &self,
        chunk: usize,
        scratch: &mut Scratch,
        read: &mut dyn FnMut(&[Matrix<'_>]),
    ) -> Result<(), SolverError>;

    /// Starts reading the block from disk while something else is computed.
    fn prefetch(&self);

    /// Bytes read from the store since the block was opened.
    fn bytes_read(&self) -> u64;

    /// Confirms that what was read was sound. What was computed from the block counts only after this.
    ///
    /// # Errors
    ///
    /// When the basis changed while it was read.
    fn check(&self) -> Result<(), SolverError>;
}
