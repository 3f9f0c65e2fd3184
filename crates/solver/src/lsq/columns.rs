//! Arithmetic on (K, c) arrays column by column, in parallel and with one order of summation.

use ndarray::{Array2, Axis};
use rayon::prelude::*;

/// Rows whose sums are formed together; fixed, so that sums don't depend on the threads.
const RUN: usize = 4096;

/// Inner products of the columns of two arrays.
pub(crate) fn dots(a: &Array2<f64>, b: &Array2<f64>) -> Vec<f64> {
    assert_eq!(a.dim(), b.dim(), "arrays of inner products");
    let c = a.ncols();
    let (a, b) = (a.as_standard_layout(), b.as_standard_layout());
    let [a, b] = [&a, &b].map(|array| array.as_slice().unwrap_or_default());
    let parts: Vec<Vec<f64>> = a
        .par_chunks(RUN * c.max(1))
        .zip(b.par_chunks(RUN * c.max(1)))
        .map(|(a, b)| {
            let mut sums = vec![0.0; c];
            for (a, b) in a.chunks_exact(c).zip(b.chunks_exact(c)) {
                for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
                    *sum += a * b;
                }
            }
            sums
        })
        .collect();
    let mut total = vec![0.0; c];
    for part in parts {
        total.iter_mut().zip(part).for_each(|(total, part)| *total += part);
    }
    total
}

/// Norms of the columns.
pub(crate) fn norms(a: &Array2<f64>) -> Vec<f64> {
    dots(a, a).into_iter().map(f64::sqrt).collect()
}

/// `y_c = s_c y_c + a_c x_c` for each column c.
pub(crate) fn combine(y: &mut Array2<f64>, s: &[f64], a: &[f64], x: &Array2<f64>) {
    assert_eq!(y.dim(), x.dim(), "arrays to combine");
    y.axis_chunks_iter_mut(Axis(0), RUN).into_par_iter().zip(x.axis_chunks_iter(Axis(0), RUN)).for_each(
        |(mut y, x)| {
            for (mut y, x) in y.rows_mut().into_iter().zip(x.rows()) {
                for (((y, x), s), a) in y.iter_mut().zip(x).zip(s).zip(a) {
                    *y = s * *y + a * x;
                }
            }
        },
    );
}

/// `y += x * factors`, a factor a row.
pub(crate) fn add_scaled_rows(y: &mut Array2<f64>, factors: &[f64], x: &Array2<f64>) {
    for ((mut y, x), factor) in y.rows_mut().into_iter().zip(x.rows()).zip(factors) {
        y.scaled_add(*factor, &x);
    }
}

/// Multiplies each row by its factor.
pub(crate) fn scale_rows(y: &mut Array2<f64>, factors: &[f64]) {
    for (mut y, factor) in y.rows_mut().into_iter().zip(factors) {
        y *= *factor;
    }
}
