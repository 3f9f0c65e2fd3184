//! Forges files with false contents: changes any bytes, and then computes all hashes again.

use std::path::Path;

/// Parts of a basis file. Offsets are those of `store-format.md`.
#[derive(Clone)]
pub(super) struct Forged {
    pub(super) header: Vec<u8>,
    /// Chunks and padding between the header and the table.
    pub(super) body: Vec<u8>,
    pub(super) table: Vec<u8>,
    pub(super) footer: Vec<u8>,
}

impl Forged {
    pub(super) fn read(path: &Path) -> Self {
        let bytes = std::fs::read(path).expect("a file");
        let footer_at = bytes.len() - 128;
        let table_at = u64::from_le_bytes(bytes[footer_at + 8..footer_at + 16].try_into().expect("8 bytes")) as usize;
        Self {
            header: bytes[..4096].to_vec(),
            body: bytes[4096..table_at].to_vec(),
            table: bytes[table_at..footer_at].to_vec(),
            footer: bytes[footer_at..].to_vec(),
        }
    }

    /// Replaces all chunks by a single one, and describes it in the table.
    pub(super) fn one_chunk(&mut self, stored: &[u8], codec: u32) {
        self.body = stored.to_vec();
        self.body.resize(stored.len().next_multiple_of(64), 0);
        self.table.truncate(64);
        put64(&mut self.table, 8, stored.len() as u64);
        put32(&mut self.table, 24, crc32c::crc32c(stored));
        put32(&mut self.table, 28, codec);
        self.table[32..64].copy_from_slice(blake3::hash(stored).as_bytes());
        self.measure();
    }

    /// Writes the actual offsets and lengths into the footer.
    pub(super) fn measure(&mut self) {
        let table_at = 4096 + self.body.len();
        put64(&mut self.footer, 8, table_at as u64);
        put64(&mut self.footer, 16, self.table.len() as u64 / 64);
        put64(&mut self.footer, 24, (table_at + self.table.len() + 128) as u64);
    }

    /// Computes all hashes again, and writes the basis file.
    pub(super) fn write(&mut self, path: &Path) {
        self.write_as("spharm-rs 2026-11 basis file root v1", path);
    }

    /// Computes all hashes again, with the context of another kind of file for the root hash, and writes the file.
    pub(super) fn write_as(&mut self, root_context: &str, path: &Path) {
        let hash = blake3::hash(&self.header[..4064]);
        self.header[4064..].copy_from_slice(hash.as_bytes());
        let mut root = blake3::Hasher::new_derive_key(root_context);
        root.update(&self.header).update(&self.table);
        self.footer[32..64].copy_from_slice(root.finalize().as_bytes());
        let hash = blake3::hash(&self.footer[..96]);
        self.footer[96..].copy_from_slice(hash.as_bytes());
        let parts = [&self.header[..], &self.body, &self.table, &self.footer].concat();
        std::fs::write(path, parts).expect("a file");
    }
}

pub(super) fn put32(bytes: &mut [u8], at: usize, value: u32) {
    bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
}

pub(super) fn put64(bytes: &mut [u8], at: usize, value: u64) {
    bytes[at..at + 8].copy_from_slice(&value.to_le_bytes());
}
