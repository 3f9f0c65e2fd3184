//! Finds the bytes of an array, and decodes and decompresses them.
//!
//! A header of whole numbers precedes the data. Without compression, the header is the number of bytes. With
//! compression, the header has the number of blocks, the size of a block, the size of the last block (0 if the last
//! block is full), and the compressed size of each block. In base64, the header of compressed data is encoded
//! separately, so there may be padding between header and data.

use std::borrow::Cow;
use std::io::Read;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use super::super::budget::Budget;
use super::super::bytes::{Cursor, Endian};
use super::super::flaw::{Flaw, bounded};

/// The storage format of arrays, which is the same for all arrays of a file.
pub(super) struct Layout<'a> {
    pub(super) endian: Endian,
    /// Whether the numbers in headers have 64 bits instead of 32.
    pub(super) wide: bool,
    pub(super) compression: Compression,
    pub(super) appended: Appended<'a>,
}

/// The data after the XML.
#[derive(Clone, Copy)]
pub(super) enum Appended<'a> {
    None,
    Raw(&'a [u8]),
    Base64(&'a [u8]),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Compression {
    None,
    Zlib,
    Lz4,
}

/// Returns the bytes of an array. They are at `offset` in the data after the XML or, without an offset, in the text of
/// the array's element.
pub(super) fn bytes_of(
    text: &[u8],
    offset: Option<u64>,
    layout: &Layout<'_>,
    budget: &mut Budget,
) -> Result<Vec<u8>, Flaw> {
    let from = |data| {
        let offset = usize::try_from(offset.unwrap_or(0)).unwrap_or(usize::MAX);
        let rest = <[u8]>::get(data, offset..);
        rest.ok_or_else(|| Flaw::new(format!("appended data at byte {offset}"), format!("only {} bytes", data.len())))
    };
    let compact: Vec<u8>;
    let mut source = match (offset, layout.appended) {
        (None, _) => {
            compact = text.iter().copied().filter(|byte| !byte.is_ascii_whitespace()).collect();
            Source::base64(&compact)
        }
        (Some(_), Appended::Raw(data)) => Source::Raw(Cursor::new(from(data)?)),
        (Some(_), Appended::Base64(data)) => Source::base64(from(data)?),
        (Some(_), Appended::None) => return Err(Flaw::new("AppendedData after the XML", "none")),
    };
    if source.is_empty() {
        return Ok(Vec::new());
    }
    let first = source.word(layout)?;
    if layout.compression == Compression::None {
        let length = bounded(first, 1, source.most(), "bytes of an array")?;
        return Ok(source.take(length)?.into_owned());
    }
    if first == 0 {
        return Ok(Vec::new());
    }
    let (size, last) = (source.word(layout)?, source.word(layout)?);
    let blocks = bounded(first, if layout.wide { 8 } else { 4 }, source.most(), "blocks of an array")?;
    let packed = (0..blocks).map(|_| source.word(layout)).collect::<Result<Vec<u64>, Flaw>>()?;
    let mut bytes = Vec::new();
    for (number, packed) in packed.into_iter().enumerate() {
        let expected = if number + 1 == blocks && last > 0 { last } else { size };
        let packed = bounded(packed, 1, source.most(), "bytes of a block")?;
        let block = source.take(packed)?;
        expand(&block, expected, layout.compression, budget, &mut bytes)?;
    }
    Ok(bytes)
}

/// Decompresses a block, whose contents must have `expected` bytes, and appends the contents to `bytes`.
fn expand(
    block: &[u8],
    expected: u64,
    compression: Compression,
    budget: &mut Budget,
    bytes: &mut Vec<u8>,
) -> Result<(), Flaw> {
    /// Largest number of bytes to which one byte of data compressed by Deflate or LZ4 can expand.
    const MOST: u64 = 1032;
    if expected / MOST > block.len() as u64 {
        let found = format!("a block of only {} compressed bytes", block.len());
        return Err(Flaw::new(
            format!("a block that expands to {expected} bytes, as stated in the array's header"),
            found,
        ));
    }
    budget.spend(expected, "arrays of")?;
    let size = usize::try_from(expected).map_err(|_| Flaw::new("blocks that fit in memory", expected.to_string()))?;
    let start = bytes.len();
    match compression {
        Compression::Zlib => {
            bytes.try_reserve(size + 1).map_err(|e| Flaw::new("blocks that fit in memory", e.to_string()))?;
            // One byte more than expected is read, so that excess data are detected.
            let mut decoder = flate2::read::ZlibDecoder::new(block).take(expected + 1);
            decoder.read_to_end(bytes).map_err(|e| Flaw::new("a valid zlib stream in an array", e.to_string()))?;
        }
        _ => {
            bytes.resize(start + size, 0);
            let room = bytes.get_mut(start..).unwrap_or_default();
            let written = lz4_flex::block::decompress_into(block, room)
                .map_err(|e| Flaw::new("a valid LZ4 block in an array", e.to_string()))?;
            bytes.truncate(start + written);
        }
    }
    if bytes.len() - start != size {
        let found = if bytes.len() - start > size { "more".to_owned() } else { (bytes.len() - start).to_string() };
        return Err(Flaw::new(format!("{size} bytes in a block, as stated in the array's header"), found));
    }
    Ok(())
}

/// The bytes of an array that haven't been read yet. They are read from the front.
enum Source<'a> {
    Raw(Cursor<'a>),
    /// The base64 text that hasn't been decoded yet, and the decoded bytes that haven't been read yet.
    Base64 {
        text: &'a [u8],
        bytes: Vec<u8>,
    },
}

impl<'a> Source<'a> {
    fn base64(text: &'a [u8]) -> Self {
        Self::Base64 { text, bytes: Vec::new() }
    }

    fn is_empty(&self) -> bool {
        match self {
            Self::Raw(cursor) => cursor.remaining() == 0,
            Self::Base64 { text, bytes } => text.is_empty() && bytes.is_empty(),
        }
    }

    /// Returns an upper bound on the number of bytes that haven't been read yet.
    fn most(&self) -> usize {
        match self {
            Self::Raw(cursor) => cursor.remaining(),
            Self::Base64 { text, bytes } => bytes.len() + text.len() / 4 * 3,
        }
    }

    /// Reads the next number of a header.
    fn word(&mut self, layout: &Layout<'_>) -> Result<u64, Flaw> {
        let bytes = self.take(if layout.wide { 8 } else { 4 })?;
        let mut cursor = Cursor::new(&bytes);
        if layout.wide { cursor.u64(layout.endian) } else { cursor.u32(layout.endian).map(u64::from) }
    }

    fn take(&mut self, count: usize) -> Result<Cow<'a, [u8]>, Flaw> {
        let (text, bytes) = match self {
            Self::Raw(cursor) => return cursor.take(count).map(Cow::Borrowed),
            Self::Base64 { text, bytes } => (text, bytes),
        };
        while bytes.len() < count {
            // Four characters encode three bytes, or fewer if the characters include padding. After padding, another
            // base64 string begins.
            let characters = (count - bytes.len()).div_ceil(3).saturating_mul(4);
            let Some((piece, rest)) = text.split_at_checked(characters.min(text.len() / 4 * 4)) else { break };
            if piece.is_empty() {
                return Err(Flaw::new(format!("{count} more bytes of base64 data"), bytes.len().to_string()));
            }
            *text = rest;
            decode(piece, bytes)?;
        }
        let rest = bytes.split_off(count.min(bytes.len()));
        Ok(std::mem::replace(bytes, rest).into())
    }
}

/// Decodes base64 in groups of four characters, any of which may be padded, and appends the bytes to `bytes`.
fn decode(text: &[u8], bytes: &mut Vec<u8>) -> Result<(), Flaw> {
    let mut rest = text;
    while !rest.is_empty() {
        let padded = rest.iter().position(|&byte| byte == b'=').map_or(rest.len(), |at| (at / 4 + 1) * 4);
        let (group, after) = rest.split_at_checked(padded).unwrap_or((rest, &[]));
        STANDARD.decode_vec(group, bytes).map_err(|e| Flaw::new("valid base64 in an array", e.to_string()))?;
        rest = after;
    }
    Ok(())
}
