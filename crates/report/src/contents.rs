//! The input of a page.

use serde_json::Value;
use spharm_model::Model;
use spharm_shape::Curve;
use spharm_shape::pca::file::ShapeModel;
use spharm_surface::Mesh;

use crate::check::Check;
use crate::table::Table;

/// The contents of a page, in display order.
#[derive(Debug, Clone, Default)]
pub struct Contents {
    /// The page's heading.
    pub title: String,
    /// Warnings, shown first.
    pub warnings: Vec<String>,
    /// Quality control of the subjects, shown after the warnings.
    pub check: Option<Check>,
    /// Models of surfaces.
    pub models: Vec<Shown>,
    /// Modes of groups, with their names.
    pub modes: Vec<(String, ShapeModel)>,
    /// Maps of tests.
    pub tests: Vec<Maps>,
    /// Quality of several alignments of one group, for comparison; the first is the main alignment.
    pub quality: Vec<Quality>,
    /// Tables shown as they are, such as the status of a study's subjects.
    pub tables: Vec<Table>,
    /// Paragraphs on methods, for a paper.
    pub methods: Vec<String>,
    /// What is needed to make the contents again, such as commands: name and text.
    pub provenance: Vec<(String, String)>,
    /// The version of the program, for the page's footer.
    pub version: String,
}

/// A model in a page.
#[derive(Debug, Clone)]
pub struct Shown {
    /// Name of the model.
    pub name: String,
    /// The model, which must be of a surface.
    pub model: Model,
    /// A surface for comparison, and its name.
    pub surface: Option<(String, Mesh)>,
    /// The model's entry under `surfaces` in the report of `spharm fit`.
    pub fit: Option<Value>,
}

/// Maps on a surface: an effect, a statistic, p values.
#[derive(Debug, Clone)]
pub struct Maps {
    /// Name of the test.
    pub name: String,
    /// The tested effect, such as `a - b`; may be empty.
    pub meaning: String,
    /// Further information, such as the subjects and the covariates: name and text.
    pub about: Vec<(String, String)>,
    /// The surface.
    pub mesh: Mesh,
    /// Names and values, one per vertex; maps of p values are called `p`, `q` or begin with `p-`.
    pub maps: Vec<(String, Vec<f64>)>,
}

/// Quality of a group in correspondence, from [`group_quality`](spharm_shape::group_quality); lengths in the surfaces'
/// unit.
#[derive(Debug, Clone, Default)]
pub struct Quality {
    /// Name of the alignment.
    pub name: String,
    /// Variance along all modes, in the square of the unit.
    pub variance: f64,
    /// Share of the variance along the first modes.
    pub compactness: Curve,
    /// Distance of a member from the modes of the other members.
    pub generalisation: Curve,
    /// Distance of a random shape from the nearest member.
    pub specificity: Curve,
    /// Generalisation by the distance between surfaces.
    pub surface_generalisation: Option<Curve>,
    /// Specificity by the distance between surfaces.
    pub surface_specificity: Option<Curve>,
    /// Mean and median distance of corresponding landmarks.
    pub landmarks: Option<[f64; 2]>,
}

/// Settings of a page.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Params {
    /// Maximum number of vertices of a mesh in the page. A model whose sphere has more vertices is evaluated on an
    /// icosphere. Default 163,842.
    pub max_vertices: usize,
}

impl Default for Params {
    fn default() -> Self {
        Self { max_vertices: 163_842 }
    }
}
