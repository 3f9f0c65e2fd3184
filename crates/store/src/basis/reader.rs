//! Reading one `A_<l>`: opened and checked, then read chunk by chunk, from a memory map or by decoding.

use std::ops::Range;
use std::path::Path;

use spharm_monitor::{Monitor, Stage};

use crate::basis::header::Header;
use crate::bytes::{u32_at, u64_at};
use crate::container::codec::{Codec, decode};
use crate::container::frame::Contents;
use crate::container::reader::{Container, MappedParts};
use crate::error::StoreError;
use crate::scheme::Scalar;

/// An open basis file whose header, table and footer are sound. Chunks are checked when they are first read.
#[derive(Debug)]
pub struct DegreeFile {
    container: Container<Header>,
}

impl DegreeFile {
    /// Opens a file and checks everything except its chunks.
    ///
    /// # Errors
    ///
    /// [`StoreError::NotAFile`], [`StoreError::Corrupt`], [`StoreError::Version`], [`StoreError::Io`].
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        Ok(Self { container: Container::open(path)? })
    }

    /// Returns the file's header.
    pub fn header(&self) -> &Header {
        self.container.contents()
    }

    /// Returns the file's path.
    pub fn path(&self) -> &Path {
        self.container.source().path()
    }

    /// Returns the file's length in bytes.
    pub fn file_len(&self) -> u64 {
        self.container.source().len()
    }

    /// Returns whether every chunk is raw f64, and so can be used in place.
    pub fn is_direct(&self) -> bool {
        let entries = self.container.entries();
        self.header().scalar == Scalar::F64 && entries.iter().all(|entry| entry.codec == Codec::Raw)
    }

    /// Maps a range of chunks. A window over compressed chunks holds their stored bytes.
    ///
    /// # Errors
    ///
    /// [`StoreError::Io`].
    ///
    /// # Panics
    ///
    /// If the range is empty or goes past the last chunk.
    pub fn window(&self, chunks: Range<usize>) -> Result<ChunkWindow<'_>, StoreError> {
        Ok(ChunkWindow { file: self, mapped: self.container.map(chunks)? })
    }

    /// Returns the stored size of a chunk in bytes.
    ///
    /// # Panics
    ///
    /// If there is no such chunk.
    pub fn stored_len(&self, chunk: usize) -> usize {
        self.container.entries()[chunk].stored_len as usize
    }

    /// Checks every byte of the file against its hashes, in a stage `verify` counted in bytes. Holds a megabyte.
    ///
    /// # Errors
    ///
    /// [`StoreError::ChunkDamaged`], [`StoreError::ChangedWhileRead`], [`StoreError::Io`], [`StoreError::Interrupted`].
    pub fn verify(&self, monitor: &dyn Monitor) -> Result<(), StoreError> {
        monitor.begin(Stage::bytes("verify"), self.file_len());
        self.verify_within(monitor)?;
        monitor.end();
        Ok(())
    }

    /// Checks the same as [`verify`](Self::verify), within a stage of the caller.
    pub(crate) fn verify_within(&self, monitor: &dyn Monitor) -> Result<(), StoreError> {
        self.container.verify(monitor)
    }
}

/// Chunks of one file, mapped.
#[derive(Debug)]
pub struct ChunkWindow<'f> {
    file: &'f DegreeFile,
    mapped: MappedParts,
}

impl ChunkWindow<'_> {
    /// Returns the chunks that the window holds.
    pub fn chunks(&self) -> Range<usize> {
        self.mapped.parts()
    }

    /// Returns the values of a chunk, (rows, 2 l + 1) column-major: in place if they are raw f64, otherwise decoded
    /// into `scratch`. The first read of a chunk in a process verifies its checksum.
    ///
    /// Results computed from the values are valid only once [`check`](Self::check) has passed.
    ///
    /// # Errors
    ///
    /// [`StoreError::ChunkDamaged`], [`StoreError::ChangedWhileRead`].
    ///
    /// # Panics
    ///
    /// If the window doesn't hold the chunk.
    pub fn values<'s>(&'s self, chunk: usize, scratch: &'s mut Vec<f64>) -> Result<&'s [f64], StoreError> {
        match self.in_place(chunk)? {
            Some(values) => Ok(values),
            None => {
                self.decode(chunk, scratch)?;
                Ok(scratch)
            }
        }
    }

    /// Returns the values of a chunk if it is raw f64, as [`values`](Self::values) does; otherwise `None`.
    ///
    /// # Errors
    ///
    /// As for [`values`](Self::values).
    ///
    /// # Panics
    ///
    /// If the window doesn't hold the chunk.
    pub fn in_place(&self, chunk: usize) -> Result<Option<&[f64]>, StoreError> {
        let container = &self.file.container;
        if self.file.header().scalar != Scalar::F64 || container.entries()[chunk].codec != Codec::Raw {
            return Ok(None);
        }
        // Chunks start at multiples of 64 bytes and maps at pages, so the cast doesn't fail.
        Ok(Some(bytemuck::cast_slice(container.stored(&self.mapped, chunk)?)))
    }

    /// Decodes a chunk of any kind into `out`, which is resized to fit exactly.
    ///
    /// # Errors
    ///
    /// As for [`values`](Self::values).
    ///
    /// # Panics
    ///
    /// If the window doesn't hold the chunk.
    pub fn decode(&self, chunk: usize, out: &mut Vec<f64>) -> Result<(), StoreError> {
        let container = &self.file.container;
        let entry = &container.entries()[chunk];
        let stored = container.stored(&self.mapped, chunk)?;
        let scalar = self.file.header().scalar;
        match entry.codec {
            Codec::Raw => widen(stored, scalar, out),
            Codec::Zstd => {
                let Ok(raw) = decode(stored, entry.raw_len as usize, scalar.size()) else {
                    // The checksum was right once; find out whether the bytes have gone missing since.
                    self.check()?;
                    return Err(container.contents().damaged(self.file.path(), chunk, "its zstd frame"));
                };
                widen(&raw, scalar, out);
            }
        }
        Ok(())
    }

    /// Maps a chunk's pages at once, before it is used. Advice only.
    ///
    /// # Panics
    ///
    /// If the window doesn't hold the chunk.
    pub fn populate(&self, chunk: usize) {
        self.file.container.populate(&self.mapped, chunk);
    }

    /// Starts reading the entire window from disk. Advice only.
    pub fn will_need(&self) {
        self.file.container.will_need(&self.mapped);
    }

    /// Fails if the file has been truncated, changed or unreadable since it was opened.
    ///
    /// # Errors
    ///
    /// [`StoreError::ChangedWhileRead`].
    pub fn check(&self) -> Result<(), StoreError> {
        self.file.container.check(&self.mapped)
    }
}

/// Converts little-endian values to doubles.
fn widen(raw: &[u8], scalar: Scalar, out: &mut Vec<f64>) {
    out.clear();
    match scalar {
        Scalar::F64 => out.extend(raw.chunks_exact(8).map(|bytes| f64::from_bits(u64_at(bytes, 0)))),
        Scalar::F32 => out.extend(raw.chunks_exact(4).map(|bytes| f64::from(f32::from_bits(u32_at(bytes, 0))))),
    }
}
