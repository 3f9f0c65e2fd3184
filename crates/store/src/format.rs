//! Versions and limits of the format: "Limits" and "Versions" in `store-format.md`.

/// The version of basis files written, and the only one read.
pub const VERSION: u32 = 1;
/// The version of factors written, and the only one read.
pub const FACTOR_VERSION: u32 = 1;

/// Maximum number of rows (directions): more than a file can hold, and small enough that no product of a header's
/// numbers overflows.
pub const MAX_ROWS: u64 = 1 << 40;
/// Maximum number of rows in a chunk.
pub const MAX_CHUNK_ROWS: usize = 1 << 20;
/// The number of rows in a chunk is a multiple of this, so that columns of f64 start at multiples of 64 bytes.
pub const ROW_MULTIPLE: usize = 8;
/// Maximum number of chunks in a file; bounds the memory of the file's table.
pub const MAX_CHUNKS: u64 = 1 << 22;
/// Maximum size of a decoded chunk in bytes.
pub const MAX_CHUNK_LEN: u64 = 1 << 32;
/// Maximum number of rows and columns in a tile of a factor; both are multiples of 8.
pub const MAX_TILE: usize = 1024;
/// Maximum number of tiles in a factor; bounds the memory of the factor's table.
pub const MAX_TILES: u64 = 1 << 22;
