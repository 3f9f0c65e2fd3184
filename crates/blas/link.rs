//! Build script of what is installed: leaves out the kernels that OpenBLAS carries for processors of before 2011.
//!
//! Debian's static OpenBLAS chooses among twenty processors' kernels at run time, which are 40 of its 55 MB. Each set
//! hangs on one table, `gotoblas_NAME`, that the choice points to. Linked as another name of an older processor's table,
//! a newer one's kernels are dropped, and the program still runs wherever it ran: every processor gets the best of the
//! sets that stay and that it can execute.

use std::env;
use std::fs;
use std::path::PathBuf;

/// A table that is left out, and the one that serves its processors.
const SERVED_BY: [(&str, &str); 15] = [
    // SSE3 and no AVX.
    ("OPTERON", "PRESCOTT"),
    ("OPTERON_SSE3", "PRESCOTT"),
    ("BARCELONA", "PRESCOTT"),
    ("BOBCAT", "PRESCOTT"),
    ("ATOM", "PRESCOTT"),
    ("NANO", "PRESCOTT"),
    ("CORE2", "PRESCOTT"),
    ("PENRYN", "PRESCOTT"),
    ("DUNNINGTON", "PRESCOTT"),
    ("NEHALEM", "PRESCOTT"),
    // AVX and no AVX2.
    ("BULLDOZER", "SANDYBRIDGE"),
    ("PILEDRIVER", "SANDYBRIDGE"),
    ("STEAMROLLER", "SANDYBRIDGE"),
    ("EXCAVATOR", "SANDYBRIDGE"),
    // AVX-512; what it has besides is bfloat16.
    ("COOPERLAKE", "SKYLAKEX"),
];

fn main() {
    println!("cargo::rerun-if-changed=crates/blas/link.rs");
    println!("cargo::rerun-if-env-changed=CARGO_ENCODED_RUSTFLAGS");
    let linux = env::var("CARGO_CFG_TARGET_OS").is_ok_and(|os| os == "linux");
    let x86_64 = env::var("CARGO_CFG_TARGET_ARCH").is_ok_and(|arch| arch == "x86_64");
    if !(linux && x86_64 && env::var_os("CARGO_FEATURE_OPENBLAS_SYSTEM").is_some()) {
        return;
    }
    // Of a library without run-time choice, or with another list, nothing is left out.
    let Some(library) = library().and_then(|path| fs::read(path).ok()) else { return };
    let has = |processor: &str| {
        let table = format!("\0gotoblas_{processor}\0");
        library.windows(table.len()).any(|bytes| bytes == table.as_bytes())
    };
    let kept = ["PRESCOTT", "SANDYBRIDGE", "SKYLAKEX"];
    if kept.into_iter().all(has) {
        for (left_out, by) in SERVED_BY {
            println!("cargo::rustc-link-arg=-Wl,--defsym=gotoblas_{left_out}=gotoblas_{by}");
        }
    }
}

/// The static OpenBLAS in the folders that `.cargo/config.toml` names.
fn library() -> Option<PathBuf> {
    let flags = env::var("CARGO_ENCODED_RUSTFLAGS").ok()?;
    flags
        .split('\x1f')
        .filter_map(|flag| flag.strip_prefix("-Lnative=").or_else(|| flag.strip_prefix("native=")))
        .map(|folder| PathBuf::from(folder).join("libopenblas.a"))
        .find(|path| path.exists())
}
