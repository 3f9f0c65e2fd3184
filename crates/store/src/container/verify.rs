//! Verifies every byte of a file against the hashes in its table and footer. The file is read in pieces of at most 1
//! MiB, so that a manipulated file that declares huge parts costs time but not memory.

use std::fs::File;
use std::io;
use std::ops::Range;

use spharm_monitor::Monitor;

use crate::container::codec::{Codec, check_frame};
use crate::container::frame::Contents;
use crate::container::reader::Container;
use crate::error::StoreError;
use crate::platform;
use crate::source::Source;

/// Maximum number of bytes read at a time.
const PIECE: u64 = 1 << 20;

impl<C: Contents> Container<C> {
    /// Checks every BLAKE3 hash, every CRC, every padding byte and every zstd frame. Together with the checks made on
    /// opening, these checks cover every bit of the file. Advances the monitor's stage by the length of the file in
    /// bytes.
    pub(crate) fn verify(&self, monitor: &dyn Monitor) -> Result<(), StoreError> {
        let (source, entries) = (self.source(), self.entries());
        let mut buffer = Vec::new();
        for (part, entry) in entries.iter().enumerate() {
            let damaged = |what| self.contents().damaged(source.path(), part, what);
            let (mut hasher, mut crc) = (blake3::Hasher::new(), 0);
            for_each_piece(source, entry.offset..entry.end(), &mut buffer, monitor, &mut |piece| {
                hasher.update(piece);
                crc = crc32c::crc32c_append(crc, piece);
            })?;
            if hasher.finalize().as_bytes() != &entry.hash {
                return Err(damaged("its BLAKE3 hash"));
            }
            if crc != entry.crc {
                return Err(damaged("its CRC-32C"));
            }
            let next = entries.get(part + 1).map_or(self.table_offset(), |entry| entry.offset);
            let mut zeros = true;
            for_each_piece(source, entry.end()..next, &mut buffer, monitor, &mut |piece| {
                zeros &= piece.iter().all(|&byte| byte == 0);
            })?;
            if !zeros {
                return Err(damaged("its padding"));
            }
            if entry.codec == Codec::Zstd {
                let stored = FileRange { file: source.file(), range: entry.offset..entry.end() };
                check_frame(stored, entry.raw_len).map_err(|_| damaged("its zstd frame"))?;
            }
        }
        let first = entries.first().map_or(self.table_offset(), |entry| entry.offset);
        monitor.step(first + source.len() - self.table_offset());
        source.check()
    }
}

/// Reads a range of a file through `buffer`, and calls `visit` with each piece.
fn for_each_piece(
    source: &Source,
    range: Range<u64>,
    buffer: &mut Vec<u8>,
    monitor: &dyn Monitor,
    visit: &mut dyn FnMut(&[u8]),
) -> Result<(), StoreError> {
    let mut at = range.start;
    while at < range.end {
        monitor.check()?;
        buffer.resize((range.end - at).min(PIECE) as usize, 0);
        source.read_at(at, buffer)?;
        visit(buffer);
        monitor.step(buffer.len() as u64);
        at += buffer.len() as u64;
    }
    Ok(())
}

/// A reader over a range of a file.
struct FileRange<'f> {
    file: &'f File,
    range: Range<u64>,
}

impl io::Read for FileRange<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let len = (self.range.end - self.range.start).min(buffer.len() as u64) as usize;
        let read = platform::read_at(self.file, &mut buffer[..len], self.range.start)?;
        self.range.start += read as u64;
        Ok(read)
    }
}
