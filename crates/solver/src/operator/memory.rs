//! A basis held in memory, for small problems and as a reference for streamed bases.

use std::ops::RangeInclusive;

use ndarray::{Array2, ArrayView2};
use rayon::prelude::*;
use spharm_harmonics::index::{basis_size, first_column, order_count};
use spharm_harmonics::product::Matrix;
use spharm_harmonics::{Directions, HarmonicsError, Recurrence, Sweep};

use super::products::{apply_adjoint_by_blocks, apply_by_blocks};
use super::{Block, BlockOperator, Operator, Residency, Scratch};
use crate::SolverError;

/// An entire basis in memory, `8 n (L + 1)^2` bytes, in chunks of rows.
#[derive(Debug, Clone)]
pub struct MemoryOperator {
    /// Values of each chunk: the matrices A_0, A_1, .. of the degrees, one after another, each column-major.
    chunks: Vec<Vec<f64>>,
    rows: usize,
    max_degree: usize,
    chunk_rows: usize,
}

impl MemoryOperator {
    /// Evaluates the harmonics up to `max_degree` at `directions`.
    ///
    /// # Errors
    ///
    /// [`HarmonicsError::DegreeTooHigh`] if the harmonics don't support `max_degree`.
    pub fn new(directions: &Directions, max_degree: usize, chunk_rows: usize) -> Result<Self, HarmonicsError> {
        let recurrence = Recurrence::new(max_degree)?;
        let evaluate = |run: &[[f64; 3]]| {
            let mut values = vec![0.0; run.len() * basis_size(max_degree)];
            let mut sweep = Sweep::new(&recurrence, run);
            for l in 0..=max_degree {
                sweep.next_degree(&mut values[run.len() * first_column(l)..run.len() * first_column(l + 1)]);
            }
            values
        };
        let chunks = directions.as_slice().par_chunks(chunk_rows).map(evaluate).collect();
        Ok(Self { chunks, rows: directions.len(), max_degree, chunk_rows })
    }
}

impl Operator for MemoryOperator {
    fn rows(&self) -> usize {
        self.rows
    }

    fn max_degree(&self) -> usize {
        self.max_degree
    }

    fn apply(&self, x: ArrayView2<'_, f64>) -> Result<Array2<f64>, SolverError> {
        apply_by_blocks(self, x)
    }

    fn apply_adjoint(&self, r: ArrayView2<'_, f64>) -> Result<Array2<f64>, SolverError> {
        apply_adjoint_by_blocks(self, r)
    }
}

impl BlockOperator for MemoryOperator {
    fn chunk_rows(&self) -> usize {
        self.chunk_rows
    }

    fn resident_bytes(&self, _: &RangeInclusive<usize>, _: Residency, _: usize) -> usize {
        0
    }

    fn open<'a>(&'a self, degrees: RangeInclusive<usize>, _: Residency) -> Result<Box<dyn Block + 'a>, SolverError> {
        Ok(Box::new(MemoryBlock { operator: self, degrees }))
    }
}

struct MemoryBlock<'a> {
    operator: &'a MemoryOperator,
    degrees: RangeInclusive<usize>,
}

impl Block for MemoryBlock<'_> {
    fn chunk(&self, chunk: usize, _: &mut Scratch, read: &mut dyn FnMut(&[Matrix<'_>])) -> Result<(), SolverError> {
        let rows = self.operator.chunk_range(chunk).len();
        let values = &self.operator.chunks[chunk];
        let of = |l: usize| Matrix::new(&values[rows * first_column(l)..], rows, order_count(l), rows);
        read(&self.degrees.clone().map(of).collect::<Vec<_>>());
        Ok(())
    }

    fn prefetch(&self) {}

    fn bytes_read(&self) -> u64 {
        0
    }

    fn check(&self) -> Result<(), SolverError> {
        Ok(())
    }
}
