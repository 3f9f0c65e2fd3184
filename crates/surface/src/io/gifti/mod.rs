//! Reads and writes GIfTI, the neuroimaging community's XML format. A surface consists of a `NIFTI_INTENT_POINTSET` and
//! a `NIFTI_INTENT_TRIANGLE` array. Arrays with other intents form a signal, with one channel per column.
//!
//! Source: GIFTI Surface Data Format, version 1.0 (2010). No maintained crate reads the format, so this module does:
//! `xml` parses the document (with quick-xml), `data` decodes an array (with base64 and flate2), and `write` writes
//! files.

mod data;
mod names;
mod write;
mod xml;

use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use spharm_files::open;

use super::flaw::{Flaw, shown};
use super::scalar::index;
use crate::mesh::{Input, Mesh, Meta, Signal};
use data::Array;
use names::{POINTSET, STRUCTURE, TRIANGLE};
pub use write::gifti_metadata;
pub(super) use write::{write_mesh, write_signal};
use xml::{DataArray, Document};

/// Reads a surface or a signal.
pub(super) fn read(bytes: &[u8]) -> Result<Input, Flaw> {
    // The standard requires UTF-8. Invalid bytes are replaced instead of rejected, because only names and other strings
    // can contain invalid bytes.
    interpret(xml::parse(&String::from_utf8_lossy(bytes))?)
}

/// Largest number of bytes in which [`read_gifti_metadata`] looks for the first DataArray.
const MOST_HEAD: u64 = 1 << 20;

/// Returns the metadata of a GIfTI file, as pairs (name, value), without reading its arrays. Returns `None` if the file
/// can't be read, is compressed, isn't GIfTI, or has no array within the first MiB.
#[must_use]
pub fn read_gifti_metadata(path: impl AsRef<Path>) -> Option<Vec<(String, String)>> {
    let mut head = String::new();
    for line in BufReader::new(open(path).ok()?.take(MOST_HEAD)).split(b'\n') {
        let line = line.ok()?;
        let line = String::from_utf8_lossy(&line);
        if let Some((before, _)) = line.split_once("<DataArray") {
            // Close the root element, so that the text before the first array is a complete document.
            let document = format!("{head}{before}</GIFTI>");
            return Some(xml::parse(&document).ok()?.metadata);
        }
        head.push_str(&line);
        head.push('\n');
    }
    None
}

/// Intent of arrays of labels.
const LABEL: &str = "NIFTI_INTENT_LABEL";

/// The keys and names of a file's labels.
pub(super) type LabelTable = Vec<(i64, String)>;

/// Reads the LabelTable of a file and the label of each vertex.
pub(super) fn read_labels(bytes: &[u8]) -> Result<(LabelTable, Vec<f64>), Flaw> {
    let document = xml::parse(&String::from_utf8_lossy(bytes))?;
    if document.labels.is_empty() {
        return Err(Flaw::new("a LabelTable with names", "none"));
    }
    if let Some(other) = document.arrays.iter().find(|array| array.intent != LABEL) {
        return Err(Flaw::new(format!("an array of {LABEL}"), shown(other.intent.as_bytes())));
    }
    let signal = to_signal(document.arrays)?;
    if signal.channels != 1 {
        return Err(Flaw::new("one label per vertex", format!("{} per vertex", signal.channels)));
    }
    Ok((document.labels, signal.values))
}

fn interpret(mut document: Document) -> Result<Input, Flaw> {
    if document.arrays.is_empty() {
        return Err(Flaw::new("at least one DataArray", "none"));
    }
    let points = position_of(&document.arrays, POINTSET)?;
    let triangles = position_of(&document.arrays, TRIANGLE)?;
    match (points, triangles) {
        (Some(p), Some(t)) => {
            let point_array = document.arrays.get_mut(p).map(std::mem::take).unwrap_or_default();
            let triangle_array = document.arrays.get_mut(t).map(std::mem::take).unwrap_or_default();
            let vertices = to_positions(point_array.values)?;
            let faces = to_triangles(triangle_array.values)?;
            let mut meta = Meta {
                file_metadata: document.metadata,
                surface_metadata: point_array.metadata,
                coordinate_system: point_array.coordinate_system,
                ..Meta::default()
            };
            // The anatomical structure belongs to the point set, but some programs write it to the file's metadata.
            meta.anatomical_structure_primary =
                take(&mut meta.surface_metadata, STRUCTURE).or_else(|| take(&mut meta.file_metadata, STRUCTURE));
            Ok(Input::Mesh(Mesh { vertices, faces, meta }))
        }
        (Some(_), None) => Err(Flaw::new(format!("a {TRIANGLE} array in addition to the {POINTSET} array"), "none")),
        (None, Some(_)) => Err(Flaw::new(format!("a {POINTSET} array in addition to the {TRIANGLE} array"), "none")),
        (None, None) => to_signal(document.arrays).map(Input::Signal),
    }
}

fn position_of(arrays: &[DataArray], intent: &str) -> Result<Option<usize>, Flaw> {
    let mut found = arrays.iter().enumerate().filter(|(_, a)| a.intent == intent).map(|(i, _)| i);
    let first = found.next();
    match found.count() {
        0 => Ok(first),
        more => Err(Flaw::unsupported(
            format!("{} {intent} arrays", more + 1),
            "split the file into files with one surface each",
        )),
    }
}

fn take(metadata: &mut Vec<(String, String)>, name: &str) -> Option<String> {
    let at = metadata.iter().position(|(n, _)| n == name)?;
    Some(metadata.remove(at).1)
}

fn rows_of_three(array: Array, intent: &str) -> Result<Vec<f64>, Flaw> {
    if array.columns != 3 {
        return Err(Flaw::new(
            format!("a {intent} array of n x 3 values"),
            format!("{} x {}", array.rows, array.columns),
        ));
    }
    Ok(array.values)
}

fn to_positions(array: Array) -> Result<Vec<[f64; 3]>, Flaw> {
    let values = rows_of_three(array, POINTSET)?;
    Ok(values.as_chunks().0.to_vec())
}

fn to_triangles(array: Array) -> Result<Vec<[u32; 3]>, Flaw> {
    let values = rows_of_three(array, TRIANGLE)?;
    let (triangles, _) = values.as_chunks::<3>();
    triangles.iter().map(|&[a, b, c]| Ok([index(a)?, index(b)?, index(c)?])).collect()
}

/// Joins all arrays side by side as channels. A time series has one array per frame, and a matrix is a single array.
fn to_signal(arrays: Vec<DataArray>) -> Result<Signal, Flaw> {
    let arrays: Vec<Array> = arrays.into_iter().map(|a| a.values).collect();
    let vertices = arrays.first().map_or(0, |a| a.rows);
    for (i, array) in arrays.iter().enumerate() {
        if array.rows != vertices {
            return Err(Flaw::new(
                format!("arrays of {vertices} values each, as in the first array"),
                format!("{} values in array {i} (counted from 0)", array.rows),
            ));
        }
    }
    // The sum of the columns can't overflow, since the values of all columns are already in memory.
    let channels = arrays.iter().map(|a| a.columns).sum();
    if let [array] = arrays.as_slice() {
        return Ok(Signal::new(array.values.clone(), vertices, channels));
    }
    let mut values = Vec::with_capacity(arrays.iter().map(|a| a.values.len()).sum());
    for row in 0..vertices {
        for array in &arrays {
            let start = row * array.columns;
            values.extend_from_slice(array.values.get(start..start + array.columns).unwrap_or_default());
        }
    }
    Ok(Signal::new(values, vertices, channels))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::icosphere;
    use crate::io::{WriteOptions, write_mesh};

    #[test]
    fn metadata_are_read_without_the_arrays() {
        let folder = tempfile::tempdir().unwrap();
        let (path, packed) = (folder.path().join("a.surf.gii"), folder.path().join("a.surf.gii.gz"));
        let mut mesh = icosphere(0);
        let pairs = vec![("Note".to_owned(), "two\nlines & <DataArray>".to_owned()), ("Id".to_owned(), "7".to_owned())];
        mesh.meta.file_metadata.clone_from(&pairs);
        write_mesh(&path, &mesh, &WriteOptions::default()).unwrap();
        write_mesh(&packed, &mesh, &WriteOptions::default()).unwrap();
        assert_eq!(read_gifti_metadata(&path), Some(pairs));
        assert_eq!(read_gifti_metadata(&packed), None);
        std::fs::write(&path, "<DataArray").unwrap();
        assert_eq!(read_gifti_metadata(&path), None);
    }
}
