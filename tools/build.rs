//! Leaves out most of OpenBLAS's kernels, and the symbols of what is installed.

use std::env;

fn main() {
    spharm_link::leave_out_kernels();
    // Cargo strips by the profile, but not a package whose opt-level is its own.
    let is = |name: &str, value: &str| env::var(name).is_ok_and(|found| found == value);
    if is("PROFILE", "release") && is("DEBUG", "false") && is("CARGO_CFG_TARGET_OS", "linux") {
        println!("cargo::rustc-link-arg-bins=-Wl,--strip-all");
    }
}
