//! Escapes text for HTML and scripts. Names come from files and are never interpreted as HTML.

use serde::Serialize;

/// Returns text escaped for HTML, between tags or in quotes. Control characters, which are invalid in HTML, become
/// U+FFFD.
pub(crate) fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\'' => escaped.push_str("&#39;"),
            '\t' | '\n' | '\r' => escaped.push(' '),
            _ if character.is_control() => escaped.push('\u{fffd}'),
            _ => escaped.push(character),
        }
    }
    escaped
}

/// Returns escaped text in a `<bdi>` element, which isolates its writing direction, so that a right-to-left name
/// doesn't affect the text that follows.
pub(crate) fn name(text: &str) -> String {
    format!("<bdi>{}</bdi>", escape(text))
}

/// Returns JSON for a `<script>` element. The JSON contains no `<`, `>` or `&`, so that it can't end the element or
/// begin a comment. It contains no line separators.
pub(crate) fn json(value: &impl Serialize) -> Result<String, serde_json::Error> {
    let mut escaped = String::new();
    for character in serde_json::to_string(value)?.chars() {
        match character {
            '<' | '>' | '&' | '\u{2028}' | '\u{2029}' | '\u{7f}' => {
                escaped.push_str(&format!("\\u{:04x}", u32::from(character)));
            }
            _ => escaped.push(character),
        }
    }
    Ok(escaped)
}

/// Formats a number with up to five significant digits in a readable form.
pub(crate) fn number(x: f64) -> String {
    if !x.is_finite() {
        return "–".to_owned();
    }
    if x == 0.0 || (1e-3..1e5).contains(&x.abs()) {
        let digits = if x == 0.0 { 0 } else { (4 - x.abs().log10().floor() as i32).max(0) as usize };
        let text = format!("{x:.digits$}");
        return if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text };
    }
    format!("{x:.3e}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_stay_text() {
        let hostile = "</script><script>alert('1')</script>\u{202e}\u{2028}\"&\0";
        let html = name(hostile);
        assert!(!html[5..html.len() - 6].contains(['<', '>', '"', '\'', '\0']), "{html}");
        let text = json(&[hostile]).unwrap();
        assert!(!text.contains(['<', '>', '&', '\u{2028}', '\0']), "{text}");
        assert_eq!(serde_json::from_str::<Vec<String>>(&text).unwrap(), [hostile]);
    }

    #[test]
    fn numbers_have_five_digits() {
        let cases = [(0.0, "0"), (1.5, "1.5"), (12.345678, "12.346"), (2e-8, "2.000e-8"), (-4321.0, "-4321")];
        for (x, text) in cases {
            assert_eq!(number(x), text);
        }
        assert_eq!(number(f64::NAN), "–");
    }
}
