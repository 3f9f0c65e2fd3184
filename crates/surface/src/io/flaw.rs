//! Errors of parsers, which don't know the file's name.

use std::path::Path;

use crate::error::SurfaceError;
use crate::room::{NoRoom, check_room};

/// An error of a parser. [`Flaw::at`] adds the file's name.
#[derive(Debug)]
pub(super) enum Flaw {
    /// The bytes break the format's rules.
    Malformed { expected: String, found: String },
    /// The bytes follow them, and this reader doesn't.
    Unsupported { found: String, remedy: &'static str },
    /// What they hold takes more memory than there is.
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

/// What other crates say quotes the file; a terminal should get neither its newlines nor its escape sequences.
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

/// A short, printable rendering of bytes from outside, for an error of one line.
pub(super) fn shown(bytes: &[u8]) -> String {
    const MOST: usize = 32;
    let head = bytes.get(..MOST).unwrap_or(bytes);
    let more = if bytes.len() > MOST { "..." } else { "" };
    format!("\"{}\"{more}", head.escape_ascii())
}

/// A count from a header, held against what is left of the file, so that it may be allocated for.
///
/// `least` is the fewest bytes one item takes in the file; in memory none takes less than a number of 64 bits.
pub(super) fn bounded(count: u64, least: usize, remaining: usize, what: &str) -> Result<usize, Flaw> {
    match usize::try_from(count) {
        Ok(n) if n.checked_mul(least).is_some_and(|bytes| bytes <= remaining) => {
            check_room(count.saturating_mul(8))?;
            Ok(n)
        }
        _ => Err(Flaw::new(
            format!("{count} {what} (at least {least} bytes each), as its header says"),
            format!("{remaining} bytes"),
        )),
    }
}
