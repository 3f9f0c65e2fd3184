//! Writes MATLAB's MAT files of level 5.

use std::io::{self, Write};

use ndarray::Array2;
use num_complex::Complex64;
use spharm_harmonics::Coefficients;

const TEXT: &str = "MATLAB 5.0 MAT-file, by spharm";
const I8: u32 = 1;
const I32: u32 = 5;
const U32: u32 = 6;
const F64: u32 = 9;
const MATRIX: u32 = 14;
/// MATLAB's class number of f64 matrices.
const DOUBLE: u32 = 6;
/// Flag bit that marks a complex matrix.
const COMPLEX: u32 = 1 << 11;

/// Geometry of a surface model with a sphere: positions, triangles with vertices numbered from 0, and directions.
pub(crate) struct Surface<'a> {
    pub(crate) vertices: &'a [[f64; 3]],
    pub(crate) faces: &'a [[u32; 3]],
    pub(crate) sphere: &'a [[f64; 3]],
}

pub(crate) fn write(out: &mut dyn Write, a: &Coefficients, surface: Option<&Surface<'_>>) -> io::Result<()> {
    write!(out, "{TEXT:<124}")?;
    out.write_all(&[0, 1, b'I', b'M'])?;
    let complex = a.to_complex();
    let part = |part: fn(&Complex64) -> f64| complex.t().iter().map(part).collect::<Vec<f64>>();
    matrix(out, "fvec", complex.dim(), &[part(|c| c.re), part(|c| c.im)])?;
    let Some(Surface { vertices, faces, sphere }) = surface else { return Ok(()) };
    let triangles: Vec<[f64; 3]> = faces.iter().map(|face| face.map(|v| f64::from(v) + 1.0)).collect();
    for (name, rows) in [("vertices", *vertices), ("faces", &triangles), ("sph_verts", *sphere)] {
        matrix(out, name, (rows.len(), 3), &[columns(rows)])?;
    }
    Ok(())
}

fn columns(rows: &[[f64; 3]]) -> Vec<f64> {
    let array = Array2::from_shape_fn((3, rows.len()), |(axis, row)| {
        rows.get(row).and_then(|row| row.get(axis)).copied().unwrap_or_default()
    });
    array.into_iter().collect()
}

/// Writes a matrix whose values are given column by column. `parts` consists of the real parts and, for a complex
/// matrix, the imaginary parts.
fn matrix(out: &mut dyn Write, name: &str, (rows, columns): (usize, usize), parts: &[Vec<f64>]) -> io::Result<()> {
    let mut body = Vec::new();
    let flags = DOUBLE | if parts.len() > 1 { COMPLEX } else { 0 };
    element(&mut body, U32, &[flags.to_le_bytes(), [0; 4]].concat())?;
    element(&mut body, I32, &[signed(rows)?.to_le_bytes(), signed(columns)?.to_le_bytes()].concat())?;
    element(&mut body, I8, name.as_bytes())?;
    for part in parts {
        element(&mut body, F64, &part.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>())?;
    }
    element(out, MATRIX, &body)
}

fn element(out: &mut dyn Write, kind: u32, bytes: &[u8]) -> io::Result<()> {
    out.write_all(&kind.to_le_bytes())?;
    let length = u32::try_from(bytes.len()).map_err(|_| io::Error::other("too large for a MAT file of level 5"))?;
    out.write_all(&length.to_le_bytes())?;
    out.write_all(bytes)?;
    out.write_all(&vec![0; bytes.len().next_multiple_of(8) - bytes.len()])
}

fn signed(count: usize) -> io::Result<i32> {
    i32::try_from(count).map_err(io::Error::other)
}
