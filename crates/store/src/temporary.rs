//! Creates temporary files in a scheme's folder, and finds the temporary files of killed builds.
//!
//! A builder holds a lock on every temporary file that it writes. A temporary file that isn't locked is abandoned.

use std::fs::{File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use tempfile::NamedTempFile;

use crate::error::StoreError;
use crate::platform;

/// Prefixes of the names of temporary files: `.A_` for basis files, `.factor_` for factors.
const PREFIXES: [&str; 2] = [".A_", ".factor_"];
const SUFFIX: &str = ".tmp";

/// Creates a temporary file and locks it, so that other processes see that it is in use. On file systems without locks,
/// other processes regard a file as abandoned if it is old.
pub(crate) fn create(folder: &Path, prefix: &str) -> io::Result<NamedTempFile> {
    debug_assert!(PREFIXES.iter().any(|known| prefix.starts_with(known)), "{prefix}");
    loop {
        let mut builder = tempfile::Builder::new();
        builder.prefix(prefix).suffix(SUFFIX);
        platform::with_usual_rights(&mut builder);
        let temporary = builder.tempfile_in(folder)?;
        match temporary.as_file().try_lock() {
            // Between the creation and the locking of the file, another process mistook the file for a leftover. That
            // process has removed the file, or holds the lock in order to remove it. Try again with a new file.
            Ok(()) if !temporary.path().try_exists()? => {}
            Err(TryLockError::WouldBlock) => {}
            Ok(()) | Err(TryLockError::Error(_)) => return Ok(temporary),
        }
    }
}

/// Lists the temporary files in a folder that no process is writing to.
pub(crate) fn abandoned(folder: &Path) -> Result<Vec<PathBuf>, StoreError> {
    let mut found = Vec::new();
    for_each_abandoned(folder, &mut |path| found.push(path.to_path_buf()))?;
    Ok(found)
}

/// Removes the abandoned temporary files and returns their paths. Files that can't be removed are skipped.
pub(crate) fn remove_abandoned(folder: &Path) -> Result<Vec<PathBuf>, StoreError> {
    let mut removed = Vec::new();
    for_each_abandoned(folder, &mut |path| {
        if std::fs::remove_file(path).is_ok() {
            removed.push(path.to_path_buf());
        }
    })?;
    Ok(removed)
}

/// Calls `visit` with each abandoned temporary file while holding the file's lock. If a builder has just created the
/// file, the builder fails to lock it and so notices that the file is being removed.
fn for_each_abandoned(folder: &Path, visit: &mut dyn FnMut(&Path)) -> Result<(), StoreError> {
    for item in std::fs::read_dir(folder).map_err(StoreError::io(folder, "cannot list"))? {
        let item = item.map_err(StoreError::io(folder, "cannot list"))?;
        let name = item.file_name();
        let name = name.to_string_lossy();
        let regular = item.file_type().is_ok_and(|kind| kind.is_file());
        if !regular || !PREFIXES.iter().any(|prefix| name.starts_with(prefix)) || !name.ends_with(SUFFIX) {
            continue;
        }
        // The file may have been published or removed since the folder was listed.
        let Ok(file) = File::open(item.path()) else { continue };
        let free = match file.try_lock() {
            Ok(()) => true,
            Err(TryLockError::WouldBlock) => false,
            Err(TryLockError::Error(_)) => is_old(&item),
        };
        if free {
            visit(&item.path());
        }
    }
    Ok(())
}

/// Returns whether a file was last written to more than 24 hours ago.
fn is_old(item: &std::fs::DirEntry) -> bool {
    /// Time since the last write after which a file is regarded as abandoned, on file systems without locks.
    const OLD: Duration = Duration::from_secs(24 * 3600);
    let modified = item.metadata().and_then(|metadata| metadata.modified());
    modified.is_ok_and(|time| time.elapsed().is_ok_and(|age| age > OLD))
}

#[cfg(test)]
mod tests {
    use std::time::SystemTime;

    use super::*;

    #[test]
    fn a_day_without_a_write_is_old() {
        let folder = tempfile::tempdir().unwrap();
        let file = File::create(folder.path().join("file")).unwrap();
        let old_after = |hours: u64| {
            file.set_modified(SystemTime::now() - Duration::from_secs(hours * 3600)).unwrap();
            is_old(&std::fs::read_dir(folder.path()).unwrap().next().unwrap().unwrap())
        };
        assert!(!old_after(0) && !old_after(23) && old_after(25));
        // A file with a modification time in the future isn't old.
        file.set_modified(SystemTime::now() + Duration::from_secs(90_000)).unwrap();
        assert!(!is_old(&std::fs::read_dir(folder.path()).unwrap().next().unwrap().unwrap()));
    }

    #[test]
    fn others_see_that_a_new_file_is_in_use() {
        let folder = tempfile::tempdir().unwrap();
        let temporary = create(folder.path(), ".A_1.").unwrap();
        let name = temporary.path().file_name().unwrap().to_string_lossy().into_owned();
        assert!(name.starts_with(".A_1.") && name.ends_with(".tmp"), "{name}");
        assert!(abandoned(folder.path()).unwrap().is_empty());
        // Close the file, as the system does when a builder is killed.
        let path = temporary.into_temp_path();
        assert_eq!(abandoned(folder.path()).unwrap(), [path.to_path_buf()]);
    }
}
