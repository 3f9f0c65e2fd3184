//! Parses the header of a PLY file.

use super::super::axes::stated;
use super::super::bytes::{Cursor, Endian};
use super::super::flaw::{Flaw, shown};
use super::super::landmarks::Frame;
use super::super::scalar::Scalar;
use super::super::text::{number, words};

/// The encoding of the data after the header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    Ascii,
    Binary(Endian),
}

/// Returns the number type with the given PLY name.
fn scalar(word: &[u8]) -> Result<Scalar, Flaw> {
    Ok(match word {
        b"char" | b"int8" => Scalar::I8,
        b"uchar" | b"uint8" => Scalar::U8,
        b"short" | b"int16" => Scalar::I16,
        b"ushort" | b"uint16" => Scalar::U16,
        b"int" | b"int32" => Scalar::I32,
        b"uint" | b"uint32" => Scalar::U32,
        b"float" | b"float32" => Scalar::F32,
        b"double" | b"float64" => Scalar::F64,
        other => return Err(Flaw::new("a PLY type, such as float", shown(other))),
    })
}

#[derive(Clone, Copy, Debug)]
pub(super) enum Kind {
    Scalar(Scalar),
    List { count: Scalar, item: Scalar },
}

#[derive(Debug)]
pub(super) struct Property {
    pub(super) name: Vec<u8>,
    pub(super) kind: Kind,
}

#[derive(Debug)]
pub(super) struct Element {
    pub(super) name: Vec<u8>,
    pub(super) count: u64,
    pub(super) properties: Vec<Property>,
}

impl Element {
    /// Returns the smallest possible size of an instance of this element, in bytes.
    pub(super) fn least_size(&self, encoding: Encoding) -> usize {
        let sizes = self.properties.iter().map(|p| match (encoding, p.kind) {
            // A number in text takes at least two bytes, a digit and a separator.
            (Encoding::Ascii, _) => 2,
            (Encoding::Binary(_), Kind::Scalar(scalar)) => scalar.size(),
            (Encoding::Binary(_), Kind::List { count, .. }) => count.size(),
        });
        sizes.sum()
    }
}

#[derive(Debug)]
pub(super) struct Header {
    pub(super) encoding: Encoding,
    pub(super) elements: Vec<Element>,
    /// Axes stated in a comment.
    pub(super) frame: Option<Frame>,
}

/// Reads the header, up to and including `end_header`.
pub(super) fn read(cursor: &mut Cursor<'_>) -> Result<Header, Flaw> {
    let magic = cursor.line().unwrap_or_default();
    if magic.trim_ascii() != b"ply" {
        return Err(Flaw::new("the word ply", shown(magic)));
    }
    let (mut encoding, mut frame) = (None, None);
    let mut elements: Vec<Element> = Vec::new();
    loop {
        let line = cursor.line().ok_or_else(|| Flaw::new("end_header", "the end of the file"))?;
        let mut words = words(line);
        let mut next = || words.next().unwrap_or_default();
        match next() {
            b"end_header" => break,
            b"comment" => frame = frame.or_else(|| stated(line)),
            b"obj_info" | b"" => {}
            b"format" => {
                encoding = Some(match next() {
                    b"ascii" => Encoding::Ascii,
                    b"binary_little_endian" => Encoding::Binary(Endian::Little),
                    b"binary_big_endian" => Encoding::Binary(Endian::Big),
                    other => return Err(Flaw::new("a PLY encoding, such as ascii", shown(other))),
                });
            }
            b"element" => {
                let name = next().to_vec();
                let count = next();
                let count = number(count).ok_or_else(|| Flaw::new("an element's count", shown(count)))?;
                elements.push(Element { name, count, properties: Vec::new() });
            }
            b"property" => {
                let kind = match next() {
                    b"list" => Kind::List { count: scalar(next())?, item: scalar(next())? },
                    word => Kind::Scalar(scalar(word)?),
                };
                let name = next().to_vec();
                let Some(element) = elements.last_mut() else {
                    return Err(Flaw::new("an element line before the first property", shown(line)));
                };
                element.properties.push(Property { name, kind });
            }
            _ => {
                return Err(Flaw::new("format, element, property or end_header", shown(line)));
            }
        }
    }
    let encoding = encoding.ok_or_else(|| Flaw::new("a format line", "none"))?;
    Ok(Header { encoding, elements, frame })
}
