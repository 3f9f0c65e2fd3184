//! Reads MetaMesh (`.meta`): surfaces and parameterisations of SPHARM-PDM, written by ITK as text.
//!
//! The file has lines `Key = value`. `Points =` is followed by a line `ID x y z` for each point. `Cells =` is followed
//! by a line `ID a b c` for each cell, where a, b and c are IDs of points. A surface and its parameterisation are two
//! files with the same points in the same order.
//!
//! Source: ITK's MetaIO, `metaMesh.cxx`.

use std::collections::HashMap;

use super::flaw::{Flaw, bounded, shown};
use super::polygon::Triangles;
use super::text::{lines, next_number, next_position, number, words};
use crate::mesh::Mesh;

/// Returns whether the bytes begin like a MetaMesh file.
pub(super) fn is_metamesh(bytes: &[u8]) -> bool {
    bytes.starts_with(b"ObjectType")
}

/// Reads the points and polygons of the first mesh in a file.
pub(super) fn read(bytes: &[u8]) -> Result<Mesh, Flaw> {
    if !is_metamesh(bytes) {
        return Err(Flaw::new("`ObjectType = Scene` or `ObjectType = Mesh`", shown(bytes)));
    }
    let (mut vertices, mut faces) = (Vec::new(), Triangles::default());
    let mut places: HashMap<i64, u32> = HashMap::new();
    let (mut points, mut cells, mut cell_type): (u64, u64, &[u8]) = (0, 0, b"TRI");
    let mut lines = lines(bytes);
    while let Some((at, line)) = lines.next() {
        let Some((key, value)) = key_and_value(line) else { continue };
        let count = |what: &str| number(value).ok_or_else(|| Flaw::new(format!("{what} on line {at}"), shown(value)));
        match key {
            b"ObjectType" if !matches!(value, b"Scene" | b"Mesh") => {
                return Err(Flaw::unsupported(
                    format!("an object of type {}", shown(value)),
                    "save the surface as a mesh",
                ));
            }
            // A second mesh begins here; only the first is read.
            b"ObjectType" if !faces.is_empty() => break,
            b"BinaryData" | b"CompressedData" if value.eq_ignore_ascii_case(b"true") => {
                return Err(Flaw::unsupported("binary data", "write the file as text (BinaryData = False)"));
            }
            b"TransformMatrix" | b"Offset" | b"ElementSpacing" if !is_identity(key, value) => {
                return Err(Flaw::unsupported(
                    format!("{} = {}", shown(key), shown(value)),
                    "apply the transform to the points, as SPHARM-PDM does",
                ));
            }
            b"NPoints" => points = count("the count of points")?,
            b"Points" => {
                // The shortest line of a point, "0 0 0 0" and a newline, has 8 bytes.
                let points = bounded(points, 8, bytes.len(), "points")?;
                vertices.reserve(points);
                for place in 0..points {
                    let (at, line) = lines.next().ok_or_else(|| Flaw::new("a point", "the end of the file"))?;
                    let mut words = words(line);
                    places.insert(next_number(&mut words, "a point's number", at)?, place as u32);
                    vertices.push(next_position(&mut words, at)?);
                }
            }
            b"CellType" => cell_type = value,
            b"NCells" => cells = count("the count of cells")?,
            b"Cells" => {
                let cells = bounded(cells, 6, bytes.len(), "cells")?;
                let polygons = matches!(cell_type, b"TRI" | b"QAD" | b"PLG");
                for _ in 0..cells {
                    let (at, line) = lines.next().ok_or_else(|| Flaw::new("a cell", "the end of the file"))?;
                    if polygons {
                        face(line, at, &places, &mut faces)?;
                    }
                }
            }
            _ => {}
        }
    }
    Ok(faces.into_mesh(vertices))
}

/// Returns the key and the value of a line `Key = value`.
fn key_and_value(line: &[u8]) -> Option<(&[u8], &[u8])> {
    let at = line.iter().position(|&byte| byte == b'=')?;
    let (key, value) = line.split_at_checked(at)?;
    Some((key.trim_ascii(), value.get(1..)?.trim_ascii()))
}

/// Returns whether the value of `key`, which describes part of a transform, is the value for the identity.
fn is_identity(key: &[u8], value: &[u8]) -> bool {
    let numbers: Vec<f64> = words(value).filter_map(number).collect();
    match key {
        b"Offset" => numbers.iter().all(|&x| x == 0.0),
        b"ElementSpacing" => numbers.iter().all(|&x| x == 1.0),
        _ => numbers.iter().enumerate().all(|(i, &x)| x == if i % 4 == 0 { 1.0 } else { 0.0 }),
    }
}

fn face(line: &[u8], at: usize, places: &HashMap<i64, u32>, faces: &mut Triangles) -> Result<(), Flaw> {
    let corner = |word: &[u8]| {
        let place = number::<i64>(word).and_then(|point| places.get(&point).copied());
        place.ok_or_else(|| Flaw::new(format!("a point's number on line {at}"), shown(word)))
    };
    let corners: Vec<u32> = words(line).skip(1).map(corner).collect::<Result<_, _>>()?;
    if faces.polygon(&corners) {
        Ok(())
    } else {
        Err(Flaw::new(format!("at least three corners on line {at}"), corners.len().to_string()))
    }
}
