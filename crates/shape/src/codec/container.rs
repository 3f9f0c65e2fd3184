//! Reads and writes the parts of a file around the coded stream: header, levels and checksums. `docs/sphz-format.md`
//! specifies the format byte by byte.

use std::io::{Read, Write};

use flate2::Compression;
use flate2::read::ZlibDecoder;
use flate2::write::ZlibEncoder;
use spharm_harmonics::{MAX_DEGREE, basis_size};

use super::error::CodecError;

/// Version of the file format. Files of other versions are neither written nor read.
pub const VERSION: u8 = 1;

/// First bytes of a compressed model. The first byte isn't a letter, so that no text file is mistaken for a model.
const MAGIC: [u8; 4] = *b"\x89SPZ";
const VERSION_AT: usize = MAGIC.len();
const FLAGS_AT: usize = VERSION_AT + 1;
const HEAD_LEN_AT: usize = FLAGS_AT + 1;
const FIELDS_AT: usize = HEAD_LEN_AT + 4;
const CRC: usize = 4;

const SURFACE: u8 = 1;
const METADATA: u8 = 2;

/// Maximum number of channels.
pub(super) const MOST_CHANNELS: usize = 1 << 16;
/// Maximum size in bytes of the metadata before compression.
const MOST_METADATA: usize = 1 << 24;
/// Maximum number of coefficients; as f64 they occupy 2 GiB.
pub(super) const MOST_VALUES: usize = 1 << 28;
/// Limits on the number of zero coefficients that a file may declare above the stream's highest degree. The limit is
/// the first value, plus the second value for each byte of the file.
const MOST_ZEROS: [usize; 2] = [1 << 20, 1 << 10];
/// Maximum of [`Head::guess`], the log2 of the mean magnitude of the quantised coefficients of degree 1.
pub(super) const MOST_GUESS: u32 = 20;

/// Header of a file.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Head {
    pub(super) surface: bool,
    pub(super) max_degree: usize,
    pub(super) channels: usize,
    /// Highest degree of the stream; 0 if the stream is empty.
    pub(super) top: usize,
    /// Approximate log2 of the mean magnitude of the quantised coefficients of degree 1.
    pub(super) guess: u32,
    pub(super) shifts: [i8; 2],
    pub(super) steps: Vec<f64>,
    pub(super) first: Vec<i64>,
    /// Metadata as JSON in UTF-8, if any.
    pub(super) metadata: Option<String>,
    pub(super) segments: Vec<Segment>,
}

/// The part of the stream between the end of the preceding level and the end of a level, with its length in bytes and
/// its checksum.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Segment {
    /// Highest degree of the model that is complete at the end of this segment.
    pub(super) degree: usize,
    pub(super) length: usize,
    pub(super) crc: u32,
}

/// A header and its length in bytes.
#[derive(Debug)]
pub(super) struct Parsed {
    pub(super) head: Head,
    pub(super) length: usize,
}

/// Returns whether a file of `bytes` bytes may have coefficients up to `max_degree` if its stream ends at degree `top`.
/// The coefficients of the degrees above `top` are zeros, and their number is limited (see [`MOST_ZEROS`]).
pub(super) fn plausible(max_degree: usize, top: usize, channels: usize, bytes: usize) -> bool {
    let values = |degree: usize| basis_size(degree).saturating_mul(channels);
    let zeros = values(max_degree) - values(top);
    values(max_degree) <= MOST_VALUES && zeros <= MOST_ZEROS[1].saturating_mul(bytes).saturating_add(MOST_ZEROS[0])
}

impl Head {
    /// Writes the header with its checksum.
    pub(super) fn write(&self) -> Result<Vec<u8>, CodecError> {
        let mut out = MAGIC.to_vec();
        let flags = if self.surface { SURFACE } else { 0 } | if self.metadata.is_some() { METADATA } else { 0 };
        out.extend([VERSION, flags]);
        out.extend([0; FIELDS_AT - HEAD_LEN_AT]);
        for number in [self.max_degree, self.channels, self.top, self.guess as usize] {
            put(&mut out, number as u64);
        }
        out.extend(self.shifts.map(|shift| shift.to_le_bytes()[0]));
        self.steps.iter().for_each(|step| out.extend(step.to_le_bytes()));
        self.first.iter().for_each(|&first| put(&mut out, (first << 1 ^ first >> 63) as u64));
        put(&mut out, self.segments.len() as u64);
        let mut before = 0;
        for segment in &self.segments {
            put(&mut out, (segment.degree - before) as u64);
            put(&mut out, segment.length as u64);
            out.extend(segment.crc.to_le_bytes());
            before = segment.degree;
        }
        if let Some(text) = &self.metadata {
            if text.len() > MOST_METADATA {
                return Err(CodecError::TooLarge {
                    what: "bytes of the provenance",
                    most: MOST_METADATA,
                    found: text.len(),
                });
            }
            put(&mut out, text.len() as u64);
            out.extend(deflate(text));
        }
        let length = u32::try_from(out.len() + CRC).map_err(|_| CodecError::TooLarge {
            what: "bytes of the header",
            most: u32::MAX as usize,
            found: out.len(),
        })?;
        out[HEAD_LEN_AT..FIELDS_AT].copy_from_slice(&length.to_le_bytes());
        let crc = crc32c::crc32c(&out);
        out.extend(crc.to_le_bytes());
        Ok(out)
    }

    /// Reads and validates a header. `bytes` is the file, or a prefix of it.
    pub(super) fn read(bytes: &[u8]) -> Result<Parsed, CodecError> {
        let start = &bytes[..bytes.len().min(MAGIC.len())];
        if start != &MAGIC[..start.len()] || start.is_empty() {
            let (expected, found) = (MAGIC.escape_ascii().to_string(), start.escape_ascii().to_string());
            return Err(CodecError::Magic { expected, found });
        }
        let cut_off = |expected| CodecError::CutOff { expected, found: bytes.len(), level: None };
        let Some(fixed) = bytes.get(..FIELDS_AT) else { return Err(cut_off(FIELDS_AT + CRC)) };
        if fixed[VERSION_AT] != VERSION {
            return Err(CodecError::Version { expected: VERSION, found: fixed[VERSION_AT] });
        }
        let length = u32_at(fixed, HEAD_LEN_AT) as usize;
        if length < FIELDS_AT + CRC {
            return Err(CodecError::damaged("length of the header", format!("at least {}", FIELDS_AT + CRC), length));
        }
        let Some(head) = bytes.get(..length) else { return Err(cut_off(length)) };
        let (head, crc) = head.split_at(length - CRC);
        let (expected, found) = (u32_at(crc, 0), crc32c::crc32c(head));
        if expected != found {
            return Err(CodecError::damaged(
                "checksum of the header",
                format!("{expected:08x}"),
                format!("{found:08x}"),
            ));
        }
        let mut fields = Fields { rest: &head[FIELDS_AT..], flags: fixed[FLAGS_AT] };
        let head = fields.head(length)?;
        Ok(Parsed { head, length })
    }
}

/// Reader of the header fields at variable positions, which follow the fields at fixed positions.
struct Fields<'a> {
    rest: &'a [u8],
    flags: u8,
}

impl Fields<'_> {
    fn head(&mut self, length: usize) -> Result<Head, CodecError> {
        if self.flags & !(SURFACE | METADATA) != 0 {
            return Err(CodecError::damaged("flags", "0 to 3", self.flags));
        }
        let surface = self.flags & SURFACE != 0;
        let max_degree = self.number("highest degree", 0, MAX_DEGREE)?;
        let channels = self.number("number of channels", 1, MOST_CHANNELS)?;
        if surface && channels != 3 {
            return Err(CodecError::damaged("channels of a surface", 3, channels));
        }
        let top = self.number("highest degree of the stream", 0, max_degree)?;
        let guess = self.number("approximate log2 of the mean magnitude at degree 1", 0, MOST_GUESS as usize)? as u32;
        let shifts = self.take::<2>("shifts")?.map(|byte| i8::from_le_bytes([byte]));
        let mut steps = Vec::new();
        for _ in 0..if surface { 1 } else { channels } {
            let step = f64::from_le_bytes(self.take("step")?);
            if !(step > 0.0 && step.is_finite()) {
                return Err(CodecError::damaged("step", "a finite number above 0", step));
            }
            steps.push(step);
        }
        let mut first = Vec::new();
        for _ in 0..channels {
            let number = self.varint("degree 0")?;
            first.push((number >> 1) as i64 ^ -((number & 1) as i64));
        }
        let segments = self.segments(top)?;
        let file = segments.iter().fold(length, |file, segment| file.saturating_add(segment.length));
        if !plausible(max_degree, top, channels, file) {
            return Err(CodecError::damaged(
                "number of coefficients",
                format!("at most the number that a file of {file} bytes may declare"),
                basis_size(max_degree).saturating_mul(channels),
            ));
        }
        let metadata = (self.flags & METADATA != 0).then(|| self.metadata()).transpose()?;
        if !self.rest.is_empty() {
            return Err(CodecError::damaged("header", "0 bytes after the last field", self.rest.len()));
        }
        Ok(Head { surface, max_degree, channels, top, guess, shifts, steps, first, metadata, segments })
    }

    fn segments(&mut self, top: usize) -> Result<Vec<Segment>, CodecError> {
        let count = self.number("number of levels", usize::from(top > 0), top)?;
        let mut segments: Vec<Segment> = Vec::new();
        let mut degree = 0;
        for _ in 0..count {
            degree += self.number("degree of a level", 1, top - degree)?;
            let length = self.number("length of a level", 0, u32::MAX as usize)?;
            segments.push(Segment { degree, length, crc: u32::from_le_bytes(self.take("checksum of a level")?) });
        }
        if degree != top {
            return Err(CodecError::damaged("degree of the last level", top, degree));
        }
        Ok(segments)
    }

    fn metadata(&mut self) -> Result<String, CodecError> {
        let length = self.number("length of the provenance", 0, MOST_METADATA)?;
        let mut text = Vec::new();
        let deflated = std::mem::take(&mut self.rest);
        let mut decoder = ZlibDecoder::new(deflated);
        // One byte more than declared is requested, so that excess data is detected.
        let read = decoder.by_ref().take(length as u64 + 1).read_to_end(&mut text);
        read.map_err(|error| CodecError::damaged("provenance", "a zlib stream", error))?;
        if text.len() != length || decoder.total_in() != deflated.len() as u64 {
            return Err(CodecError::damaged("length of the provenance", length, text.len()));
        }
        String::from_utf8(text).map_err(|error| CodecError::damaged("provenance", "UTF-8", error))
    }

    fn take<const N: usize>(&mut self, what: &'static str) -> Result<[u8; N], CodecError> {
        let Some((bytes, rest)) = self.rest.split_first_chunk::<N>() else {
            return Err(CodecError::damaged(what, format!("{N} bytes"), self.rest.len()));
        };
        self.rest = rest;
        Ok(*bytes)
    }

    /// Reads a 64-bit number, seven bits per byte, least significant first.
    fn varint(&mut self, what: &'static str) -> Result<u64, CodecError> {
        let mut number = 0;
        for shift in (0..64).step_by(7) {
            let [byte] = self.take(what)?;
            let part = u64::from(byte & 127);
            if part << shift >> shift != part {
                break;
            }
            number |= part << shift;
            if byte < 128 {
                return Ok(number);
            }
        }
        Err(CodecError::damaged(what, "a number of at most 64 bits", "a longer number"))
    }

    fn number(&mut self, what: &'static str, least: usize, most: usize) -> Result<usize, CodecError> {
        let number = self.varint(what)?;
        match usize::try_from(number) {
            Ok(found) if (least..=most).contains(&found) => Ok(found),
            _ => Err(CodecError::damaged(what, format!("{least} to {most}"), number)),
        }
    }
}

fn put(out: &mut Vec<u8>, mut number: u64) {
    while number > 127 {
        out.push(number as u8 | 128);
        number >>= 7;
    }
    out.push(number as u8);
}

fn deflate(text: &str) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::best());
    encoder.write_all(text.as_bytes()).and_then(|()| encoder.finish()).expect("writing to memory doesn't fail")
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    bytes.get(at..at + 4).and_then(|bytes| bytes.try_into().ok()).map_or(0, u32::from_le_bytes)
}
