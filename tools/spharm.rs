//! The program `spharm`.

use std::process::ExitCode;

#[cfg(all(target_os = "linux", target_env = "gnu"))]
mod allocator;
#[cfg(all(feature = "openblas", target_os = "linux", target_arch = "x86_64"))]
mod kernels;

/// The allocator of musl makes threads wait for each other: a fit at degree 100 takes half as long again.
#[cfg(target_env = "musl")]
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    allocator::keep_freed(std::env::args_os());
    ExitCode::from(spharm_tools::main(std::env::args_os()))
}
