//! Divides the residual among threads: each thread owns a fixed run of chunks of rows, and computes its own sums over
//! them.
//!
//! The runs and the order of summation depend only on the number of threads, so repeated fits with the same number of
//! threads give bit-identical results.

use std::ops::Range;

use rayon::prelude::*;
use spharm_harmonics::product::{self, Matrix};

use super::stream::OpenBlock;
use super::triangle::Triangle;
use crate::SolverError;
use crate::chunked_rows::ChunkedRows;
use crate::dense;
use crate::operator::{BlockOperator, Scratch};

/// Smallest number of target columns for which general matrix products are faster than the kernels for few columns.
const MANY_CHANNELS: usize = 8;

/// The residual of a fit and the threads that work on it.
pub(super) struct Workers<'r> {
    workers: Vec<Worker<'r>>,
    channels: usize,
    /// Square roots (n) of the weights, if there are weights.
    root_weights: Option<&'r [f64]>,
}

/// One thread's share of the residual, and its buffers.
struct Worker<'r> {
    chunks: Range<usize>,
    residual: Vec<&'r mut [f64]>,
    /// Square roots of the weights of the thread's rows, by chunk, if there are weights.
    root_weights: Vec<&'r [f64]>,
    channels: usize,
    gram: Vec<f64>,
    adjoint: Vec<f64>,
    packed: Vec<f64>,
    weighted: Vec<f64>,
    scratch: Scratch,
}

impl<'r> Workers<'r> {
    /// Divides the chunks among `threads` workers.
    pub(super) fn new(
        operator: &dyn BlockOperator,
        residual: &'r mut ChunkedRows,
        root_weights: Option<&'r [f64]>,
        threads: usize,
    ) -> Self {
        let count = operator.chunk_count();
        let channels = residual.channels();
        let mut chunks = residual.chunks_mut().into_iter();
        let threads = threads.clamp(1, count);
        let worker = |t: usize| {
            let run = t * count / threads..(t + 1) * count / threads;
            let of_chunk = |roots: &'r [f64]| run.clone().map(|c| &roots[operator.chunk_range(c)]).collect();
            Worker {
                residual: chunks.by_ref().take(run.len()).collect(),
                root_weights: root_weights.map_or_else(Vec::new, of_chunk),
                chunks: run,
                channels,
                gram: Vec::new(),
                adjoint: Vec::new(),
                packed: Vec::new(),
                weighted: Vec::new(),
                scratch: Scratch::default(),
            }
        };
        Self { workers: (0..threads).map(worker).collect(), channels, root_weights }
    }

    /// Returns the number of columns of the residual, c.
    pub(super) fn channels(&self) -> usize {
        self.channels
    }

    pub(super) fn root_weights(&self) -> Option<&'r [f64]> {
        self.root_weights
    }

    /// Computes the block's right-hand sides `A^T W r` (k, c), row-major.
    pub(super) fn right_hand_sides(&mut self, block: &OpenBlock<'_>, k: usize) -> Result<Vec<f64>, SolverError> {
        Ok(self.sums(block, k, false)?.0)
    }

    /// Computes the block's right-hand sides `A^T W r` (k, c), row-major, and the lower triangle of the block's Gram
    /// matrix `A^T W A` (k, k).
    pub(super) fn normal_equations(
        &mut self,
        block: &OpenBlock<'_>,
        k: usize,
    ) -> Result<(Vec<f64>, Vec<f64>), SolverError> {
        self.sums(block, k, true)
    }

    fn sums(&mut self, block: &OpenBlock<'_>, k: usize, with_gram: bool) -> Result<(Vec<f64>, Vec<f64>), SolverError> {
        self.workers.par_iter_mut().try_for_each(|worker| worker.sum(block, k, with_gram))?;
        let (first, others) = self.workers.split_at_mut(1);
        let first = &mut first[0];
        for other in others {
            first.adjoint.iter_mut().zip(&other.adjoint).for_each(|(sum, value)| *sum += value);
            first.gram.iter_mut().zip(&other.gram).for_each(|(sum, value)| *sum += value);
        }
        Ok((std::mem::take(&mut first.adjoint), std::mem::take(&mut first.gram)))
    }

    /// Updates the residual: `r -= A x`, where A contains the block's columns and x (k, c) is row-major.
    pub(super) fn subtract(&mut self, block: &OpenBlock<'_>, x: &[f64]) -> Result<(), SolverError> {
        self.workers.par_iter_mut().try_for_each(|worker| worker.subtract(block, x))
    }

    /// Computes the triangular factor of `W^(1/2) [A | r]`. A is the block's columns, r the residual and W the weights.
    /// Each worker adds its chunks of rows to a factor of its own one after another, and the workers' factors are then
    /// combined.
    pub(super) fn triangle(&mut self, block: &OpenBlock<'_>, k: usize) -> Result<Triangle, SolverError> {
        let parts: Vec<Triangle> =
            self.workers.par_iter_mut().map(|worker| worker.triangle(block, k)).collect::<Result<_, _>>()?;
        let mut whole = Triangle::new(k + self.channels);
        for part in parts {
            whole.push_triangle(part);
        }
        Ok(whole)
    }
}

impl Worker<'_> {
    fn sum(&mut self, block: &OpenBlock<'_>, k: usize, with_gram: bool) -> Result<(), SolverError> {
        self.adjoint.clear();
        self.adjoint.resize(k * self.channels, 0.0);
        self.gram.clear();
        if with_gram {
            self.gram.resize(k * k, 0.0);
        }
        let Self { gram, adjoint, packed, weighted, scratch, residual, root_weights, channels, .. } = self;
        for (at, chunk) in self.chunks.clone().enumerate() {
            let root = root_weights.get(at).copied();
            block.data.chunk(chunk, scratch, &mut |parts| {
                let rows = parts[0].rows();
                let r = match root {
                    None => Matrix::new(residual[at], rows, *channels, rows),
                    Some(root) => {
                        weighted.clear();
                        weighted.extend(residual[at].iter().zip(root.iter().cycle()).map(|(r, root)| r * root * root));
                        Matrix::new(weighted, rows, *channels, rows)
                    }
                };
                let mut first = 0;
                for part in parts {
                    let out = &mut adjoint[first * *channels..(first + part.columns()) * *channels];
                    if *channels < MANY_CHANNELS {
                        product::accumulate_adjoint(*part, r, out);
                    } else {
                        dense::accumulate_adjoint(*part, r, out);
                    }
                    first += part.columns();
                }
                if with_gram {
                    match (parts, root) {
                        ([single], None) => dense::accumulate_gram(*single, gram),
                        _ => dense::accumulate_gram(pack(parts, root, packed), gram),
                    }
                }
            })?;
        }
        Ok(())
    }

    fn subtract(&mut self, block: &OpenBlock<'_>, x: &[f64]) -> Result<(), SolverError> {
        let channels = self.channels;
        for (at, chunk) in self.chunks.clone().enumerate() {
            let residual = &mut *self.residual[at];
            block.data.chunk(chunk, &mut self.scratch, &mut |parts| {
                let rows = parts[0].rows();
                let mut first = 0;
                for part in parts {
                    let x = &x[first * channels..(first + part.columns()) * channels];
                    if channels < MANY_CHANNELS {
                        product::accumulate_synthesis(*part, x, -1.0, residual, rows);
                    } else {
                        dense::accumulate_synthesis(*part, x, -1.0, residual);
                    }
                    first += part.columns();
                }
            })?;
        }
        Ok(())
    }

    fn triangle(&mut self, block: &OpenBlock<'_>, k: usize) -> Result<Triangle, SolverError> {
        let mut triangle = Triangle::new(k + self.channels);
        let Self { packed, scratch, residual, root_weights, channels, .. } = self;
        for (at, chunk) in self.chunks.clone().enumerate() {
            let root = root_weights.get(at).copied();
            block.data.chunk(chunk, scratch, &mut |parts| {
                let rows = parts[0].rows();
                let r = Matrix::new(residual[at], rows, *channels, rows);
                let all: Vec<Matrix<'_>> = parts.iter().copied().chain([r]).collect();
                match root {
                    None => triangle.push(pack(&all, None, packed)),
                    Some(roots) if roots.iter().all(|root| *root == 0.0) => {}
                    Some(roots) => triangle.push(pack_weighted(&all, roots, packed)),
                }
            })?;
        }
        Ok(triangle)
    }
}

/// Packs matrices side by side into one matrix, with each row multiplied by its root weight, and without the rows of
/// weight 0. At least one row must have a nonzero weight.
fn pack_weighted<'p>(parts: &[Matrix<'_>], root_weights: &[f64], packed: &'p mut Vec<f64>) -> Matrix<'p> {
    packed.clear();
    for part in parts {
        for j in 0..part.columns() {
            let rows = part.column(j).iter().zip(root_weights).filter(|(_, root)| **root > 0.0);
            packed.extend(rows.map(|(a, root)| a * root));
        }
    }
    let rows = root_weights.iter().filter(|root| **root > 0.0).count();
    let columns = packed.len() / rows;
    Matrix::new(packed, rows, columns, rows)
}

/// Packs matrices side by side into one matrix, with each row multiplied by its root weight if `root_weights` is given.
pub(super) fn pack<'p>(parts: &[Matrix<'_>], root_weights: Option<&[f64]>, packed: &'p mut Vec<f64>) -> Matrix<'p> {
    let rows = parts[0].rows();
    packed.clear();
    for part in parts {
        for j in 0..part.columns() {
            match root_weights {
                None => packed.extend_from_slice(part.column(j)),
                Some(roots) => packed.extend(part.column(j).iter().zip(roots).map(|(a, root)| a * root)),
            }
        }
    }
    let columns = packed.len() / rows;
    Matrix::new(packed, rows, columns, rows)
}
