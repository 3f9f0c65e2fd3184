//! Reads and writes Stanford PLY: a text header that names elements and their properties, then text or binary data.
//!
//! `header` parses the header; `body` reads vertices, polygons and strips and skips the rest. The crate ply-rs-bw isn't
//! used, because it stores every element as a map, and needs unbounded memory for elements without properties.

mod body;
mod header;
mod write;

use super::axes::noted;
use super::bytes::Cursor;
use super::flaw::Flaw;
use crate::error::SurfaceError;
use crate::mesh::Mesh;
pub(super) use write::write;

/// Reads the elements `vertex`, `face` and `tristrips`.
pub(super) fn read(bytes: &[u8]) -> Result<Mesh, Flaw> {
    let mut cursor = Cursor::new(bytes);
    let header = header::read(&mut cursor)?;
    Ok(noted(body::read(&header, cursor)?, header.frame))
}

/// Returns the number of vertices in the header of a PLY file. `head` has the first bytes of the file. Returns `None`
/// for other files, and if `head` doesn't contain the complete header.
pub(super) fn declared(head: &[u8]) -> Option<u64> {
    let header = header::read(&mut Cursor::new(head)).ok()?;
    header.elements.iter().find(|element| element.name == b"vertex").map(|element| element.count)
}

/// Values stored for each vertex in addition to its position.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PlyAttributes<'a> {
    /// Name of the property, a single word, and one value per vertex. Values are written as 32-bit floats.
    pub scalar: Option<(&'a str, &'a [f64])>,
    /// Red, green and blue components of each vertex.
    pub colors: Option<&'a [[u8; 3]]>,
}

impl PlyAttributes<'_> {
    pub(super) fn check(&self, mesh: &Mesh) -> Result<(), SurfaceError> {
        let scalars = self.scalar.map(|(_, values)| values.len());
        let colors = self.colors.map(<[_]>::len);
        for (what, found) in [("scalars at the vertices", scalars), ("colours at the vertices", colors)] {
            if let Some(found) = found.filter(|&n| n != mesh.vertices.len()) {
                return Err(SurfaceError::LengthMismatch { what, expected: mesh.vertices.len(), found });
            }
        }
        let word = |name: &str| !name.is_empty() && name.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_');
        let taken = ["x", "y", "z", "red", "green", "blue"];
        match self.scalar {
            Some((name, _)) if !word(name) || taken.contains(&name) => Err(SurfaceError::Argument {
                what: "the PLY property's name",
                expected: "one word of letters, digits and _, other than x, y, z, red, green and blue",
                found: format!("{name:?}"),
            }),
            _ => Ok(()),
        }
    }
}
