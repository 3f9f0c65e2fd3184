//! A basis that can be read by blocks of degrees and chunks of rows.

use std::ops::{Range, RangeInclusive};

use spharm_harmonics::product::Matrix;

use super::Operator;
use crate::SolverError;

/// The part of an open block that is held in memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Residency {
    /// Holds the entire block, which is then read only once.
    Whole,
    /// Holds only the chunks in use; the block is then read again for each use.
    Chunks,
}

/// Scratch space of one thread for one block: a buffer for each degree that needs decoding.
#[derive(Debug, Default)]
pub struct Scratch {
    pub(crate) buffers: Vec<Vec<f64>>,
}

/// A basis matrix that can be read by blocks of degrees and chunks of rows.
pub trait BlockOperator: Operator {
    /// Returns the number of rows of every chunk except the last.
    fn chunk_rows(&self) -> usize;

    /// Returns the bytes of memory that an open block takes, in addition to the threads' scratch space.
    fn resident_bytes(&self, degrees: &RangeInclusive<usize>, residency: Residency, threads: usize) -> usize;

    /// Opens the block of a range of degrees.
    ///
    /// # Errors
    ///
    /// If the basis can't be read.
    fn open<'a>(
        &'a self,
        degrees: RangeInclusive<usize>,
        residency: Residency,
    ) -> Result<Box<dyn Block + 'a>, SolverError>;

    /// Returns the number of chunks.
    fn chunk_count(&self) -> usize {
        self.rows().div_ceil(self.chunk_rows())
    }

    /// Returns the rows of a chunk.
    fn chunk_range(&self, chunk: usize) -> Range<usize> {
        chunk * self.chunk_rows()..((chunk + 1) * self.chunk_rows()).min(self.rows())
    }
}

/// An open block: the basis columns of consecutive degrees.
pub trait Block: Sync {
    /// Calls `read` with the chunk's matrices, one for each degree in order, each (rows, 2 l + 1).
    ///
    /// # Errors
    ///
    /// If the chunk can't be read or is damaged.
    fn chunk(
        &self,
        chunk: usize,
        scratch: &mut Scratch,
        read: &mut dyn FnMut(&[Matrix<'_>]),
    ) -> Result<(), SolverError>;

    /// Starts reading the block from disk in the background.
    fn prefetch(&self);

    /// Returns the bytes read from the store since the block was opened.
    fn bytes_read(&self) -> u64;

    /// Checks that the basis didn't change while it was read. If the check fails, results computed from the block are
    /// invalid.
    ///
    /// # Errors
    ///
    /// If the basis changed while it was read.
    fn check(&self) -> Result<(), SolverError>;
}
