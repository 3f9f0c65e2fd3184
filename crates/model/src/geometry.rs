//! Where a surface lies in its volume, as its file said it: kept in a model, so that a reconstruction says it again.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde::{Deserialize, Serialize};
use spharm_surface::{CoordinateSystem, Meta};

/// The metadata of a surface's file. Positions are as stored: none of this has been applied to them.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Geometry {
    /// GIfTI metadata of the file as a whole: (name, value).
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub file_metadata: Vec<(String, String)>,
    /// GIfTI metadata of the point set, such as `VolGeomC_R`: (name, value).
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub surface_metadata: Vec<(String, String)>,
    /// GIfTI's `CoordinateSystemTransformMatrix`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub coordinate_system: Option<Transform>,
    /// The comment that opens a FreeSurfer file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub freesurfer_stamp: Option<String>,
    /// What follows a FreeSurfer file's triangles, in base64.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub freesurfer_footer: Option<String>,
}

/// A transform from the positions as stored to another space.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Transform {
    /// The space of the positions as stored.
    pub data_space: String,
    /// The space that `matrix` leads to.
    pub transformed_space: String,
    /// Rows of a 4 x 4 matrix.
    pub matrix: [[f64; 4]; 4],
}

impl Geometry {
    /// Returns what a file said; `None` where it said nothing.
    #[must_use]
    pub fn of(meta: &Meta) -> Option<Self> {
        let geometry = Self {
            file_metadata: meta.file_metadata.clone(),
            surface_metadata: meta.surface_metadata.clone(),
            coordinate_system: meta.coordinate_system.as_ref().map(|system| Transform {
                data_space: system.data_space.clone(),
                transformed_space: system.transformed_space.clone(),
                matrix: std::array::from_fn(|row| std::array::from_fn(|column| system.matrix[4 * row + column])),
            }),
            freesurfer_stamp: meta.freesurfer_stamp.clone(),
            freesurfer_footer: meta.freesurfer_footer.as_ref().map(|bytes| STANDARD.encode(bytes)),
        };
        (geometry != Self::default()).then_some(geometry)
    }

    /// Returns it as a mesh has it. A footer that isn't base64 is left out.
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
            freesurfer_stamp: self.freesurfer_stamp.clone(),
            freesurfer_footer: self.freesurfer_footer.as_ref().and_then(|text| STANDARD.decode(text).ok()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metadata_survive_json() {
        let meta = Meta {
            anatomical_structure_primary: None,
            file_metadata: vec![("Date".to_owned(), "today".to_owned())],
            surface_metadata: vec![("VolGeomC_R".to_owned(), "5".to_owned())],
            coordinate_system: Some(CoordinateSystem {
                data_space: "NIFTI_XFORM_SCANNER_ANAT".to_owned(),
                transformed_space: "NIFTI_XFORM_MNI_152".to_owned(),
                matrix: std::array::from_fn(|k| k as f64 / 3.0),
            }),
            freesurfer_stamp: Some("created by x".to_owned()),
            freesurfer_footer: Some((0..=255).collect()),
        };
        let json = serde_json::to_string(&Geometry::of(&meta).unwrap()).unwrap();
        assert_eq!(serde_json::from_str::<Geometry>(&json).unwrap().to_meta(), meta);
        assert_eq!(Geometry::of(&Meta::default()), None);
    }
}
