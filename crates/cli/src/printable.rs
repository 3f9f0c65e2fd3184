//! Escapes text from files and arguments before it is printed to a terminal or a log.
//!
//! File names, table cells and format headers may contain characters that a terminal acts on instead of showing them:
//! escape sequences, line breaks, and characters that reverse the direction of the text. Everything that the program
//! prints passes through this module, so that each line of output stays a single line.

use std::borrow::Cow;

/// Returns whether a terminal may act on a character instead of showing it: control characters (of ASCII and of
/// Latin-1), line and paragraph separators, and characters that change the direction of the text.
fn is_obeyed(c: char) -> bool {
    c.is_control() || matches!(c, '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{200e}' | '\u{200f}')
}

/// Returns a string as one line: line breaks become blanks, and other control characters are shown as escapes such as
/// `\u{1b}`.
#[must_use]
pub fn one_line(text: &str) -> Cow<'_, str> {
    replaced(text, |c| if c == '\n' { " ".to_owned() } else { c.escape_default().collect() })
}

/// Escapes control characters in a string of several lines as [`one_line`] does, except line breaks and tabs.
#[must_use]
pub fn lines(text: &str) -> Cow<'_, str> {
    replaced(text, |c| if matches!(c, '\n' | '\t') { c.to_string() } else { c.escape_default().collect() })
}

/// Returns `text`, which is JSON, as equivalent JSON in which all control characters are escaped, except line breaks
/// between tokens. JSON itself requires escapes only for control characters up to U+001F.
#[must_use]
pub fn json(text: &str) -> Cow<'_, str> {
    // Line breaks within strings are already escaped. All other control characters are below U+10000, so four digits
    // suffice.
    replaced(text, |c| if c == '\n' { c.to_string() } else { format!("\\u{:04x}", u32::from(c)) })
}

fn replaced(text: &str, by: impl Fn(char) -> String) -> Cow<'_, str> {
    if !text.contains(is_obeyed) {
        return Cow::Borrowed(text);
    }
    let mut shown = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        if is_obeyed(c) { shown.push_str(&by(c)) } else { shown.push(c) }
    }
    Cow::Owned(shown)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_reaches_a_terminal_but_what_it_shows() {
        assert_eq!(one_line("f\u{fc}r a.ply"), "f\u{fc}r a.ply");
        assert_eq!(one_line("a\u{1b}[2J\nb\r\u{7}\t\u{9b}5m"), "a\\u{1b}[2J b\\r\\u{7}\\t\\u{9b}5m");
        assert_eq!(one_line("gnp.\u{202e}exe\u{2028}"), "gnp.\\u{202e}exe\\u{2028}");
        assert_eq!(lines("a\tb\n\u{1b}c\u{7f}"), "a\tb\n\\u{1b}c\\u{7f}");
    }

    #[test]
    fn escaped_json_means_the_same() {
        let value = serde_json::json!({ "a\u{9b}": ["\u{1b}[0m", "\u{7f}\n\u{2029}"], "b": 1 });
        let text = serde_json::to_string_pretty(&value).unwrap();
        let shown = json(&text);
        assert!(shown.chars().all(|c| c == '\n' || !is_obeyed(c)));
        assert_eq!(serde_json::from_str::<serde_json::Value>(&shown).unwrap(), value);
    }
}
