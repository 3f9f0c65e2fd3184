//! Opens regular files for reading and mapping, and checks that they haven't changed since they were opened.

use std::fs::{File, Metadata};
use std::io;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use crate::error::StoreError;
use crate::platform;

/// An open regular file, with the size and modification time that it had when it was opened.
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
    /// Modification time; `None` if the file system doesn't provide it.
    modified: Option<SystemTime>,
}

impl Stamp {
    fn of(metadata: &Metadata) -> Self {
        Self { len: metadata.len(), modified: metadata.modified().ok() }
    }
}

impl Source {
    /// Opens a regular file. Never blocks on a FIFO, and rejects symbolic links.
    pub(crate) fn open(path: &Path) -> Result<Self, StoreError> {
        let opened = platform::open_regular(path).map_err(StoreError::io(path, "cannot open"))?;
        let file = opened.map_err(|found| StoreError::NotAFile { path: path.to_path_buf(), found })?;
        let stamp = Stamp::of(&file.metadata().map_err(StoreError::io(path, "cannot open"))?);
        Ok(Self { path: path.to_path_buf(), file, stamp })
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
        platform::read_exact_at(&self.file, buffer, offset).map_err(|error| match error.kind() {
            io::ErrorKind::UnexpectedEof => StoreError::ChangedWhileRead { path: self.path.clone() },
            _ => StoreError::io(&self.path, "cannot read")(error),
        })
    }

    /// Returns an error if the file's size or modification time has changed since it was opened.
    pub(crate) fn check(&self) -> Result<(), StoreError> {
        match self.file.metadata() {
            Ok(metadata) if Stamp::of(&metadata) == self.stamp => Ok(()),
            _ => Err(StoreError::ChangedWhileRead { path: self.path.clone() }),
        }
    }
}
