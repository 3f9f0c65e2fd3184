//! Creates temporary files, and removes temporary files left behind by killed processes.
//!
//! A process locks the temporary file that it writes, so a temporary file without a lock is abandoned. On file systems
//! without locks, a temporary file is assumed to be abandoned if it hasn't been modified for a day.

use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use tempfile::NamedTempFile;

const PREFIX: &str = ".spharm.";
const SUFFIX: &str = ".tmp";
/// Age at which a temporary file on a file system without locks is assumed to be abandoned.
const OLD: Duration = Duration::from_secs(24 * 3600);

/// Creates and locks a temporary file in a folder.
pub(super) fn create(folder: &Path) -> io::Result<NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(PREFIX).suffix(SUFFIX);
    #[cfg(unix)]
    {
        // Set the default permissions of new files. Otherwise, temporary files would be private, and so would the final
        // files.
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(fs::Permissions::from_mode(0o666));
    }
    loop {
        let temporary = builder.tempfile_in(folder)?;
        match temporary.as_file().try_lock() {
            // Between the creation of the file and the lock, another process removed the file as a leftover, so try
            // again.
            Ok(()) if !temporary.path().try_exists()? => {}
            Err(TryLockError::WouldBlock) => {}
            Ok(()) | Err(TryLockError::Error(_)) => return Ok(temporary),
        }
    }
}

/// Removes a folder's abandoned temporary files (those that no process is writing to), and returns their paths. Files
/// that can't be removed are skipped.
///
/// # Errors
///
/// Returns an error if the folder can't be listed.
pub fn remove_leftovers(folder: impl AsRef<Path>) -> io::Result<Vec<PathBuf>> {
    let mut removed = Vec::new();
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let name = entry.file_name();
        let name = name.to_string_lossy();
        if !name.starts_with(PREFIX) || !name.ends_with(SUFFIX) || !entry.file_type().is_ok_and(|kind| kind.is_file()) {
            continue;
        }
        // The file may have been completed since the folder was listed. The lock is held during the removal, so that a
        // process that has just created the file notices the removal.
        let Ok(file) = File::open(entry.path()) else { continue };
        let abandoned = match file.try_lock() {
            Ok(()) => true,
            Err(TryLockError::WouldBlock) => false,
            Err(TryLockError::Error(_)) => {
                let modified = entry.metadata().and_then(|metadata| metadata.modified());
                modified.is_ok_and(|time| time.elapsed().is_ok_and(|age| age > OLD))
            }
        };
        if abandoned && fs::remove_file(entry.path()).is_ok() {
            removed.push(entry.path());
        }
    }
    Ok(removed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_nobody_writes_is_removed_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for name in [".spharm.abcdef.tmp", "model.npz", ".spharm.note", "other.tmp"] {
            fs::write(at(name), "x").unwrap();
        }
        fs::create_dir(at(".spharm.folder.tmp")).unwrap();
        let held = create(folder.path()).unwrap();
        assert_eq!(remove_leftovers(folder.path()).unwrap(), [at(".spharm.abcdef.tmp")]);
        assert!(held.path().exists() && at("model.npz").exists() && at("other.tmp").exists());
        let path = held.path().to_owned();
        drop(held);
        assert!(!path.exists() && remove_leftovers(at("nowhere")).is_err());
    }
}
