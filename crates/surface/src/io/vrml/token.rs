//! Splits a VRML file into words and brackets (section 5.2 of the standard). Commas are treated as blanks. Comments
//! extend from # to the end of the line.

use super::super::flaw::{Flaw, shown};
use super::super::text::number;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Token<'a> {
    Word(&'a [u8]),
    /// A quoted string. Its contents are dropped, since meshes don't use strings.
    Text,
    /// `{`, which begins a node's fields.
    Open,
    /// `}`, which ends a node's fields.
    Close,
    /// `[`, which begins a list of values.
    ListStart,
    /// `]`, which ends a list of values.
    ListEnd,
}

/// Reads tokens from a position in a file.
#[derive(Clone, Copy)]
pub(super) struct Tokens<'a> {
    bytes: &'a [u8],
    pub(super) at: usize,
}

impl<'a> Tokens<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    /// Returns the next token, or `None` at the end of the file.
    pub(super) fn next(&mut self) -> Option<Token<'a>> {
        self.skip_blanks();
        let rest = self.bytes.get(self.at..)?;
        let (token, length) = match rest.first()? {
            b'{' => (Token::Open, 1),
            b'}' => (Token::Close, 1),
            b'[' => (Token::ListStart, 1),
            b']' => (Token::ListEnd, 1),
            b'"' => (Token::Text, text_length(rest)),
            _ => {
                let ends = |byte: &u8| is_blank(*byte) || b"{}[]\"#".contains(byte);
                let length = rest.iter().position(ends).unwrap_or(rest.len());
                (Token::Word(rest.get(..length)?), length)
            }
        };
        self.at += length;
        Some(token)
    }

    /// Returns the next token without consuming it.
    pub(super) fn peek(&self) -> Option<Token<'a>> {
        let mut ahead = *self;
        ahead.next()
    }

    /// Reads the next word.
    pub(super) fn word(&mut self, what: &str) -> Result<&'a [u8], Flaw> {
        match self.next() {
            Some(Token::Word(word)) => Ok(word),
            other => Err(Flaw::new(what, self.found(other))),
        }
    }

    /// Reads a number.
    pub(super) fn number<T: std::str::FromStr>(&mut self, what: &str) -> Result<T, Flaw> {
        let word = self.word(what)?;
        let line = || self.line();
        number(word).ok_or_else(|| Flaw::new(format!("{what} on line {}", line()), shown(word)))
    }

    /// Reads the numbers of a list, and passes each to `each`. A single number needs no brackets.
    pub(super) fn numbers<T: std::str::FromStr>(&mut self, what: &str, mut each: impl FnMut(T)) -> Result<(), Flaw> {
        if self.peek() != Some(Token::ListStart) {
            each(self.number(what)?);
            return Ok(());
        }
        self.next();
        while self.peek() != Some(Token::ListEnd) {
            each(self.number(what)?);
        }
        self.next();
        Ok(())
    }

    /// Describes a token for an error message.
    pub(super) fn found(&self, token: Option<Token<'_>>) -> String {
        let line = self.line();
        match token {
            None => "the end of the file".to_owned(),
            Some(Token::Word(word)) => format!("{} on line {line}", shown(word)),
            Some(other) => format!("{other:?} on line {line}"),
        }
    }

    fn line(&self) -> usize {
        self.bytes.iter().take(self.at).filter(|&&byte| byte == b'\n').count() + 1
    }

    fn skip_blanks(&mut self) {
        while let Some(&byte) = self.bytes.get(self.at) {
            if byte == b'#' {
                let rest = self.bytes.get(self.at..).unwrap_or_default();
                self.at += rest.iter().position(|&byte| byte == b'\n' || byte == b'\r').unwrap_or(rest.len());
            } else if is_blank(byte) {
                self.at += 1;
            } else {
                return;
            }
        }
    }
}

fn is_blank(byte: u8) -> bool {
    byte.is_ascii_whitespace() || byte == b','
}

/// Returns the length of a quoted string, including its quotation marks. A quotation mark after a backslash doesn't end
/// the string.
fn text_length(rest: &[u8]) -> usize {
    let mut escaped = false;
    for (at, &byte) in rest.iter().enumerate().skip(1) {
        match byte {
            b'"' if !escaped => return at + 1,
            b'\\' => escaped = !escaped,
            _ => escaped = false,
        }
    }
    rest.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comments_commas_and_quotes_are_no_words() {
        let mut tokens = Tokens::new(b"#VRML V2.0 utf8\nDEF a{ x [1,-2 ,3e1] \"q \\\" } #\" } # end");
        let mut found = Vec::new();
        while let Some(token) = tokens.next() {
            found.push(token);
        }
        use Token::{Close, ListEnd, ListStart, Open, Text, Word};
        let words =
            [Word(b"DEF"), Word(b"a"), Open, Word(b"x"), ListStart, Word(b"1"), Word(b"-2"), Word(b"3e1"), ListEnd];
        assert_eq!(found, [words.as_slice(), &[Text, Close]].concat());
        let error = Tokens::new(b"\n\n q").number::<f64>("a coordinate").unwrap_err();
        assert!(format!("{error:?}").contains("a coordinate on line 3"), "{error:?}");
    }
}
