//! The readers as fuzz targets; `tests/corpus.rs` includes the same files.

mod readers;

/// Gives an input to the reader of a name, in a folder of this process.
///
/// # Panics
///
/// Where the reader doesn't keep a promise.
pub fn run(name: &str, input: &[u8]) {
    // As programs do; less than the fuzzer lets a reader have.
    spharm_surface::io::ask_for_free_memory(|| 256 << 20);
    readers::run(name, readers::scratch(), input);
}
