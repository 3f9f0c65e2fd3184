//! Defines the contents of a page and its settings.

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
    /// Heading of the page.
    pub title: String,
    /// Warnings, shown at the top of the page.
    pub warnings: Vec<String>,
    /// Quality control of the subjects, shown after the warnings.
    pub check: Option<Check>,
    /// Maps of statistical tests. The view opens with the first test or, without tests, the first model or modes.
    pub tests: Vec<Maps>,
    /// Models of surfaces.
    pub models: Vec<Shown>,
    /// Modes of groups, with the names of the groups.
    pub modes: Vec<(String, ShapeModel)>,
    /// Quality of the correspondence in several alignments of one group, for comparison. The first alignment is the
    /// main one.
    pub quality: Vec<Quality>,
    /// Further tables, such as the status of a study's subjects, shown unchanged.
    pub tables: Vec<Table>,
    /// Paragraphs on methods, for a paper.
    pub methods: Vec<String>,
    /// Information needed to reproduce the contents, such as commands, as pairs of name and text.
    pub provenance: Vec<(String, String)>,
    /// Version of the program, for the page's footer.
    pub version: String,
}

/// A model to show in a page.
#[derive(Debug, Clone)]
pub struct Shown {
    /// Name of the model.
    pub name: String,
    /// The model, which must be of a surface.
    pub model: Model,
    /// Name and mesh of a surface to compare the model with, if any.
    pub surface: Option<(String, Mesh)>,
    /// The model's entry under `surfaces` in the report of `spharm fit`, if any.
    pub fit: Option<Value>,
}

/// Maps of a test on a surface, such as an effect, a statistic and p values.
#[derive(Debug, Clone)]
pub struct Maps {
    /// Name of the test.
    pub name: String,
    /// The tested effect, such as `a - b`; may be empty.
    pub meaning: String,
    /// Further information, such as subjects and covariates, as pairs of name and text.
    pub about: Vec<(String, String)>,
    /// Surface on which the maps are shown.
    pub mesh: Mesh,
    /// Name and values of each map, with one value per vertex. Names of maps of p values are `p`, `q` or begin with
    /// `p-`.
    pub maps: Vec<(String, Vec<f64>)>,
}

/// Quality of a group's correspondence, from [`group_quality`](spharm_shape::group_quality); lengths in the surfaces'
/// unit.
#[derive(Debug, Clone, Default)]
pub struct Quality {
    /// Name of the alignment.
    pub name: String,
    /// Variance along all modes, in the square of the surfaces' unit.
    pub variance: f64,
    /// Fraction of the variance along the first modes.
    pub compactness: Curve,
    /// Mean distance of a member from the modes of the other members.
    pub generalisation: Curve,
    /// Mean distance of a random shape from the nearest member.
    pub specificity: Curve,
    /// Generalisation measured by distances between surfaces, if computed.
    pub surface_generalisation: Option<Curve>,
    /// Specificity measured by distances between surfaces, if computed.
    pub surface_specificity: Option<Curve>,
    /// Mean and median distance between corresponding landmarks, if measured.
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
