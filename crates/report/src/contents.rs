//! What a page is made of.

use serde_json::Value;
use spharm_model::Model;
use spharm_shape::Curve;
use spharm_shape::pca::file::ShapeModel;
use spharm_surface::Mesh;

use crate::table::Table;

/// The contents of a page, in its order.
#[derive(Debug, Clone, Default)]
pub struct Contents {
    /// The page's heading.
    pub title: String,
    /// Warnings, shown before all else.
    pub warnings: Vec<String>,
    /// Models of surfaces.
    pub models: Vec<Shown>,
    /// Modes of groups, with their names.
    pub modes: Vec<(String, ShapeModel)>,
    /// Maps of tests.
    pub tests: Vec<Maps>,
    /// Quality of alignments of one group, side by side; the first is the one that matters.
    pub quality: Vec<Quality>,
    /// Tables of status, and others.
    pub tables: Vec<Table>,
    /// The version of the program, for the page's foot.
    pub version: String,
}

/// A model in a page.
#[derive(Debug, Clone)]
pub struct Shown {
    /// Its name.
    pub name: String,
    /// The model, of a surface.
    pub model: Model,
    /// The surface to compare it with, and its name.
    pub surface: Option<(String, Mesh)>,
    /// Its entry under `surfaces` in the report of `spharm fit`.
    pub fit: Option<Value>,
}

/// Maps on a surface: an effect, a statistic, p values.
#[derive(Debug, Clone)]
pub struct Maps {
    /// Name of the test.
    pub name: String,
    /// What was tested, such as `a - b`; may be empty.
    pub meaning: String,
    /// What else there is to say of it, such as the subjects and the covariates: name and text.
    pub about: Vec<(String, String)>,
    /// The surface.
    pub mesh: Mesh,
    /// Names and values, one a vertex; those of p values are called `p`, `q` or begin with `p-`.
    pub maps: Vec<(String, Vec<f64>)>,
}

/// Quality of a group that corresponds, by [`group_quality`](spharm_shape::group_quality); lengths in the surfaces'
/// unit.
#[derive(Debug, Clone, Default)]
pub struct Quality {
    /// What the group was brought together by.
    pub name: String,
    /// Variance along all modes, in the square of the unit.
    pub variance: f64,
    /// Share of the variance along the first modes.
    pub compactness: Curve,
    /// Distance of a member from the modes of the others.
    pub generalisation: Curve,
    /// Distance of a random shape from the nearest member.
    pub specificity: Curve,
    /// Generalisation by the distance between surfaces.
    pub surface_generalisation: Option<Curve>,
    /// Specificity by the distance between surfaces.
    pub surface_specificity: Option<Curve>,
    /// Mean and median distance of landmarks that should be at one place.
    pub landmarks: Option<[f64; 2]>,
}

/// Settings of a page.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Params {
    /// Most vertices of a mesh in the page. A model over more is evaluated on an icosphere. Default 163,842.
    pub max_vertices: usize,
}

impl Default for Params {
    fn default() -> Self {
        Self { max_vertices: 163_842 }
    }
}
