//! Reads and writes numbers in text files.

use std::io::{self, Write};

use crate::flaw::Flaw;

/// Writes the numbers of a row with 17 significant digits, separated by `separator`.
pub(crate) fn write_row<'a>(
    out: &mut dyn Write,
    values: impl IntoIterator<Item = &'a f64>,
    separator: &str,
) -> io::Result<()> {
    for (i, value) in values.into_iter().enumerate() {
        if i > 0 {
            write!(out, "{separator}")?;
        }
        write!(out, "{value:.16e}")?;
    }
    Ok(())
}

/// Parses a finite number. Its exponent may begin with Fortran's `D` instead of `e`.
pub(crate) fn number(word: &str, line: usize) -> Result<f64, Flaw> {
    let parsed = word.parse().or_else(|_| word.replace(['d', 'D'], "e").parse());
    parsed
        .ok()
        .filter(|x: &f64| x.is_finite())
        .ok_or_else(|| Flaw::new(format!("a number on line {line}"), quoted(word)))
}

/// Returns the first 40 characters of a word in quotes, for error messages.
pub(crate) fn quoted(word: &str) -> String {
    format!("{:?}", word.chars().take(40).collect::<String>())
}

/// Returns the contents of a file as text, without a byte-order mark.
pub(crate) fn text(bytes: &[u8]) -> Result<&str, Flaw> {
    let text = std::str::from_utf8(bytes).map_err(|error| Flaw::new("UTF-8 text", error))?;
    Ok(text.trim_start_matches('\u{feff}'))
}
