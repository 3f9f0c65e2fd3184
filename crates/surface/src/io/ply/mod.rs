//! Stanford PLY: a text header that names elements and their properties, then text or binary data.
//!
//! `header` parses the header, `body` reads vertices and polygons and skips the rest. ply-rs-bw keeps a map for each
//! element and grows without bound on elements that have no properties, so it isn't used.

mod body;
mod header;
mod write;

use super::bytes::Cursor;
use super::flaw::Flaw;
use crate::error::SurfaceError;
use crate::mesh::Mesh;
pub(super) use write::write;

/// Reads the `vertex` and `face` elements.
pub(super) fn read(bytes: &[u8]) -> Result<Mesh, Flaw> {
    let mut cursor = Cursor::new(bytes);
    let header = header::read(&mut cursor)?;
    body::read(&header, cursor)
}

/// Attributes of each vertex in addition to its position.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PlyAttributes<'a> {
    /// A property's name, a single word, and its values, one per vertex; written in 32 bits.
    pub scalar: Option<(&'a str, &'a [f64])>,
    /// Red, green, blue for each vertex.
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
                expected: "one word of letters, digits and _, none of x, y, z, red, green, blue",
                found: format!("{name:?}"),
            }),
            _ => Ok(()),
        }
    }
}
