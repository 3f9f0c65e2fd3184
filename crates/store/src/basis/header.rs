//! Encodes and decodes the header of a basis file; see "Header" in `store-format.md`.
//!
//! A test compares the encoded header with a committed file byte by byte.

use std::ops::Range;
use std::path::Path;

use crate::bytes::{hash_at, put, u32_at, u64_at};
use crate::container::codec::Codec;
use crate::container::frame::{ALIGNMENT, Contents, FIELDS_AT, HEADER_LEN, HeaderBytes, Kind};
use crate::error::StoreError;
use crate::format::{MAX_CHUNK_LEN, MAX_CHUNK_ROWS, MAX_CHUNKS, MAX_ROWS, ROW_MULTIPLE, VERSION};
use crate::scheme::{Scalar, SchemeKey};

const KEY_AT: usize = FIELDS_AT;
const ROWS_AT: usize = KEY_AT + 32;
const DEGREE_AT: usize = ROWS_AT + 8;
const COLUMNS_AT: usize = DEGREE_AT + 4;
const SCALAR_AT: usize = COLUMNS_AT + 4;
const CODEC_AT: usize = SCALAR_AT + 4;
const CHUNK_ROWS_AT: usize = CODEC_AT + 4;
const CHUNK_COUNT_AT: usize = CHUNK_ROWS_AT + 8;
const RESERVED_AT: usize = CHUNK_COUNT_AT + 8;

/// Header of a basis file. The file holds the matrix `A_l` (rows, 2 l + 1) of a scheme.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Header {
    /// Key of the sampling scheme.
    pub key: SchemeKey,
    /// Number of directions, n.
    pub rows: usize,
    /// Degree, l.
    pub degree: usize,
    /// Scalar type of the values.
    pub scalar: Scalar,
    /// Codec of the file. A chunk that compression doesn't make smaller is stored raw.
    pub codec: Codec,
    /// Number of rows in every chunk except the last, which may have fewer.
    pub chunk_rows: usize,
}

impl Header {
    /// Returns whether the file's numbers of rows and chunks and its chunk size are within the limits of the format.
    pub(crate) fn is_within_limits(&self) -> bool {
        let chunk_len = (self.chunk_rows * self.columns() * self.scalar.size()) as u64;
        self.rows as u64 <= MAX_ROWS && self.chunk_count() as u64 <= MAX_CHUNKS && chunk_len <= MAX_CHUNK_LEN
    }

    /// Returns the number of columns, `2 l + 1`.
    pub fn columns(&self) -> usize {
        2 * self.degree + 1
    }

    /// Returns the number of chunks.
    pub fn chunk_count(&self) -> usize {
        self.rows.div_ceil(self.chunk_rows)
    }

    /// Returns the range of rows in a chunk.
    pub fn chunk_range(&self, chunk: usize) -> Range<usize> {
        let start = (chunk * self.chunk_rows).min(self.rows);
        start..(start + self.chunk_rows).min(self.rows)
    }

    /// Returns the size of a decoded chunk in bytes.
    pub fn raw_len(&self, chunk: usize) -> usize {
        self.chunk_range(chunk).len() * self.columns() * self.scalar.size()
    }

    /// Returns the offset in bytes of a chunk in a file whose chunks are all stored raw.
    pub(crate) fn raw_offset(&self, chunk: usize) -> u64 {
        let full = (self.chunk_rows * self.columns() * self.scalar.size()) as u64;
        HEADER_LEN as u64 + chunk as u64 * full.next_multiple_of(ALIGNMENT)
    }
}

impl Contents for Header {
    const KIND: Kind = Kind {
        magic: *b"\x89SPH\r\n\x1a\n",
        version: VERSION,
        reserved_at: RESERVED_AT,
        root_context: "spharm-rs 2026-11 basis file root v1",
        part: "chunk",
    };

    fn encode_fields(&self, header: &mut HeaderBytes) {
        put(header, KEY_AT, &self.key.0);
        put(header, ROWS_AT, &(self.rows as u64).to_le_bytes());
        put(header, DEGREE_AT, &(self.degree as u32).to_le_bytes());
        put(header, COLUMNS_AT, &(self.columns() as u32).to_le_bytes());
        put(header, SCALAR_AT, &self.scalar.code().to_le_bytes());
        put(header, CODEC_AT, &self.codec.code().to_le_bytes());
        put(header, CHUNK_ROWS_AT, &(self.chunk_rows as u64).to_le_bytes());
        put(header, CHUNK_COUNT_AT, &(self.chunk_count() as u64).to_le_bytes());
    }

    fn decode_fields(bytes: &HeaderBytes, path: &Path) -> Result<Self, StoreError> {
        let corrupt = |what, expected: &dyn ToString, found: &dyn ToString| {
            StoreError::corrupt(path, what, expected.to_string(), found.to_string())
        };
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
            return Err(corrupt("rows per chunk", &expected, &chunk_rows));
        }
        let chunk_rows = chunk_rows as usize;
        let chunk_len = (chunk_rows * columns * scalar.size()) as u64;
        if chunk_len > MAX_CHUNK_LEN {
            return Err(corrupt(
                "chunk size",
                &format!("at most {MAX_CHUNK_LEN} bytes"),
                &format!("{chunk_len} bytes"),
            ));
        }
        let rows = u64_at(bytes, ROWS_AT);
        if rows == 0 || rows > MAX_ROWS {
            return Err(corrupt("rows", &"1 to 2^40", &rows));
        }
        let key = SchemeKey(hash_at(bytes, KEY_AT));
        let header = Self { key, rows: rows as usize, degree, scalar, codec, chunk_rows };
        let chunk_count = u64_at(bytes, CHUNK_COUNT_AT);
        if chunk_count > MAX_CHUNKS {
            return Err(corrupt("number of chunks", &format!("at most {MAX_CHUNKS}"), &chunk_count));
        }
        if chunk_count != header.chunk_count() as u64 {
            return Err(corrupt("number of chunks", &header.chunk_count(), &chunk_count));
        }
        Ok(header)
    }

    fn parts(&self) -> usize {
        self.chunk_count()
    }

    fn raw_len(&self, part: usize) -> usize {
        self.raw_len(part)
    }

    fn codec(&self) -> Codec {
        self.codec
    }

    fn damaged(&self, path: &Path, part: usize, what: &'static str) -> StoreError {
        StoreError::ChunkDamaged { path: path.to_path_buf(), chunk: part, what }
    }
}
