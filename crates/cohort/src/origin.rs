//! The origin of the sphere beside a model, recorded in its GIfTI metadata.
//!
//! A sphere with the same triangles may be that of another subject, or made for another degree.

use spharm::FileRecord;
use spharm::parametrize::CaldParams;
use spharm_surface::Meta;

const INPUT: &str = "SpharmInput";
const LABEL: &str = "SpharmLabel";
const MAP: &str = "SpharmMap";

/// The input and the method of a sphere.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Origin {
    /// The BLAKE3 hash of the input's contents.
    input: String,
    /// For a volume, the label.
    label: Option<i64>,
    /// The method and its settings.
    map: String,
}

impl Origin {
    /// Returns the origin of the map that [`parametrize_with`](spharm::parametrize::parametrize_with) makes of an input
    /// with these settings, with or without cutting its handles.
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

    /// Returns the origin recorded in a sphere's file; `None` if there is none.
    pub(crate) fn of(meta: &Meta) -> Option<Self> {
        let value = |name: &str| {
            let found = meta.file_metadata.iter().find(|(found, _)| found == name);
            found.map(|(_, value)| value.clone())
        };
        let label = value(LABEL).map(|label| label.parse()).transpose().ok()?;
        Some(Self { input: value(INPUT)?, label, map: value(MAP)? })
    }

    /// Returns whether the sphere was made from this input, with any settings.
    pub(crate) fn is_of(&self, input: &FileRecord) -> bool {
        (&self.input, self.label) == (&input.blake3, input.label)
    }

    /// Writes it to the metadata of a sphere that is to be written, in place of those of the surface's file.
    pub(crate) fn write_to(&self, meta: &mut Meta) {
        meta.file_metadata.retain(|(name, _)| ![INPUT, LABEL, MAP].contains(&name.as_str()));
        let label = self.label.map(|label| (LABEL, label.to_string()));
        let pairs = [Some((INPUT, self.input.clone())), label, Some((MAP, self.map.clone()))];
        meta.file_metadata.extend(pairs.into_iter().flatten().map(|(name, value)| (name.to_owned(), value)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_origin_is_read_as_it_was_written() {
        let mut meta = Meta { file_metadata: vec![("Date".to_owned(), "today".to_owned())], ..Meta::default() };
        assert_eq!(Origin::of(&meta), None);
        for label in [None, Some(-3)] {
            let input = FileRecord { path: "a".to_owned(), bytes: 1, blake3: "ab".repeat(32), label };
            let origin = Origin::new(&input, &CaldParams::for_degree(8), label.is_none());
            origin.write_to(&mut meta);
            assert_eq!(Origin::of(&meta), Some(origin.clone()));
            assert!(origin.is_of(&input) && !origin.is_of(&FileRecord { label: Some(4), ..input }));
        }
        assert_eq!(meta.file_metadata[0].0, "Date");
    }
}
