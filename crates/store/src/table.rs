//! The end of a file: the table of chunks, and the footer that makes the file count.
//!
//! See "Table" and "Footer" in `store-format.md`.

use std::path::Path;

use crate::StoreError;
use crate::bytes::{u32_at, u64_at};
use crate::codec::Codec;
use crate::header::{ALIGNMENT, HEADER_LEN, Header};

/// Where a chunk is and what it must hash to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Entry {
    pub(crate) offset: u64,
    pub(crate) stored_len: u64,
    pub(crate) raw_len: u64,
    pub(crate) crc: u32,
    pub(crate) codec: Codec,
    pub(crate) hash: [u8; 32],
}

pub(crate) const ENTRY_LEN: usize = 64;
pub(crate) const FOOTER_LEN: usize = 128;

const OFFSET_AT: usize = 0;
const STORED_AT: usize = OFFSET_AT + 8;
const RAW_AT: usize = STORED_AT + 8;
const CRC_AT: usize = RAW_AT + 8;
const CODEC_AT: usize = CRC_AT + 4;
const CHUNK_HASH_AT: usize = CODEC_AT + 4;

impl Entry {
    fn encode(&self) -> [u8; ENTRY_LEN] {
        let mut bytes = [0; ENTRY_LEN];
        let mut put = |at: usize, value: &[u8]| bytes[at..at + value.len()].copy_from_slice(value);
        put(OFFSET_AT, &self.offset.to_le_bytes());
        put(STORED_AT, &self.stored_len.to_le_bytes());
        put(RAW_AT, &self.raw_len.to_le_bytes());
        put(CRC_AT, &self.crc.to_le_bytes());
        put(CODEC_AT, &self.codec.code().to_le_bytes());
        put(CHUNK_HASH_AT, &self.hash);
        bytes
    }

    pub(crate) fn decode(bytes: &[u8], path: &Path) -> Result<Self, StoreError> {
        let codec = u32_at(bytes, CODEC_AT);
        let codec = Codec::from_code(codec)
            .ok_or_else(|| StoreError::corrupt(path, "codec of a chunk", "0 (none) or 1 (zstd)", codec))?;
        let mut hash = [0; 32];
        hash.copy_from_slice(&bytes[CHUNK_HASH_AT..]);
        Ok(Self {
            offset: u64_at(bytes, OFFSET_AT),
            stored_len: u64_at(bytes, STORED_AT),
            raw_len: u64_at(bytes, RAW_AT),
            crc: u32_at(bytes, CRC_AT),
            codec,
            hash,
        })
    }
}

pub(crate) fn encode_table(entries: &[Entry]) -> Vec<u8> {
    entries.iter().flat_map(Entry::encode).collect()
}

/// Reads the table and checks that its chunks follow each other from the header to the table, each of the size that
/// the header implies.
pub(crate) fn decode_table(
    bytes: &[u8],
    header: &Header,
    table_offset: u64,
    path: &Path,
) -> Result<Vec<Entry>, StoreError> {
    let mut entries = Vec::with_capacity(bytes.len() / ENTRY_LEN);
    let mut expected_offset = HEADER_LEN as u64;
    for (chunk, bytes) in bytes.chunks_exact(ENTRY_LEN).enumerate() {
        let entry = Entry::decode(bytes, path)?;
        if entry.offset != expected_offset {
            return Err(StoreError::corrupt(path, "offset of a chunk", expected_offset, entry.offset));
        }
        let raw_len = header.raw_len(chunk) as u64;
        if entry.raw_len != raw_len {
            return Err(StoreError::corrupt(path, "decoded length of a chunk", raw_len, entry.raw_len));
        }
        let fits = match entry.codec {
            Codec::Raw => entry.stored_len == raw_len,
            Codec::Zstd => entry.stored_len > 0 && entry.stored_len < raw_len,
        };
        if entry.codec == Codec::Zstd && header.codec == Codec::Raw {
            return Err(StoreError::corrupt(path, "codec of a chunk", "none, as the header says", "zstd"));
        }
        if !fits {
            let expected = format!("{raw_len}, or less when compressed");
            return Err(StoreError::corrupt(path, "stored length of a chunk", expected, entry.stored_len));
        }
        // Neither sum overflows: offset and length are below 2^60 by the header's bounds.
        expected_offset = (entry.offset + entry.stored_len).next_multiple_of(ALIGNMENT);
        entries.push(entry);
    }
    if expected_offset != table_offset {
        return Err(StoreError::corrupt(path, "offset of the table", expected_offset, table_offset));
    }
    Ok(entries)
}

/// The last 128 bytes of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Footer {
    pub(crate) table_offset: u64,
    pub(crate) entries: u64,
    pub(crate) file_len: u64,
    /// BLAKE3 of header and table, and with the table's hashes of everything.
    pub(crate) root: [u8; 32],
}

const FOOTER_MAGIC: [u8; 8] = *b"SPH-END\n";
/// What the root of a basis file is derived with.
pub(crate) const ROOT_CONTEXT: &str = "spharm-rs 2026-11 basis file root v1";

const TABLE_OFFSET_AT: usize = 8;
const ENTRIES_AT: usize = TABLE_OFFSET_AT + 8;
const FILE_LEN_AT: usize = ENTRIES_AT + 8;
const ROOT_AT: usize = FILE_LEN_AT + 8;
const RESERVED_AT: usize = ROOT_AT + 32;
const FOOTER_HASH_AT: usize = FOOTER_LEN - 32;

impl Footer {
    pub(crate) fn encode(&self) -> [u8; FOOTER_LEN] {
        let mut bytes = [0; FOOTER_LEN];
        let mut put = |at: usize, value: &[u8]| bytes[at..at + value.len()].copy_from_slice(value);
        put(0, &FOOTER_MAGIC);
        put(TABLE_OFFSET_AT, &self.table_offset.to_le_bytes());
        put(ENTRIES_AT, &self.entries.to_le_bytes());
        put(FILE_LEN_AT, &self.file_len.to_le_bytes());
        put(ROOT_AT, &self.root);
        let hash = blake3::hash(&bytes[..FOOTER_HASH_AT]);
        bytes[FOOTER_HASH_AT..].copy_from_slice(hash.as_bytes());
        bytes
    }

    /// Reads a footer. `file_len` is the length that the file has.
    pub(crate) fn decode(bytes: &[u8; FOOTER_LEN], file_len: u64, path: &Path) -> Result<Self, StoreError> {
        if bytes[..8] != FOOTER_MAGIC {
            let found = bytes[..8].escape_ascii();
            return Err(StoreError::corrupt(path, "footer (cut off?)", FOOTER_MAGIC.escape_ascii(), found));
        }
        if blake3::hash(&bytes[..FOOTER_HASH_AT]).as_bytes() != &bytes[FOOTER_HASH_AT..] {
            return Err(StoreError::corrupt(path, "footer", "bytes that fit its hash", "others"));
        }
        if bytes[RESERVED_AT..FOOTER_HASH_AT].iter().any(|&b| b != 0) {
            return Err(StoreError::corrupt(path, "reserved bytes of the footer", "zeros", "others"));
        }
        let mut root = [0; 32];
        root.copy_from_slice(&bytes[ROOT_AT..RESERVED_AT]);
        let footer = Self {
            table_offset: u64_at(bytes, TABLE_OFFSET_AT),
            entries: u64_at(bytes, ENTRIES_AT),
            file_len: u64_at(bytes, FILE_LEN_AT),
            root,
        };
        if footer.file_len != file_len {
            return Err(StoreError::corrupt(path, "length of the file", footer.file_len, file_len));
        }
        Ok(footer)
    }
}

/// The root hash of a file with these header and table bytes; the context is that of its kind.
pub(crate) fn root(context: &str, header: &[u8], table: &[u8]) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new_derive_key(context);
    hasher.update(header);
    hasher.update(table);
    *hasher.finalize().as_bytes()
}
