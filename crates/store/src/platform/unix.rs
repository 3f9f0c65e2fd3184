//! System calls of Unix.

use std::fs::{File, OpenOptions, Permissions};
use std::io;
use std::num::NonZeroU64;
use std::os::unix::fs::{FileExt, FileTypeExt, OpenOptionsExt, PermissionsExt};
use std::path::Path;

use memmap2::{Advice, Mmap};
use tempfile::NamedTempFile;

pub(crate) use super::faults::FaultGuard;

/// Opens a regular file for reading, without following a symbolic link and without blocking on a FIFO. If the path
/// names something other than a regular file, the inner error states what it is, such as a folder.
pub(crate) fn open_regular(path: &Path) -> io::Result<Result<File, &'static str>> {
    let flags = libc::O_NOFOLLOW | libc::O_NONBLOCK | libc::O_CLOEXEC;
    let file = match OpenOptions::new().read(true).custom_flags(flags).open(path) {
        Err(error) if error.raw_os_error() == Some(libc::ELOOP) => return Ok(Err("a symbolic link")),
        Err(error) if error.raw_os_error() == Some(libc::ENXIO) => return Ok(Err("a socket or device")),
        opened => opened?,
    };
    let kind = file.metadata()?.file_type();
    Ok(match kind {
        k if k.is_file() => Ok(file),
        k if k.is_dir() => Err("a folder"),
        k if k.is_fifo() => Err("a FIFO"),
        k if k.is_socket() => Err("a socket"),
        _ => Err("a device"),
    })
}

/// Opens a lock file, without following a symbolic link. With `write`, also opens the file for writing, and creates it
/// if it doesn't exist.
pub(crate) fn open_lock(path: &Path, write: bool) -> io::Result<File> {
    let flags = libc::O_NOFOLLOW | libc::O_NONBLOCK;
    OpenOptions::new().read(true).write(write).create(write).custom_flags(flags).open(path)
}

/// Reads bytes starting at `offset` into `buffer`, and returns the number of bytes read.
pub(crate) fn read_at(file: &File, buffer: &mut [u8], offset: u64) -> io::Result<usize> {
    file.read_at(buffer, offset)
}

/// Fills `buffer` with the bytes that begin at `offset`.
pub(crate) fn read_exact_at(file: &File, buffer: &mut [u8], offset: u64) -> io::Result<()> {
    file.read_exact_at(buffer, offset)
}

/// Writes all bytes at `offset`.
pub(crate) fn write_all_at(file: &File, bytes: &[u8], offset: u64) -> io::Result<()> {
    file.write_all_at(bytes, offset)
}

/// Asks the system to start reading a range of a file. The request is only a hint, so a failure is ignored.
pub(crate) fn file_will_need(file: &File, offset: u64, len: NonZeroU64) {
    #[cfg(not(target_vendor = "apple"))]
    let _ = rustix::fs::fadvise(file, offset, Some(len), rustix::fs::Advice::WillNeed);
    #[cfg(target_vendor = "apple")]
    let _ = (file, offset, len);
}

/// Asks the system to start reading a range of a map. The request is only a hint, so a failure is ignored.
pub(crate) fn map_will_need(map: &Mmap, offset: usize, len: usize) {
    let _ = map.advise_range(Advice::WillNeed, offset, len);
}

/// Makes the pages of a range of a map resident with one system call. The request is only a hint, so a failure is
/// ignored.
pub(crate) fn populate_map(map: &Mmap, offset: usize, len: usize) {
    #[cfg(target_os = "linux")]
    let _ = map.advise_range(Advice::PopulateRead, offset, len);
    #[cfg(not(target_os = "linux"))]
    map_will_need(map, offset, len);
}

/// Syncs a folder to disk, so that the creation and removal of files in it survive a power failure.
pub(crate) fn sync_folder(folder: &Path) -> io::Result<()> {
    match File::open(folder)?.sync_all() {
        // Some network file systems can't sync a folder (EINVAL). Their servers make changes durable on their own.
        Err(error) if error.kind() == io::ErrorKind::InvalidInput => Ok(()),
        result => result,
    }
}

/// Returns the free bytes on the disk of an existing folder.
pub(crate) fn free_space(folder: &Path) -> io::Result<u64> {
    let statistics = rustix::fs::statvfs(folder)?;
    Ok(statistics.f_bavail.saturating_mul(statistics.f_frsize))
}

/// Gives a temporary file its final name, without replacing an existing file of that name.
pub(crate) fn publish(temporary: NamedTempFile, path: &Path) -> io::Result<()> {
    temporary.persist_noclobber(path).map(drop).map_err(|error| error.error)
}

/// Gives new temporary files the usual permissions, limited by the umask, so that other users can read a store.
pub(crate) fn with_usual_rights(builder: &mut tempfile::Builder<'_, '_>) {
    builder.permissions(Permissions::from_mode(0o666));
}
