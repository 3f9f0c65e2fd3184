//! Links without most of OpenBLAS's kernels, and strips the symbols of release binaries.

use std::env;

fn main() {
    spharm_link::leave_out_kernels();
    // Cargo strips according to the profile, but not a package with its own opt-level.
    let is = |name: &str, value: &str| env::var(name).is_ok_and(|found| found == value);
    if is("PROFILE", "release") && is("DEBUG", "false") && is("CARGO_CFG_TARGET_OS", "linux") {
        println!("cargo::rustc-link-arg-bins=-Wl,--strip-all");
    }
}
