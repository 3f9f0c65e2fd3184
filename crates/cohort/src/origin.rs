//! Records the origin of the sphere beside a model in the sphere's GIfTI metadata.
//!
//! The origin is needed to decide whether a sphere can be reused. Equal triangles don't suffice: a sphere with the same
//! triangles as the surface may have been made from another subject's surface, or for another degree.

use std::path::Path;

use spharm::FileRecord;
use spharm::parametrize::CaldParams;
use spharm_surface::Meta;
use spharm_surface::io::read_gifti_metadata;

const INPUT: &str = "SpharmInput";
const LABEL: &str = "SpharmLabel";
const MAP: &str = "SpharmMap";

/// The input from which a sphere was made, and the mapping method.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Origin {
    /// BLAKE3 hash of the contents of the input's file.
    input: String,
    /// Label of the surface, if the input is a volume.
    label: Option<i64>,
    /// Name and settings of the mapping method.
    map: String,
}

impl Origin {
    /// Returns the origin of a sphere that [`parametrize_with`](spharm::parametrize::parametrize_with) makes from
    /// `input` with the settings `params`. `cut` is true if the handles of the surface were cut.
    pub(crate) fn new(input: &FileRecord, params: &CaldParams, cut: bool) -> Self {
        let CaldParams { area, degree, steps, seed } = params;
        let degree = degree.map_or("auto".to_owned(), |degree| degree.to_string());
        let map = match input.label {
            Some(_) if !cut => "equal-area".to_owned(),
            _ => {
                let cut = if cut { ", handles cut" } else { "" };
                format!("auto, area {area}, degree {degree}, steps {steps}, seed {seed}{cut}")
            }
        };
        Self { input: input.blake3.clone(), label: input.label, map }
    }

    /// Returns the origin recorded in the metadata of a sphere; `None` if no origin is recorded.
    pub(crate) fn of(meta: &Meta) -> Option<Self> {
        Self::of_pairs(&meta.file_metadata)
    }

    /// Returns the origin recorded in the metadata of a file, given as pairs (name, value).
    fn of_pairs(pairs: &[(String, String)]) -> Option<Self> {
        let value = |name: &str| {
            let found = pairs.iter().find(|(found, _)| found == name);
            found.map(|(_, value)| value.clone())
        };
        let label = value(LABEL).map(|label| label.parse()).transpose().ok()?;
        Some(Self { input: value(INPUT)?, label, map: value(MAP)? })
    }

    /// Returns the origin recorded in a sphere's file; `None` if the file can't be read or records no origin. The
    /// vertices and triangles aren't read, because this function is called for many spheres when a folder is listed.
    pub(crate) fn of_file(sphere: &Path) -> Option<Self> {
        Self::of_pairs(&read_gifti_metadata(sphere)?)
    }

    /// Returns whether the sphere was made from a label of a volume.
    pub(crate) fn is_of_label(&self) -> bool {
        self.label.is_some()
    }

    /// Returns whether the sphere was made from this input, regardless of the settings.
    pub(crate) fn is_of(&self, input: &FileRecord) -> bool {
        (&self.input, self.label) == (&input.blake3, input.label)
    }

    /// Writes the origin to the metadata of a new sphere, and replaces any origin that was copied from the surface's
    /// file.
    pub(crate) fn write_to(&self, meta: &mut Meta) {
        meta.file_metadata.retain(|(name, _)| ![INPUT, LABEL, MAP].contains(&name.as_str()));
        let label = self.label.map(|label| (LABEL, label.to_string()));
        let pairs = [Some((INPUT, self.input.clone())), label, Some((MAP, self.map.clone()))];
        meta.file_metadata.extend(pairs.into_iter().flatten().map(|(name, value)| (name.to_owned(), value)));
    }
}

#[cfg(test)]
mod tests {
    use spharm::io::{WriteOptions, write_mesh};
    use spharm_surface::generate::icosphere;

    use super::*;

    #[test]
    fn an_origin_is_read_as_it_was_written() {
        let mut meta = Meta { file_metadata: vec![("Date".to_owned(), "today".to_owned())], ..Meta::default() };
        assert_eq!(Origin::of(&meta), None);
        for label in [None, Some(-3)] {
            let input =
                FileRecord { path: "a".to_owned(), bytes: 1, blake3: "ab".repeat(32), label, ..FileRecord::default() };
            let origin = Origin::new(&input, &CaldParams::for_degree(8), label.is_none());
            origin.write_to(&mut meta);
            assert_eq!(Origin::of(&meta), Some(origin.clone()));
            assert!(origin.is_of(&input) && !origin.is_of(&FileRecord { label: Some(4), ..input }));
        }
        assert_eq!(meta.file_metadata[0].0, "Date");
    }

    #[test]
    fn the_origin_of_a_file_is_read_without_its_arrays() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.sphere.surf.gii");
        let input = FileRecord { blake3: "ab".repeat(32), label: Some(3), ..FileRecord::default() };
        let origin = Origin::new(&input, &CaldParams::for_degree(8), false);
        let mut mesh = icosphere(0);
        origin.write_to(&mut mesh.meta);
        write_mesh(&path, &mesh, &WriteOptions::default()).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let (head, _) = text.split_once("<Data>").unwrap();
        std::fs::write(&path, head).unwrap();
        assert_eq!(Origin::of_file(&path), Some(origin));
        assert_eq!(Origin::of_file(&folder.path().join("missing.surf.gii")), None);
    }
}
