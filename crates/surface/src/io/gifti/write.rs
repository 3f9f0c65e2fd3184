//! Writes GIfTI files with GZipBase64Binary, little-endian, row-major data, which every reader accepts.

use std::io::{self, Write};

use base64::engine::general_purpose::STANDARD;
use base64::write::EncoderWriter;
use flate2::Compression;
use flate2::write::ZlibEncoder;

use super::names::{NONE, POINTSET, SHAPE, STRUCTURE, TRIANGLE, UNKNOWN_SPACE};
use crate::io::choose::without_ending;
use crate::io::spec::Context;
use crate::mesh::{CoordinateSystem, Mesh, Meta, Signal};
use crate::volume_geometry::VolumeGeometry;

/// Writes a surface.
pub(in crate::io) fn write_mesh(out: &mut dyn Write, mesh: &Mesh, context: &Context<'_>) -> io::Result<()> {
    open(out, 2, &mesh.meta.file_metadata)?;
    let unknown = CoordinateSystem {
        data_space: UNKNOWN_SPACE.to_owned(),
        transformed_space: UNKNOWN_SPACE.to_owned(),
        matrix: std::array::from_fn(|i| if i % 5 == 0 { 1.0 } else { 0.0 }),
    };
    let array = Heading {
        intent: POINTSET,
        data_type: float_type(context.double),
        dimensions: &[mesh.vertices.len(), 3],
        metadata: &gifti_metadata(&mesh.meta),
        system: Some(mesh.meta.coordinate_system.as_ref().unwrap_or(&unknown)),
    };
    let positions = mesh.vertices.as_flattened();
    array.write(out, |data| write_floats(data, positions.iter().copied(), context.double))?;

    let array = Heading {
        intent: TRIANGLE,
        data_type: "NIFTI_TYPE_INT32",
        dimensions: &[mesh.faces.len(), 3],
        metadata: &[],
        system: None,
    };
    array.write(out, |data| {
        for &index in mesh.faces.as_flattened() {
            let index = i32::try_from(index).map_err(|_| {
                io::Error::other("GIfTI files hold only indices below 2^31; write the surface as .ply instead")
            })?;
            data.write_all(&index.to_le_bytes())?;
        }
        Ok(())
    })?;
    writeln!(out, "</GIFTI>")
}

/// Returns the metadata of a mesh's point set in a GIfTI file, as pairs (name, value). They contain the anatomical
/// structure, `surface_metadata` and, for a mesh from a FreeSurfer file, the geometry of its volume.
#[must_use]
pub fn gifti_metadata(meta: &Meta) -> Vec<(String, String)> {
    let mut metadata = Vec::new();
    if let Some(structure) = &meta.anatomical_structure_primary {
        metadata.push((STRUCTURE.to_owned(), structure.clone()));
    }
    metadata.extend_from_slice(&meta.surface_metadata);
    let known = metadata.iter().chain(&meta.file_metadata).any(|(name, _)| name.starts_with("VolGeom"));
    if let (false, Some(geometry)) = (known, VolumeGeometry::of(meta)) {
        metadata.extend(geometry.to_metadata());
    }
    metadata
}

/// Writes a signal with one array per channel, like Workbench's metric files.
pub(in crate::io) fn write_signal(out: &mut dyn Write, signal: &Signal, context: &Context<'_>) -> io::Result<()> {
    let structure = context.structure.map(|structure| (STRUCTURE.to_owned(), structure.to_owned()));
    open(out, signal.channels, structure.as_slice())?;
    let name = without_ending(context.name, ".gii").unwrap_or(context.name);
    let of_shape = without_ending(name, ".shape");
    let intent = if of_shape.is_some() { SHAPE } else { NONE };
    let name = of_shape.or_else(|| without_ending(name, ".func")).unwrap_or(name);
    for channel in 0..signal.channels {
        let number = if signal.channels > 1 { format!(" {}", channel + 1) } else { String::new() };
        let array = Heading {
            intent,
            data_type: float_type(context.double),
            dimensions: &[signal.vertices],
            // Workbench and FreeView show this name in their lists of maps.
            metadata: &[("Name".to_owned(), format!("{name}{number}"))],
            system: None,
        };
        let column = signal.values.iter().skip(channel).step_by(signal.channels).copied();
        array.write(out, |data| write_floats(data, column, context.double))?;
    }
    writeln!(out, "</GIFTI>")
}

fn float_type(double: bool) -> &'static str {
    if double { "NIFTI_TYPE_FLOAT64" } else { "NIFTI_TYPE_FLOAT32" }
}

fn write_floats(out: &mut dyn Write, values: impl Iterator<Item = f64>, double: bool) -> io::Result<()> {
    for x in values {
        if double {
            out.write_all(&x.to_le_bytes())?;
        } else {
            out.write_all(&(x as f32).to_le_bytes())?;
        }
    }
    Ok(())
}

fn open(out: &mut dyn Write, arrays: usize, metadata: &[(String, String)]) -> io::Result<()> {
    writeln!(out, r#"<?xml version="1.0" encoding="UTF-8"?>"#)?;
    // The line is copied verbatim from the standard, because some readers require exactly this line.
    writeln!(out, r#"<!DOCTYPE GIFTI SYSTEM "http://www.nitrc.org/frs/download.php/115/gifti.dtd">"#)?;
    writeln!(out, r#"<GIFTI Version="1.0" NumberOfDataArrays="{arrays}">"#)?;
    write_metadata(out, metadata)?;
    writeln!(out, "<LabelTable/>")
}

fn write_metadata(out: &mut dyn Write, metadata: &[(String, String)]) -> io::Result<()> {
    writeln!(out, "<MetaData>")?;
    for (name, value) in metadata {
        let (name, value) = (escaped(name), escaped(value));
        writeln!(out, "<MD><Name>{name}</Name><Value>{value}</Value></MD>")?;
    }
    writeln!(out, "</MetaData>")
}

/// Returns text escaped for XML 1.0. Most control characters, which XML 1.0 can't represent, are replaced by spaces.
fn escaped(text: &str) -> String {
    let printable: String =
        text.chars().map(|c| if c.is_control() && !matches!(c, '\t' | '\n' | '\r') { ' ' } else { c }).collect();
    quick_xml::escape::escape(printable).into_owned()
}

struct Heading<'a> {
    intent: &'a str,
    data_type: &'a str,
    dimensions: &'a [usize],
    metadata: &'a [(String, String)],
    system: Option<&'a CoordinateSystem>,
}

impl Heading<'_> {
    /// Writes a DataArray element. `data` writes the array's numbers as little-endian bytes.
    fn write(&self, out: &mut dyn Write, data: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
        let (intent, data_type) = (self.intent, self.data_type);
        write!(out, r#"<DataArray Intent="{intent}" DataType="{data_type}" ArrayIndexingOrder="RowMajorOrder" "#)?;
        write!(out, r#"Dimensionality="{}" "#, self.dimensions.len())?;
        for (i, size) in self.dimensions.iter().enumerate() {
            write!(out, r#"Dim{i}="{size}" "#)?;
        }
        writeln!(
            out,
            r#"Encoding="GZipBase64Binary" Endian="LittleEndian" ExternalFileName="" ExternalFileOffset="">"#
        )?;
        write_metadata(out, self.metadata)?;
        if let Some(system) = self.system {
            let (from, to) = (escaped(&system.data_space), escaped(&system.transformed_space));
            writeln!(out, "<CoordinateSystemTransformMatrix>")?;
            writeln!(out, "<DataSpace>{from}</DataSpace>")?;
            writeln!(out, "<TransformedSpace>{to}</TransformedSpace>")?;
            // Each row of the matrix is on its own line, because nibabel infers the shape of the matrix from the lines.
            let rows =
                system.matrix.chunks(4).map(|row| row.iter().map(|x| format!("{x:?}")).collect::<Vec<_>>().join(" "));
            writeln!(out, "<MatrixData>{}</MatrixData>", rows.collect::<Vec<_>>().join("\n"))?;
            writeln!(out, "</CoordinateSystemTransformMatrix>")?;
        }
        write!(out, "<Data>")?;
        let text = EncoderWriter::new(&mut *out, &STANDARD);
        let mut packed = ZlibEncoder::new(io::BufWriter::with_capacity(1 << 15, text), Compression::default());
        {
            let mut raw = io::BufWriter::with_capacity(1 << 15, &mut packed);
            data(&mut raw)?;
            raw.flush()?;
        }
        let mut text = packed.finish()?.into_inner().map_err(io::IntoInnerError::into_error)?;
        text.finish()?;
        drop(text);
        writeln!(out, "</Data>")?;
        writeln!(out, "</DataArray>")
    }
}
