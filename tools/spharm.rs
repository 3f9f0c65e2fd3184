//! The program `spharm`.

use std::process::ExitCode;

#[cfg(all(feature = "openblas", target_os = "linux", target_arch = "x86_64"))]
mod kernels;

/// Replaces musl's allocator, which makes threads wait for each other. With musl's allocator, a fit at degree 100 takes
/// 1.5 times as long.
#[cfg(target_env = "musl")]
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

#[cfg(all(target_os = "linux", target_env = "gnu"))]
#[global_allocator]
static ALLOCATOR: spharm_tools::allocator::LargePages = spharm_tools::allocator::LargePages;

fn main() -> ExitCode {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    spharm_tools::allocator::keep_freed(std::env::args_os());
    ExitCode::from(spharm_tools::main(std::env::args_os()))
}
