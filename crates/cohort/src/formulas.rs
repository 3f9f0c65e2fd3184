//! Protects tables against cells that spreadsheets would evaluate as formulas.
//!
//! Cells contain names of files and subjects. When a spreadsheet opens a table, it may evaluate a cell as a formula if
//! the cell begins with `=`, `+`, `-`, `@`, a tab or a carriage return. As OWASP advises ("CSV Injection"), such a cell
//! is prefixed with an apostrophe, which spreadsheets treat as a mark of text. A cell that already has apostrophes
//! before such a character gets one more apostrophe, so that the prefix can be removed without ambiguity.

use std::borrow::Cow;

const STARTS: [char; 6] = ['=', '+', '-', '@', '\t', '\r'];

fn starts_one(text: &str) -> bool {
    text.trim_start_matches('\'').starts_with(STARTS)
}

/// Converts a string to a cell that no spreadsheet evaluates as a formula, by prefixing an apostrophe if necessary.
/// Numbers are unchanged.
///
/// ```
/// use spharm_cohort::{guarded, unguarded};
/// assert_eq!(guarded("=cmd|calc"), "'=cmd|calc");
/// assert_eq!(guarded("-2.5e-3"), "-2.5e-3");
/// assert_eq!(unguarded("'=cmd|calc"), "=cmd|calc");
/// ```
#[must_use]
pub fn guarded(text: &str) -> Cow<'_, str> {
    if starts_one(text) && text.parse::<f64>().is_err() { Cow::Owned(format!("'{text}")) } else { Cow::Borrowed(text) }
}

/// Converts a string to a cell of a tab-separated table, protected by [`guarded`]. Control characters, which could end
/// the cell, are replaced by blanks.
#[must_use]
pub fn cell(text: &str) -> String {
    guarded(&text.replace(char::is_control, " ")).into_owned()
}

/// Returns the original string of a cell that [`guarded`] returned.
#[must_use]
pub fn unguarded(cell: &str) -> &str {
    cell.strip_prefix('\'').filter(|text| starts_one(text)).unwrap_or(cell)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn guarded_text_begins_no_formula_and_comes_back() {
        for text in
            ["=1+1", "+a", "-b", "@SUM(1+1)", "\tx", "\rx", "'=x", "''@y", "s01", "", "'", "'s", "-1", "+2.5", "1e3"]
        {
            let cell = guarded(text);
            assert!(!cell.starts_with(STARTS) || cell.parse::<f64>().is_ok(), "{text:?}");
            assert_eq!(unguarded(&cell), text, "{cell:?}");
        }
        assert_eq!((guarded("s01"), guarded("-1")), (Cow::Borrowed("s01"), Cow::Borrowed("-1")));
    }
}
