//! Versions and limits of the store format; see "Limits" and "Versions" in `store-format.md`.

/// Format version of basis files. Basis files are written in this version, and those of other versions can't be read.
pub const VERSION: u32 = 1;
/// Format version of factors. Factors are written in this version, and those of other versions can't be read.
pub const FACTOR_VERSION: u32 = 1;

/// Maximum number of rows (directions), far more than any sampling needs. The limit prevents an overflow in products of
/// the numbers in a header, such as rows times columns times bytes per value.
pub const MAX_ROWS: u64 = 1 << 40;
/// Maximum number of rows in a chunk.
pub const MAX_CHUNK_ROWS: usize = 1 << 20;
/// The number of rows in a chunk must be a multiple of this constant, so that each column of f64 values starts at a
/// multiple of 64 bytes.
pub const ROW_MULTIPLE: usize = 8;
/// Maximum number of chunks in a basis file; limits the memory of the file's table.
pub const MAX_CHUNKS: u64 = 1 << 22;
/// Maximum size of a decoded chunk in bytes.
pub const MAX_CHUNK_LEN: u64 = 1 << 32;
/// Maximum number of rows and columns of a factor's tiles, which are square. The number is a multiple of 8.
pub const MAX_TILE: usize = 1024;
/// Maximum number of tiles in a factor; limits the memory of the factor's table.
pub const MAX_TILES: u64 = 1 << 22;
