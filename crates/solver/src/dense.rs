//! The BLAS and LAPACK behind one door: every call of OpenBLAS is in this file.
//!
//! Matrices are column-major slices with a leading dimension. `unsafe` is here because cblas-sys and lapack-sys are
//! foreign functions; each wrapper checks the sizes that its function will touch. ndarray's own `dot` does twice the
//! flops of `dsyrk` on a Gram matrix, and ndarray-linalg has no condition estimate for a Cholesky factor; the
//! rank-revealing solve goes through ndarray-linalg.

#![allow(unsafe_code)]

use std::ffi::{c_char, c_int};

use cblas_sys::{CBLAS_LAYOUT, CBLAS_TRANSPOSE, CBLAS_UPLO};
use ndarray::{Array2, ShapeBuilder, s};
use ndarray_linalg::{JobSvd, SVDDC};
use spharm_harmonics::product::Matrix;

unsafe extern "C" {
    fn openblas_set_num_threads(threads: c_int);
    fn openblas_get_config() -> *const c_char;
}

/// Version, kernels and build options of OpenBLAS.
pub fn openblas() -> String {
    // SAFETY: OpenBLAS gives a text of its own that ends in a zero and stays.
    unsafe { std::ffi::CStr::from_ptr(openblas_get_config()) }.to_string_lossy().trim().to_owned()
}

/// Runs before OpenBLAS's own initialiser, which has no priority and so comes last.
#[cfg(all(target_os = "linux", target_arch = "x86_64"))]
#[used]
#[unsafe(link_section = ".init_array.00200")]
static CHOOSE_KERNELS: extern "C" fn() = choose_kernels;

/// Names the kernels that fit this processor, and one thread to begin with: threads of its own, and their buffers, come
/// when `set_blas_threads` asks for them.
///
/// OpenBLAS 0.3.20 takes processors that it doesn't know, such as the Xeons of 2023, for a Pentium 4 and runs at a fifth
/// of their speed. Whoever sets OPENBLAS_CORETYPE or OPENBLAS_NUM_THREADS knows better than this.
#[cfg(all(target_os = "linux", target_arch = "x86_64"))]
extern "C" fn choose_kernels() {
    use std::arch::is_x86_feature_detected as has;
    let wide = has!("avx512f") && has!("avx512cd") && has!("avx512bw") && has!("avx512dq") && has!("avx512vl");
    let kernels = match (wide, has!("avx2") && has!("fma")) {
        (true, _) => Some(c"SkylakeX"),
        (false, true) => Some(c"Haswell"),
        (false, false) => None,
    };
    let set = |name: &std::ffi::CStr, value: &std::ffi::CStr| {
        // SAFETY: both texts end in a zero, and no thread has been started yet that could read the environment.
        unsafe { libc::setenv(name.as_ptr(), value.as_ptr(), 0) };
    };
    if let Some(kernels) = kernels {
        set(c"OPENBLAS_CORETYPE", kernels);
    }
    set(c"OPENBLAS_NUM_THREADS", c"1");
}

/// Sets the threads of later BLAS and LAPACK calls of this process. One inside parallel regions.
pub fn set_blas_threads(threads: usize) {
    // SAFETY: OpenBLAS takes any number; it clamps it to what it was built for.
    unsafe { openblas_set_num_threads(threads.clamp(1, 1024) as c_int) };
}

pub use spharm_blas::RESERVED_PER_THREAD;

fn int(value: usize) -> c_int {
    c_int::try_from(value).unwrap_or_else(|_| panic!("a dimension of {value} is beyond a 32-bit BLAS"))
}

/// Upper triangle of `gram += block^T block`, gram (k, k) column-major. n k (k + 1) flops.
pub(crate) fn accumulate_gram(block: Matrix<'_>, gram: &mut [f64], leading: usize) {
    let k = block.columns();
    assert!(leading >= k && gram.len() >= (k.max(1) - 1) * leading + k, "Gram matrix of {k} columns");
    // SAFETY: `Matrix` has checked the block's extent, the assertion the Gram matrix's.
    unsafe {
        cblas_sys::cblas_dsyrk(
            CBLAS_LAYOUT::CblasColMajor,
            CBLAS_UPLO::CblasUpper,
            CBLAS_TRANSPOSE::CblasTrans,
            int(k),
            int(block.rows()),
            1.0,
            block.values().as_ptr(),
            int(block.leading()),
            1.0,
            gram.as_mut_ptr(),
            int(leading),
        );
    }
}

/// `out += block^T r`: out (k, c) row-major.
pub fn accumulate_adjoint(block: Matrix<'_>, r: Matrix<'_>, out: &mut [f64]) {
    let (k, c) = (block.columns(), r.columns());
    assert!(out.len() == k * c && r.rows() == block.rows(), "adjoint of {k} x {c}");
    // Row-major (k, c) is column-major (c, k): out^T += r^T block.
    // SAFETY: extents as asserted, `Matrix` has checked both factors.
    unsafe {
        cblas_sys::cblas_dgemm(
            CBLAS_LAYOUT::CblasColMajor,
            CBLAS_TRANSPOSE::CblasTrans,
            CBLAS_TRANSPOSE::CblasNoTrans,
            int(c),
            int(k),
            int(block.rows()),
            1.0,
            r.values().as_ptr(),
            int(r.leading()),
            block.values().as_ptr(),
            int(block.leading()),
            1.0,
            out.as_mut_ptr(),
            int(c),
        );
    }
}

/// `out += sign block x`: x (k, c) row-major, out (rows, c) column-major.
pub(crate) fn accumulate_synthesis(block: Matrix<'_>, x: &[f64], sign: f64, out: &mut [f64]) {
    let (rows, k) = (block.rows(), block.columns());
    assert!(k > 0 && x.len().is_multiple_of(k) && out.len() == rows * (x.len() / k), "synthesis of {rows} x {k}");
    let c = x.len() / k;
    // SAFETY: extents as asserted, `Matrix` has checked the block.
    unsafe {
        cblas_sys::cblas_dgemm(
            CBLAS_LAYOUT::CblasColMajor,
            CBLAS_TRANSPOSE::CblasNoTrans,
            CBLAS_TRANSPOSE::CblasTrans,
            int(rows),
            int(c),
            int(k),
            sign,
            block.values().as_ptr(),
            int(block.leading()),
            x.as_ptr(),
            int(c),
            1.0,
            out.as_mut_ptr(),
            int(rows),
        );
    }
}

const UPPER: c_char = b'U' as c_char;

/// Cholesky factor of a matrix (k, k) given by its upper triangle, in place. Returns an estimate of the matrix's
/// reciprocal condition number in the 1-norm, or `None` when it isn't numerically positive definite.
pub(crate) fn cholesky(matrix: &mut [f64], k: usize) -> Option<f64> {
    assert_eq!(matrix.len(), k * k, "matrix of order {k}");
    let norm = symmetric_norm(matrix, k);
    let (order, mut info) = (int(k), 0);
    // SAFETY: the matrix is k by k with leading dimension k.
    unsafe { lapack_sys::dpotrf_(&UPPER, &order, matrix.as_mut_ptr(), &order, &mut info) };
    if info != 0 || !norm.is_finite() {
        return None;
    }
    let mut reciprocal = 0.0;
    let (mut work, mut integers) = (vec![0.0; 3 * k], vec![0; k]);
    // SAFETY: work space of 3 k and k as dpocon asks for.
    unsafe {
        lapack_sys::dpocon_(
            &UPPER,
            &order,
            matrix.as_ptr(),
            &order,
            &norm,
            &mut reciprocal,
            work.as_mut_ptr(),
            integers.as_mut_ptr(),
            &mut info,
        );
    }
    (info == 0).then_some(reciprocal)
}

/// 1-norm of a symmetric matrix given by its upper triangle.
fn symmetric_norm(matrix: &[f64], k: usize) -> f64 {
    let mut sums = vec![0.0; k];
    for (j, column) in matrix.chunks_exact(k).enumerate() {
        for (i, value) in column[..=j].iter().enumerate() {
            sums[j] += value.abs();
            if i < j {
                sums[i] += value.abs();
            }
        }
    }
    // Not f64::max, which would pass over a NaN.
    sums.into_iter().fold(0.0, |m, s| if s > m || s.is_nan() { s } else { m })
}

/// Solves with a factor from [`cholesky`]: `x`, (k, c) row-major, is the right-hand side on the way in.
pub(crate) fn cholesky_solve(factor: &[f64], k: usize, x: &mut [f64]) {
    assert!(factor.len() == k * k && x.len().is_multiple_of(k), "factor of order {k}");
    let c = x.len() / k;
    let mut columns = transpose(x, k, c);
    let (order, right_hand_sides, mut info) = (int(k), int(c), 0);
    // SAFETY: factor k by k, right-hand sides k by c, as asserted.
    unsafe {
        lapack_sys::dpotrs_(
            &UPPER,
            &order,
            &right_hand_sides,
            factor.as_ptr(),
            &order,
            columns.as_mut_ptr(),
            &order,
            &mut info,
        );
    }
    assert_eq!(info, 0, "dpotrs: argument {info}");
    x.copy_from_slice(&transpose(&columns, c, k));
}

/// Row-major (rows, columns) to row-major (columns, rows).
pub(crate) fn transpose(values: &[f64], rows: usize, columns: usize) -> Vec<f64> {
    (0..rows * columns).map(|i| values[(i % rows) * columns + i / rows]).collect()
}

/// Triangular factor of a QR factorisation, in place: matrix (rows, columns) column-major; on return its first
/// `min(rows, columns)` rows hold R, with zeros below the diagonal.
pub(crate) fn triangularise(matrix: &mut [f64], rows: usize, columns: usize) {
    assert_eq!(matrix.len(), rows * columns, "matrix of {rows} x {columns}");
    let (m, n, mut info) = (int(rows), int(columns), 0);
    let mut tau = vec![0.0; rows.min(columns)];
    let (mut query, length) = (0.0, -1);
    // SAFETY: a work space query: only `query` is written to.
    unsafe {
        let a = matrix.as_mut_ptr();
        lapack_sys::dgeqrf_(&m, &n, a, &m, tau.as_mut_ptr(), &mut query, &length, &mut info);
    }
    let mut work = vec![0.0; query as usize + 1];
    let length = int(work.len());
    // SAFETY: matrix, tau and work have the sizes that dgeqrf asks for.
    unsafe {
        let a = matrix.as_mut_ptr();
        lapack_sys::dgeqrf_(&m, &n, a, &m, tau.as_mut_ptr(), work.as_mut_ptr(), &length, &mut info);
    }
    assert_eq!(info, 0, "dgeqrf: argument {info}");
    for (j, column) in matrix.chunks_exact_mut(rows).enumerate() {
        column[(j + 1).min(rows)..].fill(0.0);
    }
}

/// What LAPACK's divide and conquer SVD didn't manage, which it says rather than give a wrong answer.
#[derive(Debug, Clone, thiserror::Error)]
#[error("the singular value decomposition of a block did not converge: {0}")]
pub(crate) struct NoConvergence(String);

/// Minimum-norm least squares of `r x = z`: r (m, k), z (m, c), column-major. Singular values up to `tolerance` times
/// the largest count as zero. Returns x (k, c) row-major, the numerical rank, and the largest over the smallest singular
/// value.
pub(crate) fn minimum_norm(
    r: Vec<f64>,
    z: Vec<f64>,
    m: usize,
    tolerance: f64,
) -> Result<(Vec<f64>, usize, f64), NoConvergence> {
    let (k, c) = (r.len() / m, z.len() / m);
    let shaped = |values: Vec<f64>, columns: usize| {
        Array2::from_shape_vec((m, columns).f(), values).unwrap_or_else(|_| unreachable!("m divides both"))
    };
    let (r, z) = (shaped(r, k), shaped(z, c));
    let (left, singular, right) = r.svddc(JobSvd::Some).map_err(|error| NoConvergence(error.to_string()))?;
    let (Some(left), Some(right)) = (left, right) else { unreachable!("JobSvd::Some asks for both") };
    // Decreasing.
    let largest = singular.first().copied().unwrap_or(0.0);
    let smallest = singular.last().copied().unwrap_or(0.0);
    let rank = singular.iter().filter(|&&s| s > tolerance * largest).count();
    let mut projected = left.slice(s![.., ..rank]).t().dot(&z);
    for (mut row, singular) in projected.rows_mut().into_iter().zip(&singular) {
        row /= *singular;
    }
    let solution = right.slice(s![..rank, ..]).t().dot(&projected);
    let condition = if smallest > 0.0 { largest / smallest } else { f64::INFINITY };
    Ok((solution.as_standard_layout().iter().copied().collect(), rank, condition))
}

const LOWER: c_char = b'L' as c_char;

/// Lower Cholesky factor, in place, of a matrix (k, k) given by its lower triangle, column-major with `leading`; what is
/// above the diagonal is left as it is. Fails with the column, from 0, at which the matrix isn't positive definite.
pub(crate) fn cholesky_lower(matrix: &mut [f64], k: usize, leading: usize) -> Result<(), usize> {
    assert!(leading >= k && matrix.len() >= (k.max(1) - 1) * leading + k, "matrix of order {k}");
    let (order, stride, mut info) = (int(k), int(leading), 0);
    // SAFETY: the matrix is k by k with that leading dimension, as asserted.
    unsafe { lapack_sys::dpotrf_(&LOWER, &order, matrix.as_mut_ptr(), &stride, &mut info) };
    if info > 0 { Err(info as usize - 1) } else { Ok(()) }
}

/// `out = out C^-T`: C (k, k) lower triangular, out (rows, k) column-major with `leading`.
pub(crate) fn divide_by_transpose(c: Matrix<'_>, out: &mut [f64], rows: usize, leading: usize) {
    let k = c.columns();
    assert!(c.rows() == k && leading >= rows && out.len() >= (k.max(1) - 1) * leading + rows, "{rows} x {k}");
    // SAFETY: extents as asserted, `Matrix` has checked the triangle.
    unsafe {
        cblas_sys::cblas_dtrsm(
            CBLAS_LAYOUT::CblasColMajor,
            cblas_sys::CBLAS_SIDE::CblasRight,
            CBLAS_UPLO::CblasLower,
            CBLAS_TRANSPOSE::CblasTrans,
            cblas_sys::CBLAS_DIAG::CblasNonUnit,
            int(rows),
            int(k),
            1.0,
            c.values().as_ptr(),
            int(c.leading()),
            out.as_mut_ptr(),
            int(leading),
        );
    }
}

/// `out -= a b^T`: a (rows, k), b (columns, k), out (rows, columns) column-major with `leading`.
pub(crate) fn subtract_outer(a: Matrix<'_>, b: Matrix<'_>, out: &mut [f64], leading: usize) {
    let (rows, columns, k) = (a.rows(), b.rows(), a.columns());
    assert!(b.columns() == k && leading >= rows && out.len() >= (columns.max(1) - 1) * leading + rows, "{rows} x {k}");
    // SAFETY: extents as asserted, `Matrix` has checked both factors.
    unsafe {
        cblas_sys::cblas_dgemm(
            CBLAS_LAYOUT::CblasColMajor,
            CBLAS_TRANSPOSE::CblasNoTrans,
            CBLAS_TRANSPOSE::CblasTrans,
            int(rows),
            int(columns),
            int(k),
            -1.0,
            a.values().as_ptr(),
            int(a.leading()),
            b.values().as_ptr(),
            int(b.leading()),
            1.0,
            out.as_mut_ptr(),
            int(leading),
        );
    }
}

/// `out -= a y`, or `out -= a^T y` when `transposed`: all column-major, y and out without gaps.
fn subtract(a: Matrix<'_>, transposed: bool, y: &[f64], out: &mut [f64]) {
    let (rows, k) = if transposed { (a.columns(), a.rows()) } else { (a.rows(), a.columns()) };
    let c = y.len() / k;
    assert!(y.len() == k * c && out.len() == rows * c, "{rows} x {k} times {c} columns");
    // SAFETY: extents as asserted, `Matrix` has checked the other factor.
    unsafe {
        cblas_sys::cblas_dgemm(
            CBLAS_LAYOUT::CblasColMajor,
            if transposed { CBLAS_TRANSPOSE::CblasTrans } else { CBLAS_TRANSPOSE::CblasNoTrans },
            CBLAS_TRANSPOSE::CblasNoTrans,
            int(rows),
            int(c),
            int(k),
            -1.0,
            a.values().as_ptr(),
            int(a.leading()),
            y.as_ptr(),
            int(k),
            1.0,
            out.as_mut_ptr(),
            int(rows),
        );
    }
}

/// `out -= a y`: a (rows, k), y (k, c), out (rows, c) column-major.
pub(crate) fn subtract_product(a: Matrix<'_>, y: &[f64], out: &mut [f64]) {
    subtract(a, false, y, out);
}

/// `out -= a^T x`: a (rows, k), x (rows, c), out (k, c) column-major.
pub(crate) fn subtract_adjoint_product(a: Matrix<'_>, x: &[f64], out: &mut [f64]) {
    subtract(a, true, x, out);
}

/// `x = C^-1 x`, or `C^-T x` when `transposed`: C (k, k) lower triangular, x (k, c) column-major.
fn solve_triangle(c: Matrix<'_>, transposed: bool, x: &mut [f64]) {
    let k = c.rows();
    assert!(c.columns() == k && x.len().is_multiple_of(k), "triangle of order {k}");
    // SAFETY: extents as asserted, `Matrix` has checked the triangle.
    unsafe {
        cblas_sys::cblas_dtrsm(
            CBLAS_LAYOUT::CblasColMajor,
            cblas_sys::CBLAS_SIDE::CblasLeft,
            CBLAS_UPLO::CblasLower,
            if transposed { CBLAS_TRANSPOSE::CblasTrans } else { CBLAS_TRANSPOSE::CblasNoTrans },
            cblas_sys::CBLAS_DIAG::CblasNonUnit,
            int(k),
            int(x.len() / k),
            1.0,
            c.values().as_ptr(),
            int(c.leading()),
            x.as_mut_ptr(),
            int(k),
        );
    }
}

/// `x = C^-1 x`: C (k, k) lower triangular, x (k, c) column-major.
pub(crate) fn solve_lower(c: Matrix<'_>, x: &mut [f64]) {
    solve_triangle(c, false, x);
}

/// `x = C^-T x`.
pub(crate) fn solve_lower_transposed(c: Matrix<'_>, x: &mut [f64]) {
    solve_triangle(c, true, x);
}
