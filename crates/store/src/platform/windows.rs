//! System calls of Windows.

use std::fs::{File, OpenOptions};
use std::io;
use std::num::NonZeroU64;
use std::os::windows::fs::{FileExt, OpenOptionsExt};
use std::path::Path;

use memmap2::Mmap;

/// `FILE_FLAG_OPEN_REPARSE_POINT`: a symbolic link is opened itself.
const NO_FOLLOW: u32 = 0x0020_0000;
/// `FILE_SHARE_READ` and `FILE_SHARE_DELETE`: others may read, rename and delete the file, but not write to it.
const SHARE_READ_AND_DELETE: u32 = 0x1 | 0x4;
/// `ERROR_ACCESS_DENIED`, with which the system refuses to open a folder as a file.
const ACCESS_DENIED: i32 = 5;

/// Opens a regular file for reading, without following a symbolic link. While it is open, nobody can write to it. The
/// inner error is the kind of a path that isn't a regular file.
pub(crate) fn open_regular(path: &Path) -> io::Result<Result<File, &'static str>> {
    let mut options = OpenOptions::new();
    let file = match options.read(true).share_mode(SHARE_READ_AND_DELETE).custom_flags(NO_FOLLOW).open(path) {
        Err(error) if error.raw_os_error() == Some(ACCESS_DENIED) && path.is_dir() => return Ok(Err("a folder")),
        opened => opened?,
    };
    let kind = file.metadata()?.file_type();
    Ok(match kind {
        k if k.is_file() => Ok(file),
        k if k.is_symlink() => Err("a symbolic link"),
        _ => Err("a device"),
    })
}

/// Opens a lock file, without following a symbolic link. `write` also creates it.
pub(crate) fn open_lock(path: &Path, write: bool) -> io::Result<File> {
    OpenOptions::new().read(true).write(write).create(write).truncate(false).custom_flags(NO_FOLLOW).open(path)
}

/// Reads bytes that begin at `offset`, and returns their number.
pub(crate) fn read_at(file: &File, buffer: &mut [u8], offset: u64) -> io::Result<usize> {
    file.seek_read(buffer, offset)
}

/// Fills `buffer` with the bytes that begin at `offset`.
pub(crate) fn read_exact_at(file: &File, mut buffer: &mut [u8], mut offset: u64) -> io::Result<()> {
    while !buffer.is_empty() {
        match file.seek_read(buffer, offset) {
            Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(read) => {
                buffer = &mut buffer[read..];
                offset += read as u64;
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// Writes all bytes at `offset`.
pub(crate) fn write_all_at(file: &File, mut bytes: &[u8], mut offset: u64) -> io::Result<()> {
    while !bytes.is_empty() {
        match file.seek_write(bytes, offset) {
            Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
            Ok(written) => {
                bytes = &bytes[written..];
                offset += written as u64;
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// Does nothing: the system reads files ahead on its own.
pub(crate) fn file_will_need(_file: &File, _offset: u64, _len: NonZeroU64) {}

/// Does nothing: the system reads files ahead on its own.
pub(crate) fn map_will_need(_map: &Mmap, _offset: usize, _len: usize) {}

/// Does nothing: pages become resident as they are read.
pub(crate) fn populate_map(_map: &Mmap, _offset: usize, _len: usize) {}

/// Checks that a folder exists. Its entries are made durable by the file system's journal.
pub(crate) fn sync_folder(folder: &Path) -> io::Result<()> {
    std::fs::metadata(folder).map(|_| ())
}

/// Returns the free bytes on the disk of an existing folder.
pub(crate) fn free_space(folder: &Path) -> io::Result<u64> {
    fs4::available_space(folder)
}

/// Does nothing: new files inherit the rights of their folder.
pub(crate) fn with_usual_rights(_builder: &mut tempfile::Builder<'_, '_>) {}

/// Stands for the guard of Unix: a file that the store has open can't be truncated, so that its map has all its pages.
#[derive(Debug)]
pub(crate) struct FaultGuard;

impl FaultGuard {
    /// Returns a guard.
    pub(crate) fn new(_start: usize, _end: usize) -> Option<Self> {
        Some(Self)
    }

    /// Returns false.
    pub(crate) fn faulted(&self) -> bool {
        false
    }
}
