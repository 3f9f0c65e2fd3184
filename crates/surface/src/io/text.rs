//! Parses numbers and lines of text formats.

use super::flaw::{Flaw, shown};

/// Returns each line, without its line ending, and the line's number, counted from 1. Carriage returns end the lines of
/// a file without newlines.
pub(super) fn lines(bytes: &[u8]) -> impl Iterator<Item = (usize, &[u8])> {
    let end = if bytes.contains(&b'\n') { b'\n' } else { b'\r' };
    bytes.split(move |&b| b == end).enumerate().map(|(i, line)| (i + 1, line.strip_suffix(b"\r").unwrap_or(line)))
}

/// Returns the words of a line, separated by white space.
pub(super) fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty())
}

/// Parses a number. NaN and infinity are accepted here; later checks reject them and report the vertex.
pub(super) fn number<T: std::str::FromStr>(word: &[u8]) -> Option<T> {
    std::str::from_utf8(word).ok()?.parse().ok()
}

/// Parses the next word as a number.
pub(super) fn next_number<'a, T: std::str::FromStr>(
    words: &mut impl Iterator<Item = &'a [u8]>,
    what: &str,
    line: usize,
) -> Result<T, Flaw> {
    let word = words.next().unwrap_or_default();
    number(word).ok_or_else(|| Flaw::new(format!("{what} on line {line}"), shown(word)))
}

/// Parses the next three words as a position.
pub(super) fn next_position<'a>(words: &mut impl Iterator<Item = &'a [u8]>, line: usize) -> Result<[f64; 3], Flaw> {
    let mut position = [0.0; 3];
    for x in &mut position {
        *x = next_number(words, "a coordinate", line)?;
    }
    Ok(position)
}
