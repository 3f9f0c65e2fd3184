//! Text from outside on its way to a terminal or a log.
//!
//! Names of files, cells of tables and headers of formats come from others, and may hold what a terminal obeys: escape
//! sequences, line breaks, and characters that turn the order of the text around. All that the program prints passes
//! through here, so that one line stays one line.

use std::borrow::Cow;

/// Whether a terminal may do something else with a character than show it: control characters (of ASCII and of
/// Latin-1), line and paragraph separators, and those that change the direction of the text.
fn is_obeyed(c: char) -> bool {
    c.is_control() || matches!(c, '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{200e}' | '\u{200f}')
}

/// Returns a text in one line: line breaks are blanks, and whatever else a terminal would obey is shown as `\u{1b}`.
#[must_use]
pub fn one_line(text: &str) -> Cow<'_, str> {
    replaced(text, |c| if c == '\n' { " ".to_owned() } else { c.escape_default().collect() })
}

/// As [`one_line`], for a text of several lines and with tabs, which are kept.
#[must_use]
pub fn lines(text: &str) -> Cow<'_, str> {
    replaced(text, |c| if matches!(c, '\n' | '\t') { c.to_string() } else { c.escape_default().collect() })
}

/// Returns JSON that means the same, in which whatever a terminal would obey is escaped, other than the line breaks
/// between its tokens: JSON itself asks for that only up to U+001F.
#[must_use]
pub fn json(text: &str) -> Cow<'_, str> {
    // Line breaks within strings are escaped already. All the others are below U+10000.
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
