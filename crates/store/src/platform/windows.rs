//! System calls of Windows.

use std::fs::{File, OpenOptions};
use std::io;
use std::num::NonZeroU64;
use std::os::windows::fs::{FileExt, MetadataExt, OpenOptionsExt};
use std::path::Path;
use std::time::{Duration, Instant};

use memmap2::Mmap;
use tempfile::NamedTempFile;

/// `FILE_FLAG_OPEN_REPARSE_POINT`: opens a symbolic link itself rather than its target.
const NO_FOLLOW: u32 = 0x0020_0000;
/// `FILE_ATTRIBUTE_REPARSE_POINT`: the file is a reparse point, such as a symbolic link.
const REPARSE_POINT: u32 = 0x400;
/// `FILE_SHARE_READ` and `FILE_SHARE_DELETE`: other processes may read, rename and delete the file, but not write to
/// it.
const SHARE_READ_AND_DELETE: u32 = 0x1 | 0x4;
/// `ERROR_ACCESS_DENIED`: returned if a folder is opened as a file, or a file is renamed while another program reads
/// it.
const ACCESS_DENIED: i32 = 5;
/// `ERROR_SHARING_VIOLATION`: another process has the file open for writing.
const SHARING_VIOLATION: i32 = 32;
/// `ERROR_LOCK_VIOLATION`: another process has locked the file, which also prevents reading.
const LOCK_VIOLATION: i32 = 33;

/// Repeats a call for up to a second while it fails with one of the temporary errors `passing`. A file is visible under
/// its final name shortly before its writer closes it, and virus scanners open new files for a moment.
fn with_patience<T>(passing: &[i32], mut call: impl FnMut() -> io::Result<T>) -> io::Result<T> {
    let started = Instant::now();
    loop {
        match call() {
            Err(error)
                if error.raw_os_error().is_some_and(|code| passing.contains(&code))
                    && started.elapsed() < Duration::from_secs(1) =>
            {
                std::thread::sleep(Duration::from_millis(10));
            }
            result => return result,
        }
    }
}

/// Opens a regular file for reading, without following a symbolic link. While the file is open, no process can write to
/// it. If the path names something other than a regular file, the inner error states what it is, such as a folder.
pub(crate) fn open_regular(path: &Path) -> io::Result<Result<File, &'static str>> {
    let open = |flags: u32| {
        let mut options = OpenOptions::new();
        options.read(true).share_mode(SHARE_READ_AND_DELETE).custom_flags(flags);
        with_patience(&[SHARING_VIOLATION, LOCK_VIOLATION], || options.open(path))
    };
    let file = match open(NO_FOLLOW) {
        Err(error) if error.raw_os_error() == Some(ACCESS_DENIED) && path.is_dir() => return Ok(Err("a folder")),
        opened => opened?,
    };
    let metadata = file.metadata()?;
    Ok(match metadata.file_type() {
        k if k.is_symlink() => Err("a symbolic link"),
        // This reparse point is a regular file whose bytes are supplied by a file-system filter, such as a file on a
        // volume with deduplication.
        k if k.is_file() && metadata.file_attributes() & REPARSE_POINT != 0 => Ok(open(0)?),
        k if k.is_file() => Ok(file),
        _ => Err("a device"),
    })
}

/// Opens a lock file, without following a symbolic link. With `write`, also opens the file for writing, and creates it
/// if it doesn't exist.
pub(crate) fn open_lock(path: &Path, write: bool) -> io::Result<File> {
    OpenOptions::new().read(true).write(write).create(write).truncate(false).custom_flags(NO_FOLLOW).open(path)
}

/// Reads bytes starting at `offset` into `buffer`, and returns the number of bytes read.
pub(crate) fn read_at(file: &File, buffer: &mut [u8], offset: u64) -> io::Result<usize> {
    with_patience(&[LOCK_VIOLATION], || file.seek_read(buffer, offset))
}

/// Fills `buffer` with the bytes that begin at `offset`.
pub(crate) fn read_exact_at(file: &File, mut buffer: &mut [u8], mut offset: u64) -> io::Result<()> {
    while !buffer.is_empty() {
        match read_at(file, buffer, offset) {
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

/// Does nothing: a page becomes resident when it is first read.
pub(crate) fn populate_map(_map: &Mmap, _offset: usize, _len: usize) {}

/// Checks that a folder exists. Its entries are made durable by the file system's journal.
pub(crate) fn sync_folder(folder: &Path) -> io::Result<()> {
    std::fs::metadata(folder).map(|_| ())
}

/// Returns the free bytes on the disk of an existing folder.
pub(crate) fn free_space(folder: &Path) -> io::Result<u64> {
    fs4::available_space(folder)
}

/// Gives a temporary file its final name, without replacing an existing file of that name.
pub(crate) fn publish(temporary: NamedTempFile, path: &Path) -> io::Result<()> {
    let mut unpublished = Some(temporary);
    with_patience(&[ACCESS_DENIED, SHARING_VIOLATION], || match unpublished.take() {
        Some(temporary) => temporary.persist_noclobber(path).map(drop).map_err(|failed| {
            unpublished = Some(failed.file);
            failed.error
        }),
        None => Ok(()),
    })
}

/// Does nothing: new files inherit the permissions of their folder.
pub(crate) fn with_usual_rights(_builder: &mut tempfile::Builder<'_, '_>) {}

/// Stands in for the guard of Unix, and does nothing: a file that the store has open can't be truncated, so its map
/// always has all pages.
#[derive(Debug)]
pub(crate) struct FaultGuard;

impl FaultGuard {
    /// Returns a guard that does nothing.
    pub(crate) fn new(_start: usize, _end: usize) -> Option<Self> {
        Some(Self)
    }

    /// Returns false, because pages are never missing.
    pub(crate) fn faulted(&self) -> bool {
        false
    }
}
