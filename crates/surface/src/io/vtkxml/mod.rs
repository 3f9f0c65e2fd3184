//! Reads and writes VTK's XML formats: PolyData (`.vtp`), and unstructured grids of a surface (`.vtu`, read only).
//!
//! A file consists of pieces. A piece of PolyData has points, polygons and strips. A piece of an unstructured grid has
//! points, and cells with types. An array's numbers are stored as text or base64 in the array's element, or as raw
//! bytes or base64 after the XML. Numbers that aren't text may be compressed.
//!
//! `document` walks through the XML, `array` decodes an array, `packed` finds and decompresses its bytes, and `write`
//! writes files.
//!
//! Source: "VTK File Formats", the XML formats, and VTK's `vtkXMLDataParser`.

mod array;
mod document;
mod packed;
mod write;

use super::bytes::Cursor;
use super::flaw::{Flaw, shown};
use crate::mesh::Mesh;
use packed::Appended;
pub(super) use write::write;

/// Returns whether `<VTKFile` is within the first 512 bytes, as in `.vtp` and `.vtu` files.
pub(super) fn is_vtk_xml(bytes: &[u8]) -> bool {
    bytes.get(..512).unwrap_or(bytes).windows(8).any(|window| window == b"<VTKFile")
}

/// Reads the surface of all pieces.
pub(super) fn read(bytes: &[u8]) -> Result<Mesh, Flaw> {
    let (head, appended) = split(bytes)?;
    let whole = matches!(appended, Appended::None);
    // Invalid UTF-8 is replaced instead of rejected, because only names can contain it.
    document::read(&String::from_utf8_lossy(head), whole, appended, bytes.len())
}

/// Splits a file into its XML and the data after it, since raw bytes can't be parsed as XML.
fn split(bytes: &[u8]) -> Result<(&[u8], Appended<'_>), Flaw> {
    const TAG: &[u8] = b"<AppendedData";
    let Some(at) = bytes.windows(TAG.len()).position(|window| window == TAG) else {
        return Ok((bytes, Appended::None));
    };
    let mut cursor = Cursor::new(bytes);
    let head = cursor.take(at)?;
    let rest = cursor.rest();
    let tag_end = rest.iter().position(|&byte| byte == b'>');
    let tag = tag_end.and_then(|end| rest.get(..end)).unwrap_or_default();
    let data = rest.get(tag.len()..).unwrap_or_default();
    // The data begin after the first underscore.
    let start = data.iter().take(4096).position(|&byte| byte == b'_');
    let Some(data) = start.and_then(|start| data.get(start + 1..)) else {
        return Err(Flaw::new("an underscore and data in AppendedData", shown(rest)));
    };
    let has = |word: &[u8]| tag.windows(word.len()).any(|window| window == word);
    if has(b"\"raw\"") || has(b"'raw'") {
        return Ok((head, Appended::Raw(data)));
    }
    if !has(b"\"base64\"") && !has(b"'base64'") && has(b"encoding") {
        return Err(Flaw::new("raw or base64 as the encoding of AppendedData", shown(tag)));
    }
    let end = data.iter().position(|&byte| byte == b'<').unwrap_or(data.len());
    Ok((head, Appended::Base64(data.get(..end).unwrap_or_default().trim_ascii())))
}
