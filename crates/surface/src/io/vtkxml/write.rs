//! Writes PolyData (`.vtp`) with 64-bit positions, compressed by zlib, in base64 within the XML. Raw data after the XML
//! would be smaller, but the file would no longer be well-formed XML.

use std::io::{self, Write};

use base64::engine::general_purpose::STANDARD;
use base64::write::EncoderWriter;
use flate2::Compression;
use flate2::write::ZlibEncoder;

use crate::mesh::Mesh;

/// Number of bytes in a block. Each block is compressed separately.
const BLOCK: usize = 1 << 20;

/// Writes a mesh. `scalar` gives the name and values of an attribute, one value per vertex.
pub(in crate::io) fn write(out: &mut dyn Write, mesh: &Mesh, scalar: Option<(&str, &[f64])>) -> io::Result<()> {
    let (points, polys) = (mesh.vertices.len(), mesh.faces.len());
    writeln!(out, r#"<?xml version="1.0"?>"#)?;
    write!(out, r#"<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64" "#)?;
    writeln!(out, r#"compressor="vtkZLibDataCompressor">"#)?;
    writeln!(out, "<PolyData>")?;
    write!(out, r#"<Piece NumberOfPoints="{points}" NumberOfVerts="0" NumberOfLines="0" NumberOfStrips="0" "#)?;
    writeln!(out, r#"NumberOfPolys="{polys}">"#)?;
    if let Some((name, values)) = scalar {
        writeln!(out, r#"<PointData Scalars="{name}">"#)?;
        array(out, "Float64", name, 1, values.iter().map(|x| x.to_le_bytes()))?;
        writeln!(out, "</PointData>")?;
    }
    writeln!(out, "<Points>")?;
    array(out, "Float64", "Points", 3, mesh.vertices.as_flattened().iter().map(|x| x.to_le_bytes()))?;
    writeln!(out, "</Points>")?;
    writeln!(out, "<Polys>")?;
    let corners = mesh.faces.as_flattened().iter().map(|&corner| i64::from(corner).to_le_bytes());
    array(out, "Int64", "connectivity", 1, corners)?;
    array(out, "Int64", "offsets", 1, (1..=polys as i64).map(|face| (3 * face).to_le_bytes()))?;
    writeln!(out, "</Polys>")?;
    writeln!(out, "</Piece>")?;
    writeln!(out, "</PolyData>")?;
    writeln!(out, "</VTKFile>")
}

/// Writes an array of 8-byte numbers.
fn array(
    out: &mut dyn Write,
    kind: &str,
    name: &str,
    components: usize,
    mut numbers: impl Iterator<Item = [u8; 8]>,
) -> io::Result<()> {
    // The header precedes the data and contains the compressed size of every block, so all compressed blocks are kept
    // in memory until the header has been written.
    let (mut packed, mut sizes, mut last) = (Vec::new(), Vec::new(), 0);
    loop {
        let mut encoder = ZlibEncoder::new(&mut packed, Compression::default());
        let mut raw = io::BufWriter::with_capacity(1 << 15, &mut encoder);
        let mut count = 0;
        for number in numbers.by_ref().take(BLOCK / 8) {
            raw.write_all(&number)?;
            count += 8;
        }
        raw.flush()?;
        drop(raw);
        let start: u64 = sizes.iter().sum();
        encoder.finish()?;
        if count == 0 {
            packed.truncate(start as usize);
            break;
        }
        sizes.push(packed.len() as u64 - start);
        last = count as u64;
        if count < BLOCK {
            break;
        }
    }
    let partial = if last < BLOCK as u64 { last } else { 0 };
    let head: Vec<u64> = [sizes.len() as u64, BLOCK as u64, partial].into_iter().chain(sizes).collect();
    writeln!(out, r#"<DataArray type="{kind}" Name="{name}" NumberOfComponents="{components}" format="binary">"#)?;
    for bytes in [head.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>(), packed] {
        let mut text = EncoderWriter::new(&mut *out, &STANDARD);
        text.write_all(&bytes)?;
        text.finish()?;
    }
    writeln!(out, "\n</DataArray>")
}
