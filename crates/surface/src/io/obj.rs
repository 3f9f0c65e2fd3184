//! Reads and writes Wavefront OBJ: `v x y z`, `f a/b/c ...`. Everything else (normals, textures, groups, materials) is
//! skipped, except for a comment that states the axes. A backslash at the end of a line means that the line continues
//! on the next line.
//!
//! The crate tobj isn't used, because it makes a separate model with separate vertices for each group, so the order of
//! the vertices is lost.

use std::borrow::Cow;
use std::io::{self, Write};

use super::axes::{known, noted, stated};
use super::flaw::{Flaw, shown};
use super::polygon::Triangles;
use super::text::{lines, next_position, number, words};
use crate::mesh::Mesh;

/// Reads the positions and polygons of all groups, in the file's order.
pub(super) fn read(bytes: &[u8]) -> Result<Mesh, Flaw> {
    let mut vertices = Vec::new();
    let mut faces = Triangles::default();
    let mut corners = Vec::new();
    let mut frame = None;
    let mut lines = lines(bytes);
    while let Some((line_number, line)) = lines.next() {
        // Only lines with vertices or polygons are joined with the next line, because a comment or a file's name may
        // also end in a backslash.
        let line = match words(line).next() {
            Some(b"v" | b"f") => continued(line, &mut lines),
            Some(word) if word.starts_with(b"#") => {
                frame = frame.or_else(|| stated(line));
                continue;
            }
            _ => continue,
        };
        let mut words = words(&line);
        match words.next() {
            // A weight or a colour may follow the position.
            Some(b"v") => vertices.push(next_position(&mut words, line_number)?),
            Some(b"f") => {
                corners.clear();
                for word in words.take_while(|word| !word.starts_with(b"#")) {
                    corners.push(index(word, vertices.len(), line_number)?);
                }
                if !faces.polygon(&corners) {
                    return Err(Flaw::new(
                        format!("at least three corners on line {line_number}"),
                        corners.len().to_string(),
                    ));
                }
            }
            _ => {}
        }
    }
    Ok(noted(faces.into_mesh(vertices), frame))
}

/// Joins a line and the lines that continue it.
fn continued<'a>(line: &'a [u8], rest: &mut impl Iterator<Item = (usize, &'a [u8])>) -> Cow<'a, [u8]> {
    let Some(start) = line.strip_suffix(b"\\") else { return Cow::Borrowed(line) };
    let mut whole = start.to_vec();
    for (_, line) in rest {
        whole.push(b' ');
        match line.strip_suffix(b"\\") {
            Some(part) => whole.extend_from_slice(part),
            None => {
                whole.extend_from_slice(line);
                break;
            }
        }
    }
    Cow::Owned(whole)
}

/// Parses a corner such as `7`, `7/1`, `7//3` or `-1`. Positive indices count from 1, and negative indices count back
/// from the last vertex read so far.
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
    if let Some(statement) = known(&mesh.meta) {
        writeln!(out, "# {statement}")?;
    }
    for [x, y, z] in &mesh.vertices {
        writeln!(out, "v {x:?} {y:?} {z:?}")?;
    }
    for face in &mesh.faces {
        let [a, b, c] = face.map(|i| u64::from(i) + 1);
        writeln!(out, "f {a} {b} {c}")?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_continued_and_end_at_carriage_returns_too() {
        let text = "# in C:\\\nv 0 0 0\nv 1 \\\n  0 0\nv 0 1 0\nv 0 0 1\nf 1 2\\\n\\\n3\nf 1 2 3 4";
        let plain = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 3 4\n";
        let wanted = read(plain.as_bytes()).unwrap();
        assert_eq!((wanted.vertices.len(), wanted.faces.len()), (4, 3));
        for text in [text.to_owned(), text.replace('\n', "\r\n"), plain.replace('\n', "\r")] {
            assert_eq!(read(text.as_bytes()).unwrap(), wanted, "{text:?}");
        }
    }
}
