//! Writes a basis file or factor: first its parts (chunks or tiles) in any order, then the header, table and footer.
//! Finally, gives the temporary file its final name.
//!
//! A file is valid if its footer passes all checks and it has its final name. Before that, it has a temporary name,
//! which readers ignore. If an error occurs, the temporary file is removed; see "Writing" in `store-format.md`.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use tempfile::NamedTempFile;

use crate::container::codec::Codec;
use crate::container::frame::{Contents, HEADER_LEN, encode};
use crate::container::reader::Container;
use crate::container::table::{Entry, FOOTER_LEN, Footer, encode_table, root};
use crate::error::StoreError;
use crate::{platform, temporary};

/// A file being written. Threads may write different parts at the same time.
#[derive(Debug)]
pub(crate) struct ContainerWriter {
    path: PathBuf,
    temporary: NamedTempFile,
    entries: Mutex<Vec<Option<Entry>>>,
}

impl ContainerWriter {
    /// Creates the temporary file for `folder/name`, which will have `parts` parts. The temporary file's name begins
    /// with `.` and `prefix`.
    pub(crate) fn create(folder: &Path, name: &str, prefix: &str, parts: usize) -> Result<Self, StoreError> {
        let temporary = temporary::create(folder, &format!(".{prefix}."))
            .map_err(StoreError::io(folder, "cannot create a file in the store"))?;
        Ok(Self { path: folder.join(name), temporary, entries: Mutex::new(vec![None; parts]) })
    }

    /// Returns the final path of the file.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the open temporary file.
    pub(crate) fn file(&self) -> &File {
        self.temporary.as_file()
    }

    /// Writes the stored bytes of a part. The padding up to the next part isn't written; the system fills it with
    /// zeros.
    pub(crate) fn write_part(
        &self,
        part: usize,
        offset: u64,
        stored: &[u8],
        raw_len: usize,
        codec: Codec,
    ) -> Result<(), StoreError> {
        platform::write_all_at(self.file(), stored, offset).map_err(StoreError::io(&self.path, "cannot write"))?;
        let entry = Entry::of(offset, stored, raw_len, codec);
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)[part] = Some(entry);
        Ok(())
    }

    /// Writes the header, table and footer, syncs the file to disk, and gives it its final name. Returns the file's
    /// length in bytes. If another process has already published a file under that name, checks and keeps the other
    /// file, and returns `None`.
    ///
    /// Panics if a part wasn't written.
    pub(crate) fn publish<C: Contents>(self, contents: &C) -> Result<Option<u64>, StoreError> {
        let Self { path, temporary, entries } = self;
        let entries = entries.into_inner().unwrap_or_else(PoisonError::into_inner);
        let entries: Vec<Entry> = entries.into_iter().flatten().collect();
        assert_eq!(
            entries.len(),
            contents.parts(),
            "every {} must be written before the file is published",
            C::KIND.part
        );
        let header = encode(contents);
        let table = encode_table(&entries);
        let table_offset = entries.last().map_or(HEADER_LEN as u64, Entry::next_offset);
        let footer_offset = table_offset + table.len() as u64;
        let file_len = footer_offset + FOOTER_LEN as u64;
        let root = root(C::KIND.root_context, &header[..], &table);
        let footer = Footer { table_offset, entries: entries.len() as u64, file_len, root };
        let failed = |action| StoreError::io(&path, action);
        let file = temporary.as_file();
        platform::write_all_at(file, &header[..], 0).map_err(failed("cannot write"))?;
        platform::write_all_at(file, &table, table_offset).map_err(failed("cannot write"))?;
        platform::write_all_at(file, &footer.encode(), footer_offset).map_err(failed("cannot write"))?;
        file.sync_all().map_err(failed("cannot write to disk"))?;
        match platform::publish(temporary, &path) {
            Ok(()) => Ok(Some(file_len)),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                Container::<C>::open(&path)?;
                Ok(None)
            }
            Err(error) => Err(failed("cannot move the finished file to this path")(error)),
        }
    }
}
