//! Defines the error type of parsers, which know the contents of a file but not its path.

use std::path::Path;

use crate::error::ExchangeError;

/// A reason why a file can't be read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Flaw {
    /// A violation of the file's format: the expected content and the content found.
    Violation { expected: String, found: String },
    /// Content without readable coefficients, and advice on what the user can do with the content.
    Other { found: &'static str, remedy: &'static str },
}

impl Flaw {
    pub(crate) fn new(expected: impl Into<String>, found: impl ToString) -> Self {
        Self::Violation { expected: expected.into(), found: found.to_string() }
    }

    pub(crate) fn at(self, path: &Path, format: &'static str) -> ExchangeError {
        let path = path.to_owned();
        match self {
            Self::Violation { expected, found } => {
                let (expected, found) = (printable(&expected), printable(&found));
                ExchangeError::Malformed { path, format, expected, found }
            }
            Self::Other { found, remedy } => ExchangeError::OtherContents { path, format, found, remedy },
        }
    }
}

/// Returns the beginning of a string for error messages, with control characters escaped.
fn printable(text: &str) -> String {
    const MOST: usize = 160;
    let mut line = String::new();
    for c in text.chars().take(MOST) {
        if c.is_control() {
            line.extend(c.escape_default());
        } else {
            line.push(c);
        }
    }
    if text.chars().nth(MOST).is_some() {
        line.push_str("...");
    }
    line
}
