//! What the threads do for one block: each owns a fixed run of chunks, their residual, and its own sums.
//!
//! Runs and the order in which sums are added up depend on the number of threads alone, so that the same number gives
//! the same bits.

use std::ops::Range;

use rayon::prelude::*;
use spharm_harmonics::product::{self, Matrix};

use crate::SolverError;
use crate::dense;
use crate::operator::{Block, BlockOperator, Scratch};
use crate::rows::ChunkedRows;
use crate::triangle::Triangle;

/// From this many columns of the targets on, a BLAS product beats the kernels for few columns.
const MANY_CHANNELS: usize = 8;

/// One thread's share of a sweep.
pub(crate) struct Worker<'r> {
    chunks: Range<usize>,
    residual: Vec<&'r mut [f64]>,
    /// Square roots of the weights of its rows, by chunk, when there are weights.
    roots: Vec<&'r [f64]>,
    channels: usize,
    gram: Vec<f64>,
    adjoint: Vec<f64>,
    packed: Vec<f64>,
    weighted: Vec<f64>,
    scratch: Scratch,
}

/// Divides the chunks among `threads` workers.
pub(crate) fn workers<'r>(
    operator: &dyn BlockOperator,
    residual: &'r mut ChunkedRows,
    roots: Option<&'r [f64]>,
    threads: usize,
) -> Vec<Worker<'r>> {
    let count = operator.chunk_count();
    let channels = residual.channels();
    let mut chunks = residual.chunks_mut().into_iter();
    let threads = threads.clamp(1, count);
    (0..threads)
        .map(|t| {
            let run = t * count / threads..(t + 1) * count / threads;
            let roots =
                roots.map_or_else(Vec::new, |roots| run.clone().map(|c| &roots[operator.chunk_range(c)]).collect());
            Worker {
                residual: chunks.by_ref().take(run.len()).collect(),
                chunks: run,
                roots,
                channels,
                gram: Vec::new(),
                adjoint: Vec::new(),
                packed: Vec::new(),
                weighted: Vec::new(),
                scratch: Scratch::default(),
            }
        })
        .collect()
}

/// `A^T W r`, (k, c) row-major, and when asked for the upper triangle of `A^T W A`, (k, k), summed over the workers.
pub(crate) fn normal_equations(
    block: &dyn Block,
    workers: &mut [Worker<'_>],
    columns: usize,
    with_gram: bool,
) -> Result<(Vec<f64>, Option<Vec<f64>>), SolverError> {
    workers.par_iter_mut().try_for_each(|worker| worker.sum(block, columns, with_gram))?;
    let (first, others) = workers.split_at_mut(1);
    let first = &mut first[0];
    for other in others {
        first.adjoint.iter_mut().zip(&other.adjoint).for_each(|(sum, value)| *sum += value);
        if with_gram {
            first.gram.iter_mut().zip(&other.gram).for_each(|(sum, value)| *sum += value);
        }
    }
    let gram = with_gram.then(|| std::mem::take(&mut first.gram));
    Ok((std::mem::take(&mut first.adjoint), gram))
}

/// `r -= A x` for x (k, c) row-major.
pub(crate) fn update(block: &dyn Block, workers: &mut [Worker<'_>], x: &[f64]) -> Result<(), SolverError> {
    workers.par_iter_mut().try_for_each(|worker| worker.subtract(block, x))
}

/// Triangular factor of `W^(1/2) [A | r]`, folded chunk by chunk.
pub(crate) fn triangular(
    block: &dyn Block,
    workers: &mut [Worker<'_>],
    columns: usize,
) -> Result<Triangle, SolverError> {
    let parts: Vec<Triangle> =
        workers.par_iter_mut().map(|worker| worker.triangle(block, columns)).collect::<Result<_, _>>()?;
    let channels = workers[0].channels;
    let mut whole = Triangle::new(columns + channels);
    for part in parts {
        whole.push_triangle(part);
    }
    Ok(whole)
}

impl Worker<'_> {
    fn sum(&mut self, block: &dyn Block, columns: usize, with_gram: bool) -> Result<(), SolverError> {
        self.adjoint.clear();
        self.adjoint.resize(columns * self.channels, 0.0);
        if with_gram {
            self.gram.clear();
            self.gram.resize(columns * columns, 0.0);
        }
        let Self { gram, adjoint, packed, weighted, scratch, residual, roots, channels, .. } = self;
        for (at, chunk) in self.chunks.clone().enumerate() {
            let root = roots.get(at).copied();
            block.chunk(chunk, scratch, &mut |parts| {
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
                        ([single], None) => dense::accumulate_gram(*single, gram, columns),
                        _ => dense::accumulate_gram(pack(parts, root, packed), gram, columns),
                    }
                }
            })?;
        }
        Ok(())
    }

    fn subtract(&mut self, block: &dyn Block, x: &[f64]) -> Result<(), SolverError> {
        let channels = self.channels;
        for (at, chunk) in self.chunks.clone().enumerate() {
            let residual = &mut *self.residual[at];
            block.chunk(chunk, &mut self.scratch, &mut |parts| {
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

    fn triangle(&mut self, block: &dyn Block, columns: usize) -> Result<Triangle, SolverError> {
        let mut triangle = Triangle::new(columns + self.channels);
        let Self { packed, scratch, residual, roots, channels, .. } = self;
        for (at, chunk) in self.chunks.clone().enumerate() {
            let root = roots.get(at).copied();
            block.chunk(chunk, scratch, &mut |parts| {
                let rows = parts[0].rows();
                let r = Matrix::new(residual[at], rows, *channels, rows);
                let all: Vec<Matrix<'_>> = parts.iter().copied().chain([r]).collect();
                triangle.push(pack(&all, root, packed));
            })?;
        }
        Ok(triangle)
    }
}

/// The parts side by side, rows scaled by `root` when there is one.
pub(crate) fn pack<'p>(parts: &[Matrix<'_>], root: Option<&[f64]>, packed: &'p mut Vec<f64>) -> Matrix<'p> {
    let rows = parts[0].rows();
    packed.clear();
    for part in parts {
        for j in 0..part.columns() {
            match root {
                None => packed.extend_from_slice(part.column(j)),
                Some(root) => packed.extend(part.column(j).iter().zip(root).map(|(a, root)| a * root)),
            }
        }
    }
    let columns = packed.len() / rows;
    Matrix::new(packed, rows, columns, rows)
}
