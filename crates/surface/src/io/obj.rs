//! Reads and writes Wavefront OBJ: `v x y z`, `f a/b/c ...`. Everything else (normals, textures, groups, materials) is
//! skipped.
//!
//! The crate tobj isn't used: it makes a separate model with separate vertices for each group, which loses the order of
//! the vertices.

use std::io::{self, Write};

use super::flaw::{Flaw, shown};
use super::polygon::fan;
use super::text::{lines, next_position, number, words};
use crate::mesh::Mesh;

/// Reads the positions and polygons of all groups, in the file's order.
pub(super) fn read(bytes: &[u8]) -> Result<Mesh, Flaw> {
    let mut vertices = Vec::new();
    let mut faces = Vec::new();
    let mut corners = Vec::new();
    for (line_number, line) in lines(bytes) {
        let mut words = words(line);
        match words.next() {
            // A weight or a colour may follow the position.
            Some(b"v") => vertices.push(next_position(&mut words, line_number)?),
            Some(b"f") => {
                corners.clear();
                for word in words.take_while(|word| !word.starts_with(b"#")) {
                    corners.push(index(word, vertices.len(), line_number)?);
                }
                if !fan(&corners, &mut faces) {
                    return Err(Flaw::new(
                        format!("at least three corners on line {line_number}"),
                        corners.len().to_string(),
                    ));
                }
            }
            _ => {}
        }
    }
    Ok(Mesh::new(vertices, faces))
}

/// Parses a corner such as `7`, `7/1`, `7//3` or `-1`. Positive indices count from 1; negative ones count back from the
/// last vertex read so far.
fn index(word: &[u8], vertices_so_far: usize, line_number: usize) -> Result<u32, Flaw> {
    let position = word.split(|&b| b == b'/').next().unwrap_or_default();
    let from_zero = match number::<i64>(position) {
        Some(i) if i > 0 => Some(i - 1),
        Some(i) if i < 0 => i64::try_from(vertices_so_far).ok().map(|n| n + i),
        _ => None,
    };
    from_zero
        .and_then(|i| u32::try_from(i).ok())
        .ok_or_else(|| Flaw::new(format!("a vertex's number on line {line_number}"), shown(word)))
}

/// Writes positions, in digits that read back exactly, and triangles.
pub(super) fn write(out: &mut dyn Write, mesh: &Mesh) -> io::Result<()> {
    for [x, y, z] in &mesh.vertices {
        writeln!(out, "v {x:?} {y:?} {z:?}")?;
    }
    for face in &mesh.faces {
        let [a, b, c] = face.map(|i| u64::from(i) + 1);
        writeln!(out, "f {a} {b} {c}")?;
    }
    Ok(())
}
