//! Build script: leaves most of OpenBLAS's kernels out of the program, merges identical functions, and strips the
//! symbols of release binaries.

use std::env;

fn main() {
    spharm_link::leave_out_kernels();
    spharm_link::fold_identical_functions();
    // Cargo doesn't strip symbols as the profile requests if a package has its own opt-level, as this package has.
    // Therefore, the linker strips them.
    let is = |name: &str, value: &str| env::var(name).is_ok_and(|found| found == value);
    let gnu_linker = is("CARGO_CFG_TARGET_OS", "linux") || is("CARGO_CFG_TARGET_ENV", "gnu");
    if is("PROFILE", "release") && is("DEBUG", "false") && gnu_linker {
        println!("cargo::rustc-link-arg-bins=-Wl,--strip-all");
    }
}
