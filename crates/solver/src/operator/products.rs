//! Computes products with a basis that is read in blocks: one degree after another, in bounded memory.

use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use ndarray::{Array2, ArrayView2};
use rayon::prelude::*;
use spharm_harmonics::index::{basis_size, first_column};
use spharm_harmonics::product::{Matrix, accumulate_adjoint, accumulate_synthesis};

use super::{BlockOperator, Residency, Scratch};
use crate::SolverError;
use crate::chunked_rows::ChunkedRows;

/// Implements [`Operator::apply`](super::Operator::apply) (the product A x) for operators that can be read in blocks.
pub(super) fn apply_by_blocks(
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
        block.check()?;
    }
    Ok(samples.to_array())
}

/// Implements [`Operator::apply_adjoint`](super::Operator::apply_adjoint) (the product A^T r) for operators that can be
/// read in blocks.
pub(super) fn apply_adjoint_by_blocks(
    operator: &dyn BlockOperator,
    r: ArrayView2<'_, f64>,
) -> Result<Array2<f64>, SolverError> {
    assert_eq!(r.nrows(), operator.rows(), "the adjoint's argument must have one row per direction");
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
            *sums[chunk].lock().unwrap_or_else(PoisonError::into_inner) = sum;
            Ok::<(), SolverError>(())
        })?;
        block.check()?;
        // Add in the order of the chunks, so that the sums don't depend on the number of threads.
        for sum in sums {
            let sum = sum.into_inner().unwrap_or_else(PoisonError::into_inner);
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
        _ => panic!("expected (L + 1)^2 coefficients with L of at most {max_degree}, found {rows}"),
    }
}
