//! Reads and decompresses the bytes of files.

use std::fs;
use std::io::Read;
use std::path::Path;

use spharm_files::{open, other_kind};

use super::flaw::Flaw;
use crate::error::SurfaceError;
use crate::room::{Bytes, check_room, most_expanded};

/// Reads a complete regular file. Directories, FIFOs and devices are rejected before they are opened, since opening a
/// FIFO would wait for its writer.
pub(super) fn load(path: &Path) -> Result<Vec<u8>, SurfaceError> {
    let io = |action| move |cause| SurfaceError::Io { path: path.to_owned(), action, cause };
    let found = regular(path)?;
    // The size is checked because a sparse file takes no space on disk but can be larger than the free memory.
    check_room(found.len()).map_err(|room| SurfaceError::NoRoom { path: path.to_owned(), room })?;
    let mut bytes = Vec::new();
    open(path).and_then(|mut file| file.read_to_end(&mut bytes)).map_err(io("read"))?;
    Ok(bytes)
}

/// Returns the metadata of a regular file without opening it. Returns an error if the path isn't a regular file.
fn regular(path: &Path) -> Result<fs::Metadata, SurfaceError> {
    let found = fs::metadata(path);
    let found = found.map_err(|cause| SurfaceError::Io { path: path.to_owned(), action: "open", cause })?;
    match other_kind(found.file_type()) {
        None => Ok(found),
        Some(found) => Err(SurfaceError::NotAFile { path: path.to_owned(), found }),
    }
}

/// Number of bytes that [`head`] reads.
const HEAD: u64 = 4096;

/// Reads the first bytes of a regular file.
pub(super) fn head(path: &Path) -> Result<Vec<u8>, SurfaceError> {
    let io = |action| move |cause| SurfaceError::Io { path: path.to_owned(), action, cause };
    regular(path)?;
    let mut bytes = Vec::new();
    open(path).map_err(io("open"))?.take(HEAD).read_to_end(&mut bytes).map_err(io("read"))?;
    Ok(bytes)
}

/// Largest number of bytes to which one byte of data compressed by Deflate (gzip, zip) can expand. The limit is
/// inherent in the method.
pub const MOST_EXPANSION: u64 = 1032;

/// Returns whether the bytes begin like a gzip file.
pub(super) fn is_gzip(bytes: &[u8]) -> bool {
    bytes.starts_with(&[0x1f, 0x8b])
}

/// Number of bytes inflated at a time.
const PIECE: usize = 1 << 20;

/// Inflates a gzip file. Contents larger than [`most_expanded`] allows are rejected as a decompression bomb.
pub(super) fn gunzip(bytes: &[u8]) -> Result<Vec<u8>, Flaw> {
    let limit = most_expanded(bytes.len() as u64);
    let text = inflated(flate2::read::MultiGzDecoder::new(bytes), limit, "a gzip stream")?;
    if text.len() as u64 >= limit {
        return Err(Flaw::unsupported(
            format!("contents of more than {} from {} compressed bytes", Bytes(limit), bytes.len()),
            "if you trust the file, unpack it with gunzip",
        ));
    }
    Ok(text)
}

/// Reads decompressed data up to `limit` bytes. Free memory is checked before each allocation. `what` names the data in
/// errors.
pub(super) fn inflated(decoder: impl Read, limit: u64, what: &str) -> Result<Vec<u8>, Flaw> {
    let mut decoder = decoder.take(limit);
    let mut bytes = Vec::new();
    loop {
        if bytes.capacity() - bytes.len() < PIECE {
            let more = bytes.len().max(PIECE);
            check_room((bytes.len() + more) as u64)?;
            bytes.reserve_exact(more);
        }
        let piece = decoder.by_ref().take(PIECE as u64).read_to_end(&mut bytes);
        if piece.map_err(|e| Flaw::new(what, e.to_string()))? == 0 {
            return Ok(bytes);
        }
    }
}
