//! Prepares the modes of a group for a page. The page's script evaluates the mean and the shapes along the modes.

use serde::Serialize;
use spharm_harmonics::Coefficients;
use spharm_model::Model;
use spharm_render::Panel;
use spharm_shape::pca::file::ShapeModel;
use spharm_surface::{Kind, Mesh};

use crate::ReportError;
use crate::blocks::{Block, Blocks};
use crate::grid::{Grid, icosphere_for};
use crate::still::still;

/// Maximum number of modes in the page. Each mode has a slider.
const MOST: usize = 10;

/// Modes of a group, in the form in which the page's script reads them.
#[derive(Debug, Serialize)]
pub(crate) struct ModesItem {
    kind: &'static str,
    name: String,
    degree: usize,
    grid: Grid,
    /// Coefficients of the mean, (K, 3).
    coefficients: Block,
    /// Coefficients of the modes without row 0, (modes, K - 1, 3). Each mode has the norm sqrt(4 pi).
    modes: Block,
    /// Standard deviation along each mode.
    deviations: Vec<f64>,
    /// Fraction of the total variance along each mode.
    shares: Vec<f64>,
    members: Vec<Member>,
}

/// A member of the group, with its position along the modes in standard deviations.
#[derive(Debug, Serialize)]
struct Member {
    name: String,
    scores: Vec<f64>,
}

impl ModesItem {
    /// Creates the item and its picture, which shows the mean and the shapes at three standard deviations along the
    /// first mode in both directions.
    pub(crate) fn new(
        name: &str,
        shapes: &ShapeModel,
        max_vertices: usize,
        blocks: &mut Blocks,
    ) -> Result<(Self, Vec<u8>), ReportError> {
        let mut modes = shapes.modes.clone();
        modes.truncate(MOST);
        let of_harmonics = |error: spharm_harmonics::HarmonicsError| ReportError::Model {
            name: name.to_owned(),
            source: spharm_model::ModelError::Transform(error.into()),
        };
        let mean = Coefficients::new(modes.mean.clone()).map_err(of_harmonics)?;
        let degree = mean.max_degree();
        let sphere = icosphere_for(degree, max_vertices);
        let along = |z: f64| -> Result<Mesh, ReportError> {
            let first = if modes.count() > 0 { &[z][..] } else { &[] };
            let shape = modes.shape(first).map_err(|source| ReportError::Shape { name: name.to_owned(), source })?;
            let model = Model::without_sphere(Coefficients::new(shape).map_err(of_harmonics)?, Kind::Surface);
            let of_model = |source| ReportError::Model { name: name.to_owned(), source };
            model.reconstruct(&sphere, degree).map_err(of_model)
        };
        let (low, middle, high) = (along(-3.0)?, along(0.0)?, along(3.0)?);
        let panels = [(&low, "mode 1, −3 sd"), (&middle, "mean"), (&high, "mode 1, +3 sd")];
        let still = still(&panels.map(|(mesh, caption)| Panel::new(mesh, caption)))?;
        let deviations: Vec<f64> = modes.variances.iter().map(|variance| variance.sqrt()).collect();
        let in_deviations = |(score, deviation): (&f64, &f64)| if *deviation > 0.0 { score / deviation } else { 0.0 };
        let member = |(name, scores): (&String, ndarray::ArrayView1<'_, f64>)| Member {
            name: name.clone(),
            scores: scores.iter().zip(&deviations).map(in_deviations).collect(),
        };
        let item = Self {
            kind: "modes",
            name: name.to_owned(),
            degree,
            grid: Grid::of_sphere(&sphere, blocks),
            coefficients: blocks.f32(modes.mean.iter().copied()),
            modes: blocks.f32(modes.modes.iter().copied()),
            shares: modes.variances.iter().map(|variance| share(*variance, modes.total_variance)).collect(),
            members: shapes.members.iter().zip(modes.scores.rows()).map(member).collect(),
            deviations,
        };
        Ok((item, still))
    }
}

fn share(variance: f64, total: f64) -> f64 {
    if total > 0.0 { variance / total } else { 0.0 }
}
