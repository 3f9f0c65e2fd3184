//! Protection against cells that spreadsheets would treat as formulas.
//!
//! A cell that begins with `=`, `+`, `-`, `@`, a tab or a carriage return may be evaluated as a formula when a table is
//! opened, and its contents come from the names of files and subjects. As OWASP advises ("CSV Injection"), such text is
//! prefixed with an apostrophe, which spreadsheets treat as a mark of text. To make this reversible, text that already
//! has apostrophes before such a character is prefixed with one more.

use std::borrow::Cow;

const STARTS: [char; 6] = ['=', '+', '-', '@', '\t', '\r'];

fn starts_one(text: &str) -> bool {
    text.trim_start_matches('\'').starts_with(STARTS)
}

/// Returns a cell that no spreadsheet treats as a formula: the text, prefixed with an apostrophe if necessary. Numbers
/// are unchanged.
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

/// Returns the text of a [`guarded`] cell.
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
