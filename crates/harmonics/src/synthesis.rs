//! Computes samples at any directions from coefficients, by direct sums.
//!
//! Cost: `n K (1.5 + 2 c)` flops. Memory: one block `A_l` of 256 rows per thread. For many directions at high degrees
//! the transforms of `spharm-transform` are faster.

use ndarray::{Array2, ArrayView2, Axis};
use rayon::prelude::*;

use crate::index::{first_column, max_degree_of, order_count};
use crate::product::{Matrix, accumulate_synthesis};
use crate::recurrence::Recurrence;
use crate::sweep::Sweep;
use crate::{Directions, HarmonicsError};

/// Number of rows per run. Up to degree 100 the sweep's state and the run's block fit in a core's L2 cache together.
const RUN: usize = 256;

/// Evaluates c functions at n `directions` from their canonical `coefficients` (K, c), and returns the samples (n, c).
///
/// Runs on the rayon pool from which it is called; the result is bit-identical for any number of threads.
///
/// # Errors
///
/// - [`HarmonicsError::NotABasisSize`] if K isn't `(L + 1)^2` for any L.
/// - [`HarmonicsError::DegreeTooHigh`] if L is above [`MAX_DEGREE`](crate::MAX_DEGREE).
pub fn synthesis(directions: &Directions, coefficients: ArrayView2<'_, f64>) -> Result<Array2<f64>, HarmonicsError> {
    let (rows, channels) = coefficients.dim();
    let max_degree = max_degree_of(rows).ok_or(HarmonicsError::NotABasisSize { rows })?;
    let recurrence = Recurrence::new(max_degree)?;
    // In row-major order, the rows of one degree are contiguous.
    let coefficients = coefficients.as_standard_layout();
    let x = coefficients.as_slice().unwrap_or_default();
    let mut samples = Array2::zeros((directions.len(), channels));
    samples.axis_chunks_iter_mut(Axis(0), RUN).into_par_iter().zip(directions.as_slice().par_chunks(RUN)).for_each(
        |(mut out, run)| {
            let rows = run.len();
            let mut sweep = Sweep::new(&recurrence, run);
            let mut block = vec![0.0; rows * order_count(max_degree)];
            let mut sums = vec![0.0; rows * channels];
            for l in 0..=max_degree {
                let block = &mut block[..rows * order_count(l)];
                sweep.next_degree(block);
                let of_degree = &x[first_column(l) * channels..][..order_count(l) * channels];
                accumulate_synthesis(Matrix::new(block, rows, order_count(l), rows), of_degree, 1.0, &mut sums, rows);
            }
            for (channel, column) in sums.chunks_exact(rows).enumerate() {
                for (out, sum) in out.column_mut(channel).iter_mut().zip(column) {
                    *out = *sum;
                }
            }
        },
    );
    Ok(samples)
}
