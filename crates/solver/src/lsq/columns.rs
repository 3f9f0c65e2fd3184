//! Arithmetic on (K, c) arrays column by column, in parallel and with a fixed order of summation.

use ndarray::Array2;
use rayon::prelude::*;

/// Number of rows that are summed together; fixed, so that sums don't depend on the number of threads.
const RUN: usize = 4096;

/// Returns the inner products of corresponding columns of two arrays.
pub(crate) fn dots(a: &Array2<f64>, b: &Array2<f64>) -> Vec<f64> {
    assert_eq!(a.dim(), b.dim(), "both arrays must have the same shape");
    let c = a.ncols();
    let (a, b) = (a.as_standard_layout(), b.as_standard_layout());
    let [a, b] = [&a, &b].map(|array| array.as_slice().unwrap_or_default());
    let parts: Vec<Vec<f64>> = a
        .par_chunks(RUN * c.max(1))
        .zip(b.par_chunks(RUN * c.max(1)))
        .map(|(a, b)| if c == 1 { vec![dot(a, b)] } else { dots_of_rows(a, b, c) })
        .collect();
    let mut total = vec![0.0; c];
    for part in parts {
        total.iter_mut().zip(part).for_each(|(total, part)| *total += part);
    }
    total
}

/// Computes an inner product as the sum of several partial sums, which the processor evaluates in parallel.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    const LANES: usize = 16;
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    let mut sums = [0.0; LANES];
    for (a, b) in a.iter().zip(b) {
        for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
            *sum += a * b;
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    sums.iter().sum::<f64>() + rest
}

fn dots_of_rows(a: &[f64], b: &[f64], c: usize) -> Vec<f64> {
    let mut sums = vec![0.0; c];
    for (a, b) in a.chunks_exact(c).zip(b.chunks_exact(c)) {
        for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
            *sum += a * b;
        }
    }
    sums
}

/// Returns the Euclidean norms of the columns.
pub(crate) fn norms(a: &Array2<f64>) -> Vec<f64> {
    dots(a, a).into_iter().map(f64::sqrt).collect()
}

/// Computes `y_c = s_c y_c + a_c x_c` for each column c.
pub(crate) fn combine(y: &mut Array2<f64>, s: &[f64], a: &[f64], x: &Array2<f64>) {
    assert_eq!(y.dim(), x.dim(), "the arrays to combine must have the same shape");
    let c = y.ncols().max(1);
    let x = x.as_standard_layout();
    let x = x.as_slice().unwrap_or_default();
    if !y.is_standard_layout() {
        *y = y.as_standard_layout().into_owned();
    }
    let y = y.as_slice_mut().unwrap_or_default();
    y.par_chunks_mut(RUN * c).zip(x.par_chunks(RUN * c)).for_each(|(y, x)| {
        if let ([s], [a]) = (s, a) {
            y.iter_mut().zip(x).for_each(|(y, x)| *y = s * *y + a * x);
            return;
        }
        for (y, x) in y.chunks_exact_mut(c).zip(x.chunks_exact(c)) {
            for (((y, x), s), a) in y.iter_mut().zip(x).zip(s).zip(a) {
                *y = s * *y + a * x;
            }
        }
    });
}

/// Computes `y += x * factors`, with `factors` containing one factor for each row of x.
pub(crate) fn add_scaled_rows(y: &mut Array2<f64>, factors: &[f64], x: &Array2<f64>) {
    for ((mut y, x), factor) in y.rows_mut().into_iter().zip(x.rows()).zip(factors) {
        y.scaled_add(*factor, &x);
    }
}

/// Multiplies each row of `y` by its factor.
pub(crate) fn scale_rows(y: &mut Array2<f64>, factors: &[f64]) {
    for (mut y, factor) in y.rows_mut().into_iter().zip(factors) {
        y *= *factor;
    }
}
