//! For build scripts of what is installed: leaves out most of the kernels that OpenBLAS carries.
//!
//! # Processors
//!
//! Debian's static OpenBLAS chooses among twenty processors' kernels at run time, which are 40 of its 55 MB. Each set
//! hangs on one table, `gotoblas_NAME`, that the choice points to. Where the table is linked as another name of an
//! older processor's, its kernels are dropped, and what is installed still runs everywhere: each processor gets the
//! best of the sets that stay and that it can execute. Processors without AVX2, of before 2013, lose speed in large
//! factors.
//!
//! # Precisions
//!
//! The table has the kernels of all precisions, and what calls them here are `dgemm`, `dsyrk`, `dtrsm`, `ddot` and
//! `dpotrf` alone. Those of single precision and of complex numbers, four fifths of what is left, are linked as address
//! 0: a call of one would end the process at once. `tests/linked.rs` sees to it that nothing is linked into the program
//! that calls them; the Python extension has no other callers of BLAS than the program (`crates/solver/src/blas.rs`).

#![forbid(unsafe_code)]

use std::collections::BTreeSet;
use std::env;
use std::fs;
use std::path::PathBuf;

/// Tables that are left out, and the one that serves their processors.
const SERVED_BY: [(&str, &[&str]); 3] = [
    // Without AVX2 and FMA: what a processor of 64 bits has had since 2004.
    (
        "PRESCOTT",
        &[
            "OPTERON",
            "OPTERON_SSE3",
            "BARCELONA",
            "BOBCAT",
            "ATOM",
            "NANO",
            "CORE2",
            "PENRYN",
            "DUNNINGTON",
            "NEHALEM",
            "SANDYBRIDGE",
            "BULLDOZER",
            "PILEDRIVER",
            "STEAMROLLER",
        ],
    ),
    // With AVX2 and FMA: the same kernels.
    ("HASWELL", &["ZEN", "EXCAVATOR"]),
    // With AVX-512; what the other has besides is bfloat16.
    ("SKYLAKEX", &["COOPERLAKE"]),
];

/// Is set where the linker is zig's.
const ZIG: &str = "CARGO_ZIGBUILD_TARGET";

/// Tells Cargo how to link the package whose build script calls this, where the feature `openblas-system` is on.
pub fn leave_out_kernels() {
    println!("cargo::rerun-if-env-changed=CARGO_ENCODED_RUSTFLAGS");
    println!("cargo::rerun-if-env-changed={ZIG}");
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
    if !SERVED_BY.iter().all(|(by, _)| has(by)) {
        return;
    }
    let names = SERVED_BY.iter().flat_map(|(by, left_out)| left_out.iter().map(move |table| (table, by)));
    let mut script: String = names.map(|(table, by)| format!("gotoblas_{table} = gotoblas_{by};\n")).collect();
    script.extend(other_precisions(&library).iter().map(|kernel| format!("{kernel} = 0;\n")));
    let path = PathBuf::from(env::var_os("OUT_DIR").unwrap_or_default()).join("kernels.ld");
    if fs::write(&path, script).is_err() {
        return;
    }
    // A text file among the objects is more of the linker's script, but zig wants to be told.
    let option = if env::var_os(ZIG).is_some() { "-Wl,-T," } else { "" };
    println!("cargo::rustc-link-arg={option}{}", path.display());
}

/// The kernels of other numbers than f64, for the processors that have some: names as in `strmm_kernel_LN_HASWELL` that
/// begin with s, c or z for their numbers, or with i for the place of one of these.
fn other_precisions(library: &[u8]) -> BTreeSet<&str> {
    let is_other = |name: &str| {
        let numbers = name.strip_prefix('i').unwrap_or(name);
        let processor = SERVED_BY.iter().any(|(by, _)| name.strip_suffix(by).is_some_and(|name| name.ends_with('_')));
        processor && numbers.starts_with(['s', 'c', 'z'])
    };
    // What a name is, is between zeros in the tables of the objects' names.
    let words = library.split(|&byte| byte == 0).filter_map(|word| std::str::from_utf8(word).ok());
    words.filter(|word| word.len() < 64 && word.bytes().all(is_of_a_name) && is_other(word)).collect()
}

fn is_of_a_name(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || byte == b'_'
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
