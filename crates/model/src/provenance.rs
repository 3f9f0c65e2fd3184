//! Records the origin of a model: input, sphere and settings.
//!
//! The record is sufficient to decide whether an existing model is up to date.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use spharm_surface::Meta;
use spharm_surface::io::landmarks::Frame;
use spharm_surface::range::times_within;

use crate::file_record::{self, FileRecord};
use crate::geometry::Geometry;

/// Origin of a model. In JSON, the provenance is one object with the fields of this struct and of [`Settings`].
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Provenance {
    /// Name of the program or library function that made the model.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tool: Option<String>,
    /// Versions of the software that made the model.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub versions: Option<Versions>,
    /// Name of the surface in a study's table, if the surface belongs to a study.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub id: Option<String>,
    /// File of the fitted surface or signal; `None` in models from version 0.1.
    #[serde(deserialize_with = "file_record::of_any_version")]
    pub input: Option<FileRecord>,
    /// File of the mask or label that selects the vertices with known values. `None` unless the values of the other
    /// vertices were extrapolated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub region: Option<FileRecord>,
    /// Path of the sphere's file, as given by the user. The model's scheme key identifies the sphere's directions.
    pub sphere: Option<String>,
    /// Whether the sphere was computed as a parametrization of this surface.
    pub parametrized: bool,
    /// Settings of the fit.
    #[serde(flatten)]
    pub settings: Option<Settings>,
    /// Whether the channels are the positions x, y and z of a surface; `None` if unknown.
    pub surface: Option<bool>,
    /// Cube root of the volume of the input's bounding box, in the unit of the input.
    pub scale: Option<f64>,
    /// Distances between the model and the input's vertices.
    pub distances: Option<Distances>,
    /// Root mean square distance between the model's surface and the input surface, measured in both directions, in the
    /// input's unit; `None` if the fit didn't measure it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub surface_rms: Option<f64>,
    /// Voxels of the label, if the input surface was extracted from a label.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub voxels: Option<VoxelRecord>,
    /// GIfTI's `AnatomicalStructurePrimary` of the input, such as `CortexLeft`.
    pub anatomical_structure_primary: Option<String>,
    /// Voxel size along x, y and z in mm, if the user gave a size that replaces the size in the volume's file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub voxel_size: Option<[f64; 3]>,
    /// Order of the axes of a NumPy file, if the user gave an order other than `xyz`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub axes: Option<String>,
    /// Kind of the surface extracted from the label, if the input is a label: `smooth` or `voxels`. `None` in models
    /// from earlier versions, whose surfaces follow the voxels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub label_surface: Option<String>,
    /// Smoothing radius of a smooth surface in voxels, if it isn't the default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub smooth_radius: Option<f64>,
    /// Threshold of grey values, if the input is a volume of grey values. Voxels at or above the threshold are inside
    /// the body.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub threshold: Option<f64>,
    /// Whether the input is a volume of probabilities.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub probability: bool,
    /// Whether repairing the label or mesh was requested, even if no repair was needed.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub fix: bool,
    /// Number of voxels along the longest side of the mesh's bounding box, if the mesh was wrapped.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wrap: Option<usize>,
    /// Whether cutting handles was requested, even if the surface had no handles.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub cut_handles: bool,
    /// Changes made by the repair: to a label of nonzero genus before its surface was extracted, or to a mesh.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub repair: Option<Map<String, Value>>,
    /// Record of the handles that were cut, if the surface had any: the genus, the loops of the cuts, and the areas of
    /// the fillings.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub handles: Option<Map<String, Value>>,
    /// Position of the input surface in its volume, from the input's file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub geometry: Option<Geometry>,
    /// Unknown fields of the JSON, which are preserved unchanged.
    #[serde(flatten)]
    pub other: Map<String, Value>,
}

/// Number and size of the voxels of the label whose surface was fitted.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct VoxelRecord {
    /// Number of the label's voxels in the file.
    pub count: usize,
    /// Lengths of a voxel's edges, in mm.
    pub size: [f64; 3],
    /// Whether the label touches the border of the volume. If it does, the body may be truncated.
    pub at_border: bool,
}

/// Software versions and platform on which a result may depend.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Versions {
    /// Version of the library and its programs.
    pub spharm: String,
    /// Version of the basis store's format.
    pub store_format: u32,
    /// Operating system and processor architecture.
    pub platform: (String, String),
}

/// Settings on which the coefficients of a model depend, and the outcome of the fit's iterations.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Method of the fit: `lsq`, `irf`, `sirf`, `mirf`, `nlsf` or `quadrature`.
    pub method: String,
    /// Objective of the fit: `surface`, `vertices`, or `samples` if the model was fitted to moments. `None` in models
    /// from version 0.1, which were fitted to the vertices.
    #[serde(default, alias = "target")]
    pub objective: Option<String>,
    /// Largest area distortion allowed in the mapping of a mesh without a sphere, if the user gave a limit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub area: Option<f64>,
    /// Number of passes over the basis.
    pub passes: usize,
    /// Maximum number of columns per block, g, for methods with blocks.
    pub granularity: Option<usize>,
    /// Last degree of the first block, s, for methods with blocks.
    pub start_degree: Option<usize>,
    /// Whether pairs of passes were accelerated by conjugate gradients.
    #[serde(default)]
    pub accelerate: bool,
    /// Weights of the vertices: `uniform`, `area`, or the path of a file of weights.
    pub weights: String,
    /// BLAKE3 hash of the weights, as 64 hexadecimal digits, if they were read from a file.
    #[serde(default)]
    pub weights_blake3: Option<String>,
    /// Fraction of the vertices that the fit held out.
    #[serde(default)]
    pub hold_out: Option<f64>,
    /// Requested tolerance for the optimality, for fits by full least squares; `None` in models from version 0.1.
    #[serde(default)]
    pub tolerance: Option<f64>,
    /// Maximum number of iterations, for iterative methods.
    #[serde(default)]
    pub max_iterations: Option<usize>,
    /// Requested preconditioner, for methods that use one.
    #[serde(default)]
    pub preconditioner: Option<String>,
    /// Optimality reached, for methods with a tolerance.
    #[serde(default)]
    pub optimality: Option<f64>,
    /// Whether the iterations converged, for iterative methods.
    #[serde(default)]
    pub converged: Option<bool>,
    /// Choice of the smoothness penalty lambda: `default`, `fixed` or `auto`; `None` in models from version 0.1.
    #[serde(default)]
    pub smoothness_choice: Option<String>,
    /// Smoothness penalty lambda that was used. If each channel has its own penalty, this is the largest penalty.
    pub smoothness: f64,
    /// Scalar type of the basis: `f64` or `f32`.
    pub dtype: String,
}

/// Mean and maximal squared distance of a model from its target.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Distances {
    /// Whether the distances were measured after an additional pass, which removes remaining rounding errors.
    pub refinement: bool,
    /// Mean squared distance after scaling the bounding box to volume 1; `None` if the bounding box has no volume.
    pub msd: Option<f64>,
    /// Maximal squared distance after scaling the bounding box to volume 1; `None` if the bounding box has no volume.
    pub xsd: Option<f64>,
    /// Mean squared distance, in the square of the input's unit.
    pub msd_raw: f64,
    /// Maximal squared distance, in the square of the input's unit.
    pub xsd_raw: f64,
    /// Root mean square distance, in the input's unit. This field is needed if the squared distance is outside the
    /// range of f64, in which case `msd_raw` is clamped to that range.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rms_raw: Option<f64>,
    /// Largest distance, in the input's unit. This field is needed if the squared distance is outside the range of f64,
    /// in which case `xsd_raw` is clamped to that range.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_raw: Option<f64>,
}

impl Distances {
    /// Returns the distances of a surface whose bounding box has the volume `scale^3`. `mean_square` and `max_square`
    /// are in the square of the input's unit.
    #[must_use]
    pub fn new(mean_square: f64, max_square: f64, refinement: bool, scale: Option<f64>) -> Self {
        let normalised = |value: f64| scale.map(|scale| value / (scale * scale));
        Self {
            refinement,
            msd: normalised(mean_square),
            xsd: normalised(max_square),
            msd_raw: mean_square,
            xsd_raw: max_square,
            rms_raw: None,
            max_raw: None,
        }
    }

    /// Returns the root mean square distance, in the input's unit.
    #[must_use]
    pub fn rms(&self) -> f64 {
        self.rms_raw.unwrap_or_else(|| self.msd_raw.sqrt())
    }

    /// Returns the largest distance, in the input's unit.
    #[must_use]
    pub fn max(&self) -> f64 {
        self.max_raw.unwrap_or_else(|| self.xsd_raw.sqrt())
    }

    /// Returns the distances as they are after the input is scaled by 2^exponent.
    #[must_use]
    pub fn times(self, exponent: i32) -> Self {
        if exponent == 0 {
            return self;
        }
        Self {
            msd_raw: times_within(self.msd_raw, 2 * exponent),
            xsd_raw: times_within(self.xsd_raw, 2 * exponent),
            rms_raw: Some(times_within(self.rms(), exponent)),
            max_raw: Some(times_within(self.max(), exponent)),
            ..self
        }
    }
}

impl Provenance {
    /// Parses the provenance in a model's file. Invalid JSON gives an empty provenance instead of an error, because the
    /// coefficients don't depend on the provenance.
    #[must_use]
    pub fn parse(json: &str) -> Self {
        serde_json::from_str(json).unwrap_or_default()
    }

    /// Returns the axes that the surface's file stated, if any; see [`Meta::axes`].
    #[must_use]
    pub fn axes(&self) -> Option<Frame> {
        self.geometry.as_ref()?.to_meta().axes()
    }

    /// Stores the metadata of a surface's file in the provenance.
    pub fn set_meta(&mut self, meta: &Meta) {
        self.anatomical_structure_primary.clone_from(&meta.anatomical_structure_primary);
        self.geometry = Geometry::of(meta);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn provenance() -> Provenance {
        Provenance {
            tool: Some("fit".to_owned()),
            input: Some(FileRecord {
                path: "sub-01/lh.pial".to_owned(),
                bytes: 7,
                blake3: "ab".repeat(32),
                ..FileRecord::default()
            }),
            sphere: Some("lh.sphere.reg".to_owned()),
            settings: Some(Settings {
                method: "lsq".to_owned(),
                objective: Some("surface".to_owned()),
                area: None,
                passes: 1,
                granularity: None,
                start_degree: None,
                accelerate: false,
                weights: "w.csv".to_owned(),
                weights_blake3: Some("cd".repeat(32)),
                hold_out: None,
                tolerance: Some(1e-10),
                max_iterations: Some(3000),
                preconditioner: Some("low-degrees 20".to_owned()),
                optimality: Some(2.5e-11),
                converged: Some(true),
                smoothness_choice: Some("fixed".to_owned()),
                smoothness: 1.0 / 3.0,
                dtype: "f64".to_owned(),
            }),
            surface: Some(true),
            other: Map::from_iter([("study".to_owned(), Value::from("x"))]),
            ..Provenance::default()
        }
    }

    #[test]
    fn json_is_flat_and_returns() {
        let json = serde_json::to_string(&provenance()).unwrap();
        assert_eq!(Provenance::parse(&json), provenance());
        let value: Value = serde_json::from_str(&json).unwrap();
        assert_eq!((&value["method"], &value["input"]["path"]), (&"lsq".into(), &"sub-01/lh.pial".into()));
        assert_eq!(Provenance::parse("no JSON"), Provenance::default());
        assert_eq!(Provenance::parse("{}").settings, None);
    }

    /// The JSON is in the form that version 0.1 wrote.
    #[test]
    fn an_old_model_is_understood() {
        let json = r#"{"tool":"fit","versions":{"spharm":"0.1.0","store_format":1,"platform":["linux","x86_64"]},
            "input":"lh.pial","sphere":"lh.sphere.reg","method":"irf","passes":2,"granularity":100,"start_degree":null,
            "weights":"uniform","smoothness":0.0,"dtype":"f64","surface":true,"scale":80.5,
            "distances":{"refinement":false,"msd":1e-5,"xsd":2e-5,"msd_raw":0.1,"xsd_raw":0.2},
            "anatomical_structure_primary":"CortexLeft"}"#;
        let old = Provenance::parse(json);
        assert_eq!((old.input, old.sphere.as_deref()), (None, Some("lh.sphere.reg")));
        let settings = old.settings.as_ref().unwrap();
        assert_eq!((settings.granularity, settings.tolerance), (Some(100), None));
        assert_eq!((&settings.weights_blake3, settings.max_iterations, settings.converged), (&None, None, None));
        assert_eq!(old.distances.unwrap().xsd_raw, 0.2);
        assert_eq!(old.anatomical_structure_primary.as_deref(), Some("CortexLeft"));
        assert!(old.other.is_empty(), "{:?}", old.other);
    }

    #[test]
    fn a_file_is_known_by_its_contents() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("a"), "abc").unwrap();
        let found = FileRecord::of(&folder.path().join("a")).unwrap();
        assert!(found.bytes == 3 && found.blake3.starts_with("6437b3ac38465133ffb63b75273a8db5"), "{found:?}");
        assert!(found.same_contents(&FileRecord { path: String::new(), ..found.clone() }));
    }

    #[test]
    fn distances_that_leave_the_range_are_neither_zero_nor_infinite() {
        let small = Distances::new(1e-60, 1e-60, false, None).times(-1000);
        assert!(small.rms() > 0.0 && small.max() > 0.0 && small.msd_raw > 0.0, "{small:?}");
        let large = Distances::new(1e60, 1e60, false, None).times(1000);
        assert!(large.rms().is_finite() && large.max().is_finite() && large.msd_raw.is_finite(), "{large:?}");
        let none = Distances::new(0.0, 0.0, false, None).times(-1000);
        assert!([none.rms(), none.max(), none.msd_raw] == [0.0; 3], "{none:?}");
    }
}
