//! Writes a basis file `A_<l>`: several threads may write chunks in any order.

use std::path::Path;
use std::sync::{Condvar, Mutex, PoisonError};
use std::time::Duration;

use spharm_monitor::Monitor;

use crate::basis::header::Header;
use crate::container::codec::{Codec, Encoder};
use crate::container::frame::{ALIGNMENT, HEADER_LEN};
use crate::container::writer::ContainerWriter;
use crate::error::StoreError;

/// Returns the name of the basis file of a degree.
pub(crate) fn file_name(degree: usize) -> String {
    format!("A_{degree}")
}

/// A basis file being written. Threads may write different chunks at the same time.
pub(crate) struct DegreeWriter {
    header: Header,
    file: ContainerWriter,
    next: Mutex<NextPlace>,
    turn: Condvar,
}

/// Number and file offset of the next compressed chunk to write. Compressed chunks are placed in ascending order, so
/// that a file's bytes don't depend on the timing of the threads.
struct NextPlace {
    chunk: usize,
    offset: u64,
}

impl DegreeWriter {
    pub(crate) fn create(folder: &Path, header: Header) -> Result<Self, StoreError> {
        let name = file_name(header.degree);
        let file = ContainerWriter::create(folder, &name, &name, header.chunk_count())?;
        let next = Mutex::new(NextPlace { chunk: 0, offset: HEADER_LEN as u64 });
        Ok(Self { header, file, next, turn: Condvar::new() })
    }

    /// Writes a chunk given as raw bytes, and compresses it if `encoder` is given. A compressed chunk waits for the
    /// chunks before it; cancelling the monitor ends the wait with an error.
    pub(crate) fn put(
        &self,
        chunk: usize,
        raw: &[u8],
        encoder: Option<&mut Encoder>,
        monitor: &dyn Monitor,
    ) -> Result<(), StoreError> {
        debug_assert_eq!(raw.len(), self.header.raw_len(chunk));
        let Some(encoder) = encoder else {
            return self.file.write_part(chunk, self.header.raw_offset(chunk), raw, raw.len(), Codec::Raw);
        };
        let failed = |error| StoreError::io(self.file.path(), "cannot compress")(error);
        let encoded = encoder.encode(raw, self.header.scalar.size()).map_err(failed)?;
        let (stored, codec) = if encoded.len() < raw.len() { (&encoded[..], Codec::Zstd) } else { (raw, Codec::Raw) };
        let offset = self.take_place(chunk, stored.len(), monitor)?;
        self.file.write_part(chunk, offset, stored, raw.len(), codec)
    }

    /// Waits until all chunks before this one have been placed, and returns this chunk's offset. The wait always ends:
    /// threads take chunks in ascending order, so some thread is working on the lowest chunk that isn't placed.
    fn take_place(&self, chunk: usize, len: usize, monitor: &dyn Monitor) -> Result<u64, StoreError> {
        let mut next = self.next.lock().unwrap_or_else(PoisonError::into_inner);
        while next.chunk != chunk {
            monitor.check()?;
            let waited = self.turn.wait_timeout(next, Duration::from_millis(50));
            next = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
        let offset = next.offset;
        next.chunk += 1;
        next.offset = (offset + len as u64).next_multiple_of(ALIGNMENT);
        self.turn.notify_all();
        Ok(offset)
    }

    /// Publishes the file, as [`ContainerWriter::publish`] does. The caller must sync the folder afterwards.
    pub(crate) fn publish(self) -> Result<Option<u64>, StoreError> {
        self.file.publish(&self.header)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;
    use crate::basis::reader::DegreeFile;
    use crate::scheme::{Scalar, SchemeKey};

    /// A chunk is stored compressed only if it gets shorter. A chunk whose zstd frame is as long as the raw chunk is
    /// stored raw.
    #[test]
    fn a_chunk_that_does_not_shrink_is_stored_raw() {
        let mut encoder = Encoder::new().unwrap();
        let noise = |i: usize| blake3::hash(&i.to_le_bytes()).as_bytes()[0];
        let mut as_long = 0;
        for rows in [8, 16, 24] {
            let len = 8 * rows;
            // The more equal bytes the noise contains, the better it compresses. For some number of equal bytes, the
            // frame is exactly as long as the raw chunk.
            for same in 0..len {
                let raw: Vec<u8> = (0..len).map(|i| if i % 8 * rows + i / 8 < same { 7 } else { noise(i) }).collect();
                let encoded = encoder.encode(&raw, 8).unwrap().len();
                if encoded.abs_diff(len) > 1 {
                    continue;
                }
                as_long += usize::from(encoded == len);
                let folder = tempfile::tempdir().unwrap();
                let (key, scalar, codec) = (SchemeKey([7; 32]), Scalar::F64, Codec::Zstd);
                let header = Header { key, rows, degree: 0, scalar, codec, chunk_rows: rows };
                let writer = DegreeWriter::create(folder.path(), header).unwrap();
                writer.put(0, &raw, Some(&mut encoder), &AtomicBool::new(false)).unwrap();
                writer.publish().unwrap().unwrap();
                let file = DegreeFile::open(&folder.path().join("A_0")).unwrap();
                assert_eq!((file.stored_len(0), file.is_direct()), (encoded.min(len), encoded >= len));
            }
        }
        assert!(as_long > 0, "no chunk is as long as its frame");
    }
}
