//! The header: 4,096 bytes at the start of every `A_<l>`.
//!
//! Offsets follow "Header" in `store-format.md`; a committed file is held against them byte by byte in the tests.

use std::path::Path;

use crate::StoreError;
use crate::bytes::{u32_at, u64_at};
use crate::codec::Codec;
use crate::scheme::{Scalar, SchemeKey};

/// The format version written, and the only one read.
pub const VERSION: u32 = 1;
/// Length of the header: a page, so that the first chunk is page-aligned.
pub const HEADER_LEN: usize = 4096;
/// Chunks start at multiples of this.
pub const ALIGNMENT: u64 = 64;
/// Most rows that a chunk may have.
pub const MAX_CHUNK_ROWS: usize = 1 << 20;
/// Rows of a chunk are a multiple of this, so that columns of f64 start at multiples of 64 bytes.
pub const ROW_MULTIPLE: usize = 8;
/// Most chunks that a file may have: bounds the memory that a table takes.
pub const MAX_CHUNKS: u64 = 1 << 22;
/// Most bytes that a chunk may have once decoded.
pub const MAX_CHUNK_LEN: u64 = 1 << 32;
/// Most rows: beyond what a file can hold, and below that no product of the header's numbers overflows.
pub const MAX_ROWS: u64 = 1 << 40;

const MAGIC: [u8; 8] = *b"\x89SPH\r\n\x1a\n";

pub(crate) const MAGIC_AT: usize = 0;
pub(crate) const VERSION_AT: usize = MAGIC_AT + 8;
pub(crate) const HEADER_LEN_AT: usize = VERSION_AT + 4;
pub(crate) const KEY_AT: usize = HEADER_LEN_AT + 4;
const ROWS_AT: usize = KEY_AT + 32;
const DEGREE_AT: usize = ROWS_AT + 8;
const COLUMNS_AT: usize = DEGREE_AT + 4;
const SCALAR_AT: usize = COLUMNS_AT + 4;
const CODEC_AT: usize = SCALAR_AT + 4;
const CHUNK_ROWS_AT: usize = CODEC_AT + 4;
const CHUNK_COUNT_AT: usize = CHUNK_ROWS_AT + 8;
const RESERVED_AT: usize = CHUNK_COUNT_AT + 8;
pub(crate) const HASH_AT: usize = HEADER_LEN - 32;

/// Checks what the headers of all kinds of files have alike: magic, version, hash, length, and that what is reserved, from
/// `reserved_at` to the hash, is zero.
pub(crate) fn check_frame(
    bytes: &[u8; HEADER_LEN],
    magic: [u8; 8],
    version: u32,
    reserved_at: usize,
    path: &Path,
) -> Result<(), StoreError> {
    let corrupt = |what, expected: &dyn ToString, found: &dyn ToString| {
        StoreError::corrupt(path, what, expected.to_string(), found.to_string())
    };
    if bytes[..8] != magic {
        return Err(corrupt("magic number", &magic.escape_ascii(), &bytes[..8].escape_ascii()));
    }
    let found = u32_at(bytes, VERSION_AT);
    if found != version {
        return Err(StoreError::Version { path: path.to_path_buf(), found });
    }
    if blake3::hash(&bytes[..HASH_AT]).as_bytes() != &bytes[HASH_AT..] {
        return Err(corrupt("header", &"bytes that fit its hash", &"others"));
    }
    let header_len = u32_at(bytes, HEADER_LEN_AT);
    if header_len as usize != HEADER_LEN {
        return Err(corrupt("header length", &HEADER_LEN, &header_len));
    }
    if bytes[reserved_at..HASH_AT].iter().any(|&b| b != 0) {
        return Err(corrupt("reserved bytes", &"zeros", &"others"));
    }
    Ok(())
}

/// What one file holds: block `A_l` of a scheme, (rows, 2 l + 1).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Header {
    /// The sampling scheme.
    pub key: SchemeKey,
    /// Number of directions, n.
    pub rows: usize,
    /// Degree, l.
    pub degree: usize,
    /// Scalar type of the values.
    pub scalar: Scalar,
    /// Codec that the file was written with; a chunk that doesn't shrink is stored raw all the same.
    pub codec: Codec,
    /// Rows of every chunk but the last.
    pub chunk_rows: usize,
}

impl Header {
    /// Whether the numbers keep to the bounds of the format.
    pub(crate) fn is_within_bounds(&self) -> bool {
        let chunk_len = (self.chunk_rows * self.columns() * self.scalar.size()) as u64;
        self.rows as u64 <= MAX_ROWS && self.chunk_count() as u64 <= MAX_CHUNKS && chunk_len <= MAX_CHUNK_LEN
    }

    /// Number of columns, `2 l + 1`.
    pub fn columns(&self) -> usize {
        2 * self.degree + 1
    }

    /// Number of chunks.
    pub fn chunk_count(&self) -> usize {
        self.rows.div_ceil(self.chunk_rows)
    }

    /// Rows of a chunk, as a range.
    pub fn chunk_range(&self, chunk: usize) -> std::ops::Range<usize> {
        let start = (chunk * self.chunk_rows).min(self.rows);
        start..(start + self.chunk_rows).min(self.rows)
    }

    /// Bytes of a chunk when decoded.
    pub fn raw_len(&self, chunk: usize) -> usize {
        self.chunk_range(chunk).len() * self.columns() * self.scalar.size()
    }

    /// Offset of a chunk in a file whose chunks are all raw.
    pub(crate) fn raw_offset(&self, chunk: usize) -> u64 {
        let full = (self.chunk_rows * self.columns() * self.scalar.size()) as u64;
        HEADER_LEN as u64 + chunk as u64 * full.next_multiple_of(ALIGNMENT)
    }

    pub(crate) fn encode(&self) -> Vec<u8> {
        let mut bytes = vec![0; HEADER_LEN];
        let mut put = |at: usize, value: &[u8]| bytes[at..at + value.len()].copy_from_slice(value);
        put(MAGIC_AT, &MAGIC);
        put(VERSION_AT, &VERSION.to_le_bytes());
        put(HEADER_LEN_AT, &(HEADER_LEN as u32).to_le_bytes());
        put(KEY_AT, &self.key.0);
        put(ROWS_AT, &(self.rows as u64).to_le_bytes());
        put(DEGREE_AT, &(self.degree as u32).to_le_bytes());
        put(COLUMNS_AT, &(self.columns() as u32).to_le_bytes());
        put(SCALAR_AT, &self.scalar.code().to_le_bytes());
        put(CODEC_AT, &self.codec.code().to_le_bytes());
        put(CHUNK_ROWS_AT, &(self.chunk_rows as u64).to_le_bytes());
        put(CHUNK_COUNT_AT, &(self.chunk_count() as u64).to_le_bytes());
        let hash = blake3::hash(&bytes[..HASH_AT]);
        bytes[HASH_AT..].copy_from_slice(hash.as_bytes());
        bytes
    }

    /// Reads a header; every number is checked before it is used.
    pub(crate) fn decode(bytes: &[u8; HEADER_LEN], path: &Path) -> Result<Self, StoreError> {
        let corrupt = |what, expected: &dyn ToString, found: &dyn ToString| {
            StoreError::corrupt(path, what, expected.to_string(), found.to_string())
        };
        check_frame(bytes, MAGIC, VERSION, RESERVED_AT, path)?;
        let mut key = [0; 32];
        key.copy_from_slice(&bytes[KEY_AT..KEY_AT + 32]);
        let degree = u32_at(bytes, DEGREE_AT) as usize;
        if degree > spharm_harmonics::MAX_DEGREE {
            return Err(corrupt("degree", &format!("at most {}", spharm_harmonics::MAX_DEGREE), &degree));
        }
        let columns = u32_at(bytes, COLUMNS_AT) as usize;
        if columns != 2 * degree + 1 {
            return Err(corrupt("columns", &(2 * degree + 1), &columns));
        }
        let scalar = u32_at(bytes, SCALAR_AT);
        let scalar = Scalar::from_code(scalar).ok_or_else(|| corrupt("scalar type", &"1 (f64) or 2 (f32)", &scalar))?;
        let codec = u32_at(bytes, CODEC_AT);
        let codec = Codec::from_code(codec).ok_or_else(|| corrupt("codec", &"0 (none) or 1 (zstd)", &codec))?;
        let chunk_rows = u64_at(bytes, CHUNK_ROWS_AT);
        if chunk_rows == 0 || chunk_rows > MAX_CHUNK_ROWS as u64 || !chunk_rows.is_multiple_of(ROW_MULTIPLE as u64) {
            let expected = format!("a multiple of {ROW_MULTIPLE} up to {MAX_CHUNK_ROWS}");
            return Err(corrupt("rows a chunk", &expected, &chunk_rows));
        }
        let chunk_rows = chunk_rows as usize;
        if (chunk_rows * columns * scalar.size()) as u64 > MAX_CHUNK_LEN {
            return Err(corrupt("chunk size", &format!("at most {MAX_CHUNK_LEN} bytes"), &(chunk_rows * columns)));
        }
        let rows = u64_at(bytes, ROWS_AT);
        if rows == 0 || rows > MAX_ROWS {
            return Err(corrupt("rows", &"1 to 2^40", &rows));
        }
        let header = Self { key: SchemeKey(key), rows: rows as usize, degree, scalar, codec, chunk_rows };
        let chunk_count = u64_at(bytes, CHUNK_COUNT_AT);
        if chunk_count > MAX_CHUNKS {
            return Err(corrupt("number of chunks", &format!("at most {MAX_CHUNKS}"), &chunk_count));
        }
        if chunk_count != header.chunk_count() as u64 {
            return Err(corrupt("number of chunks", &header.chunk_count(), &chunk_count));
        }
        Ok(header)
    }
}
