//! Forges files for tests: changes any of their bytes, and recomputes the other hashes to match.

use std::path::Path;

pub(crate) const BASIS_ROOT: &str = "spharm-rs 2026-11 basis file root v1";
pub(crate) const FACTOR_ROOT: &str = "spharm-rs 2026-11 factor file root v1";

/// A file split into header, body, table and footer; for offsets see `store-format.md`.
#[derive(Clone)]
pub(crate) struct Forged {
    root_context: &'static str,
    pub(crate) header: Vec<u8>,
    /// Chunks or tiles, with their padding.
    pub(crate) body: Vec<u8>,
    pub(crate) table: Vec<u8>,
    pub(crate) footer: Vec<u8>,
}

impl Forged {
    pub(crate) fn read(path: &Path, root_context: &'static str) -> Self {
        let bytes = std::fs::read(path).expect("a file");
        let footer_at = bytes.len() - 128;
        let table_at = u64::from_le_bytes(bytes[footer_at + 8..footer_at + 16].try_into().expect("8 bytes")) as usize;
        Self {
            root_context,
            header: bytes[..4096].to_vec(),
            body: bytes[4096..table_at].to_vec(),
            table: bytes[table_at..footer_at].to_vec(),
            footer: bytes[footer_at..].to_vec(),
        }
    }

    /// Recomputes the hash of the header.
    pub(crate) fn seal_header(&mut self) {
        let hash = blake3::hash(&self.header[..4064]);
        self.header[4064..].copy_from_slice(hash.as_bytes());
    }

    /// Recomputes the root hash of header and table.
    pub(crate) fn seal_root(&mut self) {
        let mut root = blake3::Hasher::new_derive_key(self.root_context);
        root.update(&self.header).update(&self.table);
        self.footer[32..64].copy_from_slice(root.finalize().as_bytes());
    }

    /// Recomputes the hash of the footer.
    pub(crate) fn seal_footer(&mut self) {
        let hash = blake3::hash(&self.footer[..96]);
        self.footer[96..].copy_from_slice(hash.as_bytes());
    }

    /// Writes the file without recomputing any hash.
    pub(crate) fn write(&self, path: &Path) {
        std::fs::write(path, [&self.header[..], &self.body, &self.table, &self.footer].concat()).expect("a file");
    }

    /// Recomputes all hashes except those of the parts, and writes the file.
    pub(crate) fn write_sealed(&mut self, path: &Path) {
        self.seal_header();
        self.seal_root();
        self.seal_footer();
        self.write(path);
    }
}

pub(crate) fn put64(bytes: &mut [u8], at: usize, value: u64) {
    bytes[at..at + 8].copy_from_slice(&value.to_le_bytes());
}
