//! Reads masks, which select the vertices to use.
//!
//! A mask is given by a file of values on vertices, by a FreeSurfer label (`lh.cortex.label`), or by an annotation
//! (`lh.aparc.annot`). In a file of values, 0 marks excluded vertices. An annotation selects all its regions except
//! unknown and the medial wall. A label file is text. It has a comment line, the number of vertices, and one line per
//! selected vertex with its index, position and value.

use std::path::Path;

use super::annotation::{is_annotation, is_region, read_annotation};
use super::flaw::{Flaw, bounded, shown};
use super::text::{lines, next_number, number, words};
use super::{load, read_signal};
use crate::error::SurfaceError;

/// First bytes of a FreeSurfer label.
const LABEL: &[u8] = b"#!ascii label";

/// Reads a mask for `vertices` vertices. An element of the result is true if the vertex is selected.
///
/// # Errors
///
/// The errors of [`read_signal`]; [`VertexCount`](SurfaceError::VertexCount) if the file doesn't have `vertices`
/// vertices; [`Malformed`](SurfaceError::Malformed) if it has more than one value per vertex, or is a label with an
/// index out of range; [`NothingKept`](SurfaceError::NothingKept) if no vertex is selected.
pub fn read_mask(path: impl AsRef<Path>, vertices: usize) -> Result<Vec<bool>, SurfaceError> {
    let path = path.as_ref();
    let mask = if load::head(path)?.starts_with(LABEL) {
        label(&load::load(path)?, vertices).map_err(|flaw| flaw.at(path, "a FreeSurfer label"))?
    } else if is_annotation(path) {
        read_annotation(path, vertices)?.is_cortex()
    } else {
        let signal = read_signal(path)?;
        if signal.vertices != vertices {
            let (path, found) = (path.to_owned(), signal.vertices);
            return Err(SurfaceError::VertexCount { path, sphere: None, expected: vertices, found });
        }
        if signal.channels != 1 {
            let flaw = Flaw::new("one value per vertex", format!("{} per vertex", signal.channels));
            return Err(flaw.at(path, "a mask"));
        }
        // In a GIfTI label file, a nonzero value may denote a region called unknown or medial wall.
        let labels = if is_gifti_label(path) { read_annotation(path, vertices).ok() } else { None };
        let is_outside = |vertex: usize| {
            let name = labels.as_ref().and_then(|labels| labels.name_at(vertex));
            name.is_some_and(|name| !is_region(name))
        };
        signal.values.iter().enumerate().map(|(vertex, keep)| *keep != 0.0 && !is_outside(vertex)).collect()
    };
    if mask.contains(&true) { Ok(mask) } else { Err(SurfaceError::NothingKept { path: path.to_owned() }) }
}

/// Returns whether a file's name marks it as GIfTI labels.
fn is_gifti_label(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
    [".label.gii", ".label.gii.gz"].iter().any(|ending| name.ends_with(ending))
}

fn label(bytes: &[u8], vertices: usize) -> Result<Vec<bool>, Flaw> {
    let mut rows = lines(bytes).skip(1).filter(|(_, line)| !line.trim_ascii().is_empty());
    let (_, count) = rows.next().unwrap_or_default();
    let count: u64 =
        number(count.trim_ascii()).ok_or_else(|| Flaw::new("a number of vertices on line 2", shown(count)))?;
    let count = bounded(count, 2, bytes.len(), "vertices")?;
    let mut mask = vec![false; vertices];
    let mut found = 0;
    for (at, line) in rows {
        let vertex: usize = next_number(&mut words(line), "a vertex", at)?;
        let Some(keep) = mask.get_mut(vertex) else {
            return Err(Flaw::new(
                format!("vertex numbers below {vertices}, the surface's number of vertices"),
                format!("{vertex} on line {at}"),
            ));
        };
        *keep = true;
        found += 1;
    }
    if found == count {
        Ok(mask)
    } else {
        Err(Flaw::new(format!("{count} vertices, as stated at the top"), found.to_string()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_and_values_are_masks() {
        let folder = tempfile::tempdir().unwrap();
        let read = |name: &str, text: &str, vertices: usize| {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            read_mask(path, vertices)
        };
        let head = "#!ascii label  , from subject bert vox2ras=TkReg\n";
        let text = format!("{head}2\n3  -1.5 2.0 3.0 0.000000\n0  1 2 3 0.1\n");
        assert_eq!(read("lh.cortex.label", &text, 5).unwrap(), [true, false, false, true, false]);
        assert_eq!(read("lh.windows.label", &text.replace('\n', "\r\n"), 4).unwrap(), [true, false, false, true]);
        assert_eq!(read("mask.csv", "0\n1\n-2\n", 3).unwrap(), [false, true, true]);
        for (text, vertices, expected) in [
            (text.as_str(), 3, "vertex numbers below 3"),
            (&text.replace("\n2\n", "\n3\n"), 5, "expected 3 vertices, as stated at the top, found 2"),
            (&text.replace("\n2\n", "\n4000000000\n"), 5, "4000000000 vertices"),
            (&text.replace("\n2\n", "\nx\n"), 5, "a number of vertices on line 2"),
            (&text.replace("\n3  ", "\n-3  "), 5, "a vertex on line 3"),
            (&format!("{head}0\n"), 5, "all vertices are excluded"),
            (head, 5, "expected a number of vertices"),
        ] {
            let error = read("bad.label", text, vertices).unwrap_err().to_string();
            assert!(error.contains("bad.label") && error.contains(expected) && !error.contains('\n'), "{error}");
        }
        for (text, expected) in
            [("0\n0\n", "vertices are excluded"), ("1\n", "1 vertices"), ("1,2\n1,2\n", "2 per vertex")]
        {
            let error = read("bad.csv", text, 2).unwrap_err().to_string();
            assert!(error.contains("bad.csv") && error.contains(expected), "{error}");
        }
    }
}
