//! Encodes and decodes the end of a basis file or factor: the table of the file's parts (chunks or tiles), and the
//! footer.
//!
//! See "Table" and "Footer" in `store-format.md`.

use std::path::Path;

use crate::bytes::{hash_at, put, u32_at, u64_at};
use crate::container::codec::Codec;
use crate::container::frame::{ALIGNMENT, Contents, HEADER_LEN};
use crate::error::StoreError;

/// Table entry of a part: its location, lengths, codec and hashes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Entry {
    pub(crate) offset: u64,
    pub(crate) stored_len: u64,
    pub(crate) raw_len: u64,
    pub(crate) crc: u32,
    pub(crate) codec: Codec,
    pub(crate) hash: [u8; 32],
}

/// Length of a table entry in bytes.
pub(crate) const ENTRY_LEN: usize = 64;
/// Length of the footer in bytes.
pub(crate) const FOOTER_LEN: usize = 128;

const OFFSET_AT: usize = 0;
const STORED_AT: usize = OFFSET_AT + 8;
const RAW_AT: usize = STORED_AT + 8;
const CRC_AT: usize = RAW_AT + 8;
const CODEC_AT: usize = CRC_AT + 4;
const PART_HASH_AT: usize = CODEC_AT + 4;

impl Entry {
    /// Creates the table entry of a part from the part's stored bytes and their offset in the file.
    pub(crate) fn of(offset: u64, stored: &[u8], raw_len: usize, codec: Codec) -> Self {
        Self {
            offset,
            stored_len: stored.len() as u64,
            raw_len: raw_len as u64,
            crc: crc32c::crc32c(stored),
            codec,
            hash: *blake3::hash(stored).as_bytes(),
        }
    }

    /// Returns the offset of the first byte after the part's stored bytes.
    pub(crate) fn end(&self) -> u64 {
        self.offset + self.stored_len
    }

    /// Returns the offset of the next part, or the offset of the table if this is the last part.
    pub(crate) fn next_offset(&self) -> u64 {
        self.end().next_multiple_of(ALIGNMENT)
    }

    fn encode(&self) -> [u8; ENTRY_LEN] {
        let mut bytes = [0; ENTRY_LEN];
        put(&mut bytes, OFFSET_AT, &self.offset.to_le_bytes());
        put(&mut bytes, STORED_AT, &self.stored_len.to_le_bytes());
        put(&mut bytes, RAW_AT, &self.raw_len.to_le_bytes());
        put(&mut bytes, CRC_AT, &self.crc.to_le_bytes());
        put(&mut bytes, CODEC_AT, &self.codec.code().to_le_bytes());
        put(&mut bytes, PART_HASH_AT, &self.hash);
        bytes
    }

    fn decode(bytes: &[u8], path: &Path) -> Result<Self, StoreError> {
        let codec = u32_at(bytes, CODEC_AT);
        let codec = Codec::from_code(codec)
            .ok_or_else(|| StoreError::corrupt(path, "codec of a chunk", "0 (none) or 1 (zstd)", codec))?;
        Ok(Self {
            offset: u64_at(bytes, OFFSET_AT),
            stored_len: u64_at(bytes, STORED_AT),
            raw_len: u64_at(bytes, RAW_AT),
            crc: u32_at(bytes, CRC_AT),
            codec,
            hash: hash_at(bytes, PART_HASH_AT),
        })
    }
}

pub(crate) fn encode_table(entries: &[Entry]) -> Vec<u8> {
    entries.iter().flat_map(Entry::encode).collect()
}

/// Decodes the table. Checks that the parts follow each other without gaps from the header to the table, and that each
/// part has the length that the header implies.
pub(crate) fn decode_table<C: Contents>(
    bytes: &[u8],
    contents: &C,
    table_offset: u64,
    path: &Path,
) -> Result<Vec<Entry>, StoreError> {
    let mut entries = Vec::with_capacity(bytes.len() / ENTRY_LEN);
    let mut expected_offset = HEADER_LEN as u64;
    for (part, bytes) in bytes.chunks_exact(ENTRY_LEN).enumerate() {
        let entry = Entry::decode(bytes, path)?;
        let corrupt = |what: &str, expected: String, found: String| {
            StoreError::corrupt(path, format!("{what} of a {}", C::KIND.part), expected, found)
        };
        if entry.offset != expected_offset {
            return Err(corrupt("offset", expected_offset.to_string(), entry.offset.to_string()));
        }
        let raw_len = contents.raw_len(part) as u64;
        if entry.raw_len != raw_len {
            return Err(corrupt("decoded length", raw_len.to_string(), entry.raw_len.to_string()));
        }
        if entry.codec != Codec::Raw && entry.codec != contents.codec() {
            return Err(corrupt("codec", contents.codec().name().to_owned(), entry.codec.name().to_owned()));
        }
        let (fits, expected) = match entry.codec {
            Codec::Raw => (entry.stored_len == raw_len, raw_len.to_string()),
            Codec::Zstd => {
                ((1..raw_len).contains(&entry.stored_len), format!("less than {raw_len} for compressed data"))
            }
        };
        if !fits {
            return Err(corrupt("stored length", expected, entry.stored_len.to_string()));
        }
        // The offset can't overflow, because `Contents::parts` limits the total size of the parts.
        expected_offset = entry.next_offset();
        entries.push(entry);
    }
    if expected_offset != table_offset {
        return Err(StoreError::corrupt(path, "offset of the table", expected_offset, table_offset));
    }
    Ok(entries)
}

/// The footer: the last 128 bytes of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Footer {
    pub(crate) table_offset: u64,
    /// Number of entries in the table.
    pub(crate) entries: u64,
    /// Length of the file in bytes.
    pub(crate) file_len: u64,
    /// BLAKE3 hash of the header and the table. The table holds the hashes of the parts, so this hash covers the entire
    /// contents.
    pub(crate) root: [u8; 32],
}

const FOOTER_MAGIC: [u8; 8] = *b"SPH-END\n";

const TABLE_OFFSET_AT: usize = 8;
const ENTRIES_AT: usize = TABLE_OFFSET_AT + 8;
const FILE_LEN_AT: usize = ENTRIES_AT + 8;
const ROOT_AT: usize = FILE_LEN_AT + 8;
const RESERVED_AT: usize = ROOT_AT + 32;
const FOOTER_HASH_AT: usize = FOOTER_LEN - 32;

impl Footer {
    pub(crate) fn encode(&self) -> [u8; FOOTER_LEN] {
        let mut bytes = [0; FOOTER_LEN];
        put(&mut bytes, 0, &FOOTER_MAGIC);
        put(&mut bytes, TABLE_OFFSET_AT, &self.table_offset.to_le_bytes());
        put(&mut bytes, ENTRIES_AT, &self.entries.to_le_bytes());
        put(&mut bytes, FILE_LEN_AT, &self.file_len.to_le_bytes());
        put(&mut bytes, ROOT_AT, &self.root);
        let hash = blake3::hash(&bytes[..FOOTER_HASH_AT]);
        put(&mut bytes, FOOTER_HASH_AT, hash.as_bytes());
        bytes
    }

    /// Decodes a footer and checks it. `file_len` is the actual length of the file.
    pub(crate) fn decode(bytes: &[u8; FOOTER_LEN], file_len: u64, path: &Path) -> Result<Self, StoreError> {
        if bytes[..8] != FOOTER_MAGIC {
            let found = bytes[..8].escape_ascii();
            return Err(StoreError::corrupt(path, "footer (truncated file?)", FOOTER_MAGIC.escape_ascii(), found));
        }
        if blake3::hash(&bytes[..FOOTER_HASH_AT]).as_bytes() != &bytes[FOOTER_HASH_AT..] {
            return Err(StoreError::corrupt(path, "hash of the footer", "the stored hash", "a different hash"));
        }
        if bytes[RESERVED_AT..FOOTER_HASH_AT].iter().any(|&byte| byte != 0) {
            return Err(StoreError::corrupt(path, "reserved bytes of the footer", "zeros", "nonzero bytes"));
        }
        let footer = Self {
            table_offset: u64_at(bytes, TABLE_OFFSET_AT),
            entries: u64_at(bytes, ENTRIES_AT),
            file_len: u64_at(bytes, FILE_LEN_AT),
            root: hash_at(bytes, ROOT_AT),
        };
        if footer.file_len != file_len {
            return Err(StoreError::corrupt(path, "length of the file", footer.file_len, file_len));
        }
        Ok(footer)
    }
}

/// Returns the root hash over the bytes of a file's header and table. `context` is the key-derivation context of the
/// kind of file.
pub(crate) fn root(context: &str, header: &[u8], table: &[u8]) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new_derive_key(context);
    hasher.update(header);
    hasher.update(table);
    *hasher.finalize().as_bytes()
}
