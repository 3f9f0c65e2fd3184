//! Writes an archive with one object. Equal meshes give identical bytes.

use std::io::{self, BufWriter, Cursor, Write};

use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use super::names::{MODEL, MODEL_TYPE, RELATIONSHIPS};
use crate::mesh::Mesh;

const DECLARATION: &str = r#"<?xml version="1.0" encoding="UTF-8"?>"#;
const CONTENT_TYPES: &str = r#"<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types"><Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/><Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>"#;
const RELATIONSHIP_SPACE: &str = "http://schemas.openxmlformats.org/package/2006/relationships";
const CORE_SPACE: &str = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02";

/// Writes positions, in digits that read back exactly, and triangles. The model's unit is the millimetre, 3MF's
/// default.
pub(in crate::io) fn write(out: &mut dyn Write, mesh: &Mesh) -> io::Result<()> {
    if mesh.vertices.len() > i32::MAX as usize {
        return Err(io::Error::other("3MF files hold only indices below 2^31; write the surface as .ply instead"));
    }
    // The archive is completed in memory before it is written. In a streamed archive, the sizes of the parts would
    // follow their data, and some programs reject such archives.
    let mut archive = Cursor::new(Vec::new());
    let mut zip = ZipWriter::new(&mut archive);
    // A vertex takes less than 100 bytes of text, a triangle less than 64.
    let is_large = mesh.vertices.len() * 100 + mesh.faces.len() * 64 > u32::MAX as usize;
    let options = SimpleFileOptions::default().compression_method(CompressionMethod::Deflated).large_file(is_large);
    let start = |zip: &mut ZipWriter<_>, path: &str| zip.start_file(path, options).map_err(io::Error::other);
    start(&mut zip, "[Content_Types].xml")?;
    write!(zip, "{DECLARATION}\n{CONTENT_TYPES}")?;
    start(&mut zip, RELATIONSHIPS)?;
    write!(zip, "{DECLARATION}\n<Relationships xmlns=\"{RELATIONSHIP_SPACE}\"><Relationship Id=\"model\" ")?;
    write!(zip, "Target=\"/{MODEL}\" Type=\"{MODEL_TYPE}\"/></Relationships>")?;
    start(&mut zip, MODEL)?;
    let mut text = BufWriter::with_capacity(1 << 15, &mut zip);
    write_model(&mut text, mesh)?;
    text.flush()?;
    drop(text);
    zip.finish().map_err(io::Error::other)?;
    out.write_all(archive.get_ref())
}

fn write_model(out: &mut dyn Write, mesh: &Mesh) -> io::Result<()> {
    writeln!(out, "{DECLARATION}\n<model unit=\"millimeter\" xml:lang=\"en-US\" xmlns=\"{CORE_SPACE}\">")?;
    writeln!(out, "<resources>\n<object id=\"1\" type=\"model\">\n<mesh>\n<vertices>")?;
    for [x, y, z] in &mesh.vertices {
        writeln!(out, r#"<vertex x="{x:?}" y="{y:?}" z="{z:?}"/>"#)?;
    }
    writeln!(out, "</vertices>\n<triangles>")?;
    for [a, b, c] in &mesh.faces {
        writeln!(out, r#"<triangle v1="{a}" v2="{b}" v3="{c}"/>"#)?;
    }
    writeln!(out, "</triangles>\n</mesh>\n</object>\n</resources>\n<build>\n<item objectid=\"1\"/>\n</build>\n</model>")
}
