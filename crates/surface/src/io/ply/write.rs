//! Writes PLY files as little-endian binary, which every viewer reads.

use std::io::{self, Write};

use super::super::axes::titled;
use super::PlyAttributes;
use crate::mesh::Mesh;

/// Writes a mesh with its attributes. The caller must have checked the attributes' lengths.
pub(in crate::io) fn write(
    out: &mut dyn Write,
    mesh: &Mesh,
    attributes: &PlyAttributes<'_>,
    double: bool,
) -> io::Result<()> {
    let float = if double { "double" } else { "float" };
    let comment = titled("by spharm", &mesh.meta);
    writeln!(out, "ply\nformat binary_little_endian 1.0\ncomment {comment}")?;
    writeln!(out, "element vertex {}", mesh.vertices.len())?;
    for axis in ["x", "y", "z"] {
        writeln!(out, "property {float} {axis}")?;
    }
    if let Some((name, _)) = attributes.scalar {
        writeln!(out, "property float {name}")?;
    }
    if attributes.colors.is_some() {
        writeln!(out, "property uchar red\nproperty uchar green\nproperty uchar blue")?;
    }
    writeln!(out, "element face {}", mesh.faces.len())?;
    // Indices have type int if possible, because some viewers don't support uint.
    let index = if mesh.vertices.len() > i32::MAX as usize { "uint" } else { "int" };
    writeln!(out, "property list uchar {index} vertex_indices\nend_header")?;

    let mut scalars = attributes.scalar.map(|(_, values)| values.iter());
    let mut colors = attributes.colors.map(<[_]>::iter);
    for position in &mesh.vertices {
        for &x in position {
            if double {
                out.write_all(&x.to_le_bytes())?;
            } else {
                out.write_all(&(x as f32).to_le_bytes())?;
            }
        }
        if let Some(&x) = scalars.as_mut().and_then(Iterator::next) {
            out.write_all(&(x as f32).to_le_bytes())?;
        }
        if let Some(color) = colors.as_mut().and_then(Iterator::next) {
            out.write_all(color)?;
        }
    }
    for face in &mesh.faces {
        out.write_all(&[3])?;
        for i in face {
            out.write_all(&i.to_le_bytes())?;
        }
    }
    Ok(())
}
