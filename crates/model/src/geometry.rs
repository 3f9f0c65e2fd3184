//! Preserves the position of a surface in the volume from which it was extracted, as recorded in the surface's file. A
//! model stores this position, and writes it to the files of reconstructions. The author and date of the original file
//! aren't preserved.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde::{Deserialize, Serialize};
use spharm_surface::{CoordinateSystem, Meta};

/// Metadata of a surface's file that a model preserves. Positions are stored as in the file; the recorded transform
/// isn't applied to them.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Geometry {
    /// GIfTI metadata of the whole file, except `Date` and `UserName`, as pairs (name, value).
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub file_metadata: Vec<(String, String)>,
    /// GIfTI metadata of the point set, such as `VolGeomC_R`, except `Date` and `UserName`, as pairs (name, value).
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub surface_metadata: Vec<(String, String)>,
    /// GIfTI's `CoordinateSystemTransformMatrix`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub coordinate_system: Option<Transform>,
    /// Bytes after the triangles of a FreeSurfer file, in base64.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub freesurfer_footer: Option<String>,
}

/// A transform from the space of the stored positions to another space.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Transform {
    /// Name of the space of the stored positions.
    pub data_space: String,
    /// Name of the space of the transformed positions.
    pub transformed_space: String,
    /// Rows of the 4 x 4 transformation matrix.
    pub matrix: [[f64; 4]; 4],
}

impl Geometry {
    /// Returns the metadata of a surface's file that a model preserves; `None` if the file has no such metadata.
    #[must_use]
    pub fn of(meta: &Meta) -> Option<Self> {
        let geometry = Self {
            file_metadata: without_maker(&meta.file_metadata),
            surface_metadata: without_maker(&meta.surface_metadata),
            coordinate_system: meta.coordinate_system.as_ref().map(|system| Transform {
                data_space: system.data_space.clone(),
                transformed_space: system.transformed_space.clone(),
                matrix: std::array::from_fn(|row| std::array::from_fn(|column| system.matrix[4 * row + column])),
            }),
            freesurfer_footer: meta.freesurfer_footer.as_ref().map(|bytes| STANDARD.encode(bytes)),
        };
        (geometry != Self::default()).then_some(geometry)
    }

    /// Returns the metadata in the form that a mesh stores. A FreeSurfer footer that isn't valid base64 is omitted.
    #[must_use]
    pub fn to_meta(&self) -> Meta {
        Meta {
            anatomical_structure_primary: None,
            file_metadata: self.file_metadata.clone(),
            surface_metadata: self.surface_metadata.clone(),
            coordinate_system: self.coordinate_system.as_ref().map(|transform| CoordinateSystem {
                data_space: transform.data_space.clone(),
                transformed_space: transform.transformed_space.clone(),
                matrix: std::array::from_fn(|k| transform.matrix[k / 4][k % 4]),
            }),
            freesurfer_stamp: None,
            freesurfer_footer: self.freesurfer_footer.as_ref().and_then(|text| STANDARD.decode(text).ok()),
        }
    }
}

/// Returns metadata without the standard entries for the author and date of a file.
fn without_maker(metadata: &[(String, String)]) -> Vec<(String, String)> {
    metadata.iter().filter(|(name, _)| !["Date", "UserName"].contains(&name.as_str())).cloned().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metadata_survive_json_but_for_who_made_the_file_and_when() {
        let pair = |name: &str| (name.to_owned(), "x".to_owned());
        let kept = Meta {
            anatomical_structure_primary: None,
            file_metadata: vec![pair("Name")],
            surface_metadata: vec![pair("VolGeomC_R")],
            coordinate_system: Some(CoordinateSystem {
                data_space: "NIFTI_XFORM_SCANNER_ANAT".to_owned(),
                transformed_space: "NIFTI_XFORM_MNI_152".to_owned(),
                matrix: std::array::from_fn(|k| k as f64 / 3.0),
            }),
            freesurfer_stamp: None,
            freesurfer_footer: Some((0..=255).collect()),
        };
        let read = Meta {
            file_metadata: vec![pair("Date"), pair("Name"), pair("UserName")],
            surface_metadata: vec![pair("UserName"), pair("VolGeomC_R")],
            freesurfer_stamp: Some("created by x on Monday".to_owned()),
            ..kept.clone()
        };
        let json = serde_json::to_string(&Geometry::of(&read).unwrap()).unwrap();
        assert_eq!(serde_json::from_str::<Geometry>(&json).unwrap().to_meta(), kept);
        assert_eq!(Geometry::of(&Meta::default()), None);
    }
}
