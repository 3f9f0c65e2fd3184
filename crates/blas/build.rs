//! Links libgfortran and libquadmath statically beside the distribution's OpenBLAS, whose LAPACK calls them.
//!
//! gfortran keeps both in a folder of its own, which only the compiler can name. Without gfortran they are left out, and
//! the linker says what is missing.

use std::path::{Path, PathBuf};
use std::process::Command;

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    if std::env::var_os("CARGO_FEATURE_SYSTEM").is_none() {
        return;
    }
    for name in ["gfortran", "quadmath"] {
        if let Some(folder) = folder_of(&format!("lib{name}.a")) {
            println!("cargo:rustc-link-search=native={}", folder.display());
            println!("cargo:rustc-link-lib=static={name}");
        }
    }
}

/// The folder in which the C compiler finds a static library; it prints the bare name of what it doesn't find.
fn folder_of(library: &str) -> Option<PathBuf> {
    let output = Command::new("cc").arg(format!("-print-file-name={library}")).output().ok()?;
    let path = String::from_utf8(output.stdout).ok()?;
    let path = Path::new(path.trim());
    path.is_absolute().then(|| path.parent().map(Path::to_path_buf))?
}
