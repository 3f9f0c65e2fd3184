//! One `A_<l>` on its way to disk: chunks in any order into a temporary file, then the footer, then the final name.
//!
//! A file is there when its footer is sound and its name is final. Everything before that lives under a temporary name
//! that no reader looks at and that is removed on any error; what a killed process leaves behind is recognised by its
//! lock being free, and removed by the next builder or by `store gc`.

use std::fs::{File, Permissions};
use std::io;
use std::os::unix::fs::{FileExt, MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::{Condvar, Mutex, PoisonError};
use std::time::Duration;

use spharm_monitor::Monitor;
use tempfile::NamedTempFile;

use crate::StoreError;
use crate::codec::{Codec, Encoder};
use crate::header::{ALIGNMENT, HEADER_LEN, Header};
use crate::reader::DegreeFile;
use crate::table::{Entry, FOOTER_LEN, Footer, ROOT_CONTEXT, encode_table, root};

/// Name of a degree's file.
pub(crate) fn file_name(degree: usize) -> String {
    format!("A_{degree}")
}

/// What temporary names begin with: those of basis files and those of factors.
const TEMPORARY_PREFIXES: [&str; 2] = [".A_", ".factor_"];
const TEMPORARY_SUFFIX: &str = ".tmp";

/// A basis file being written. Threads may put different chunks at the same time.
pub(crate) struct DegreeWriter {
    header: Header,
    path: PathBuf,
    temporary: NamedTempFile,
    slots: Mutex<Slots>,
    turn: Condvar,
}

struct Slots {
    entries: Vec<Option<Entry>>,
    /// For compressed chunks: whose turn it is to take the next place, and where that is. The order of chunks on disk
    /// doesn't depend on the threads, so a file's bytes don't either.
    next_chunk: usize,
    next_offset: u64,
}

impl DegreeWriter {
    pub(crate) fn create(folder: &Path, header: Header) -> Result<Self, StoreError> {
        let path = folder.join(file_name(header.degree));
        let temporary = create_temporary(folder, &format!(".A_{}.", header.degree))
            .map_err(StoreError::io(folder, "cannot create a file in the store"))?;
        temporary.as_file().write_all_at(&header.encode(), 0).map_err(StoreError::io(&path, "cannot write"))?;
        let slots = Slots { entries: vec![None; header.chunk_count()], next_chunk: 0, next_offset: HEADER_LEN as u64 };
        Ok(Self { header, path, temporary, slots: Mutex::new(slots), turn: Condvar::new() })
    }

    /// Writes a chunk given as raw bytes, compressed when there is an encoder. Gives up early when the monitor says so.
    pub(crate) fn put(
        &self,
        chunk: usize,
        raw: &[u8],
        encoder: Option<&mut Encoder>,
        monitor: &dyn Monitor,
    ) -> Result<(), StoreError> {
        debug_assert_eq!(raw.len(), self.header.raw_len(chunk));
        let failed = |error| StoreError::io(&self.path, "cannot write")(error);
        let Some(encoder) = encoder else {
            let offset = self.header.raw_offset(chunk);
            self.write(offset, raw).map_err(failed)?;
            let entry = entry(offset, raw, raw.len(), Codec::Raw);
            self.lock().entries[chunk] = Some(entry);
            return Ok(());
        };
        let encoded = encoder.encode(raw, self.header.scalar.size()).map_err(failed)?;
        let (stored, codec) = if encoded.len() < raw.len() { (&encoded[..], Codec::Zstd) } else { (raw, Codec::Raw) };
        let mut entry = entry(0, stored, raw.len(), codec);
        entry.offset = self.take_place(chunk, stored.len(), monitor)?;
        self.write(entry.offset, stored).map_err(failed)?;
        self.lock().entries[chunk] = Some(entry);
        Ok(())
    }

    /// Waits for the chunks before this one to have taken their places. Threads take chunks in increasing order, so
    /// somebody is always at work on the one that everybody waits for.
    fn take_place(&self, chunk: usize, len: usize, monitor: &dyn Monitor) -> Result<u64, StoreError> {
        let mut slots = self.lock();
        while slots.next_chunk != chunk {
            monitor.check()?;
            let waited = self.turn.wait_timeout(slots, Duration::from_millis(50));
            slots = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
        let offset = slots.next_offset;
        slots.next_chunk += 1;
        slots.next_offset = (offset + len as u64).next_multiple_of(ALIGNMENT);
        self.turn.notify_all();
        Ok(offset)
    }

    /// Writes stored bytes; the gap up to the next chunk stays a hole, which reads as zeros.
    fn write(&self, offset: u64, stored: &[u8]) -> io::Result<()> {
        self.temporary.as_file().write_all_at(stored, offset)
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Slots> {
        self.slots.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Writes table and footer, waits for the disk, and gives the file its name. Returns its length, or `None` when
    /// another builder has published the same file first, which then stays.
    pub(crate) fn publish(self) -> Result<Option<u64>, StoreError> {
        let slots = self.slots.into_inner().unwrap_or_else(PoisonError::into_inner);
        let entries: Vec<Entry> = slots.entries.into_iter().flatten().collect();
        assert_eq!(entries.len(), self.header.chunk_count(), "every chunk was put");
        let published = publish(self.temporary, &self.path, &self.header.encode(), &entries, ROOT_CONTEXT)?;
        if published.is_none() {
            DegreeFile::open(&self.path)?;
        }
        Ok(published)
    }
}

/// Writes table and footer of a file whose header and chunks are written, waits for the disk, and gives the file its
/// name. Returns its length, or `None` when there is a file of that name by now, which then stays.
pub(crate) fn publish(
    temporary: NamedTempFile,
    path: &Path,
    header: &[u8],
    entries: &[Entry],
    root_context: &str,
) -> Result<Option<u64>, StoreError> {
    let failed = |action| StoreError::io(path, action);
    let table_offset = entries.last().map_or(0, |entry| (entry.offset + entry.stored_len).next_multiple_of(ALIGNMENT));
    let table = encode_table(entries);
    let file_len = table_offset + (table.len() + FOOTER_LEN) as u64;
    let root = root(root_context, header, &table);
    let footer = Footer { table_offset, entries: entries.len() as u64, file_len, root };
    let file = temporary.as_file();
    file.write_all_at(&table, table_offset).map_err(failed("cannot write"))?;
    file.write_all_at(&footer.encode(), table_offset + table.len() as u64).map_err(failed("cannot write"))?;
    file.sync_all().map_err(failed("cannot write to disk"))?;
    match temporary.persist_noclobber(path) {
        Ok(_) => Ok(Some(file_len)),
        Err(error) if error.error.kind() == io::ErrorKind::AlreadyExists => Ok(None),
        Err(error) => Err(failed("cannot give the file its name")(error.error)),
    }
}

/// A new temporary file, locked to tell other processes that somebody is at work on it. Where locks don't work, age has
/// to do.
pub(crate) fn create_temporary(folder: &Path, prefix: &str) -> io::Result<NamedTempFile> {
    loop {
        let temporary = tempfile::Builder::new()
            .prefix(prefix)
            .suffix(TEMPORARY_SUFFIX)
            .permissions(Permissions::from_mode(0o666)) // less the umask: a store is there to be shared
            .tempfile_in(folder)?;
        match temporary.as_file().try_lock() {
            // Between its creation and the lock somebody took it for a leftover and removed it, or is about to.
            Ok(()) if temporary.as_file().metadata()?.nlink() == 0 => {}
            Err(std::fs::TryLockError::WouldBlock) => {}
            Ok(()) | Err(std::fs::TryLockError::Error(_)) => return Ok(temporary),
        }
    }
}

pub(crate) fn entry(offset: u64, stored: &[u8], raw_len: usize, codec: Codec) -> Entry {
    Entry {
        offset,
        stored_len: stored.len() as u64,
        raw_len: raw_len as u64,
        crc: crc32c::crc32c(stored),
        codec,
        hash: *blake3::hash(stored).as_bytes(),
    }
}

/// Makes names and removals in a folder durable.
pub(crate) fn sync_folder(folder: &Path) -> Result<(), StoreError> {
    let failed = |error| StoreError::io(folder, "cannot write to disk")(error);
    match File::open(folder).map_err(failed)?.sync_all() {
        // Some network file systems can't sync a folder; their servers do so on their own.
        Err(error) if error.kind() == io::ErrorKind::InvalidInput => Ok(()),
        result => result.map_err(failed),
    }
}

/// Temporary files in a scheme's folder that nobody is at work on any more.
pub(crate) fn abandoned(folder: &Path) -> Result<Vec<PathBuf>, StoreError> {
    let mut found = Vec::new();
    for_each_abandoned(folder, &mut |path| found.push(path.to_path_buf()))?;
    Ok(found)
}

/// Removes them, and says which. One that can't be removed is left for the next builder.
pub(crate) fn remove_abandoned(folder: &Path) -> Result<Vec<PathBuf>, StoreError> {
    let mut removed = Vec::new();
    for_each_abandoned(folder, &mut |path| {
        if std::fs::remove_file(path).is_ok() {
            removed.push(path.to_path_buf());
        }
    })?;
    Ok(removed)
}

/// Calls `visit` with each while its lock is held, so that a builder that has only just created a file finds out.
fn for_each_abandoned(folder: &Path, visit: &mut dyn FnMut(&Path)) -> Result<(), StoreError> {
    /// Where locks don't work, nobody works on one file for this long.
    const OLD: Duration = Duration::from_secs(24 * 3600);
    for item in std::fs::read_dir(folder).map_err(StoreError::io(folder, "cannot list"))? {
        let item = item.map_err(StoreError::io(folder, "cannot list"))?;
        let name = item.file_name();
        let name = name.to_string_lossy();
        let regular = item.file_type().is_ok_and(|kind| kind.is_file());
        if !regular
            || !TEMPORARY_PREFIXES.iter().any(|prefix| name.starts_with(prefix))
            || !name.ends_with(TEMPORARY_SUFFIX)
        {
            continue;
        }
        // It may have been finished or removed since it was listed.
        let Ok(file) = File::open(item.path()) else { continue };
        let old = || {
            let modified = item.metadata().and_then(|metadata| metadata.modified());
            modified.is_ok_and(|time| time.elapsed().is_ok_and(|age| age > OLD))
        };
        let free = match file.try_lock() {
            Ok(()) => true,
            Err(std::fs::TryLockError::WouldBlock) => false,
            Err(std::fs::TryLockError::Error(_)) => old(),
        };
        if free {
            visit(&item.path());
        }
    }
    Ok(())
}
