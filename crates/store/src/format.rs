//! Versions and limits of the format: "Limits" and "Versions" in `store-format.md`.

/// The version of basis files written, and the only one read.
pub const VERSION: u32 = 1;
/// The version of factors written, and the only one read.
pub const FACTOR_VERSION: u32 = 1;

/// Most rows (directions): more than a file can hold, and few enough that no product of a header's numbers overflows.
pub const MAX_ROWS: u64 = 1 << 40;
/// Most rows of a chunk.
pub const MAX_CHUNK_ROWS: usize = 1 << 20;
/// Rows of a chunk are a multiple of this, so that columns of f64 start at multiples of 64 bytes.
pub const ROW_MULTIPLE: usize = 8;
/// Most chunks of a file: bounds the memory that its table takes.
pub const MAX_CHUNKS: u64 = 1 << 22;
/// Most bytes of a decoded chunk.
pub const MAX_CHUNK_LEN: u64 = 1 << 32;
/// Most rows and columns of a factor's tile, which are a multiple of 8.
pub const MAX_TILE: usize = 1024;
/// Most tiles of a factor: bounds the memory that its table takes.
pub const MAX_TILES: u64 = 1 << 22;
