//! Reads a basis file `A_<l>`: opens and checks it, then reads chunks from a memory map, decoding them if necessary.

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

/// An open basis file whose header, table and footer have passed all checks. Each chunk is checked when it is first
/// read.
#[derive(Debug)]
pub struct DegreeFile {
    container: Container<Header>,
}

impl DegreeFile {
    /// Opens a file and performs all checks except those of the chunks.
    ///
    /// # Errors
    ///
    /// [`StoreError::NotAFile`] if the path names something other than a regular file, [`StoreError::Corrupt`] if the
    /// file violates the format, [`StoreError::Version`] if the file has another format version, [`StoreError::Io`] if
    /// the file can't be read.
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

    /// Returns whether all values are raw f64, so that the mapped bytes can be used without decoding.
    pub fn is_direct(&self) -> bool {
        let entries = self.container.entries();
        self.header().scalar == Scalar::F64 && entries.iter().all(|entry| entry.codec == Codec::Raw)
    }

    /// Maps a range of chunks into memory. Compressed chunks stay compressed in the window.
    ///
    /// # Errors
    ///
    /// [`StoreError::Io`] if the chunks can't be mapped.
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

    /// Checks every byte of the file against its hashes. Reports one stage, `verify`, counted in bytes, to the monitor.
    /// Uses a buffer of 1 MiB.
    ///
    /// # Errors
    ///
    /// [`StoreError::ChunkDamaged`] if a chunk or its padding doesn't pass a check, [`StoreError::ChangedWhileRead`] if
    /// the file has changed since it was opened, [`StoreError::Io`] if the file can't be read,
    /// [`StoreError::Interrupted`] if the monitor cancels the verification.
    pub fn verify(&self, monitor: &dyn Monitor) -> Result<(), StoreError> {
        monitor.begin(Stage::bytes("verify"), self.file_len());
        self.verify_within(monitor)?;
        monitor.end();
        Ok(())
    }

    /// Performs the checks of [`verify`](Self::verify) within a stage that the caller has begun.
    pub(crate) fn verify_within(&self, monitor: &dyn Monitor) -> Result<(), StoreError> {
        self.container.verify(monitor)
    }
}

/// Mapped chunks of one basis file.
#[derive(Debug)]
pub struct ChunkWindow<'f> {
    file: &'f DegreeFile,
    mapped: MappedParts,
}

impl ChunkWindow<'_> {
    /// Returns the indices of the chunks in the window.
    pub fn chunks(&self) -> Range<usize> {
        self.mapped.parts()
    }

    /// Returns the values (rows, 2 l + 1) of a chunk, column-major. Raw f64 values are returned from the map without a
    /// copy; other values are decoded into `scratch`. The first read of a chunk verifies its checksum.
    ///
    /// Results computed from the values are valid only after [`check`](Self::check) has returned no error.
    ///
    /// # Errors
    ///
    /// [`StoreError::ChunkDamaged`] if the chunk doesn't match its checksum or can't be decoded,
    /// [`StoreError::ChangedWhileRead`] if the file has changed or couldn't be read.
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

    /// Returns the values (rows, 2 l + 1) of a chunk from the map, column-major, if they are raw f64; otherwise `None`.
    ///
    /// # Errors
    ///
    /// The errors of [`values`](Self::values).
    ///
    /// # Panics
    ///
    /// If the window doesn't hold the chunk.
    pub fn in_place(&self, chunk: usize) -> Result<Option<&[f64]>, StoreError> {
        let container = &self.file.container;
        if self.file.header().scalar != Scalar::F64 || container.entries()[chunk].codec != Codec::Raw {
            return Ok(None);
        }
        // The cast can't fail: chunks start at multiples of 64 bytes in the file, and memory maps start at pages.
        Ok(Some(bytemuck::cast_slice(container.stored(&self.mapped, chunk)?)))
    }

    /// Decodes a chunk of any codec and scalar type into `out`, which is resized to the number of values.
    ///
    /// # Errors
    ///
    /// The errors of [`values`](Self::values).
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
                    // The chunk's checksum has already been verified. Before reporting damage, check whether the file
                    // has changed since that verification.
                    self.check()?;
                    return Err(container.contents().damaged(self.file.path(), chunk, "its zstd frame"));
                };
                widen(&raw, scalar, out);
            }
        }
        Ok(())
    }

    /// Maps all pages of a chunk with one system call. The request is only a hint, so a failure is ignored.
    ///
    /// # Panics
    ///
    /// If the window doesn't hold the chunk.
    pub fn populate(&self, chunk: usize) {
        self.file.container.populate(&self.mapped, chunk);
    }

    /// Asks the system to start reading the entire window from disk. The request is only a hint, so a failure is
    /// ignored.
    pub fn will_need(&self) {
        self.file.container.will_need(&self.mapped);
    }

    /// Returns an error if the file has been truncated or changed since it was opened, or if part of it couldn't be
    /// read.
    ///
    /// # Errors
    ///
    /// [`StoreError::ChangedWhileRead`] in each of these cases.
    pub fn check(&self) -> Result<(), StoreError> {
        self.file.container.check(&self.mapped)
    }
}

/// Converts little-endian values of type `scalar` to doubles.
fn widen(raw: &[u8], scalar: Scalar, out: &mut Vec<f64>) {
    out.clear();
    match scalar {
        Scalar::F64 => out.extend(raw.chunks_exact(8).map(|bytes| f64::from_bits(u64_at(bytes, 0)))),
        Scalar::F32 => out.extend(raw.chunks_exact(4).map(|bytes| f64::from(f32::from_bits(u32_at(bytes, 0))))),
    }
}
