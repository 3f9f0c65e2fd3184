//! Defines the error type for parsers, which don't know the file's path.

use std::path::Path;

use crate::error::SurfaceError;
use crate::room::{NoRoom, check_room};

/// An error found by a parser. [`Flaw::at`] adds the file's path to it.
#[derive(Debug)]
pub(super) enum Flaw {
    /// The bytes violate the format.
    Malformed { expected: String, found: String },
    /// The bytes conform to the format but use an unsupported feature of it.
    Unsupported { found: String, remedy: &'static str },
    /// Reading the contents needs more memory than is free.
    NoRoom(NoRoom),
}

impl From<NoRoom> for Flaw {
    fn from(room: NoRoom) -> Self {
        Self::NoRoom(room)
    }
}

impl Flaw {
    pub(super) fn new(expected: impl Into<String>, found: impl Into<String>) -> Self {
        Self::Malformed { expected: expected.into(), found: found.into() }
    }

    pub(super) fn unsupported(found: impl Into<String>, remedy: &'static str) -> Self {
        Self::Unsupported { found: found.into(), remedy }
    }

    pub(super) fn at(self, path: &Path, format: &'static str) -> SurfaceError {
        let path = path.to_owned();
        match self {
            Self::Malformed { expected, found } => {
                SurfaceError::Malformed { path, format, expected: one_line(&expected), found: one_line(&found) }
            }
            Self::Unsupported { found, remedy } => {
                SurfaceError::Unsupported { path, format, found: one_line(&found), remedy }
            }
            Self::NoRoom(room) => SurfaceError::NoRoom { path, room },
        }
    }
}

/// Escapes control characters in a message from another crate, and shortens the message. Such a message may quote the
/// file, whose newlines and escape sequences must not reach a terminal.
fn one_line(text: &str) -> String {
    const MOST: usize = 160;
    let mut line: String = text.chars().take(MOST).flat_map(printable).collect();
    if text.chars().nth(MOST).is_some() {
        line.push_str("...");
    }
    line
}

fn printable(c: char) -> impl Iterator<Item = char> {
    let escaped = c.is_control().then(|| c.escape_default());
    let plain = (!c.is_control()).then_some(c);
    escaped.into_iter().flatten().chain(plain)
}

/// Returns the first bytes of `bytes` in printable form, for a one-line error message.
pub(super) fn shown(bytes: &[u8]) -> String {
    const MOST: usize = 32;
    let head = bytes.get(..MOST).unwrap_or(bytes);
    let more = if bytes.len() > MOST { "..." } else { "" };
    format!("\"{}\"{more}", head.escape_ascii())
}

/// Checks that a count in a header is plausible, before memory is allocated for the counted items. The items must fit
/// into the rest of the file, and enough memory for them must be free.
///
/// `least` is the smallest size of an item in the file, in bytes. In memory, an item is assumed to take at least 8
/// bytes.
pub(super) fn bounded(count: u64, least: usize, remaining: usize, what: &str) -> Result<usize, Flaw> {
    match usize::try_from(count) {
        Ok(n) if n.checked_mul(least).is_some_and(|bytes| bytes <= remaining) => {
            check_room(count.saturating_mul(8))?;
            Ok(n)
        }
        _ => Err(Flaw::new(
            format!("data for {count} {what} (at least {least} bytes each), as stated in the header"),
            format!("only {remaining} bytes"),
        )),
    }
}
