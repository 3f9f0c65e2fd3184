//! Converts VTK's cells to triangles: polygons and strips of PolyData, and cells of an unstructured grid by their
//! types.
//!
//! Source: "VTK File Formats", figures of the linear cell types, and VTK's `vtkCellType.h` for their numbers.

use super::super::flaw::Flaw;
use super::super::polygon::Triangles;

/// Adds a polygon's triangles to `faces`.
pub(in crate::io) fn polygon(corners: &[u32], faces: &mut Triangles) -> Result<(), Flaw> {
    if faces.polygon(corners) {
        return Ok(());
    }
    Err(Flaw::new("polygons of at least three corners", corners.len().to_string()))
}

/// Adds a strip's triangles to `faces`.
pub(in crate::io) fn triangle_strip(corners: &[u32], faces: &mut Triangles) -> Result<(), Flaw> {
    if faces.strip(corners) {
        return Ok(());
    }
    Err(Flaw::new("triangle strips of at least three corners", corners.len().to_string()))
}

/// Adds the triangles of a cell of an unstructured grid to `faces`. Vertices and lines have no triangles.
pub(in crate::io) fn cell(kind: u64, corners: &[u32], faces: &mut Triangles) -> Result<(), Flaw> {
    match kind {
        // Empty cells, vertices and lines.
        0..=4 => Ok(()),
        5 => sized(kind, corners, 3).and_then(|()| polygon(corners, faces)),
        6 => triangle_strip(corners, faces),
        7 => polygon(corners, faces),
        8 => {
            // VTK's cell type `pixel` has four corners, which are listed row by row.
            let &[a, b, c, d] = corners else { return sized(kind, corners, 4) };
            polygon(&[a, b, d, c], faces)
        }
        9 => sized(kind, corners, 4).and_then(|()| polygon(corners, faces)),
        10..=16 | 24..=27 | 29 | 33 | 41 | 42 => Err(Flaw::unsupported(
            format!("cells with a volume (type {kind})"),
            "extract the surface, for example with ParaView's filter Extract Surface",
        )),
        other => Err(Flaw::unsupported(
            format!("cells of type {other}"),
            "convert the cells to triangles, for example with ParaView's filters Extract Surface and Triangulate",
        )),
    }
}

fn sized(kind: u64, corners: &[u32], count: usize) -> Result<(), Flaw> {
    if corners.len() == count {
        return Ok(());
    }
    Err(Flaw::new(format!("{count} corners in cells of type {kind}"), corners.len().to_string()))
}
