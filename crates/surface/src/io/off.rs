//! Reads and writes Geomview's OFF: a keyword, the counts, a line per vertex, a line per polygon. Colours and normals
//! after the positions are skipped.
//!
//! The crate off-rs isn't used, because it rounds positions to 32 bits.

use std::io::{self, Write};

use super::flaw::{Flaw, bounded, shown};
use super::polygon::Triangles;
use super::text::{lines, next_number, next_position, words};
use crate::mesh::Mesh;

/// Reads a text file with the keyword OFF, COFF, NOFF or CNOFF.
pub(super) fn read(bytes: &[u8]) -> Result<Mesh, Flaw> {
    // Comments are removed, and lines that are then empty are skipped.
    let mut lines = lines(bytes)
        .map(|(number, line)| (number, line.split(|&b| b == b'#').next().unwrap_or_default().trim_ascii()))
        .filter(|(_, line)| !line.is_empty());
    let mut next = |what: &str| lines.next().ok_or_else(|| Flaw::new(what, "the end of the file"));

    let (mut at, mut line) = next("the word OFF")?;
    let mut header = words(line);
    let keyword = header.next().unwrap_or_default();
    match keyword {
        b"OFF" | b"COFF" | b"NOFF" | b"CNOFF" => {}
        _ if keyword.ends_with(b"OFF") => {
            return Err(Flaw::unsupported(
                format!("the variant {}", shown(keyword)),
                "save the surface as plain three-dimensional OFF",
            ));
        }
        _ => return Err(Flaw::new("the word OFF", shown(keyword))),
    }
    let mut counts = header.peekable();
    if counts.peek().is_none() {
        (at, line) = next("the counts of vertices and polygons")?;
        counts = words(line).peekable();
    }
    if counts.peek() == Some(&b"BINARY".as_slice()) {
        return Err(Flaw::unsupported("binary data", "save it as text"));
    }
    let vertex_count: u64 = next_number(&mut counts, "the count of vertices", at)?;
    let face_count: u64 = next_number(&mut counts, "the count of polygons", at)?;

    // The shortest line, "0 0 0" and a newline, has 6 bytes. The last newline of the file may be missing.
    let vertex_count = bounded(vertex_count, 6, bytes.len() + 1, "vertices")?;
    let mut vertices = Vec::with_capacity(vertex_count);
    for _ in 0..vertex_count {
        let (at, line) = next("a vertex")?;
        vertices.push(next_position(&mut words(line), at)?);
    }
    let face_count = bounded(face_count, 8, bytes.len() + 1, "polygons")?;
    let mut faces = Triangles::default();
    faces.reserve(face_count);
    let mut corners = Vec::new();
    for _ in 0..face_count {
        let (at, line) = next("a polygon")?;
        let mut words = words(line);
        let count: usize = next_number(&mut words, "a count of corners", at)?;
        corners.clear();
        // `count` needn't be checked: if it is too large for the words on the line, the first missing word is reported
        // as an error.
        for _ in 0..count {
            corners.push(next_number(&mut words, "a vertex's index", at)?);
        }
        if !faces.polygon(&corners) {
            return Err(Flaw::new(format!("at least three corners on line {at}"), count.to_string()));
        }
    }
    Ok(faces.into_mesh(vertices))
}

/// Writes positions, in digits that read back exactly, and triangles.
pub(super) fn write(out: &mut dyn Write, mesh: &Mesh) -> io::Result<()> {
    writeln!(out, "OFF\n{} {} 0", mesh.vertices.len(), mesh.faces.len())?;
    for [x, y, z] in &mesh.vertices {
        writeln!(out, "{x:?} {y:?} {z:?}")?;
    }
    for [a, b, c] in &mesh.faces {
        writeln!(out, "3 {a} {b} {c}")?;
    }
    Ok(())
}
