//! Writes binary glTF 2.0 (`.glb`) for viewers: positions, normals, triangles, and a colour and a value per vertex.
//!
//! The file has a header, a chunk of JSON and a chunk of bytes. Positions are written unchanged, in the mesh's unit and
//! axes, although glTF's unit is the metre and its y axis points up. Colours are converted from sRGB to linear, as glTF
//! requires. A value is stored as the attribute `_NAME`.
//!
//! Source: Khronos Group, glTF 2.0 specification, sections 3 and 4.

use std::io::{self, Write};

use super::super::ply::PlyAttributes;
use super::document::GENERATOR;
use crate::mesh::Mesh;

/// glTF's codes for component types.
const U16: u32 = 5123;
const U32: u32 = 5125;
const F32: u32 = 5126;
/// glTF's codes for the type of data in a buffer view.
const VERTICES: u32 = 34962;
const TRIANGLES: u32 = 34963;

/// The bytes of all arrays and the JSON that describes the arrays.
#[derive(Default)]
struct Buffer {
    bytes: Vec<u8>,
    views: Vec<String>,
    accessors: Vec<String>,
}

impl Buffer {
    /// Adds an array, and returns the index of its accessor. `accessor` is JSON with the other properties of the
    /// accessor.
    fn add(&mut self, bytes: impl Iterator<Item = u8>, target: u32, accessor: &str) -> usize {
        let start = self.bytes.len();
        self.bytes.extend(bytes);
        let length = self.bytes.len() - start;
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.views.push(format!("{{\"buffer\":0,\"byteOffset\":{start},\"byteLength\":{length},\"target\":{target}}}"));
        self.accessors.push(format!("{{\"bufferView\":{},{accessor}}}", self.views.len() - 1));
        self.accessors.len() - 1
    }
}

/// Writes a mesh with its attributes. The caller must have checked the attributes' lengths.
pub(in crate::io) fn write(out: &mut dyn Write, mesh: &Mesh, attributes: &PlyAttributes<'_>) -> io::Result<()> {
    let count = mesh.vertices.len();
    let positions: Vec<[f32; 3]> = mesh.vertices.iter().map(|v| v.map(|x| x as f32)).collect();
    let bounds = |start: f32, pick: fn(f32, f32) -> f32| {
        positions.iter().fold([start; 3], |most, v| [0, 1, 2].map(|k| pick(most[k], v[k])))
    };
    let mut buffer = Buffer::default();
    let vectors = |buffer: &mut Buffer, rows: &[[f32; 3]], more: String| {
        let bytes = rows.as_flattened().iter().flat_map(|x| x.to_le_bytes());
        let accessor = format!("\"componentType\":{F32},\"count\":{count},\"type\":\"VEC3\"{more}");
        buffer.add(bytes, VERTICES, &accessor)
    };
    let (low, high) = (bounds(f32::INFINITY, f32::min), bounds(f32::NEG_INFINITY, f32::max));
    let position = vectors(&mut buffer, &positions, format!(",\"min\":{low:?},\"max\":{high:?}"));
    let normal = vectors(&mut buffer, &normals(mesh), String::new());
    let mut attributes_json = format!("\"POSITION\":{position},\"NORMAL\":{normal}");
    if let Some(colors) = attributes.colors {
        let linear = |&[r, g, b]: &[u8; 3]| [to_linear(r), to_linear(g), to_linear(b), u16::MAX];
        let bytes = colors.iter().flat_map(linear).flat_map(u16::to_le_bytes);
        let accessor = format!("\"componentType\":{U16},\"normalized\":true,\"count\":{count},\"type\":\"VEC4\"");
        attributes_json += &format!(",\"COLOR_0\":{}", buffer.add(bytes, VERTICES, &accessor));
    }
    if let Some((name, values)) = attributes.scalar {
        let bytes = values.iter().flat_map(|&x| (x as f32).to_le_bytes());
        let accessor = format!("\"componentType\":{F32},\"count\":{count},\"type\":\"SCALAR\"");
        attributes_json += &format!(",\"_{}\":{}", name.to_ascii_uppercase(), buffer.add(bytes, VERTICES, &accessor));
    }
    let corners = mesh.faces.as_flattened();
    let bytes = corners.iter().flat_map(|v| v.to_le_bytes());
    let accessor = format!("\"componentType\":{U32},\"count\":{},\"type\":\"SCALAR\"", corners.len());
    let indices = buffer.add(bytes, TRIANGLES, &accessor);
    let json = format!(
        "{{\"asset\":{{\"version\":\"2.0\",\"generator\":\"{GENERATOR}\"}},\"scene\":0,\"scenes\":[{{\"nodes\":[0]}}],\
         \"nodes\":[{{\"mesh\":0}}],\"materials\":[{{\"pbrMetallicRoughness\":{{\"metallicFactor\":0,\
         \"roughnessFactor\":0.8}},\"doubleSided\":true}}],\"meshes\":[{{\"primitives\":[{{\"attributes\":\
         {{{attributes_json}}},\"indices\":{indices},\"material\":0}}]}}],\"accessors\":[{}],\"bufferViews\":[{}],\
         \"buffers\":[{{\"byteLength\":{}}}]}}",
        buffer.accessors.join(","),
        buffer.views.join(","),
        buffer.bytes.len()
    );
    let padded = json.len().next_multiple_of(4);
    let whole = 12 + 8 + padded + 8 + buffer.bytes.len();
    let size = |n: usize| u32::try_from(n).map_err(|_| io::Error::other("the scene exceeds glTF's limit of 4 GiB"));
    out.write_all(b"glTF")?;
    for number in [2, size(whole)?, size(padded)?] {
        out.write_all(&number.to_le_bytes())?;
    }
    write!(out, "JSON{json:<padded$}")?;
    out.write_all(&size(buffer.bytes.len())?.to_le_bytes())?;
    out.write_all(b"BIN\0")?;
    out.write_all(&buffer.bytes)
}

/// Converts an sRGB component from 0 to 255 to a linear component from 0 to 65535.
fn to_linear(component: u8) -> u16 {
    let x = f64::from(component) / 255.0;
    let linear = if x <= 0.04045 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) };
    (linear * 65535.0).round() as u16
}

/// Returns unit normals at the vertices. Each is the mean of the normals of the triangles around the vertex, weighted
/// by area.
fn normals(mesh: &Mesh) -> Vec<[f32; 3]> {
    let mut sums = vec![[0.0; 3]; mesh.vertices.len()];
    for face in &mesh.faces {
        let [a, b, c] = face.map(|v| mesh.vertices.get(v as usize).copied().unwrap_or_default());
        let (u, v) = ([0, 1, 2].map(|k| b[k] - a[k]), [0, 1, 2].map(|k| c[k] - a[k]));
        let normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        for &corner in face {
            if let Some(sum) = sums.get_mut(corner as usize) {
                *sum = [0, 1, 2].map(|k| sum[k] + normal[k]);
            }
        }
    }
    let unit = |sum: &[f64; 3]| {
        let length = sum.iter().map(|x| x * x).sum::<f64>().sqrt();
        if length > 0.0 && length.is_finite() { sum.map(|x| (x / length) as f32) } else { [0.0, 0.0, 1.0] }
    };
    sums.iter().map(unit).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::icosphere;

    fn chunks(file: &[u8]) -> (String, Vec<u8>) {
        let number = |at: usize| u32::from_le_bytes(file[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!((&file[..4], number(4), number(8)), (&b"glTF"[..], 2, file.len()));
        let json = number(12);
        assert_eq!((&file[16..20], json % 4, number(20 + json) % 4), (&b"JSON"[..], 0, 0));
        assert_eq!(&file[24 + json..28 + json], b"BIN\0");
        (String::from_utf8(file[20..20 + json].to_vec()).unwrap(), file[28 + json..].to_vec())
    }

    #[test]
    fn normals_are_those_of_the_triangles_around() {
        let mut mesh = icosphere(3);
        for (normal, vertex) in normals(&mesh).iter().zip(&mesh.vertices) {
            assert!((0..3).all(|k| (f64::from(normal[k]) - vertex[k]).abs() < 0.03), "{normal:?} {vertex:?}");
        }
        // A vertex that belongs to no triangle gets the normal (0, 0, 1).
        mesh.vertices.push([5.0; 3]);
        assert_eq!(normals(&mesh).last(), Some(&[0.0, 0.0, 1.0]));
    }

    #[test]
    fn chunks_hold_what_they_say() {
        let mesh = icosphere(1);
        let values: Vec<f64> = (0..42).map(f64::from).collect();
        let attributes = PlyAttributes { scalar: Some(("distance", &values)), colors: Some(&[[255, 0, 128]; 42]) };
        let mut file = Vec::new();
        write(&mut file, &mesh, &attributes).unwrap();
        let (json, bytes) = chunks(&file);
        for part in
            ["\"POSITION\":0", "\"NORMAL\":1", "\"COLOR_0\":2", "\"_DISTANCE\":3", "\"indices\":4", "\"count\":240"]
        {
            assert!(json.contains(part), "{part}: {json}");
        }
        assert_eq!(bytes.len(), 42 * (12 + 12 + 8 + 4) + 240 * 4);
        let x = f32::from_le_bytes(bytes[..4].try_into().unwrap());
        assert_eq!(x, mesh.vertices[0][0] as f32);
        // The normals of a unit sphere equal its positions.
        let normal = f32::from_le_bytes(bytes[42 * 12..42 * 12 + 4].try_into().unwrap());
        assert!((normal - x).abs() < 0.05, "{normal} {x}");
        let colour: Vec<u16> =
            bytes[42 * 24..42 * 24 + 8].as_chunks().0.iter().map(|&b| u16::from_le_bytes(b)).collect();
        assert_eq!(colour, [65535, 0, 14146, 65535]);
    }
}
