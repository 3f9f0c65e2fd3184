//! Implements the threaded operations with OpenBLAS. All calls to OpenBLAS are in this file.
//!
//! All callers of OpenBLAS in a process share one number of threads and one set of buffers. OpenBLAS reserves
//! [`RESERVED_PER_THREAD`](ThreadedKernels::RESERVED_PER_THREAD) bytes for each calling thread and each of its worker
//! threads. Therefore only one caller at a time, the holder of an [`OpenBlas`], may use OpenBLAS.
//!
//! `unsafe` is needed because cblas-sys and lapack-sys are foreign functions; each method checks the extents that its
//! function accesses.

#![allow(unsafe_code)]

use std::ffi::{c_char, c_int};
use std::sync::{Mutex, MutexGuard, PoisonError};

use cblas_sys::{CBLAS_DIAG, CBLAS_LAYOUT, CBLAS_SIDE, CBLAS_TRANSPOSE, CBLAS_UPLO};
use spharm_harmonics::product::Matrix;

use super::{ThreadedKernels, assert_extent};

unsafe extern "C" {
    fn openblas_set_num_threads(threads: c_int);
    fn openblas_get_num_threads() -> c_int;
    fn openblas_get_config() -> *const c_char;
}

static IN_USE: Mutex<()> = Mutex::new(());

/// Exclusive use of OpenBLAS with a given number of threads. A process has at most one value of this type at a time:
/// other callers wait until the value is dropped. Dropping it restores the previous number of threads.
///
/// Don't hold this value while waiting for other threads: they may also need OpenBLAS.
#[derive(Debug)]
pub struct OpenBlas {
    threads_before: c_int,
    _only: MutexGuard<'static, ()>,
}

impl ThreadedKernels for OpenBlas {
    const RESERVED_PER_THREAD: usize = spharm_blas::RESERVED_PER_THREAD;
    /// Measured number of bytes of its buffers that a thread touches.
    const TOUCHED_PER_THREAD: usize = 34 << 20;

    /// Returns the version, kernels and build options of OpenBLAS.
    fn version() -> String {
        // SAFETY: OpenBLAS returns a static string that ends with a NUL byte.
        unsafe { std::ffi::CStr::from_ptr(openblas_get_config()) }.to_string_lossy().trim().to_owned()
    }

    /// Waits until OpenBLAS is free, and sets its number of threads to `threads`.
    fn with_threads(threads: usize) -> Self {
        let only = IN_USE.lock().unwrap_or_else(PoisonError::into_inner);
        // SAFETY: OpenBLAS accepts any number and clamps it to the maximum of its build. The lock keeps other callers
        // from changing the number in the meantime.
        let threads_before = unsafe {
            let before = openblas_get_num_threads();
            openblas_set_num_threads(threads.clamp(1, 1024) as c_int);
            before
        };
        Self { threads_before, _only: only }
    }

    fn accumulate_gram(&mut self, block: Matrix<'_>, gram: &mut [f64], leading: usize) {
        let k = block.columns();
        assert_extent(gram, k, k, leading);
        // SAFETY: `Matrix` has checked the block's extent, and the assertion has checked the Gram matrix's extent.
        unsafe {
            cblas_sys::cblas_dsyrk(
                CBLAS_LAYOUT::CblasColMajor,
                CBLAS_UPLO::CblasLower,
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

    fn cholesky(&mut self, matrix: &mut [f64], k: usize, leading: usize) -> Result<(), usize> {
        assert_extent(matrix, k, k, leading);
        const LOWER: c_char = b'L' as c_char;
        let (order, stride, mut info) = (int(k), int(leading), 0);
        // SAFETY: the assertion has checked that the slice contains a k by k matrix with this leading dimension.
        unsafe { lapack_sys::dpotrf_(&LOWER, &order, matrix.as_mut_ptr(), &stride, &mut info) };
        if info > 0 { Err(info as usize - 1) } else { Ok(()) }
    }

    fn divide_by_transpose(&mut self, c: Matrix<'_>, out: &mut [f64], rows: usize, leading: usize) {
        let k = c.columns();
        assert_eq!(c.rows(), k, "the triangle must be square");
        assert_extent(out, rows, k, leading);
        // SAFETY: the assertions have checked the extent of `out`, and `Matrix` has checked the extent of the triangle.
        unsafe {
            cblas_sys::cblas_dtrsm(
                CBLAS_LAYOUT::CblasColMajor,
                CBLAS_SIDE::CblasRight,
                CBLAS_UPLO::CblasLower,
                CBLAS_TRANSPOSE::CblasTrans,
                CBLAS_DIAG::CblasNonUnit,
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

    fn subtract_outer(&mut self, a: Matrix<'_>, b: Matrix<'_>, out: &mut [f64], leading: usize) {
        let (rows, columns, k) = (a.rows(), b.rows(), a.columns());
        assert_eq!(b.columns(), k, "both factors must have the same number of columns");
        assert_extent(out, rows, columns, leading);
        // SAFETY: the assertions have checked the extent of `out`, and `Matrix` has checked the extents of both
        // factors.
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
}

impl Drop for OpenBlas {
    fn drop(&mut self) {
        // SAFETY: OpenBLAS itself returned this number, and the lock is only released afterwards.
        unsafe { openblas_set_num_threads(self.threads_before) };
    }
}

fn int(value: usize) -> c_int {
    c_int::try_from(value).unwrap_or_else(|_| panic!("a matrix dimension of {value} is too large for a 32-bit BLAS"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn threads() -> c_int {
        // SAFETY: the function only reads a number.
        unsafe { openblas_get_num_threads() }
    }

    /// Returns OpenBLAS's number of threads, read while no other test uses OpenBLAS.
    fn threads_of_nobody() -> c_int {
        let _only = IN_USE.lock().unwrap_or_else(PoisonError::into_inner);
        threads()
    }

    #[test]
    fn the_number_of_threads_is_that_of_the_holder_and_comes_back() {
        let before = threads_of_nobody();
        {
            let _blas = OpenBlas::with_threads(2);
            assert_eq!(threads(), 2);
        }
        assert_eq!(threads_of_nobody(), before);
        let panicked = std::panic::catch_unwind(|| {
            let _blas = OpenBlas::with_threads(2);
            panic!("while it is held");
        });
        assert!(panicked.is_err());
        assert_eq!(threads_of_nobody(), before, "also after a panic");
        // A lock poisoned by a panic is still usable.
        drop(OpenBlas::with_threads(1));
    }
}
