//! What a solver sees of a basis: its products with vectors, and, for iterative residual fitting, its blocks.
//!
//! An [`Operator`] is the matrix A, (n, K): rows are vertices, columns basis functions. A [`BlockOperator`] can also be
//! read. A block is a run of degrees, a run of A's columns; it is opened, read chunk by chunk from several threads, and
//! closed. What was computed from it counts once it was closed without an error.

use std::ops::{Range, RangeInclusive};
use std::sync::Mutex;

use ndarray::{Array2, ArrayView2};
use rayon::prelude::*;
use spharm_harmonics::index::{basis_size, first_column};
use spharm_harmonics::product::{Matrix, accumulate_adjoint, accumulate_synthesis};

use crate::SolverError;
use crate::rows::ChunkedRows;

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

/// [`Operator::apply`], a degree after the other.
pub(crate) fn apply_by_blocks(
    operator: &dyn BlockOperator,
    x: ArrayView2<'_, f64>,
) -> Result<Array2<f64>, SolverError> {
    let degrees = degrees_of(x.nrows(), operator.max_degree());
    let (x, c) = (x.as_standard_layout().into_owned(), x.ncols());
    let x = x.as_slice().unwrap_or_default();
    let mut samples = ChunkedRows::zeros(operator.rows(), c, operator.chunk_rows());
    for l in degrees {
        let block = operator.open(l..=l, Residency::Chunks)?;
        let x = &x[first_column(l) * c..first_column(l + 1) * c];
        samples.chunks_mut().into_par_iter().enumerate().try_for_each(|(chunk, out)| {
            let rows = operator.chunk_range(chunk).len();
            block.chunk(chunk, &mut Scratch::default(), &mut |parts| {
                accumulate_synthesis(parts[0], x, 1.0, out, rows);
            })
        })?;
        block.close()?;
    }
    Ok(samples.to_array())
}

/// [`Operator::apply_adjoint`], a degree after the other.
pub(crate) fn apply_adjoint_by_blocks(
    operator: &dyn BlockOperator,
    r: ArrayView2<'_, f64>,
) -> Result<Array2<f64>, SolverError> {
    assert_eq!(r.nrows(), operator.rows(), "rows of the adjoint's argument");
    let c = r.ncols();
    let rows = ChunkedRows::from_array(r, operator.chunk_rows());
    let mut result = Array2::zeros((basis_size(operator.max_degree()), c));
    for l in 0..=operator.max_degree() {
        let block = operator.open(l..=l, Residency::Chunks)?;
        let k = 2 * l + 1;
        let sums: Vec<Mutex<Vec<f64>>> = (0..operator.chunk_count()).map(|_| Mutex::default()).collect();
        (0..operator.chunk_count()).into_par_iter().try_for_each(|chunk| {
            let count = operator.chunk_range(chunk).len();
            let mut sum = vec![0.0; k * c];
            block.chunk(chunk, &mut Scratch::default(), &mut |parts| {
                accumulate_adjoint(parts[0], Matrix::new(rows.chunk(chunk), count, c, count), &mut sum);
            })?;
            *sums[chunk].lock().unwrap_or_else(std::sync::PoisonError::into_inner) = sum;
            Ok::<(), SolverError>(())
        })?;
        block.close()?;
        // In the order of the chunks, whatever the threads did.
        for sum in sums {
            let sum = sum.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
            let mut rows = result.slice_mut(ndarray::s![first_column(l)..first_column(l + 1), ..]);
            for (out, value) in rows.iter_mut().zip(&sum) {
                *out += value;
            }
        }
    }
    Ok(result)
}

fn degrees_of(rows: usize, max_degree: usize) -> Range<usize> {
    let degree = spharm_harmonics::index::max_degree_of(rows);
    match degree {
        Some(degree) if degree <= max_degree => 0..degree + 1,
        _ => panic!("{rows} coefficients are no basis size up to degree {max_degree}"),
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

    /// Ends the use of the block.
    ///
    /// # Errors
    ///
    /// When what was read turns out not to have been sound: the basis changed meanwhile.
    fn close(self: Box<Self>) -> Result<(), SolverError>;
}
