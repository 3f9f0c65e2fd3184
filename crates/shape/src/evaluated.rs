//! Evaluates models as triangulated surfaces for pose estimation.

use ndarray::{ArrayView2, s};
use spharm_harmonics::{Directions, basis_size};
use spharm_surface::Mesh;
use spharm_surface::generate::icosphere;
use spharm_surface::pose::PoseSurface;
use spharm_transform::{Transform as Synthesis, TransformParams};

use crate::error::ShapeError;
use crate::transform::{Similarity, Transform};

/// Number of subdivisions of the icosphere, which then has 2,562 vertices.
const LEVEL: u32 = 4;
/// Accuracy of the evaluated vertices, relative to the coefficients.
const ACCURACY: f64 = 1e-6;

/// Sphere and transform with which models are evaluated at one degree.
pub(crate) struct Evaluated {
    sphere: Mesh,
    transform: Synthesis,
    degree: usize,
}

impl Evaluated {
    pub(crate) fn new(degree: usize) -> Result<Self, ShapeError> {
        let sphere = icosphere(LEVEL);
        let params = TransformParams { max_degree: degree, accuracy: ACCURACY, channels: 3 };
        let transform = Synthesis::new(&Directions::from_vertices(&sphere.vertices)?, &params)?;
        Ok(Self { sphere, transform, degree })
    }

    /// Returns the surface with the coefficients `coefficients` (K, 3), or `None` if it is a point or a line. The
    /// degree of the coefficients must be at least the evaluator's degree. Higher degrees are ignored.
    pub(crate) fn surface(&self, coefficients: ArrayView2<'_, f64>) -> Result<Option<PoseSurface>, ShapeError> {
        let rows = self.transform.synthesis(coefficients.slice_move(s![..basis_size(self.degree), ..]))?;
        let vertices = rows.rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect();
        Ok(PoseSurface::new(&self.sphere.with_vertices(vertices)))
    }
}

/// Returns the transform that applies `similarity`, which aligns the moving surface to the fixed one. The transform
/// also mirrors the sphere of the moving surface if the two surfaces would otherwise have opposite orientations.
pub(crate) fn in_pose(similarity: Similarity, moving: &PoseSurface, fixed: &PoseSurface) -> Transform {
    let outside = moving.volume * fixed.volume > 0.0;
    Transform { antipodal: similarity.mirrors() == outside, similarity, ..Transform::default() }
}
