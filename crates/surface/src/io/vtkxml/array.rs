//! Decodes the numbers of a DataArray, from text or bytes.

use super::super::budget::Budget;
use super::super::bytes::Cursor;
use super::super::flaw::{Flaw, shown};
use super::super::scalar::Scalar;
use super::super::text::{number, words};
use super::super::xml::Tag;
use super::packed::{Layout, bytes_of};
use crate::room::check_room;

/// The attributes of a DataArray.
#[derive(Debug, Default)]
pub(super) struct Description {
    pub(super) name: String,
    kind: String,
    format: String,
    /// Offset of the array's bytes in the data that follow the XML.
    offset: Option<u64>,
    pub(super) components: Option<u64>,
}

impl Description {
    pub(super) fn of(tag: &Tag<'_>) -> Result<Self, Flaw> {
        let attribute = |name: &str| Ok::<_, Flaw>(tag.attribute(name)?.unwrap_or_default());
        Ok(Self {
            name: attribute("Name")?,
            kind: attribute("type")?,
            format: attribute("format")?,
            offset: tag.number("offset")?,
            components: tag.number("NumberOfComponents")?,
        })
    }

    fn scalar(&self) -> Result<Scalar, Flaw> {
        Ok(match self.kind.as_str() {
            "Int8" => Scalar::I8,
            "UInt8" => Scalar::U8,
            "Int16" => Scalar::I16,
            "UInt16" => Scalar::U16,
            "Int32" => Scalar::I32,
            "UInt32" => Scalar::U32,
            "Int64" => Scalar::I64,
            "UInt64" => Scalar::U64,
            "Float32" => Scalar::F32,
            "Float64" => Scalar::F64,
            other => return Err(Flaw::new("a number type, such as Float64", shown(other.as_bytes()))),
        })
    }
}

/// Decodes an array. `text` is the text in the array's element.
pub(super) fn decode(
    description: &Description,
    text: &str,
    layout: &Layout<'_>,
    budget: &mut Budget,
) -> Result<Vec<f64>, Flaw> {
    let scalar = description.scalar()?;
    let bytes = match description.format.as_str() {
        "ascii" | "" => return ascii(text, scalar),
        "binary" => bytes_of(text.as_bytes(), None, layout, budget)?,
        "appended" => {
            let offset = description.offset.ok_or_else(|| Flaw::new("an offset for the appended data", "none"))?;
            bytes_of(&[], Some(offset), layout, budget)?
        }
        other => return Err(Flaw::new("format ascii, binary or appended", shown(other.as_bytes()))),
    };
    let count = bytes.len() / scalar.size();
    if count * scalar.size() != bytes.len() {
        return Err(Flaw::new(
            format!("numbers of {} bytes each", scalar.size()),
            format!("{} bytes in total", bytes.len()),
        ));
    }
    check_room(count as u64 * 8)?;
    let mut values = Vec::with_capacity(count);
    let mut cursor = Cursor::new(&bytes);
    for _ in 0..count {
        values.push(scalar.read(&mut cursor, layout.endian)?);
    }
    Ok(values)
}

fn ascii(text: &str, scalar: Scalar) -> Result<Vec<f64>, Flaw> {
    let value = |word: &[u8]| {
        let value = match scalar {
            // Values are rounded to the declared type, so that a text copy and a binary copy of a surface are
            // identical.
            Scalar::F32 => number::<f32>(word).map(f64::from),
            _ => number::<f64>(word),
        };
        value.ok_or_else(|| Flaw::new("a number", shown(word)))
    };
    words(text.as_bytes()).map(value).collect()
}
