//! Dense operations on matrices that are large enough for several threads to pay off.
//!
//! [`ThreadedKernels`] lists the operations, and [`Kernels`] is the implementation that the build chooses: OpenBLAS
//! with the feature `openblas` on Linux for x86-64, otherwise faer, which is written entirely in Rust. In either case,
//! the module `dense` uses faer on the calling thread for small matrices, and for threads that each process their own
//! matrices.
//!
//! Matrices are column-major slices with a leading dimension. Rows are counted from 0.

use spharm_harmonics::product::Matrix;

pub mod faer;
#[cfg(all(feature = "openblas", target_os = "linux", target_arch = "x86_64"))]
pub mod openblas;

#[cfg(not(all(feature = "openblas", target_os = "linux", target_arch = "x86_64")))]
pub use faer::Faer as Kernels;
#[cfg(all(feature = "openblas", target_os = "linux", target_arch = "x86_64"))]
pub use openblas::OpenBlas as Kernels;

/// The four dense operations that Cholesky factors and wide blocks need, on several threads.
pub trait ThreadedKernels: Sized {
    /// Bytes of address space that the library reserves per thread in addition to the bytes that it touches. These
    /// bytes count towards limits on data and address space (`ulimit -d`, `ulimit -v`).
    const RESERVED_PER_THREAD: usize;
    /// Bytes of buffers that a thread touches while it works on large matrices.
    const TOUCHED_PER_THREAD: usize;

    /// Returns the name and version of the library, for reports.
    fn version() -> String;

    /// Prepares the operations for `threads` threads.
    fn with_threads(threads: usize) -> Self;

    /// Computes the lower triangle of `gram += block^T block`: block (n, k), gram (k, k) column-major with leading
    /// dimension `leading`. Takes `n k (k + 1)` flops.
    ///
    /// # Panics
    ///
    /// If the shapes don't match.
    fn accumulate_gram(&mut self, block: Matrix<'_>, gram: &mut [f64], leading: usize);

    /// Computes the lower Cholesky factor, in place, of a matrix (k, k) given by its lower triangle, column-major with
    /// leading dimension `leading`. Entries above the diagonal are unspecified afterwards. Takes `k^3 / 3` flops.
    ///
    /// # Errors
    ///
    /// Returns the column at which the matrix isn't positive definite. A NaN isn't always detected.
    ///
    /// # Panics
    ///
    /// If the shapes don't match.
    fn cholesky(&mut self, matrix: &mut [f64], k: usize, leading: usize) -> Result<(), usize>;

    /// Computes `out = out C^-T`: C (k, k) lower triangular, out (rows, k) column-major with leading dimension
    /// `leading`. Takes `rows k^2` flops.
    ///
    /// # Panics
    ///
    /// If the shapes don't match.
    fn divide_by_transpose(&mut self, c: Matrix<'_>, out: &mut [f64], rows: usize, leading: usize);

    /// Computes `out -= a b^T`: a (rows, k), b (columns, k), out (rows, columns) column-major with leading dimension
    /// `leading`. Takes `2 rows columns k` flops.
    ///
    /// # Panics
    ///
    /// If the shapes don't match.
    fn subtract_outer(&mut self, a: Matrix<'_>, b: Matrix<'_>, out: &mut [f64], leading: usize);
}

/// Asserts that a column-major slice with `leading` values per column contains a matrix (rows, columns).
fn assert_extent(values: &[f64], rows: usize, columns: usize, leading: usize) {
    let needed = if columns == 0 { 0 } else { (columns - 1) * leading + rows };
    assert!(
        leading >= rows && values.len() >= needed,
        "a matrix of {rows} x {columns} with leading dimension {leading} needs {needed} values, found {}",
        values.len()
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns `count` pseudorandom values in [-1, 1], always the same.
    fn noise(count: usize, seed: u64) -> Vec<f64> {
        let mixed = |i: u64| (i + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15 ^ seed).rotate_left(29);
        (0..count as u64)
            .map(|i| mixed(i).wrapping_mul(0xbf58_476d_1ce4_e5b9) as i64 as f64 / i64::MAX as f64)
            .collect()
    }

    /// Matrix sizes for the tests: below, at and above the tile size of [`faer`], and one size that needs several
    /// levels of halving.
    const SIZES: [usize; 5] = [1, 37, 256, 300, 1100];
    const PADDING: usize = 3;

    fn operations_are_the_sums_written_out<K: ThreadedKernels>(threads: usize) {
        for k in SIZES {
            let leading = k + PADDING;
            // Check a Gram matrix: its lower triangle is summed, and all other values are unchanged.
            let rows = k + 5;
            let block = noise(rows * k, 1);
            let start = noise(leading * k, 2);
            let mut gram = start.clone();
            K::with_threads(threads).accumulate_gram(Matrix::new(&block, rows, k, rows), &mut gram, leading);
            let dot = |i: usize, j: usize| -> f64 {
                block[i * rows..][..rows].iter().zip(&block[j * rows..][..rows]).map(|(a, b)| a * b).sum()
            };
            for j in (0..k).step_by(1 + k / 40) {
                for i in 0..leading {
                    let expected = start[j * leading + i] + if (j..k).contains(&i) { dot(i, j) } else { 0.0 };
                    assert!((gram[j * leading + i] - expected).abs() < 1e-11, "Gram matrix of {k}: {i}, {j}");
                }
            }
            // Check the factor of a positive definite matrix: the product of the factor and its transpose is the
            // matrix.
            let diagonal = 2.0 * k as f64;
            (0..k).for_each(|j| gram[j * leading + j] += diagonal);
            let mut factor = gram.clone();
            K::with_threads(threads).cholesky(&mut factor, k, leading).expect("positive definite");
            for j in (0..k).step_by(1 + k / 40) {
                for i in j..k {
                    let product: f64 = (0..=j).map(|l| factor[l * leading + i] * factor[l * leading + j]).sum();
                    assert!((product - gram[j * leading + i]).abs() < 1e-10 * diagonal, "factor of {k}: {i}, {j}");
                }
            }
            let right = noise(rows * k, 3);
            let mut solved = right.clone();
            let triangle = Matrix::new(&factor, k, k, leading);
            K::with_threads(threads).divide_by_transpose(triangle, &mut solved, rows, rows);
            // The solution times C^T is the right-hand side, so subtracting this product by `subtract_outer` leaves
            // zeros. The factor's upper triangle isn't part of C.
            let mut c = factor.clone();
            (0..k).for_each(|j| c[j * leading..][..j].fill(0.0));
            let mut left = right.clone();
            let (solved, c) = (Matrix::new(&solved, rows, k, rows), Matrix::new(&c, k, k, leading));
            K::with_threads(threads).subtract_outer(solved, c, &mut left, rows);
            assert!(left.iter().all(|value| value.abs() < 1e-12), "solution of {k}");
        }
    }

    fn the_column_of_a_failure_is_named<K: ThreadedKernels>() {
        for (k, column) in [(1, 0), (40, 7), (700, 0), (700, 299), (700, 699)] {
            let mut matrix = vec![0.0; k * k];
            (0..k).for_each(|j| matrix[j * k + j] = if j == column { -1.0 } else { 1.0 });
            assert_eq!(K::with_threads(2).cholesky(&mut matrix, k, k), Err(column), "order {k}");
        }
    }

    #[test]
    fn the_chosen_kernels_compute_the_sums_written_out() {
        operations_are_the_sums_written_out::<Kernels>(1);
        operations_are_the_sums_written_out::<Kernels>(2);
        the_column_of_a_failure_is_named::<Kernels>();
    }

    #[test]
    fn faer_computes_the_sums_written_out() {
        operations_are_the_sums_written_out::<faer::Faer>(1);
        operations_are_the_sums_written_out::<faer::Faer>(2);
        the_column_of_a_failure_is_named::<faer::Faer>();
    }
}
