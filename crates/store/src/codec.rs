//! Chunk codecs: raw, and zstd over shuffled bytes.
//!
//! Shuffling puts the first bytes of all values together, then the second ones, and so on: signs and exponents, which
//! repeat, come to stand side by side. See "Codecs" in `store-format.md`.

use std::io;

/// How the bytes of a chunk are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Codec {
    /// As they are; read through a memory map without a copy.
    Raw,
    /// Bytes shuffled by the scalar's size, then one zstd frame.
    Zstd,
}

/// zstd's level. Harmonics hardly compress: higher levels gain under one per cent and take twice the time.
const LEVEL: i32 = 1;

impl Codec {
    /// `"none"` or `"zstd"`.
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

/// A zstd encoder with its scratch space, for one thread.
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

    /// Bytes that an encoder and its result may take for chunks of `raw_len`.
    pub(crate) fn bytes(raw_len: usize) -> usize {
        // The compressor's own tables at this level are under 2 MiB.
        raw_len + zstd::zstd_safe::compress_bound(raw_len) + (2 << 20)
    }
}

/// Decodes one zstd frame into exactly `raw_len` bytes; a frame that holds more or fewer is an error.
pub(crate) fn decode(stored: &[u8], raw_len: usize, scalar_size: usize) -> io::Result<Vec<u8>> {
    // The buffer is the bound: zstd refuses to write past it, whatever the frame claims.
    let shuffled = zstd::bulk::decompress(stored, raw_len)?;
    if shuffled.len() != raw_len {
        let message = format!("{} bytes decoded, expected {raw_len}", shuffled.len());
        return Err(io::Error::new(io::ErrorKind::InvalidData, message));
    }
    Ok(unshuffle(&shuffled, scalar_size))
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
        }
    }

    #[test]
    fn a_frame_of_another_length_is_refused() {
        let stored = Encoder::new().unwrap().encode(&[7; 1 << 20], 8).unwrap();
        assert!(stored.len() < 1000, "a bomb: {} bytes", stored.len());
        assert!(decode(&stored, 4096, 8).is_err());
        assert!(decode(&stored, 2 << 20, 8).is_err());
        assert!(decode(&stored[..stored.len() - 1], 1 << 20, 8).is_err());
    }
}
