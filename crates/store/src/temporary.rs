//! Temporary files in a scheme's folder: creating one, and finding those that killed builds left behind.
//!
//! A builder holds a lock on every temporary file that it writes. A file whose lock is free is abandoned.

use std::fs::{File, Permissions, TryLockError};
use std::io;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::time::Duration;

use tempfile::NamedTempFile;

use crate::error::StoreError;

/// Prefixes of temporary names: those of basis files and of factors.
const PREFIXES: [&str; 2] = [".A_", ".factor_"];
const SUFFIX: &str = ".tmp";

/// Creates a temporary file and locks it, so that other processes see that it is in use. If locks don't work, other
/// processes judge by its age.
pub(crate) fn create(folder: &Path, prefix: &str) -> io::Result<NamedTempFile> {
    debug_assert!(PREFIXES.iter().any(|known| prefix.starts_with(known)), "{prefix}");
    loop {
        let temporary = tempfile::Builder::new()
            .prefix(prefix)
            .suffix(SUFFIX)
            .permissions(Permissions::from_mode(0o666)) // minus the umask: a store is meant to be shared
            .tempfile_in(folder)?;
        match temporary.as_file().try_lock() {
            // Another process removed it as a leftover between its creation and the lock, or is about to.
            Ok(()) if temporary.as_file().metadata()?.nlink() == 0 => {}
            Err(TryLockError::WouldBlock) => {}
            Ok(()) | Err(TryLockError::Error(_)) => return Ok(temporary),
        }
    }
}

/// Lists the temporary files of a folder that no process is writing any longer.
pub(crate) fn abandoned(folder: &Path) -> Result<Vec<PathBuf>, StoreError> {
    let mut found = Vec::new();
    for_each_abandoned(folder, &mut |path| found.push(path.to_path_buf()))?;
    Ok(found)
}

/// Removes the abandoned files and returns their paths. Files that can't be removed are left for the next builder.
pub(crate) fn remove_abandoned(folder: &Path) -> Result<Vec<PathBuf>, StoreError> {
    let mut removed = Vec::new();
    for_each_abandoned(folder, &mut |path| {
        if std::fs::remove_file(path).is_ok() {
            removed.push(path.to_path_buf());
        }
    })?;
    Ok(removed)
}

/// Calls `visit` with each abandoned file while its lock is held, so that a builder that has just created the file
/// notices.
fn for_each_abandoned(folder: &Path, visit: &mut dyn FnMut(&Path)) -> Result<(), StoreError> {
    for item in std::fs::read_dir(folder).map_err(StoreError::io(folder, "cannot list"))? {
        let item = item.map_err(StoreError::io(folder, "cannot list"))?;
        let name = item.file_name();
        let name = name.to_string_lossy();
        let regular = item.file_type().is_ok_and(|kind| kind.is_file());
        if !regular || !PREFIXES.iter().any(|prefix| name.starts_with(prefix)) || !name.ends_with(SUFFIX) {
            continue;
        }
        // The file may have been finished or removed since it was listed.
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

/// Returns whether a file was last written to so long ago that it must be abandoned.
fn is_old(item: &std::fs::DirEntry) -> bool {
    /// If locks don't work, a file this old without a write counts as abandoned.
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
        // One of the future isn't.
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
        temporary.as_file().unlock().unwrap();
        assert_eq!(abandoned(folder.path()).unwrap(), [temporary.path()]);
    }
}
