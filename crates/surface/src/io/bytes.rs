//! Reads binary data with a cursor that never moves past the end.

use super::flaw::Flaw;

/// The byte order of numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Endian {
    Little,
    Big,
}

/// The part of a file that hasn't been read yet.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cursor<'a> {
    rest: &'a [u8],
    at: usize,
}

macro_rules! number {
    ($name:ident, $type:ty) => {
        pub(super) fn $name(&mut self, endian: Endian) -> Result<$type, Flaw> {
            let bytes = self.array()?;
            Ok(match endian {
                Endian::Little => <$type>::from_le_bytes(bytes),
                Endian::Big => <$type>::from_be_bytes(bytes),
            })
        }
    };
}

impl<'a> Cursor<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes, at: 0 }
    }

    pub(super) fn remaining(&self) -> usize {
        self.rest.len()
    }

    pub(super) fn rest(&self) -> &'a [u8] {
        self.rest
    }

    /// Returns the next `n` bytes.
    pub(super) fn take(&mut self, n: usize) -> Result<&'a [u8], Flaw> {
        let Some((head, tail)) = self.rest.split_at_checked(n) else {
            return Err(Flaw::new(
                format!("{n} more bytes from byte {} on", self.at),
                format!("only {} bytes before the end of the file", self.rest.len()),
            ));
        };
        self.rest = tail;
        self.at += n;
        Ok(head)
    }

    /// Returns the next `n` bytes as an array.
    pub(super) fn array<const N: usize>(&mut self) -> Result<[u8; N], Flaw> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N)?);
        Ok(array)
    }

    /// Returns the bytes before the next newline, and consumes them and the newline. Without a newline, returns all
    /// remaining bytes. Returns `None` at the end of the data.
    pub(super) fn line(&mut self) -> Option<&'a [u8]> {
        if self.rest.is_empty() {
            return None;
        }
        let end = self.rest.iter().position(|&b| b == b'\n');
        let (line, used) = match end {
            Some(i) => (self.rest.get(..i)?, i + 1),
            None => (self.rest, self.rest.len()),
        };
        self.rest = self.rest.get(used..)?;
        self.at += used;
        Some(line.strip_suffix(b"\r").unwrap_or(line))
    }

    /// Skips blanks and newlines.
    pub(super) fn skip_whitespace(&mut self) {
        let n = self.rest.iter().take_while(|b| b.is_ascii_whitespace()).count();
        self.rest = self.rest.get(n..).unwrap_or_default();
        self.at += n;
    }

    /// Returns the next run of bytes that aren't white space. At the end of the data, the result is empty.
    pub(super) fn token(&mut self) -> &'a [u8] {
        self.skip_whitespace();
        let n = self.rest.iter().take_while(|b| !b.is_ascii_whitespace()).count();
        let (token, tail) = self.rest.split_at(n);
        self.rest = tail;
        self.at += n;
        token
    }

    number!(u8, u8);
    number!(i8, i8);
    number!(u16, u16);
    number!(i16, i16);
    number!(u32, u32);
    number!(i32, i32);
    number!(u64, u64);
    number!(i64, i64);
    number!(f32, f32);
    number!(f64, f64);
}
