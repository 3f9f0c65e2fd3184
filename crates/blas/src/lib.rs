//! Selects the build of OpenBLAS that spharm-rs links. This crate contains no functions.
//!
//! With the feature `system`, spharm-rs links the distribution's static library (`libopenblas-dev` on Debian and
//! Ubuntu). The file `.cargo/config.toml` lists the folders of this library for each target. Without the feature,
//! OpenBLAS 0.3.20 is compiled from the source in the crate `openblas-src`.
//!
//! The only LAPACK routine called is `dpotrf`, which OpenBLAS implements in C, so no Fortran library is linked.

#[cfg(all(feature = "link", target_os = "linux", target_arch = "x86_64"))]
use lax as _;
#[cfg(all(feature = "link", target_os = "linux", target_arch = "x86_64"))]
use ndarray_linalg as _;
#[cfg(all(feature = "link", target_os = "linux", target_arch = "x86_64"))]
use openblas_src as _;

/// Bytes of address space that OpenBLAS reserves for each of its worker threads. A build from source reserves 32 MiB,
/// because `.cargo/config.toml` sets `BUFFERSIZE`. A distribution's build reserves 128 MiB.
///
/// OpenBLAS uses little of the reserved memory, but all of it counts towards the process's limit on data (`ulimit -d`).
/// If OpenBLAS can't reserve the memory, it waits forever.
pub const RESERVED_PER_THREAD: usize = if cfg!(feature = "system") { 128 << 20 } else { 32 << 20 };
