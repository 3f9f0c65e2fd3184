//! Opens and reads a basis file or factor. The header, table and footer are checked when the file is opened, and each
//! part (chunk or tile) when it is first read.

use std::ops::Range;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::container::frame::{Contents, HEADER_LEN, HeaderBytes, decode};
use crate::container::table::{ENTRY_LEN, Entry, FOOTER_LEN, Footer, decode_table, root};
use crate::error::StoreError;
use crate::map::Window;
use crate::source::Source;

/// An open file of one kind, whose header, table and footer have passed all checks.
#[derive(Debug)]
pub(crate) struct Container<C> {
    source: Source,
    contents: C,
    entries: Vec<Entry>,
    table_offset: u64,
    /// For each part, whether its checksum has been verified since the file was opened.
    checked: Vec<AtomicBool>,
}

/// A window on a file: a run of parts, mapped into memory.
#[derive(Debug)]
pub(crate) struct MappedParts {
    window: Window,
    parts: Range<usize>,
    /// Offset in the file, in bytes, of the first mapped byte.
    first: u64,
}

impl<C: Contents> Container<C> {
    /// Opens a file and checks everything except its parts, in the order of "What a reader checks" in
    /// `store-format.md`.
    pub(crate) fn open(path: &Path) -> Result<Self, StoreError> {
        let source = Source::open(path)?;
        let least = HEADER_LEN + ENTRY_LEN + FOOTER_LEN;
        if source.len() < least as u64 {
            return Err(StoreError::corrupt(path, "length of the file", format!("at least {least}"), source.len()));
        }
        let mut header = [0; HEADER_LEN];
        source.read_at(0, &mut header)?;
        let contents: C = decode(&header, path)?;
        let (table, table_offset) = read_table::<C>(&source, &header, contents.parts() as u64)?;
        let entries = decode_table(&table, &contents, table_offset, path)?;
        let checked = entries.iter().map(|_| AtomicBool::new(false)).collect();
        Ok(Self { source, contents, entries, table_offset, checked })
    }

    pub(crate) fn contents(&self) -> &C {
        &self.contents
    }

    pub(crate) fn source(&self) -> &Source {
        &self.source
    }

    pub(crate) fn entries(&self) -> &[Entry] {
        &self.entries
    }

    /// Returns the offset of the table, which is the end of the padding after the last part.
    pub(crate) fn table_offset(&self) -> u64 {
        self.table_offset
    }

    /// Maps a run of parts. Panics if the run is empty or goes past the last part.
    pub(crate) fn map(&self, parts: Range<usize>) -> Result<MappedParts, StoreError> {
        let (first, last) = (&self.entries[parts.start], &self.entries[parts.end - 1]);
        let window = Window::new(&self.source, first.offset, (last.end() - first.offset) as usize)?;
        Ok(MappedParts { window, parts, first: first.offset })
    }

    /// Returns the stored bytes of a mapped part. The first call for a part verifies its CRC, which also loads the part
    /// into the cache of the calling thread's core.
    pub(crate) fn stored<'m>(&self, mapped: &'m MappedParts, part: usize) -> Result<&'m [u8], StoreError> {
        let stored = &mapped.window.bytes()[self.place(mapped, part)];
        if !self.checked[part].load(Ordering::Relaxed) {
            if crc32c::crc32c(stored) != self.entries[part].crc {
                // If a page of the file is missing, the checksum is also wrong. In that case, report the missing page.
                self.check(mapped)?;
                return Err(self.contents.damaged(self.source.path(), part, "its CRC-32C"));
            }
            self.checked[part].store(true, Ordering::Relaxed);
        }
        Ok(stored)
    }

    /// Asks the system to start reading all mapped parts from disk. The request is only a hint, so a failure is
    /// ignored.
    pub(crate) fn will_need(&self, mapped: &MappedParts) {
        mapped.window.will_need(0, mapped.window.bytes().len());
    }

    /// Maps all pages of a part with one system call. The request is only a hint, so a failure is ignored.
    pub(crate) fn populate(&self, mapped: &MappedParts, part: usize) {
        let Range { start, end } = self.place(mapped, part);
        mapped.window.populate(start, end - start);
    }

    /// Maps the pages of all mapped parts with one system call. The request is only a hint, so a failure is ignored.
    pub(crate) fn populate_all(&self, mapped: &MappedParts) {
        mapped.window.populate(0, mapped.window.bytes().len());
    }

    /// Returns an error if a page was missing when it was accessed, or if the file has changed since it was opened.
    pub(crate) fn check(&self, mapped: &MappedParts) -> Result<(), StoreError> {
        mapped.window.check(&self.source)
    }

    /// Returns the byte range of a part within the mapped window.
    fn place(&self, mapped: &MappedParts, part: usize) -> Range<usize> {
        assert!(
            mapped.parts.contains(&part),
            "{} {part} is outside the mapped window of {:?}",
            C::KIND.part,
            mapped.parts
        );
        let entry = &self.entries[part];
        (entry.offset - mapped.first) as usize..(entry.end() - mapped.first) as usize
    }
}

impl MappedParts {
    /// Returns the indices of the mapped parts.
    pub(crate) fn parts(&self) -> Range<usize> {
        self.parts.clone()
    }
}

/// Reads the footer and the table of a file whose header has been decoded, and performs all checks except those of the
/// table's entries. Returns the table and its offset.
fn read_table<C: Contents>(source: &Source, header: &HeaderBytes, parts: u64) -> Result<(Vec<u8>, u64), StoreError> {
    let (path, file_len) = (source.path(), source.len());
    let mut footer = [0; FOOTER_LEN];
    source.read_at(file_len - FOOTER_LEN as u64, &mut footer)?;
    let footer = Footer::decode(&footer, file_len, path)?;
    if footer.entries != parts {
        return Err(StoreError::corrupt(path, "number of entries in the table", parts, footer.entries));
    }
    // The table must exactly fill the range between the last part and the footer. Its size is thus limited by the
    // file's size.
    let table_len = footer.entries.saturating_mul(ENTRY_LEN as u64);
    let end = footer.table_offset.checked_add(table_len).and_then(|end| end.checked_add(FOOTER_LEN as u64));
    if footer.table_offset < HEADER_LEN as u64 || end != Some(file_len) {
        return Err(StoreError::corrupt(
            path,
            "offset of the table",
            "the offset just before the footer",
            footer.table_offset,
        ));
    }
    let mut table = vec![0; table_len as usize];
    source.read_at(footer.table_offset, &mut table)?;
    if root(C::KIND.root_context, header, &table) != footer.root {
        return Err(StoreError::corrupt(path, "root hash", "the hash of the header and table", "a different hash"));
    }
    Ok((table, footer.table_offset))
}
