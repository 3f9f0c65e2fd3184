//! Provides the readers as fuzz targets; `tests/corpus.rs` includes the same source files.

mod readers;

/// Passes an input to the reader called `name`, which writes files to a folder of this process.
///
/// # Panics
///
/// If the reader's result violates one of the reader's guarantees.
pub fn run(name: &str, input: &[u8]) {
    // Programs set such a limit of memory too. It is below the fuzzer's own limit, so that readers refuse large files
    // first.
    spharm_surface::io::ask_for_free_memory(|| 256 << 20);
    readers::run(name, readers::scratch(), input);
}
