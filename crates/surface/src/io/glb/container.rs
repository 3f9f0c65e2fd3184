//! Splits a file into its JSON and the bytes of its buffers.
//!
//! A binary file has a header (magic, version, length), a chunk of JSON and perhaps a chunk of bytes, which is the
//! first buffer (section 4.4). A text file is the JSON alone. Other buffers are stored as base64 in the JSON; buffers
//! in other files aren't read.

use std::borrow::Cow;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use super::super::bytes::{Cursor, Endian};
use super::super::flaw::{Flaw, shown};
use super::document::Document;

const JSON: &[u8; 4] = b"JSON";
const BIN: &[u8; 4] = b"BIN\0";

/// The parts of a file.
pub(super) struct Container<'a> {
    pub(super) json: &'a [u8],
    bin: Option<&'a [u8]>,
}

impl<'a> Container<'a> {
    pub(super) fn parse(bytes: &'a [u8]) -> Result<Self, Flaw> {
        if !bytes.starts_with(b"glTF") {
            if bytes.trim_ascii_start().starts_with(b"{") {
                return Ok(Self { json: bytes, bin: None });
            }
            return Err(Flaw::new("\"glTF\", or JSON", shown(bytes)));
        }
        let mut cursor = Cursor::new(bytes);
        cursor.take(4)?;
        let version = cursor.u32(Endian::Little)?;
        if version != 2 {
            return Err(Flaw::unsupported(format!("version {version} of glTF"), "export the scene as glTF 2.0"));
        }
        let length = cursor.u32(Endian::Little)? as usize;
        let rest = length.checked_sub(12).and_then(|length| cursor.rest().get(..length)).ok_or_else(|| {
            Flaw::new(format!("{length} bytes, as stated in the header"), format!("{} bytes", bytes.len()))
        })?;
        let mut cursor = Cursor::new(rest);
        let (kind, json) = chunk(&mut cursor)?;
        if kind != JSON {
            return Err(Flaw::new("JSON as the first chunk", shown(kind)));
        }
        let mut bin = None;
        // The specification requires that chunks of other types be ignored.
        while bin.is_none() && cursor.remaining() > 0 {
            let (kind, bytes) = chunk(&mut cursor)?;
            bin = (kind == BIN).then_some(bytes);
        }
        Ok(Self { json, bin })
    }

    /// Returns all buffers. A buffer in another file, or without bytes, causes an error only when it is used, because
    /// exporters store the buffers of images and animations in other files.
    pub(super) fn buffers(&self, document: &Document) -> Result<Vec<Buffer<'a>>, Flaw> {
        let buffers = document.buffers.iter().enumerate().map(|(number, buffer)| {
            let bytes: Cow<'a, [u8]> = match (&buffer.uri, self.bin) {
                (None, Some(bin)) if number == 0 => bin.into(),
                (None, _) => return Ok(Buffer::Absent),
                (Some(uri), _) => match data_uri(uri) {
                    Some(text) => STANDARD
                        .decode(text)
                        .map_err(|e| Flaw::new(format!("valid base64 in buffer {number}"), e.to_string()))?
                        .into(),
                    None => return Ok(Buffer::External(uri.clone())),
                },
            };
            // The chunk may be up to three bytes longer than the buffer, for alignment.
            let length = usize::try_from(buffer.byte_length).unwrap_or(usize::MAX);
            match bytes {
                Cow::Borrowed(bytes) => bytes.get(..length).map(|bytes| Buffer::Bytes(bytes.into())),
                Cow::Owned(mut bytes) => (length <= bytes.len()).then(|| {
                    bytes.truncate(length);
                    Buffer::Bytes(bytes.into())
                }),
            }
            .ok_or_else(|| Flaw::new(format!("{length} bytes in buffer {number}"), "fewer"))
        });
        buffers.collect()
    }
}

/// A buffer of the document.
pub(super) enum Buffer<'a> {
    Bytes(Cow<'a, [u8]>),
    /// A buffer in another file, with its URI.
    External(String),
    /// A buffer without bytes, which some extensions for compression allow.
    Absent,
}

fn chunk<'a>(cursor: &mut Cursor<'a>) -> Result<(&'a [u8], &'a [u8]), Flaw> {
    let length = cursor.u32(Endian::Little)? as usize;
    let kind = cursor.take(4)?;
    Ok((kind, cursor.take(length)?))
}

/// Returns the base64 text of a data URI of any media type; `None` for other URIs.
fn data_uri(uri: &str) -> Option<&str> {
    let (head, text) = uri.split_once(',')?;
    (head.starts_with("data:") && head.ends_with(";base64")).then_some(text)
}
