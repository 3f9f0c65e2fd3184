//! One `A_<l>`: opened and checked, then read chunk by chunk, by map or by decoding.

use std::fs::{File, OpenOptions};
use std::io;
use std::ops::Range;
use std::os::unix::fs::{FileExt, FileTypeExt, OpenOptionsExt};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::StoreError;
use crate::codec::{Codec, check_frame, decode};
use crate::header::{HEADER_LEN, Header};
use crate::map::{Source, Window};
use crate::scheme::Scalar;
use crate::table::{ENTRY_LEN, Entry, FOOTER_LEN, Footer, ROOT_CONTEXT, decode_table, root};

/// An open basis file whose header, table and footer are sound. Chunks are checked when they are first read.
#[derive(Debug)]
pub struct DegreeFile {
    source: Source,
    header: Header,
    entries: Vec<Entry>,
    file_len: u64,
    /// Chunks whose checksum has been found right by this process.
    checked: Vec<AtomicBool>,
}

impl DegreeFile {
    /// Opens a file and checks all but its chunks.
    ///
    /// # Errors
    ///
    /// [`StoreError::NotAFile`], [`StoreError::Corrupt`], [`StoreError::Version`], [`StoreError::Io`].
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        let (file, file_len, source) = open_regular(path)?;
        if file_len < (HEADER_LEN + ENTRY_LEN + FOOTER_LEN) as u64 {
            let least = HEADER_LEN + ENTRY_LEN + FOOTER_LEN;
            return Err(StoreError::corrupt(path, "length of the file", format!("at least {least}"), file_len));
        }
        let mut header_bytes = [0; HEADER_LEN];
        read_at(&file, path, 0, &mut header_bytes)?;
        let header = Header::decode(&header_bytes, path)?;
        let (table, table_offset) =
            read_table(&file, path, file_len, &header_bytes, header.chunk_count() as u64, ROOT_CONTEXT)?;
        let entries = decode_table(&table, &header, table_offset, path)?;
        let checked = entries.iter().map(|_| AtomicBool::new(false)).collect();
        let source = Source::new(source.0, file, &source.1);
        Ok(Self { source, header, entries, file_len, checked })
    }

    /// What the file holds.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.source.path
    }

    /// Its length in bytes.
    pub fn file_len(&self) -> u64 {
        self.file_len
    }

    /// Whether every chunk is raw f64, so that it can be used in place.
    pub fn is_direct(&self) -> bool {
        self.header.scalar == Scalar::F64 && self.entries.iter().all(|entry| entry.codec == Codec::Raw)
    }

    /// Maps the chunks of a range. A window over compressed chunks holds their stored bytes.
    ///
    /// # Errors
    ///
    /// [`StoreError::Io`].
    ///
    /// # Panics
    ///
    /// If the range is empty or goes past the last chunk.
    pub fn window(&self, chunks: Range<usize>) -> Result<ChunkWindow<'_>, StoreError> {
        let (first, last) = (&self.entries[chunks.start], &self.entries[chunks.end - 1]);
        let len = (last.offset + last.stored_len - first.offset) as usize;
        let window = Window::new(&self.source, first.offset, len)?;
        Ok(ChunkWindow { file: self, window, first: first.offset, chunks })
    }

    /// Bytes of a chunk as stored.
    pub fn stored_len(&self, chunk: usize) -> usize {
        self.entries[chunk].stored_len as usize
    }

    /// Checks every BLAKE3 hash, every CRC and every padding byte, in pieces: what a hostile file claims to hold costs
    /// time, not memory. `buffer` is reused from file to file.
    pub(crate) fn verify(&self, buffer: &mut Vec<u8>) -> Result<(), StoreError> {
        let table_offset = self.file_len - FOOTER_LEN as u64 - (self.entries.len() * ENTRY_LEN) as u64;
        for (chunk, entry) in self.entries.iter().enumerate() {
            let damaged = |what| StoreError::ChunkDamaged { path: self.path().to_path_buf(), chunk, what };
            let end = entry.offset + entry.stored_len;
            let (mut hasher, mut crc) = (blake3::Hasher::new(), 0);
            pieces(&self.source, entry.offset..end, buffer, &mut |piece| {
                hasher.update(piece);
                crc = crc32c::crc32c_append(crc, piece);
            })?;
            if hasher.finalize().as_bytes() != &entry.hash {
                return Err(damaged("its BLAKE3 hash"));
            }
            if crc != entry.crc {
                return Err(damaged("its CRC-32C"));
            }
            let next = self.entries.get(chunk + 1).map_or(table_offset, |entry| entry.offset);
            let mut zeros = true;
            pieces(&self.source, end..next, buffer, &mut |piece| zeros &= piece.iter().all(|&byte| byte == 0))?;
            if !zeros {
                return Err(damaged("the padding after it"));
            }
            if entry.codec == Codec::Zstd {
                let stored = FileRange { file: &self.source.file, range: entry.offset..end };
                check_frame(stored, entry.raw_len).map_err(|_| damaged("its zstd frame"))?;
            }
        }
        self.source.check()
    }

    fn check_crc(&self, chunk: usize, stored: &[u8]) -> Result<(), StoreError> {
        if !self.checked[chunk].load(Ordering::Relaxed) {
            if crc32c::crc32c(stored) != self.entries[chunk].crc {
                // A page that went missing shows as a wrong checksum too; say what really happened.
                self.source.check()?;
                let path = self.path().to_path_buf();
                return Err(StoreError::ChunkDamaged { path, chunk, what: "its CRC-32C" });
            }
            self.checked[chunk].store(true, Ordering::Relaxed);
        }
        Ok(())
    }
}

/// Chunks of one file, mapped.
#[derive(Debug)]
pub struct ChunkWindow<'f> {
    file: &'f DegreeFile,
    window: Window,
    first: u64,
    chunks: Range<usize>,
}

impl ChunkWindow<'_> {
    /// The chunks that it holds.
    pub fn chunks(&self) -> Range<usize> {
        self.chunks.clone()
    }

    /// The values of a chunk, (rows, 2 l + 1) column-major: in place where they are raw f64, otherwise decoded into
    /// `scratch`. The first time in a process its checksum is verified.
    ///
    /// What is computed from them counts only once [`check`](Self::check) has passed.
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

    /// The values of a chunk where it is raw f64, as [`values`](Self::values) gives them; `None` where it isn't.
    ///
    /// # Errors
    ///
    /// As for [`values`](Self::values).
    ///
    /// # Panics
    ///
    /// If the window doesn't hold the chunk.
    pub fn in_place(&self, chunk: usize) -> Result<Option<&[f64]>, StoreError> {
        if self.file.header.scalar != Scalar::F64 || self.file.entries[chunk].codec != Codec::Raw {
            return Ok(None);
        }
        let bytes = self.stored(chunk);
        self.file.check_crc(chunk, bytes)?;
        // Chunks start at multiples of 64 bytes and maps at pages, so the cast doesn't fail.
        Ok(Some(bytemuck::cast_slice(bytes)))
    }

    /// Decodes a chunk of any kind into `out`, which gets its exact size.
    ///
    /// # Errors
    ///
    /// As for [`values`](Self::values).
    ///
    /// # Panics
    ///
    /// If the window doesn't hold the chunk.
    pub fn decode(&self, chunk: usize, out: &mut Vec<f64>) -> Result<(), StoreError> {
        let entry = &self.file.entries[chunk];
        let stored = self.stored(chunk);
        self.file.check_crc(chunk, stored)?;
        let scalar = self.file.header.scalar;
        match entry.codec {
            Codec::Raw => widen(stored, scalar, out),
            Codec::Zstd => {
                let Ok(raw) = decode(stored, entry.raw_len as usize, scalar.size()) else {
                    // Its checksum was right once: see whether the bytes went missing since.
                    self.check()?;
                    let path = self.file.path().to_path_buf();
                    return Err(StoreError::ChunkDamaged { path, chunk, what: "its zstd frame" });
                };
                widen(&raw, scalar, out);
            }
        }
        Ok(())
    }

    /// Maps a chunk's pages in one go, before it is used.
    pub fn populate(&self, chunk: usize) {
        let (start, len) = self.place(chunk);
        self.window.populate(start, len);
    }

    /// Starts reading the whole window from disk.
    pub fn will_need(&self) {
        self.window.will_need(0, self.window.bytes().len());
    }

    /// Fails when the file was truncated, changed or unreadable since it was opened.
    ///
    /// # Errors
    ///
    /// [`StoreError::ChangedWhileRead`].
    pub fn check(&self) -> Result<(), StoreError> {
        self.window.check(&self.file.source)
    }

    fn place(&self, chunk: usize) -> (usize, usize) {
        assert!(self.chunks.contains(&chunk), "chunk {chunk} of a window on {:?}", self.chunks);
        let entry = &self.file.entries[chunk];
        ((entry.offset - self.first) as usize, entry.stored_len as usize)
    }

    fn stored(&self, chunk: usize) -> &[u8] {
        let (start, len) = self.place(chunk);
        &self.window.bytes()[start..start + len]
    }
}

/// Little-endian values as doubles.
fn widen(raw: &[u8], scalar: Scalar, out: &mut Vec<f64>) {
    out.clear();
    match scalar {
        Scalar::F64 => out.extend(raw.chunks_exact(8).map(|b| f64::from_bits(crate::bytes::u64_at(b, 0)))),
        Scalar::F32 => {
            out.extend(raw.chunks_exact(4).map(|b| f64::from(f32::from_bits(crate::bytes::u32_at(b, 0)))));
        }
    }
}

/// Reads the footer and the table of a file whose header has been decoded, and checks all but the table's entries.
/// Gives the table and its offset.
pub(crate) fn read_table(
    file: &File,
    path: &Path,
    file_len: u64,
    header: &[u8; HEADER_LEN],
    count: u64,
    root_context: &str,
) -> Result<(Vec<u8>, u64), StoreError> {
    let mut footer_bytes = [0; FOOTER_LEN];
    read_at(file, path, file_len - FOOTER_LEN as u64, &mut footer_bytes)?;
    let footer = Footer::decode(&footer_bytes, file_len, path)?;
    if footer.entries != count {
        return Err(StoreError::corrupt(path, "entries of the table", count, footer.entries));
    }
    // The table must be what lies between the chunks and the footer, so its size is bounded by the file's.
    let table_len = footer.entries.saturating_mul(ENTRY_LEN as u64);
    let end = footer.table_offset.checked_add(table_len).and_then(|end| end.checked_add(FOOTER_LEN as u64));
    if footer.table_offset < HEADER_LEN as u64 || end != Some(file_len) {
        return Err(StoreError::corrupt(path, "place of the table", "just before the footer", footer.table_offset));
    }
    let mut table = vec![0; table_len as usize];
    read_at(file, path, footer.table_offset, &mut table)?;
    if root(root_context, header, &table) != footer.root {
        return Err(StoreError::corrupt(path, "root hash", "that of header and table", "another"));
    }
    Ok((table, footer.table_offset))
}

/// Reads a range of a file through `buffer`, a megabyte at a time.
pub(crate) fn pieces(
    source: &Source,
    range: Range<u64>,
    buffer: &mut Vec<u8>,
    visit: &mut dyn FnMut(&[u8]),
) -> Result<(), StoreError> {
    const PIECE: u64 = 1 << 20;
    let mut at = range.start;
    while at < range.end {
        buffer.resize((range.end - at).min(PIECE) as usize, 0);
        read_at(&source.file, &source.path, at, buffer)?;
        visit(buffer);
        at += buffer.len() as u64;
    }
    Ok(())
}

pub(crate) type Opened = (File, u64, (std::path::PathBuf, std::fs::Metadata));

/// Opens a regular file; never waits for the other end of a FIFO, never follows a symbolic link.
pub(crate) fn open_regular(path: &Path) -> Result<Opened, StoreError> {
    let flags = libc::O_NOFOLLOW | libc::O_NONBLOCK | libc::O_CLOEXEC;
    let not_a_file = |found| StoreError::NotAFile { path: path.to_path_buf(), found };
    let file = match OpenOptions::new().read(true).custom_flags(flags).open(path) {
        Err(error) if error.raw_os_error() == Some(libc::ELOOP) => return Err(not_a_file("a symbolic link")),
        Err(error) if error.raw_os_error() == Some(libc::ENXIO) => return Err(not_a_file("a socket or device")),
        opened => opened.map_err(StoreError::io(path, "cannot open"))?,
    };
    let metadata = file.metadata().map_err(StoreError::io(path, "cannot open"))?;
    let kind = metadata.file_type();
    if !kind.is_file() {
        return Err(not_a_file(match kind {
            k if k.is_dir() => "a folder",
            k if k.is_fifo() => "a FIFO",
            k if k.is_socket() => "a socket",
            _ => "a device",
        }));
    }
    Ok((file, metadata.len(), (path.to_path_buf(), metadata)))
}

/// A part of a file, as a stream.
struct FileRange<'f> {
    file: &'f File,
    range: Range<u64>,
}

impl io::Read for FileRange<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let len = (self.range.end - self.range.start).min(buffer.len() as u64) as usize;
        let read = self.file.read_at(&mut buffer[..len], self.range.start)?;
        self.range.start += read as u64;
        Ok(read)
    }
}

pub(crate) fn read_at(file: &File, path: &Path, offset: u64, buffer: &mut [u8]) -> Result<(), StoreError> {
    file.read_exact_at(buffer, offset).map_err(|error| match error.kind() {
        io::ErrorKind::UnexpectedEof => StoreError::ChangedWhileRead { path: path.to_path_buf() },
        _ => StoreError::io(path, "cannot read")(error),
    })
}
