//! Keeps most of OpenBLAS's kernels out of the linked binary. The build scripts of the installed program and of the
//! Python extension call this crate.
//!
//! # Processors
//!
//! Debian's static OpenBLAS contains kernels for twenty types of processors and chooses among them at run time. These
//! kernels take 40 MB of the library's 55 MB. The kernels for a type of processor are reachable only through one table
//! of addresses, `gotoblas_NAME`. If this table is linked as an alias of an older processor's table, the linker drops
//! the kernels of the replaced table. The installed binaries still run on every processor, because each processor uses
//! the best remaining kernels that it can execute. Only processors without AVX2, from before 2013, compute large
//! Cholesky factors more slowly.
//!
//! # Precisions
//!
//! A table contains kernels for all precisions, but spharm-rs calls only the double-precision routines `dgemm`,
//! `dsyrk`, `dtrsm`, `ddot` and `dpotrf`. The kernels for single precision and for complex numbers, four fifths of the
//! remaining kernels, are therefore linked as address 0. A call to such a kernel would crash the process immediately.
//! `tests/linked.rs` checks that the program contains no code that calls these kernels. The Python extension and the
//! program call BLAS from the same code (`crates/solver/src/threaded/openblas.rs`).

#![forbid(unsafe_code)]

mod fold;

pub use fold::fold_identical_functions;

use std::collections::BTreeSet;
use std::env;
use std::fs;
use std::path::PathBuf;

/// OpenBLAS's kernel tables that are linked. Each is followed by the tables that it replaces, which aren't linked.
const SERVED_BY: [(&str, &[&str]); 3] = [
    // Kernels without AVX2 and FMA. These kernels contain only instructions that all 64-bit processors have had since
    // 2004.
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
    // Kernels with AVX2 and FMA. The tables ZEN and EXCAVATOR contain the same kernels, and are therefore dropped.
    ("HASWELL", &["ZEN", "EXCAVATOR"]),
    // Kernels with AVX-512. Compared with the table used here, the dropped one adds only kernels for bfloat16.
    ("SKYLAKEX", &["COOPERLAKE"]),
];

/// Environment variable that is set if the linker is zig's.
const ZIG: &str = "CARGO_ZIGBUILD_TARGET";

/// Prints link instructions to Cargo for the package whose build script calls this, if the feature `openblas-system` is
/// on.
pub fn leave_out_kernels() {
    println!("cargo::rerun-if-env-changed=CARGO_ENCODED_RUSTFLAGS");
    println!("cargo::rerun-if-env-changed={ZIG}");
    let linux = env::var("CARGO_CFG_TARGET_OS").is_ok_and(|os| os == "linux");
    let x86_64 = env::var("CARGO_CFG_TARGET_ARCH").is_ok_and(|arch| arch == "x86_64");
    if !(linux && x86_64 && env::var_os("CARGO_FEATURE_OPENBLAS_SYSTEM").is_some()) {
        return;
    }
    let Some(path) = library() else {
        // Warn here, because rustc's own message appears minutes later and mentions neither the missing package nor the
        // alternative.
        println!(
            "cargo::warning=libopenblas.a was not found in the folders listed in .cargo/config.toml; if linking fails, \
             install OpenBLAS (Debian, Ubuntu: libopenblas-dev), or build without it: --no-default-features --features \
             tables"
        );
        return;
    };
    // Link the whole library if it lacks the table of kernels of one of these processors. Such a library doesn't choose
    // kernels at run time, or contains kernels for other processors.
    let Ok(library) = fs::read(path) else { return };
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
    // Most linkers treat a text file among the objects as part of the linker script, but zig's linker needs an option
    // for that file.
    let option = if env::var_os(ZIG).is_some() { "-Wl,-T," } else { "" };
    println!("cargo::rustc-link-arg={option}{}", path.display());
}

/// Returns the names of the kept processors' kernels for types other than f64. The names, such as
/// `strmm_kernel_LN_HASWELL`, begin with s, c or z for the type, or with i and one of these letters for index searches.
fn other_precisions(library: &[u8]) -> BTreeSet<&str> {
    let is_other = |name: &str| {
        let numbers = name.strip_prefix('i').unwrap_or(name);
        let processor = SERVED_BY.iter().any(|(by, _)| name.strip_suffix(by).is_some_and(|name| name.ends_with('_')));
        processor && numbers.starts_with(['s', 'c', 'z'])
    };
    // In the symbol tables of the objects, names are separated by zero bytes.
    let words = library.split(|&byte| byte == 0).filter_map(|word| std::str::from_utf8(word).ok());
    words.filter(|word| word.len() < 64 && word.bytes().all(is_of_a_name) && is_other(word)).collect()
}

fn is_of_a_name(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || byte == b'_'
}

/// Returns the path of the static OpenBLAS in the folders listed in `.cargo/config.toml`.
fn library() -> Option<PathBuf> {
    let flags = env::var("CARGO_ENCODED_RUSTFLAGS").ok()?;
    flags
        .split('\x1f')
        .filter_map(|flag| flag.strip_prefix("-Lnative=").or_else(|| flag.strip_prefix("native=")))
        .map(|folder| PathBuf::from(folder).join("libopenblas.a"))
        .find(|path| path.exists())
}
