//! Defines the error type of parsers, which know the contents of a file but not its path.

use std::path::Path;

use crate::error::ExchangeError;

/// A violation of a file's format: the expected content and the content found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Flaw {
    expected: String,
    found: String,
}

impl Flaw {
    pub(crate) fn new(expected: impl Into<String>, found: impl ToString) -> Self {
        Self { expected: expected.into(), found: found.to_string() }
    }

    pub(crate) fn at(self, path: &Path, format: &'static str) -> ExchangeError {
        let (expected, found) = (printable(&self.expected), printable(&self.found));
        ExchangeError::Malformed { path: path.to_owned(), format, expected, found }
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
