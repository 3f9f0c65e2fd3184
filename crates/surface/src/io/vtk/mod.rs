//! Reads and writes VTK's legacy format: PolyData with POLYGONS, in text or big-endian binary. Both layouts of polygons
//! are read: each polygon preceded by its number of corners (up to version 4.2), and offsets with connectivity (5.x).
//!
//! `cells` reads the data between the keywords: numbers, points, cells, fields.
//!
//! Source: "VTK File Formats", the simple legacy formats. The crate vtkio isn't used: it allocates memory by the
//! header's counts unchecked.

mod cells;

use std::io::{self, Write};

use super::bytes::Cursor;
use super::flaw::{Flaw, shown};
use crate::mesh::Mesh;
use cells::Values;

/// Reads the points and polygons of a PolyData file. Attributes (POINT_DATA, CELL_DATA) follow them and are ignored.
pub(super) fn read(bytes: &[u8]) -> Result<Mesh, Flaw> {
    let mut cursor = Cursor::new(bytes);
    let magic = cursor.line().unwrap_or_default();
    if !magic.starts_with(b"# vtk DataFile Version") {
        return Err(Flaw::new("\"# vtk DataFile Version\"", shown(magic)));
    }
    cursor.line();
    let ascii = match cursor.line().unwrap_or_default().trim_ascii() {
        b"ASCII" => true,
        b"BINARY" => false,
        other => return Err(Flaw::new("ASCII or BINARY on line 3", shown(other))),
    };
    let mut values = Values { cursor, ascii };
    let mut mesh = Mesh::default();
    loop {
        match values.cursor.token() {
            b"DATASET" => match values.cursor.token() {
                b"POLYDATA" => {}
                other => {
                    return Err(Flaw::unsupported(
                        format!("the dataset {}", shown(other)),
                        "save its surface as PolyData",
                    ));
                }
            },
            b"POINTS" => mesh.vertices = values.points()?,
            b"POLYGONS" => mesh.faces = values.polygons()?,
            b"TRIANGLE_STRIPS" => {
                return Err(Flaw::unsupported("triangle strips", "save it through vtkTriangleFilter"));
            }
            // Cells that aren't part of the surface are skipped. They have the same layout as polygons.
            b"VERTICES" | b"LINES" => {
                values.cells(|_| Ok(()))?;
            }
            b"FIELD" => values.skip_field()?,
            // Metadata are skipped; they end with an empty line.
            b"METADATA" => {
                values.cursor.line();
                while values.cursor.line().is_some_and(|line| !line.trim_ascii().is_empty()) {}
            }
            b"POINT_DATA" | b"CELL_DATA" | b"" => return Ok(mesh),
            other => return Err(Flaw::new("POINTS, POLYGONS or POINT_DATA", shown(other))),
        }
    }
}

/// Writes a text file of version 3.0, which every version of VTK reads. All numbers read back exactly. `scalar` gives
/// the name and values of an attribute, one value per vertex.
pub(super) fn write(out: &mut dyn Write, mesh: &Mesh, scalar: Option<(&str, &[f64])>) -> io::Result<()> {
    writeln!(out, "# vtk DataFile Version 3.0\nsurface by spharm\nASCII\nDATASET POLYDATA")?;
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
