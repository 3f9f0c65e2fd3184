//! Opens the blocks of a pass one after another, and meanwhile reads the next block from disk.

use std::ops::{Range, RangeInclusive};

use spharm_harmonics::basis_size;
use spharm_harmonics::index::first_column;

use super::plan::IrfPlan;
use crate::SolverError;
use crate::operator::{Block, BlockOperator};

/// The order of the blocks in a pass.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Order {
    /// From the first block to the last.
    Forward,
    /// From the second-to-last block to the first, after a forward pass. The last block is skipped, because the forward
    /// pass has just solved it and solving it again would change nothing.
    Backward,
}

/// Opens the blocks of a pass, with one block read ahead if the plan has memory for it.
pub(super) struct Stream<'s, 'o> {
    operator: &'o dyn BlockOperator,
    blocks: &'s [RangeInclusive<usize>],
    plan: &'s IrfPlan,
    /// Indices of the blocks that haven't been opened yet.
    rest: std::vec::IntoIter<usize>,
    ahead: Option<OpenBlock<'o>>,
}

impl<'s, 'o> Stream<'s, 'o> {
    pub(super) fn new(
        operator: &'o dyn BlockOperator,
        blocks: &'s [RangeInclusive<usize>],
        plan: &'s IrfPlan,
        order: Order,
    ) -> Self {
        let indices: Vec<usize> = match order {
            Order::Forward => (0..blocks.len()).collect(),
            Order::Backward => (0..blocks.len() - 1).rev().collect(),
        };
        Self { operator, blocks, plan, rest: indices.into_iter(), ahead: None }
    }

    /// Opens the next block; returns `None` after the last block.
    pub(super) fn next(&mut self) -> Result<Option<OpenBlock<'o>>, SolverError> {
        let block = match self.ahead.take() {
            Some(block) => Some(block),
            None => self.open_next()?,
        };
        if self.plan.read_ahead {
            self.ahead = self.open_next()?;
        }
        Ok(block)
    }

    fn open_next(&mut self) -> Result<Option<OpenBlock<'o>>, SolverError> {
        let Some(index) = self.rest.next() else { return Ok(None) };
        let degrees = self.blocks[index].clone();
        let data = self.operator.open(degrees.clone(), self.plan.residency(index))?;
        data.prefetch();
        Ok(Some(OpenBlock { index, degrees, data }))
    }
}

/// An open block: the basis columns of consecutive degrees.
pub(super) struct OpenBlock<'o> {
    /// Index of the block within a forward pass, from 0.
    pub(super) index: usize,
    pub(super) degrees: RangeInclusive<usize>,
    pub(super) data: Box<dyn Block + 'o>,
}

impl OpenBlock<'_> {
    /// Returns the block's columns within the basis.
    pub(super) fn columns(&self) -> Range<usize> {
        first_column(*self.degrees.start())..basis_size(*self.degrees.end())
    }

    /// Closes the block; returns the bytes read from the store.
    ///
    /// # Errors
    ///
    /// If the basis changed while it was read, so that all results computed from the block are invalid.
    pub(super) fn close(self) -> Result<u64, SolverError> {
        self.data.check()?;
        Ok(self.data.bytes_read())
    }
}
