//! System calls that the standard library doesn't provide on all platforms. Unix and Windows implement the same
//! functions.
//!
//! | | Unix | Windows |
//! |---|---|---|
//! | a file changes while it is read | detected afterwards, by its size and modification time | refused by the system |
//! | a page of a mapped file is missing | detected afterwards (`FaultGuard`) | ends the process |
//! | flushing a folder to disk | `fsync` | left to the file system's journal |
//! | permissions of new files | limited by the umask | inherited from the folder |

#[cfg(unix)]
mod faults;
#[cfg(unix)]
mod unix;
#[cfg(windows)]
mod windows;

#[cfg(unix)]
pub(crate) use unix::*;
#[cfg(windows)]
pub(crate) use windows::*;
