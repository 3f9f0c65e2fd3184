//! The choice of the OpenBLAS that spharm-rs links; it has no code of its own.
//!
//! With the feature `system` it is the distribution's static library (`libopenblas-dev` on Debian and Ubuntu), found in
//! the folders that `.cargo/config.toml` names for each target. Without it OpenBLAS 0.3.20 is compiled from the source
//! that the crate `openblas-src` carries.
//!
//! Of its LAPACK only `dpotrf` is called, which OpenBLAS has in C; so no Fortran library is linked.

use lax as _;
use ndarray_linalg as _;
use openblas_src as _;

/// Bytes of address space that OpenBLAS reserves for each thread that works for it: 32 MiB as built from source with
/// `BUFFERSIZE` of `.cargo/config.toml`, 128 MiB as distributions build it.
///
/// They are hardly touched, but they count against a limit on data (`ulimit -d`), and OpenBLAS waits for ever when it
/// can't have them.
pub const RESERVED_PER_THREAD: usize = if cfg!(feature = "system") { 128 << 20 } else { 32 << 20 };
