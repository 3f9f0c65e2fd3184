//! Selects the OpenBLAS that spharm-rs links; this crate has no code of its own.
//!
//! With the feature `system` it is the distribution's static library (`libopenblas-dev` on Debian and Ubuntu), found in
//! the folders listed in `.cargo/config.toml` for each target. Without it OpenBLAS 0.3.20 is compiled from the source
//! in the crate `openblas-src`.
//!
//! The only LAPACK routine called is `dpotrf`, which OpenBLAS implements in C, so no Fortran library is linked.

#[cfg(all(feature = "link", target_os = "linux", target_arch = "x86_64"))]
use lax as _;
#[cfg(all(feature = "link", target_os = "linux", target_arch = "x86_64"))]
use ndarray_linalg as _;
#[cfg(all(feature = "link", target_os = "linux", target_arch = "x86_64"))]
use openblas_src as _;

/// Bytes of address space that OpenBLAS reserves for each of its worker threads: 32 MiB if built from source with the
/// `BUFFERSIZE` that `.cargo/config.toml` sets, 128 MiB as built by distributions.
///
/// The reserved memory is hardly used, but counts towards a limit on data (`ulimit -d`). If OpenBLAS can't reserve it,
/// OpenBLAS waits forever.
pub const RESERVED_PER_THREAD: usize = if cfg!(feature = "system") { 128 << 20 } else { 32 << 20 };
