//! Errors of parsers, which don't know the file's name.

use std::path::Path;

use crate::error::ExchangeError;

/// The problem of a file's contents.
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

/// Returns a short excerpt of the file's text, without line breaks and escape sequences.
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
