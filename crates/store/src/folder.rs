//! Manages the folders of a store and of its schemes: their names, listing, locking, and free disk space.

use std::fs::{File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use spharm_monitor::{Level, Monitor};

use crate::error::StoreError;
use crate::platform;
use crate::scheme::SchemeKey;

/// Returns the path of a scheme's folder in a store.
pub(crate) fn of_scheme(store: &Path, key: SchemeKey) -> PathBuf {
    store.join(key.to_string())
}

/// Lists the keys of the schemes in a store, in ascending order.
pub(crate) fn schemes(store: &Path) -> Result<Vec<SchemeKey>, StoreError> {
    list(store, "cannot open the store", |name| name.parse().ok())
}

/// Applies `parse` to the file names in a folder. Returns the results in ascending order; names for which `parse`
/// returns `None` are skipped.
pub(crate) fn list<T: Ord>(
    folder: &Path,
    action: &'static str,
    parse: impl Fn(&str) -> Option<T>,
) -> Result<Vec<T>, StoreError> {
    let mut found = Vec::new();
    for item in std::fs::read_dir(folder).map_err(StoreError::io(folder, action))? {
        let name = item.map_err(StoreError::io(folder, action))?.file_name();
        found.extend(name.to_str().and_then(&parse));
    }
    found.sort_unstable();
    Ok(found)
}

/// Creates the folder of a scheme, and the folder of the store if it doesn't exist.
pub(crate) fn create(store: &Path, folder: &Path) -> Result<(), StoreError> {
    if !folder.is_dir() {
        std::fs::create_dir_all(folder).map_err(StoreError::io(folder, "cannot create"))?;
        sync(store)?;
    }
    Ok(())
}

/// Syncs a folder to disk, so that the creation and removal of files in it survive a power failure.
pub(crate) fn sync(folder: &Path) -> Result<(), StoreError> {
    platform::sync_folder(folder).map_err(StoreError::io(folder, "cannot write to disk"))
}

/// Removes a damaged file, so that it can be written again.
pub(crate) fn remove_damaged(path: &Path) -> Result<(), StoreError> {
    match std::fs::remove_file(path) {
        // Another builder, working without a lock, removed the file first.
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        removed => removed.map_err(StoreError::io(path, "cannot remove")),
    }
}

/// Waits until no other process builds this scheme, and returns the locked lock file. The lock only prevents duplicate
/// work. Builders are also safe without it, so the result is `None` if the file system doesn't support locks or the
/// lock file can't be created.
pub(crate) fn lock(folder: &Path, monitor: &dyn Monitor) -> Result<Option<File>, StoreError> {
    let path = folder.join(".lock");
    // If another user created the lock file, this process may have only the permission to read it, which is enough for
    // locking. If the lock file can't be created, the build continues without a lock. If the folder isn't writable, the
    // creation of the first basis file will report the error.
    let Ok(file) = platform::open_lock(&path, true).or_else(|_| platform::open_lock(&path, false)) else {
        return Ok(None);
    };
    let mut noted = false;
    loop {
        match file.try_lock() {
            Ok(()) => return Ok(Some(file)),
            Err(TryLockError::Error(_)) => return Ok(None),
            Err(TryLockError::WouldBlock) => {}
        }
        if !std::mem::replace(&mut noted, true) {
            let text = "another build of this scheme is running; waiting for it to finish";
            monitor.note(Level::Info, format_args!("{text}"));
        }
        monitor.check()?;
        std::thread::sleep(Duration::from_millis(100));
    }
}

/// Size in bytes (64 GiB) above which writing files needs explicit permission.
pub(crate) const LARGE: u64 = 64 << 30;

/// Returns an error if `needed` exceeds the free bytes on the store's disk, or the limit [`LARGE`].
pub(crate) fn check_space(store: &Path, what: &'static str, needed: u64) -> Result<(), StoreError> {
    let free = free_space(store)?;
    if is_too_much(needed, free) {
        return Err(StoreError::Space { path: store.to_path_buf(), what, needed, free });
    }
    Ok(())
}

fn is_too_much(needed: u64, free: u64) -> bool {
    needed > free || needed > LARGE
}

/// Returns the free bytes on the disk of the store, whose folder need not exist yet.
fn free_space(store: &Path) -> Result<u64, StoreError> {
    // If the store's folder doesn't exist, use its nearest existing ancestor.
    let existing = store.ancestors().find(|path| path.exists()).unwrap_or(Path::new("."));
    let existing = if existing.as_os_str().is_empty() { Path::new(".") } else { existing };
    platform::free_space(existing).map_err(StoreError::io(existing, "cannot determine the free disk space"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_fits_the_disk_and_is_not_large_may_be_written() {
        assert!(!is_too_much(10, 10) && !is_too_much(0, 0) && !is_too_much(LARGE, LARGE));
        assert!(is_too_much(11, 10) && is_too_much(LARGE + 1, u64::MAX));
        let folder = tempfile::tempdir().unwrap();
        check_space(folder.path(), "basis", 1).unwrap();
        match check_space(&folder.path().join("not/yet"), "basis", u64::MAX) {
            Err(StoreError::Space { path, what: "basis", needed: u64::MAX, free }) => {
                assert_eq!(path, folder.path().join("not/yet"));
                // Other processes may write to the disk between the two measurements, so a deviation of 10 % plus 1 GB
                // is allowed.
                let bytes = platform::free_space(folder.path()).unwrap() as f64;
                assert!((free as f64 - bytes).abs() <= 0.1 * bytes + 1e9, "{free} of {bytes}");
            }
            other => panic!("{other:?}"),
        }
        // A relative path without a folder name: its only existing ancestor is the empty path, the current directory.
        check_space(Path::new("not-yet"), "basis", 1).unwrap();
    }

    #[test]
    fn what_is_gone_need_not_be_removed() {
        let folder = tempfile::tempdir().unwrap();
        remove_damaged(&folder.path().join("nothing")).unwrap();
        std::fs::write(folder.path().join("file"), "text").unwrap();
        remove_damaged(&folder.path().join("file")).unwrap();
        assert!(!folder.path().join("file").exists());
        std::fs::create_dir(folder.path().join("folder")).unwrap();
        assert!(remove_damaged(&folder.path().join("folder")).is_err());
        sync(folder.path()).unwrap();
        assert!(sync(&folder.path().join("nothing")).is_err());
    }
}
