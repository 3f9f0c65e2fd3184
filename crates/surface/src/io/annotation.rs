//! Reads annotations, which divide a surface into named regions: FreeSurfer's `lh.aparc.annot`, and GIfTI labels.
//!
//! In an `.annot` file, all numbers are big-endian i32. The file has the number of vertices, then the index of each
//! vertex and the colour of its region, then a table of the regions' colours and names. The table comes in an older and
//! a newer version (see FreeSurfer's `read_annotation.m`). The colour of a vertex is stored as red + 2^8 green + 2^16
//! blue. The fourth number of a colour in the table, its transparency, isn't part of this value.

use std::collections::HashMap;
use std::path::Path;

use super::bytes::{Cursor, Endian};
use super::flaw::{Flaw, bounded};
use super::{gifti, load};
use crate::error::SurfaceError;

/// Parts of names that mark regions outside the cortex, in lower case and with _ in place of other separators. They
/// cover aparc, a2009s, and atlases such as Yeo's and Schaefer's (`Background+FreeSurfer_Defined_Medial_Wall`).
const OUTSIDE: [&str; 5] = ["unknown", "medial_wall", "medialwall", "corpuscallosum", "background"];

/// The region of each vertex of a surface.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Annotation {
    /// Names of the regions.
    pub names: Vec<String>,
    /// Index into `names` of each vertex's region, or `None` for a vertex without a region.
    pub regions: Vec<Option<usize>>,
}

impl Annotation {
    /// Returns the name of a vertex's region, if it has one.
    #[must_use]
    pub fn name_at(&self, vertex: usize) -> Option<&str> {
        self.regions.get(vertex).copied().flatten().and_then(|region| self.names.get(region)).map(String::as_str)
    }

    /// Returns, for each vertex, whether it belongs to a region of the cortex. Regions called unknown or medial wall
    /// don't belong to the cortex.
    #[must_use]
    pub fn is_cortex(&self) -> Vec<bool> {
        let inside: Vec<bool> = self.names.iter().map(|name| is_region(name)).collect();
        self.regions.iter().map(|region| region.is_some_and(|region| inside[region])).collect()
    }
}

/// Returns whether a name denotes a region of the cortex.
pub(super) fn is_region(name: &str) -> bool {
    let name = name.trim().to_lowercase().replace([' ', '-', '.'], "_");
    !name.is_empty() && name != "???" && !OUTSIDE.iter().any(|part| name.contains(part))
}

/// Returns whether a file's name marks it as a FreeSurfer annotation, by the extension .annot.
pub(super) fn is_annotation(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("annot"))
}

/// Reads an annotation of a surface with `vertices` vertices, from an `.annot` file or a GIfTI label file.
///
/// # Errors
///
/// [`Io`](SurfaceError::Io) if the file can't be read; [`Malformed`](SurfaceError::Malformed) if it has neither format,
/// or no table of names; [`VertexCount`](SurfaceError::VertexCount) if the annotation doesn't have `vertices` vertices.
pub fn read_annotation(path: impl AsRef<Path>, vertices: usize) -> Result<Annotation, SurfaceError> {
    let path = path.as_ref();
    let bytes = load::load(path)?;
    let found = if is_annotation(path) {
        parse(&bytes).map_err(|flaw| flaw.at(path, "a FreeSurfer annotation"))?
    } else {
        let (labels, values) = gifti::read_labels(&bytes).map_err(|flaw| flaw.at(path, "a GIfTI label file"))?;
        let keys = values.into_iter().map(|value| (value.fract() == 0.0).then_some(value as i64));
        named(keys, labels)
    };
    if found.regions.len() != vertices {
        let (path, found) = (path.to_owned(), found.regions.len());
        return Err(SurfaceError::VertexCount { path, sphere: None, expected: vertices, found });
    }
    Ok(found)
}

/// Returns the annotation for vertices with the given region keys. If several regions have the same key, the first of
/// them is used.
fn named(keys: impl Iterator<Item = Option<i64>>, table: Vec<(i64, String)>) -> Annotation {
    let mut places: HashMap<i64, usize> = HashMap::new();
    let mut names = Vec::with_capacity(table.len());
    for (key, name) in table {
        places.entry(key).or_insert(names.len());
        names.push(name);
    }
    let regions = keys.map(|key| places.get(&key?).copied()).collect();
    Annotation { names, regions }
}

fn parse(bytes: &[u8]) -> Result<Annotation, Flaw> {
    let mut cursor = Cursor::new(bytes);
    let count = whole(&mut cursor, "a number of vertices")?;
    let count = bounded(count, 8, cursor.remaining(), "vertices")?;
    let mut colours = vec![None; count];
    for _ in 0..count {
        let (vertex, colour) = (cursor.i32(Endian::Big)?, cursor.i32(Endian::Big)?);
        match usize::try_from(vertex).ok().and_then(|vertex| colours.get_mut(vertex)) {
            Some(place) => *place = Some(i64::from(colour)),
            None => return Err(Flaw::new(format!("vertex numbers below {count}"), vertex.to_string())),
        }
    }
    if cursor.remaining() == 0 || cursor.i32(Endian::Big)? == 0 {
        return Err(Flaw::new("a table of colours and names", "none"));
    }
    Ok(named(colours.into_iter(), table(&mut cursor)?))
}

/// Reads the table of the regions' colours and names.
fn table(cursor: &mut Cursor<'_>) -> Result<Vec<(i64, String)>, Flaw> {
    let first = cursor.i32(Endian::Big)?;
    let numbered = first < 0;
    if numbered && first != -2 {
        return Err(Flaw::new("a colour table of version 2", format!("version {}", -i64::from(first))));
    }
    // The newer version begins with the largest region number, followed by the name of the file from which the table
    // was read, and then the number of regions.
    let mut count = if numbered { whole(cursor, "a number of regions")? } else { u64::from(first.unsigned_abs()) };
    text(cursor)?;
    if numbered {
        count = whole(cursor, "a number of regions")?;
    }
    let count = bounded(count, 20, cursor.remaining(), "regions")?;
    let mut table = Vec::with_capacity(count);
    for _ in 0..count {
        if numbered {
            whole(cursor, "a region number")?;
        }
        let name = text(cursor)?;
        let mut colour = 0;
        for shift in [0, 8, 16] {
            colour |= i64::from(cursor.i32(Endian::Big)?) << shift;
        }
        cursor.i32(Endian::Big)?;
        table.push((colour, name));
    }
    Ok(table)
}

fn whole(cursor: &mut Cursor<'_>, what: &str) -> Result<u64, Flaw> {
    let found = cursor.i32(Endian::Big)?;
    u64::try_from(found).map_err(|_| Flaw::new(what, found.to_string()))
}

/// Reads a string that is preceded by its length and terminated by a zero byte.
fn text(cursor: &mut Cursor<'_>) -> Result<String, Flaw> {
    let length = whole(cursor, "the length of a name")?;
    let length = bounded(length, 1, cursor.remaining(), "bytes of a name")?;
    let bytes = cursor.take(length)?;
    let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(length);
    Ok(String::from_utf8_lossy(&bytes[..end]).trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn put(bytes: &mut Vec<u8>, numbers: &[i32]) {
        bytes.extend(numbers.iter().flat_map(|number| number.to_be_bytes()));
    }

    fn name(bytes: &mut Vec<u8>, name: &str) {
        put(bytes, &[name.len() as i32 + 1]);
        bytes.extend(name.bytes().chain([0]));
    }

    /// Returns an annotation file of four vertices: three in one region each, and one in no region.
    fn annotation(numbered: bool) -> Vec<u8> {
        let mut bytes = Vec::new();
        let colour = |[r, g, b]: [i32; 3]| r + (g << 8) + (b << 16);
        let regions = [("unknown", [25, 5, 25]), ("cuneus", [220, 20, 100]), ("insula", [255, 192, 32])];
        put(&mut bytes, &[4, 0, colour(regions[1].1), 2, colour(regions[2].1), 1, colour(regions[0].1), 3, 77, 1]);
        if numbered {
            put(&mut bytes, &[-2, 36]);
        } else {
            put(&mut bytes, &[3]);
        }
        name(&mut bytes, "aparc.ctab");
        if numbered {
            put(&mut bytes, &[3]);
        }
        for (index, (of, [r, g, b])) in regions.into_iter().enumerate() {
            if numbered {
                put(&mut bytes, &[index as i32]);
            }
            name(&mut bytes, of);
            put(&mut bytes, &[r, g, b, 0]);
        }
        bytes
    }

    #[test]
    fn both_versions_of_annotations_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lh.aparc.annot");
        for numbered in [false, true] {
            std::fs::write(&path, annotation(numbered)).unwrap();
            let found = read_annotation(&path, 4).unwrap();
            let names: Vec<Option<&str>> = (0..4).map(|vertex| found.name_at(vertex)).collect();
            assert_eq!(names, [Some("cuneus"), Some("unknown"), Some("insula"), None]);
            assert_eq!(found.is_cortex(), [true, false, true, false]);
            assert!(matches!(read_annotation(&path, 5), Err(SurfaceError::VertexCount { expected: 5, found: 4, .. })));
            let whole = annotation(numbered);
            for length in 0..whole.len() {
                std::fs::write(&path, &whole[..length]).unwrap();
                assert!(matches!(read_annotation(&path, 4), Err(SurfaceError::Malformed { .. })), "{length}");
            }
        }
        std::fs::write(&path, [1_i32, 7, 0].map(i32::to_be_bytes).as_flattened()).unwrap();
        let error = read_annotation(&path, 1).unwrap_err().to_string();
        assert!(error.contains("vertex numbers below 1, found 7"), "{error}");
    }

    #[test]
    fn regions_outside_of_the_cortex_have_many_names() {
        for name in
            ["", "???", "Unknown", "Medial_wall", "Background+FreeSurfer_Defined_Medial_Wall", "ctx-lh-corpuscallosum"]
        {
            assert!(!is_region(name), "{name}");
        }
        assert!(is_region("medialorbitofrontal") && is_region("L_V1_ROI"));
    }

    #[test]
    fn labels_of_gifti_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lh.label.gii");
        let text = "<GIFTI Version=\"1.0\" NumberOfDataArrays=\"1\"><LabelTable>\
                    <Label Key=\"0\" Red=\"0\">???</Label><Label Key=\"5\">Visual &amp; more</Label></LabelTable>\
                    <DataArray Intent=\"NIFTI_INTENT_LABEL\" DataType=\"NIFTI_TYPE_INT32\" Dimensionality=\"1\" Dim0=\"3\" \
                    Encoding=\"ASCII\" ArrayIndexingOrder=\"RowMajorOrder\"><Data>5 0 7</Data></DataArray></GIFTI>";
        std::fs::write(&path, text).unwrap();
        let found = read_annotation(&path, 3).unwrap();
        assert_eq!(found.name_at(0), Some("Visual & more"));
        assert_eq!((found.name_at(1), found.name_at(2)), (Some("???"), None));
        std::fs::write(&path, text.replace("<Label ", "<Other ").replace("</Label>", "</Other>")).unwrap();
        let error = read_annotation(&path, 3).unwrap_err().to_string();
        assert!(error.contains("a LabelTable with names"), "{error}");
    }
}
