//! A file's bytes.

use std::fs::{self, FileType};
use std::io::Read;
use std::path::Path;

use super::flaw::Flaw;
use crate::error::SurfaceError;

/// Reads a regular file whole. Directories, FIFOs and devices are refused before they are opened, since opening a FIFO
/// waits for whoever writes it.
pub(super) fn load(path: &Path) -> Result<Vec<u8>, SurfaceError> {
    let io = |action| move |cause| SurfaceError::Io { path: path.to_owned(), action, cause };
    let kind = fs::metadata(path).map_err(io("open"))?.file_type();
    if !kind.is_file() {
        return Err(SurfaceError::NotAFile { path: path.to_owned(), found: kind_name(kind) });
    }
    fs::read(path).map_err(io("read"))
}

/// What stands at a path, in words.
pub(super) fn kind_name(kind: FileType) -> &'static str {
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        if kind.is_fifo() {
            return "a pipe";
        }
        if kind.is_socket() {
            return "a socket";
        }
        if kind.is_block_device() || kind.is_char_device() {
            return "a device";
        }
    }
    if kind.is_dir() { "a directory" } else { "something else" }
}

/// The most bytes that one of deflate's output (gzip, zip) can stand for: a bound of the method itself.
pub const MOST_EXPANSION: u64 = 1032;

/// Whether bytes begin as a gzipped file does.
pub(super) fn is_gzip(bytes: &[u8]) -> bool {
    bytes.starts_with(&[0x1f, 0x8b])
}

/// Inflates a gzipped file.
///
/// Text compresses two- to tenfold. A file that swells beyond 64 MiB and 256 times its size is taken for a bomb.
pub(super) fn gunzip(bytes: &[u8]) -> Result<Vec<u8>, Flaw> {
    let limit = (bytes.len() as u64).saturating_mul(256).saturating_add(64 << 20);
    let mut text = Vec::new();
    let mut decoder = flate2::read::MultiGzDecoder::new(bytes).take(limit);
    decoder.read_to_end(&mut text).map_err(|e| Flaw::new("a gzip stream", e.to_string()))?;
    if text.len() as u64 >= limit {
        return Err(Flaw::unsupported(
            format!("more than {limit} bytes in {} compressed ones", bytes.len()),
            "unpack it with gunzip if it is to be trusted",
        ));
    }
    Ok(text)
}
