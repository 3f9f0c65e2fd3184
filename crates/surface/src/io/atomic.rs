//! Writes files atomically: a file appears complete or not at all.
//!
//! A temporary file in the same directory is written, flushed and synchronised. Then it is renamed to the final name in
//! one step, and the directory is synchronised. A crash or a full disk leaves at most a hidden temporary file. An
//! incomplete file is never visible under the final name. The files of a store are written by the same rule (see
//! "Publishing" in the store's design).

use std::fs;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use spharm_files::other_kind;

use super::leftovers;
use crate::error::SurfaceError;

/// Writes a file with the bytes that `f` writes, completely or not at all.
///
/// Without `overwrite`, an existing file isn't changed, even if it appears while `f` runs. With `overwrite`, the old
/// file remains readable until the new one is complete, and the new file gets the old one's permissions. If the path is
/// a symbolic link, the link's target is replaced. If the link is dangling, the link itself is replaced. Directories,
/// pipes and devices are never replaced. A new file that doesn't replace an old one gets the default permissions under
/// the umask.
///
/// # Errors
///
/// [`OutputExists`](SurfaceError::OutputExists) if the file exists and `overwrite` is false;
/// [`NotAFile`](SurfaceError::NotAFile) if the path is a directory, pipe or device; [`Io`](SurfaceError::Io) if `f` or
/// the system fails. After an error the target is unchanged, unless the last step, the synchronisation of the
/// directory, failed.
pub fn write_new(
    path: impl AsRef<Path>,
    overwrite: bool,
    f: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<(), SurfaceError> {
    let path = path.as_ref();
    let io = |action| move |cause| SurfaceError::Io { path: path.to_owned(), action, cause };
    let exists = || SurfaceError::OutputExists { path: path.to_owned() };
    if path.file_name().is_none() {
        return Err(SurfaceError::NotAFile { path: path.to_owned(), found: "a directory" });
    }
    // This check avoids running `f` if its output can't be kept. `persist_noclobber` below repeats the check without a
    // race.
    let mut mode = None;
    let target = match fs::metadata(path) {
        Ok(found) if !found.is_file() => {
            return Err(SurfaceError::NotAFile {
                path: path.to_owned(),
                found: other_kind(found.file_type()).unwrap_or("something else"),
            });
        }
        Ok(_) if !overwrite => return Err(exists()),
        Ok(found) => {
            mode = Some(found.permissions());
            fs::canonicalize(path).map_err(io("resolve"))?
        }
        Err(e) if e.kind() == io::ErrorKind::NotFound => path.to_owned(),
        Err(e) => return Err(io("open")(e)),
    };
    let directory = directory_of(&target);
    if !directory.is_dir() {
        let missing = io::Error::new(io::ErrorKind::NotFound, format!("there is no folder {}", directory.display()));
        return Err(io("create")(missing));
    }

    let temporary = leftovers::create(&directory).map_err(io("create"))?;
    if let Some(mode) = mode {
        // The temporary file gets the permissions before it is written, so that a private file's contents are never
        // exposed.
        temporary.as_file().set_permissions(mode).map_err(io("create"))?;
    }

    let mut out = BufWriter::with_capacity(1 << 16, temporary);
    f(&mut out).and_then(|()| out.flush()).map_err(io("write"))?;
    let temporary = out.into_inner().map_err(|e| io("write")(e.into_error()))?;
    temporary.as_file().sync_all().map_err(io("write"))?;
    if overwrite {
        temporary.persist(&target).map_err(|e| io("write")(e.error))?;
    } else {
        temporary.persist_noclobber(&target).map_err(|e| match e.error.kind() {
            io::ErrorKind::AlreadyExists => exists(),
            _ => io("write")(e.error),
        })?;
    }
    sync_directory(&directory).map_err(io("synchronise the file's folder"))
}

/// Synchronises a directory, so that a new name in it survives a crash. Does nothing if synchronising a directory isn't
/// supported: some network file systems refuse it, and Windows can't open a directory.
fn sync_directory(directory: &Path) -> io::Result<()> {
    if cfg!(not(unix)) {
        return Ok(());
    }
    match fs::File::open(directory).and_then(|d| d.sync_all()) {
        Err(e) if matches!(e.kind(), io::ErrorKind::InvalidInput | io::ErrorKind::Unsupported) => Ok(()),
        done => done,
    }
}

fn directory_of(path: &Path) -> PathBuf {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent.to_owned(),
        _ => PathBuf::from("."),
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn a_replaced_file_keeps_its_permissions_and_a_link_its_target() {
        let folder = tempfile::tempdir().unwrap();
        let (path, link) = (folder.path().join("model.npz"), folder.path().join("link.npz"));
        write_new(&path, false, |out| out.write_all(b"1")).unwrap();
        std::os::unix::fs::symlink(&path, &link).unwrap();
        for mode in [0o600, 0o640, 0o444] {
            fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
            write_new(&link, true, |out| out.write_all(b"2")).unwrap();
            assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, mode);
            assert!(fs::symlink_metadata(&link).unwrap().is_symlink() && fs::read(&path).unwrap() == b"2");
        }
    }
}
