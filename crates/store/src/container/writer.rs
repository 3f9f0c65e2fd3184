//! Writing a file: parts in any order, then header, table and footer, and then the change from the temporary name to
//! the final one.
//!
//! A file is valid when its footer is sound and its name is final. Until then it has a temporary name, which readers
//! ignore, and it is removed on any error; see "Writing" in `store-format.md`.

use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use tempfile::NamedTempFile;

use crate::container::codec::Codec;
use crate::container::frame::{Contents, HEADER_LEN, encode};
use crate::container::reader::Container;
use crate::container::table::{Entry, FOOTER_LEN, Footer, encode_table, root};
use crate::error::StoreError;
use crate::temporary;

/// A file being written. Threads may write different parts at the same time.
#[derive(Debug)]
pub(crate) struct ContainerWriter {
    path: PathBuf,
    temporary: NamedTempFile,
    entries: Mutex<Vec<Option<Entry>>>,
}

impl ContainerWriter {
    /// Starts the file `folder/name` with `parts` parts. The temporary name begins with `.` and `prefix`.
    pub(crate) fn create(folder: &Path, name: &str, prefix: &str, parts: usize) -> Result<Self, StoreError> {
        let temporary = temporary::create(folder, &format!(".{prefix}."))
            .map_err(StoreError::io(folder, "cannot create a file in the store"))?;
        Ok(Self { path: folder.join(name), temporary, entries: Mutex::new(vec![None; parts]) })
    }

    /// The final path.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// The temporary file.
    pub(crate) fn file(&self) -> &File {
        self.temporary.as_file()
    }

    /// Writes the stored bytes of a part. The gap up to the next part stays a hole, which reads as zeros.
    pub(crate) fn write_part(
        &self,
        part: usize,
        offset: u64,
        stored: &[u8],
        raw_len: usize,
        codec: Codec,
    ) -> Result<(), StoreError> {
        self.file().write_all_at(stored, offset).map_err(StoreError::io(&self.path, "cannot write"))?;
        let entry = Entry::of(offset, stored, raw_len, codec);
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)[part] = Some(entry);
        Ok(())
    }

    /// Writes header, table and footer, waits for the disk, and gives the file its name. Returns its length, or `None`
    /// if a sound file of that name exists by now; that file then stays.
    ///
    /// Panics if a part wasn't written.
    pub(crate) fn publish<C: Contents>(self, contents: &C) -> Result<Option<u64>, StoreError> {
        let Self { path, temporary, entries } = self;
        let entries = entries.into_inner().unwrap_or_else(PoisonError::into_inner);
        let entries: Vec<Entry> = entries.into_iter().flatten().collect();
        assert_eq!(entries.len(), contents.parts(), "every {} was written", C::KIND.part);
        let header = encode(contents);
        let table = encode_table(&entries);
        let table_offset = entries.last().map_or(HEADER_LEN as u64, Entry::next_offset);
        let footer_offset = table_offset + table.len() as u64;
        let file_len = footer_offset + FOOTER_LEN as u64;
        let root = root(C::KIND.root_context, &header[..], &table);
        let footer = Footer { table_offset, entries: entries.len() as u64, file_len, root };
        let failed = |action| StoreError::io(&path, action);
        let file = temporary.as_file();
        file.write_all_at(&header[..], 0).map_err(failed("cannot write"))?;
        file.write_all_at(&table, table_offset).map_err(failed("cannot write"))?;
        file.write_all_at(&footer.encode(), footer_offset).map_err(failed("cannot write"))?;
        file.sync_all().map_err(failed("cannot write to disk"))?;
        match temporary.persist_noclobber(&path) {
            Ok(_) => Ok(Some(file_len)),
            Err(error) if error.error.kind() == io::ErrorKind::AlreadyExists => {
                Container::<C>::open(&path)?;
                Ok(None)
            }
            Err(error) => Err(failed("cannot give the file its name")(error.error)),
        }
    }
}
