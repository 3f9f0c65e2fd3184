//! Opens regular files without blocking, and reads them completely within a size limit.
//!
//! Opening a FIFO waits for a writer, reading from a FIFO or terminal waits for data, and a device may supply data
//! without end. Such files can't be read more than once either, so they are rejected. The kind is checked before
//! opening, and again after opening, because another program may replace the file in between. Functions that read a
//! whole file have a size limit. The limit also applies to files that grow while they are read, and to files of unknown
//! size, such as those in `/proc`.
//!
//! ```
//! # fn main() -> std::io::Result<()> {
//! let path = std::env::temp_dir().join(format!("spharm-files-{}", std::process::id()));
//! std::fs::write(&path, "\u{feff}id\tage\n")?;
//! assert_eq!(spharm_files::read_text(&path, 1 << 20)?, "id\tage\n");
//! let error = spharm_files::read(&path, 4).unwrap_err();
//! assert_eq!(error.to_string(), "expected at most 4 bytes, found 10");
//! # std::fs::remove_file(&path)
//! # }
//! ```

use std::collections::HashSet;
use std::fs::{File, FileType, OpenOptions};
use std::io::{self, Read};
use std::path::Path;

/// Opens a regular file for reading.
///
/// # Errors
///
/// If the file can't be opened, or isn't a regular file.
pub fn open(path: impl AsRef<Path>) -> io::Result<File> {
    open_with(path, OpenOptions::new().read(true))
}

/// Opens a regular file with the given options, for example for appending. The options may create the file.
///
/// # Errors
///
/// If the file can't be opened, or isn't a regular file.
pub fn open_with(path: impl AsRef<Path>, options: &OpenOptions) -> io::Result<File> {
    let path = path.as_ref();
    match std::fs::metadata(path) {
        Ok(found) => check(found.file_type())?,
        // If the file doesn't exist, `options` may create it; otherwise the open below fails with this error.
        Err(error) if error.kind() == io::ErrorKind::NotFound => {}
        Err(error) => return Err(error),
    }
    #[cfg(unix)]
    let options = {
        use std::os::unix::fs::OpenOptionsExt;
        let mut options = options.clone();
        options.custom_flags(libc::O_NONBLOCK);
        options
    };
    let file = options.open(path)?;
    check(file.metadata()?.file_type())?;
    Ok(file)
}

/// Identity of a file, which is the same for all paths and links to the file: device and inode.
#[cfg(unix)]
pub type FileId = (u64, u64);

/// Identity of a file, which is the same for all paths and symbolic links to the file: the canonical path.
#[cfg(not(unix))]
pub type FileId = std::path::PathBuf;

/// Returns the identity of a regular file; `None` if the path doesn't refer to a regular file.
#[cfg(unix)]
#[must_use]
pub fn file_id(path: &Path) -> Option<FileId> {
    use std::os::unix::fs::MetadataExt;
    std::fs::metadata(path).ok().filter(std::fs::Metadata::is_file).map(|found| (found.dev(), found.ino()))
}

/// Returns the identity of a regular file; `None` if the path doesn't refer to a regular file.
#[cfg(not(unix))]
#[must_use]
pub fn file_id(path: &Path) -> Option<FileId> {
    path.canonicalize().ok().filter(|path| path.is_file())
}

/// Returns the first output that is the same file as one of the inputs, even if their paths differ or are links.
#[must_use]
pub fn first_input<'i, 'a>(
    inputs: impl IntoIterator<Item = &'i Path>,
    outputs: impl IntoIterator<Item = &'a Path>,
) -> Option<&'a Path> {
    // Outputs that don't exist can't be inputs. If no output exists, as in most runs, the inputs don't have to be
    // examined.
    let mut outputs = outputs.into_iter().filter_map(|path| Some((path, file_id(path)?))).peekable();
    outputs.peek()?;
    let inputs: HashSet<FileId> = inputs.into_iter().filter_map(file_id).collect();
    outputs.find(|(_, id)| inputs.contains(id)).map(|(output, _)| output)
}

/// Reads a regular file of at most `most` bytes.
///
/// # Errors
///
/// Returns the errors of [`open`], and an error if the file is longer than `most` bytes or reading fails.
pub fn read(path: impl AsRef<Path>, most: u64) -> io::Result<Vec<u8>> {
    let file = open(path)?;
    let length = file.metadata()?.len();
    let refuse = |found: String| io::Error::other(format!("expected at most {most} bytes, found {found}"));
    if length > most {
        return Err(refuse(length.to_string()));
    }
    let mut bytes = Vec::with_capacity(usize::try_from(length).unwrap_or(0));
    file.take(most.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        return Err(refuse("more".to_owned()));
    }
    Ok(bytes)
}

/// Reads a regular file of at most `most` bytes as UTF-8 text, without the byte-order mark that some editors write.
///
/// # Errors
///
/// Returns the errors of [`read`], and an error if the text isn't UTF-8.
pub fn read_text(path: impl AsRef<Path>, most: u64) -> io::Result<String> {
    let text = String::from_utf8(read(path, most)?).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        let message = format!("expected UTF-8 text, found byte 0x{:02x} at offset {at}", error.as_bytes()[at]);
        io::Error::new(io::ErrorKind::InvalidData, message)
    })?;
    Ok(text.strip_prefix('\u{feff}').map(str::to_owned).unwrap_or(text))
}

/// Returns the kind of a file that isn't a regular file; `None` for a regular file.
#[must_use]
pub fn other_kind(found: FileType) -> Option<&'static str> {
    if found.is_file() {
        return None;
    }
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        if found.is_fifo() {
            return Some("a pipe");
        }
        if found.is_socket() {
            return Some("a socket");
        }
        if found.is_block_device() || found.is_char_device() {
            return Some("a device");
        }
    }
    Some(if found.is_dir() { "a directory" } else { "something else" })
}

fn check(found: FileType) -> io::Result<()> {
    match other_kind(found) {
        None => Ok(()),
        Some(kind) => Err(io::Error::other(format!("expected a regular file, found {kind}"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(result: io::Result<impl Sized>) -> String {
        result.err().map(|error| error.to_string()).unwrap_or_default()
    }

    #[cfg(unix)]
    #[test]
    fn pipes_devices_sockets_and_folders_are_refused_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        rustix::fs::mkfifoat(rustix::fs::CWD, at("pipe"), rustix::fs::Mode::RWXU).unwrap();
        let _socket = std::os::unix::net::UnixListener::bind(at("socket")).unwrap();
        std::os::unix::fs::symlink(at("pipe"), at("link")).unwrap();
        let append = OpenOptions::new().read(true).append(true).create(true).clone();
        for (path, kind) in [
            (at("pipe"), "a pipe"),
            (at("link"), "a pipe"),
            (at("socket"), "a socket"),
            (at(""), "a directory"),
            ("/dev/zero".into(), "a device"),
            ("/dev/null".into(), "a device"),
        ] {
            let expected = format!("expected a regular file, found {kind}");
            assert_eq!(message(open(&path)), expected, "{}", path.display());
            assert_eq!(message(read(&path, 10)), expected);
            assert_eq!(message(open_with(&path, &append)), expected);
        }
        assert_eq!(open(at("none")).unwrap_err().kind(), io::ErrorKind::NotFound);
        assert!(open_with(at("none"), &append).is_ok());
    }

    #[test]
    fn files_are_read_within_the_bound() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("text");
        std::fs::write(&path, "0123456789").unwrap();
        assert_eq!(read(&path, 10).unwrap(), b"0123456789");
        assert_eq!(message(read(&path, 9)), "expected at most 9 bytes, found 10");
        // A sparse file of 1 TiB, which takes no space on disk.
        File::create(&path).unwrap().set_len(1 << 40).unwrap();
        assert_eq!(message(read(&path, 1 << 20)), "expected at most 1048576 bytes, found 1099511627776");
        std::fs::write(&path, b"ab\xff").unwrap();
        assert_eq!(message(read_text(&path, 10)), "expected UTF-8 text, found byte 0xff at offset 2");
    }

    /// The size limit also applies to files in `/proc`, whose length isn't known before they are read.
    #[cfg(target_os = "linux")]
    #[test]
    fn files_without_a_length_are_read_within_the_bound() {
        assert!(read("/proc/self/status", 1 << 20).unwrap().len() > 100);
        assert_eq!(message(read("/proc/self/status", 100)), "expected at most 100 bytes, found more");
    }
}
