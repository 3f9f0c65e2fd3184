//! Multiplies matrices on one thread, so that products are bitwise the same for any number of threads, even inside
//! parallel loops.
//!
//! ndarray's own `dot` uses OpenBLAS if another crate of the program enables it. The threads of OpenBLAS would then
//! compete with the threads of the calling loop.

use ndarray::{Array2, ArrayView2};
use spharm_linalg::{Accum, MatMut, MatRef, matmul};

/// Number of columns of B in each part of a large product A B. Callers split B into parts with this number of columns,
/// which fit in the L2 cache together with a few dozen rows of A.
pub(crate) const COLUMNS: usize = 768;

/// Returns the product `A B` (m, n) of A (m, k) and B (k, n). Arguments that aren't row-major are copied first.
///
/// # Panics
///
/// If the inner dimensions differ.
pub(crate) fn product(a: ArrayView2<'_, f64>, b: ArrayView2<'_, f64>) -> Array2<f64> {
    let ((m, k), (rows, n)) = (a.dim(), b.dim());
    assert_eq!(k, rows, "the inner sizes of a product must be equal");
    let mut c = Array2::zeros((m, n));
    let (a, b) = (a.as_standard_layout(), b.as_standard_layout());
    let (Some(a), Some(b), Some(out)) = (a.as_slice(), b.as_slice(), c.as_slice_mut()) else { return c };
    let (a, b) = (MatRef::from_row_major_slice(a, m, k), MatRef::from_row_major_slice(b, k, n));
    matmul(MatMut::from_row_major_slice_mut(out, m, n), Accum::Replace, a, b, 1.0);
    c
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::s;

    #[test]
    fn it_is_the_sum_of_products_whatever_the_strides() {
        let a = Array2::from_shape_fn((7, 9), |(i, j)| ((3 * i + j) as f64).sin());
        let b = Array2::from_shape_fn((9, 11), |(i, j)| ((i + 5 * j) as f64).cos());
        let by_loops = |a: ArrayView2<'_, f64>, b: ArrayView2<'_, f64>| {
            Array2::from_shape_fn((a.nrows(), b.ncols()), |(i, j)| {
                (0..a.ncols()).map(|k| a[[i, k]] * b[[k, j]]).sum::<f64>()
            })
        };
        for (a, b) in [(a.view(), b.view()), (a.slice(s![1..3, ..]), b.slice(s![.., 2..;3])), (b.t(), a.t())] {
            let off: Array2<f64> = product(a, b) - by_loops(a, b);
            assert!(off.iter().all(|off| off.abs() < 1e-13));
        }
        assert_eq!(product(a.slice(s![.., ..0]), b.slice(s![..0, ..])), Array2::<f64>::zeros((7, 11)));
    }
}
