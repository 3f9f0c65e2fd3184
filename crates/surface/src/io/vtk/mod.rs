//! Reads and writes VTK's legacy format in text or big-endian binary: PolyData with POLYGONS and TRIANGLE_STRIPS, and
//! UNSTRUCTURED_GRID with triangles, quadrangles, polygons and strips. Both layouts of cells are read: each cell
//! preceded by its number of corners (up to version 4.2), and offsets with connectivity (5.x).
//!
//! `cells` reads the data between the keywords: numbers, points, cells, fields. `surface` converts cells to triangles.
//!
//! Source: "VTK File Formats", the simple legacy formats. The crate vtkio isn't used, because it allocates as much
//! memory as the counts in the header imply, without checking them.

mod cells;
mod surface;

use std::io::{self, Write};

use super::axes::{noted, stated, titled};
use super::bytes::Cursor;
use super::flaw::{Flaw, shown};
use super::polygon::Triangles;
use crate::mesh::Mesh;
use cells::Values;
pub(super) use surface::{cell, polygon, triangle_strip};

/// Reads the points and the surface cells of a PolyData file or an unstructured grid. Reading stops at the attributes
/// (POINT_DATA, CELL_DATA), which come last.
pub(super) fn read(bytes: &[u8]) -> Result<Mesh, Flaw> {
    let mut cursor = Cursor::new(bytes);
    let magic = cursor.line().unwrap_or_default();
    if !magic.starts_with(b"# vtk DataFile Version") {
        return Err(Flaw::new("\"# vtk DataFile Version\"", shown(magic)));
    }
    let frame = stated(cursor.line().unwrap_or_default());
    let ascii = match cursor.line().unwrap_or_default().trim_ascii() {
        b"ASCII" => true,
        b"BINARY" => false,
        other => return Err(Flaw::new("ASCII or BINARY on line 3", shown(other))),
    };
    let mut values = Values { cursor, ascii };
    let (mut vertices, mut faces) = (Vec::new(), Triangles::default());
    let mut cells = Cells::default();
    loop {
        match values.cursor.token() {
            b"DATASET" => match values.cursor.token() {
                b"POLYDATA" | b"UNSTRUCTURED_GRID" => {}
                other => {
                    return Err(Flaw::unsupported(
                        format!("the dataset {}", shown(other)),
                        "save the surface as PolyData",
                    ));
                }
            },
            b"POINTS" => vertices = values.points()?,
            b"POLYGONS" => values.cells(|corners| polygon(corners, &mut faces))?,
            b"TRIANGLE_STRIPS" => values.cells(|corners| triangle_strip(corners, &mut faces))?,
            // Cells that aren't part of the surface are skipped. They have the same layout as polygons.
            b"VERTICES" | b"LINES" => values.cells(|_| Ok(()))?,
            b"CELLS" => values.cells(|corners| {
                cells.push(corners);
                Ok(())
            })?,
            b"CELL_TYPES" => {
                let kinds = values.cell_types(cells.ends.len())?;
                cells.convert(&kinds, &mut faces)?;
            }
            b"FIELD" => values.skip_field()?,
            // Metadata, which end with an empty line, are skipped.
            b"METADATA" => {
                values.cursor.line();
                while values.cursor.line().is_some_and(|line| !line.trim_ascii().is_empty()) {}
            }
            b"POINT_DATA" | b"CELL_DATA" | b"" => break,
            other => return Err(Flaw::new("POINTS, POLYGONS or POINT_DATA", shown(other))),
        }
    }
    match cells.ends.is_empty() {
        true => Ok(noted(faces.into_mesh(vertices), frame)),
        false => Err(Flaw::new("CELL_TYPES after CELLS", "none")),
    }
}

/// The cells of an unstructured grid. They are kept until their types have been read.
#[derive(Default)]
struct Cells {
    /// The corners of all cells.
    corners: Vec<u32>,
    /// For each cell, the position in `corners` at which its corners end.
    ends: Vec<usize>,
}

impl Cells {
    fn push(&mut self, corners: &[u32]) {
        self.corners.extend_from_slice(corners);
        self.ends.push(self.corners.len());
    }

    /// Adds the cells' triangles to `faces`, and removes the cells.
    fn convert(&mut self, kinds: &[u64], faces: &mut Triangles) -> Result<(), Flaw> {
        let cells = std::mem::take(self);
        let mut start = 0;
        for (&kind, end) in kinds.iter().zip(cells.ends) {
            cell(kind, cells.corners.get(start..end).unwrap_or_default(), faces)?;
            start = end;
        }
        Ok(())
    }
}

/// Writes a text file of version 3.0, which every version of VTK reads. All numbers read back exactly. `scalar` gives
/// the name and values of an attribute, one value per vertex.
pub(super) fn write(out: &mut dyn Write, mesh: &Mesh, scalar: Option<(&str, &[f64])>) -> io::Result<()> {
    let title = titled("surface by spharm", &mesh.meta);
    writeln!(out, "# vtk DataFile Version 3.0\n{title}\nASCII\nDATASET POLYDATA")?;
    writeln!(out, "POINTS {} double", mesh.vertices.len())?;
    for [x, y, z] in &mesh.vertices {
        writeln!(out, "{x:?} {y:?} {z:?}")?;
    }
    let faces = mesh.faces.len();
    writeln!(out, "POLYGONS {faces} {}", 4 * faces)?;
    for [a, b, c] in &mesh.faces {
        writeln!(out, "3 {a} {b} {c}")?;
    }
    let Some((name, values)) = scalar else { return Ok(()) };
    writeln!(out, "POINT_DATA {}\nSCALARS {name} double 1\nLOOKUP_TABLE default", values.len())?;
    values.iter().try_for_each(|x| writeln!(out, "{x:?}"))
}
