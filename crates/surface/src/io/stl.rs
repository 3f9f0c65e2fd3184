//! Reads and writes STL, as text or binary. STL has no shared vertices: each triangle stores its corners. The reader
//! merges corners with exactly equal coordinates into one vertex, and numbers vertices in the order of first
//! appearance.
//!
//! The crate stl_io isn't used, because it treats binary files that start with "solid" as text. Many binary files start
//! with "solid".

use std::io::{self, Write};

use super::axes::{noted, stated, titled};
use super::bytes::{Cursor, Endian};
use super::flaw::{Flaw, bounded, shown};
use super::text::{lines, next_position, words};
use super::weld::Welder;
use crate::mesh::Mesh;

const HEADER: usize = 80;
/// Number of bytes per triangle: a normal, three corners, and two bytes of attributes.
const TRIANGLE: usize = 50;

/// Reads a text or binary file. A file is treated as binary if its length fits the number of triangles in a binary
/// header, even if it starts with "solid".
pub(super) fn read(bytes: &[u8]) -> Result<Mesh, Flaw> {
    let frame = stated(bytes.get(..HEADER).unwrap_or(bytes));
    let text = bytes.trim_ascii_start().starts_with(b"solid");
    let mut cursor = Cursor::new(bytes);
    if text && !has_binary_length(bytes) {
        return Ok(noted(read_text(bytes)?, frame));
    }
    cursor.take(HEADER)?;
    let count = cursor.u32(Endian::Little)?;
    let count = bounded(count.into(), TRIANGLE, cursor.remaining(), "triangles")?;
    let mut welder = Welder::with_capacity(count);
    for _ in 0..count {
        cursor.take(12)?;
        for _ in 0..3 {
            let mut position = [0.0; 3];
            for x in &mut position {
                *x = cursor.f32(Endian::Little)?.into();
            }
            welder.corner(position)?;
        }
        cursor.take(2)?;
    }
    Ok(noted(welder.finish(), frame))
}

fn has_binary_length(bytes: &[u8]) -> bool {
    let mut cursor = Cursor::new(bytes);
    let count = cursor.take(HEADER).and_then(|_| cursor.u32(Endian::Little));
    count.is_ok_and(|n| (n as usize).checked_mul(TRIANGLE) == Some(cursor.remaining()))
}

fn read_text(bytes: &[u8]) -> Result<Mesh, Flaw> {
    let mut welder = Welder::with_capacity(0);
    // Number of corners read so far in the current loop, and whether a solid has begun but not ended.
    let (mut corners, mut open) = (0, false);
    for (at, line) in lines(bytes) {
        let mut words = words(line);
        let Some(word) = words.next() else { continue };
        match word {
            b"solid" if !open => open = true,
            b"endsolid" if open => open = false,
            b"facet" | b"endfacet" | b"outer" if open => {}
            b"vertex" if open && corners < 3 => {
                welder.corner(next_position(&mut words, at)?)?;
                corners += 1;
            }
            b"endloop" if corners == 3 => corners = 0,
            _ => {
                return Err(Flaw::new(
                    format!(
                        "the next keyword on line {at} (in the order solid, facet, outer loop, vertex three times, \
                         endloop, ...)"
                    ),
                    shown(word),
                ));
            }
        }
    }
    if open || corners != 0 {
        return Err(Flaw::new("endsolid", "the end of the file"));
    }
    Ok(welder.finish())
}

/// Writes a binary file. Each triangle is stored with its unit normal, or with a zero normal if it has no area.
pub(super) fn write(out: &mut dyn Write, mesh: &Mesh) -> io::Result<()> {
    let count =
        u32::try_from(mesh.faces.len()).map_err(|_| io::Error::other("STL files hold at most 2^32 - 1 triangles"))?;
    let mut header = [b' '; HEADER];
    let title = titled("binary STL by spharm", &mesh.meta);
    header[..title.len()].copy_from_slice(title.as_bytes());
    out.write_all(&header)?;
    out.write_all(&count.to_le_bytes())?;
    for face in &mesh.faces {
        let corners = face.map(|i| mesh.vertices[i as usize]);
        let normal = crate::geometry::unit(crate::geometry::face_normal(corners));
        for x in normal.iter().chain(corners.as_flattened()) {
            out.write_all(&(*x as f32).to_le_bytes())?;
        }
        out.write_all(&[0, 0])?;
    }
    Ok(())
}
