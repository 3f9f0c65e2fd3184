//! Encodes and decodes the chunks of a file, which are either stored raw, or shuffled and then compressed by zstd.
//!
//! Shuffling stores the first bytes of all values, then their second bytes, and so on. The bytes with signs and
//! exponents, which are similar for all values, thus become adjacent and compress better. See "Codecs" in
//! `store-format.md`.

use std::io::{self, BufRead, BufReader, Read};

/// Encoding of a chunk's bytes in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Codec {
    /// Unchanged bytes, which can be used from a memory map without a copy.
    Raw,
    /// Bytes shuffled by the size of the scalar type, then compressed into one zstd frame.
    Zstd,
}

/// Compression level of zstd. Higher levels make files of harmonics less than 1 % smaller and take twice the time.
const LEVEL: i32 = 1;

impl Codec {
    /// Returns `"none"` or `"zstd"`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Raw => "none",
            Self::Zstd => "zstd",
        }
    }

    pub(crate) const fn code(self) -> u32 {
        match self {
            Self::Raw => 0,
            Self::Zstd => 1,
        }
    }

    pub(crate) const fn from_code(code: u32) -> Option<Self> {
        match code {
            0 => Some(Self::Raw),
            1 => Some(Self::Zstd),
            _ => None,
        }
    }
}

/// A zstd encoder with its working memory, for use by one thread.
pub(crate) struct Encoder {
    zstd: zstd::bulk::Compressor<'static>,
    shuffled: Vec<u8>,
}

impl Encoder {
    pub(crate) fn new() -> io::Result<Self> {
        Ok(Self { zstd: zstd::bulk::Compressor::new(LEVEL)?, shuffled: Vec::new() })
    }

    pub(crate) fn encode(&mut self, raw: &[u8], scalar_size: usize) -> io::Result<Vec<u8>> {
        shuffle(raw, scalar_size, &mut self.shuffled);
        self.zstd.compress(&self.shuffled)
    }

    /// Returns the maximum memory in bytes of an encoder and its output, for chunks of `raw_len` bytes.
    pub(crate) fn bytes(raw_len: usize) -> usize {
        // At this level, zstd's own tables take less than 2 MiB.
        raw_len + zstd::zstd_safe::compress_bound(raw_len) + (2 << 20)
    }
}

/// Decodes and unshuffles a zstd frame. Fails unless `stored` is exactly one frame that decodes to exactly `raw_len`
/// bytes.
pub(crate) fn decode(stored: &[u8], raw_len: usize, scalar_size: usize) -> io::Result<Vec<u8>> {
    declares(stored, raw_len as u64)?;
    // zstd also accepts several frames in sequence, and skippable frames, but the store format allows only one frame.
    if zstd::zstd_safe::find_frame_compressed_size(stored) != Ok(stored.len()) {
        return Err(invalid("expected exactly one zstd frame".to_owned()));
    }
    // The buffer of `raw_len` bytes limits the output: zstd doesn't write past its end, whatever size the frame
    // declares.
    let shuffled = zstd::bulk::decompress(stored, raw_len)?;
    if shuffled.len() != raw_len {
        return Err(invalid(format!("expected {raw_len} decoded bytes, found {}", shuffled.len())));
    }
    Ok(unshuffle(&shuffled, scalar_size))
}

/// Checks that the bytes read from `stored` are one zstd frame that decodes to `raw_len` bytes, without holding the
/// decoded bytes in memory.
pub(crate) fn check_frame(stored: impl Read, raw_len: u64) -> io::Result<()> {
    let mut stored = BufReader::new(stored);
    declares(stored.fill_buf()?, raw_len)?;
    let mut decoder = zstd::stream::read::Decoder::with_buffer(stored)?.single_frame();
    let decoded = io::copy(&mut decoder, &mut io::sink())?;
    let rest = io::copy(&mut decoder.finish(), &mut io::sink())?;
    if decoded != raw_len || rest > 0 {
        return Err(invalid(format!(
            "expected one frame of {raw_len} decoded bytes, found {decoded}, and {rest} bytes after the frame"
        )));
    }
    Ok(())
}

/// Fails unless `stored` begins with a frame of the current zstd format that declares `raw_len` decoded bytes.
fn declares(stored: &[u8], raw_len: u64) -> io::Result<()> {
    const MAGIC: [u8; 4] = 0xfd2f_b528_u32.to_le_bytes();
    let found = zstd::zstd_safe::get_frame_content_size(stored);
    match found {
        Ok(Some(len)) if len == raw_len && stored.starts_with(&MAGIC) => Ok(()),
        _ => Err(invalid(format!("expected a zstd frame of {raw_len} decoded bytes"))),
    }
}

fn invalid(message: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, message)
}

fn shuffle(raw: &[u8], size: usize, out: &mut Vec<u8>) {
    out.clear();
    for byte in 0..size {
        out.extend(raw.iter().skip(byte).step_by(size));
    }
}

fn unshuffle(shuffled: &[u8], size: usize) -> Vec<u8> {
    let mut raw = vec![0; shuffled.len()];
    let plane = shuffled.len() / size;
    for (byte, plane) in shuffled.chunks_exact(plane.max(1)).enumerate() {
        for (out, value) in raw.iter_mut().skip(byte).step_by(size).zip(plane) {
            *out = *value;
        }
    }
    raw
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_goes_in_comes_out() {
        for (count, size) in [(0, 8), (1, 8), (1000, 8), (777, 4)] {
            let raw: Vec<u8> = (0..count * size).map(|i| (i * i % 251) as u8).collect();
            let stored = Encoder::new().unwrap().encode(&raw, size).unwrap();
            assert_eq!(decode(&stored, raw.len(), size).unwrap(), raw);
            check_frame(&stored[..], raw.len() as u64).unwrap();
        }
    }

    #[test]
    fn codecs_are_known_by_name_and_number() {
        for (codec, name, code) in [(Codec::Raw, "none", 0), (Codec::Zstd, "zstd", 1)] {
            assert_eq!((codec.name(), codec.code(), Codec::from_code(code)), (name, code, Some(codec)));
        }
        assert_eq!(Codec::from_code(2), None);
    }

    #[test]
    fn a_frame_of_another_length_is_refused() {
        let stored = Encoder::new().unwrap().encode(&[7; 1 << 20], 8).unwrap();
        assert!(stored.len() < 1000, "a bomb: {} bytes", stored.len());
        let refused = |stored: &[u8], raw_len: usize| {
            assert!(decode(stored, raw_len, 8).is_err());
            assert!(check_frame(stored, raw_len as u64).is_err());
        };
        refused(&stored, 4096);
        refused(&stored, 2 << 20);
        refused(&stored[..stored.len() - 1], 1 << 20);
        refused(&[&stored[..], &[0]].concat(), 1 << 20);
        // zstd would decode a second frame and skip a skippable frame. `decode` and `check_frame` must refuse both.
        refused(&[&stored[..], &stored[..]].concat(), 2 << 20);
        let skipped = [0x50, 0x2a, 0x4d, 0x18, 1, 0, 0, 0, 9];
        refused(&[&skipped[..], &stored[..]].concat(), 1 << 20);
        refused(&[&stored[..], &skipped[..]].concat(), 1 << 20);
    }
}
