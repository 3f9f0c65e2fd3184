//! Opens regular files for reading and mapping, and checks that they haven't changed since they were opened.

use std::fs::{File, Metadata, OpenOptions};
use std::io;
use std::os::unix::fs::{FileExt, FileTypeExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use crate::error::StoreError;

/// An open regular file, and its size and modification time when it was opened.
#[derive(Debug)]
pub(crate) struct Source {
    path: PathBuf,
    file: File,
    stamp: Stamp,
}

/// Size and modification time of a file. A change of either reveals that the file was written to or truncated. The
/// change time (ctime) isn't compared, because creating a hard link or changing the owner also updates it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Stamp {
    len: u64,
    seconds: i64,
    nanoseconds: i64,
}

impl Stamp {
    fn of(metadata: &Metadata) -> Self {
        Self { len: metadata.len(), seconds: metadata.mtime(), nanoseconds: metadata.mtime_nsec() }
    }
}

impl Source {
    /// Opens a regular file. Never blocks on a FIFO, and rejects symbolic links.
    pub(crate) fn open(path: &Path) -> Result<Self, StoreError> {
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
        Ok(Self { path: path.to_path_buf(), file, stamp: Stamp::of(&metadata) })
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    pub(crate) fn file(&self) -> &File {
        &self.file
    }

    /// Returns the length of the file when it was opened, in bytes.
    pub(crate) fn len(&self) -> u64 {
        self.stamp.len
    }

    /// Fills `buffer` with the bytes that begin at `offset`.
    pub(crate) fn read_at(&self, offset: u64, buffer: &mut [u8]) -> Result<(), StoreError> {
        self.file.read_exact_at(buffer, offset).map_err(|error| match error.kind() {
            io::ErrorKind::UnexpectedEof => StoreError::ChangedWhileRead { path: self.path.clone() },
            _ => StoreError::io(&self.path, "cannot read")(error),
        })
    }

    /// Fails if the file's size or modification time has changed since it was opened.
    pub(crate) fn check(&self) -> Result<(), StoreError> {
        match self.file.metadata() {
            Ok(metadata) if Stamp::of(&metadata) == self.stamp => Ok(()),
            _ => Err(StoreError::ChangedWhileRead { path: self.path.clone() }),
        }
    }
}
