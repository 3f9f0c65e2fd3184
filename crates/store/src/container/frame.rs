//! Encodes and decodes the 4,096-byte header of a basis file or factor. This module handles the fields that the headers
//! of both kinds of files share:
//!
//! ```text
//! 0        8         12           16                          4064        4096
//! | magic  | version | header_len | fields | reserved (zeros) | header_hash |
//! ```
//!
//! The contents of `fields` depend on the kind of file: see "Header" and "Header of a factor" in `store-format.md`.

use std::path::Path;

use crate::bytes::{put, u32_at};
use crate::container::codec::Codec;
use crate::error::StoreError;

/// Length of the header in bytes: one page, so that the first part of the file (a chunk or a tile) starts at a page
/// boundary.
pub(crate) const HEADER_LEN: usize = 4096;
/// Alignment of parts: every part starts at a multiple of this number of bytes.
pub(crate) const ALIGNMENT: u64 = 64;

const MAGIC_AT: usize = 0;
const VERSION_AT: usize = MAGIC_AT + 8;
const HEADER_LEN_AT: usize = VERSION_AT + 4;
/// Offset of the first field that depends on the kind of file.
pub(crate) const FIELDS_AT: usize = HEADER_LEN_AT + 4;
const HASH_AT: usize = HEADER_LEN - 32;

/// The bytes of a header.
pub(crate) type HeaderBytes = [u8; HEADER_LEN];

/// Constants of one kind of file (basis file or factor).
#[derive(Debug)]
pub(crate) struct Kind {
    pub(crate) magic: [u8; 8],
    /// Format version of files of this kind. Files are written in this version, and files of other versions can't be
    /// read.
    pub(crate) version: u32,
    /// Offset of the first byte after the fields of this kind of file. The bytes from this offset to the header's hash
    /// are zeros.
    pub(crate) reserved_at: usize,
    /// BLAKE3 key-derivation context of the root hash.
    pub(crate) root_context: &'static str,
    /// Word for a part of the file in error messages: `chunk` or `tile`.
    pub(crate) part: &'static str,
}

/// The contents of a file as described by its header: the fields of its kind, and the number and sizes of the parts.
pub(crate) trait Contents: Sized {
    const KIND: Kind;

    /// Writes the fields of this kind of file into the header, between [`FIELDS_AT`] and the reserved bytes.
    fn encode_fields(&self, header: &mut HeaderBytes);

    /// Reads the fields of this kind of file. Every number is checked before use.
    fn decode_fields(header: &HeaderBytes, path: &Path) -> Result<Self, StoreError>;

    /// Returns the number of parts, at most 2^22. `parts * raw_len` is below 2^60, so sums of offsets don't overflow.
    fn parts(&self) -> usize;

    /// Returns the size of a decoded part in bytes.
    fn raw_len(&self, part: usize) -> usize;

    /// Returns the codec of the file. Each part of the file is stored either with this codec or raw.
    fn codec(&self) -> Codec;

    /// Returns the error for a part that failed the check `what`.
    fn damaged(&self, path: &Path, part: usize, what: &'static str) -> StoreError;
}

/// Encodes the header that describes these contents.
pub(crate) fn encode<C: Contents>(contents: &C) -> Box<HeaderBytes> {
    let mut header = Box::new([0; HEADER_LEN]);
    put(&mut header[..], MAGIC_AT, &C::KIND.magic);
    put(&mut header[..], VERSION_AT, &C::KIND.version.to_le_bytes());
    put(&mut header[..], HEADER_LEN_AT, &(HEADER_LEN as u32).to_le_bytes());
    contents.encode_fields(&mut header);
    let hash = blake3::hash(&header[..HASH_AT]);
    put(&mut header[..], HASH_AT, hash.as_bytes());
    header
}

/// Decodes a header: first the fields common to all kinds of files, then the fields of the kind `C`.
pub(crate) fn decode<C: Contents>(header: &HeaderBytes, path: &Path) -> Result<C, StoreError> {
    let Kind { magic, version, reserved_at, .. } = C::KIND;
    if header[..8] != magic {
        let found = header[..8].escape_ascii();
        return Err(StoreError::corrupt(path, "magic number", magic.escape_ascii(), found));
    }
    let found = u32_at(header, VERSION_AT);
    if found != version {
        // If the hash matches after the expected version has been put into the header, only the version field is
        // damaged.
        let mut mended = *header;
        put(&mut mended, VERSION_AT, &version.to_le_bytes());
        if is_intact(&mended) {
            return Err(StoreError::corrupt(path, "version", version, found));
        }
        return Err(StoreError::Version { path: path.to_path_buf(), expected: version, found });
    }
    if !is_intact(header) {
        return Err(StoreError::corrupt(path, "hash of the header", "the stored hash", "a different hash"));
    }
    let header_len = u32_at(header, HEADER_LEN_AT);
    if header_len as usize != HEADER_LEN {
        return Err(StoreError::corrupt(path, "header length", HEADER_LEN, header_len));
    }
    if header[reserved_at..HASH_AT].iter().any(|&byte| byte != 0) {
        return Err(StoreError::corrupt(path, "reserved bytes", "zeros", "nonzero bytes"));
    }
    C::decode_fields(header, path)
}

/// Returns whether the bytes of a header match its hash.
fn is_intact(header: &HeaderBytes) -> bool {
    blake3::hash(&header[..HASH_AT]).as_bytes() == &header[HASH_AT..]
}
