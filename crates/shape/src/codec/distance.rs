//! How far a compressed model is from the model.
//!
//! Of surfaces it is the larger of two root mean squares, divided by the scale that makes the bounding box's volume 1:
//!
//! - of the distances from points all over each surface to the nearest point of the other, both ways
//!   ([`surface_distance`]), whichever points correspond;
//! - over the area, of the displacement along the normal, which is the former to first order.
//!
//! Both are measured on one icosphere, of 8 vertices for each basis function at least, whose triangles smooth some of
//! the error away that its vertices show: the distances are up to 7 % below the displacements (at 4 vertices for each
//! function and degree 100, 8 %). Where a surface folds the displacements may be the smaller.
//!
//! Distances take seconds at degree 100, and displacements one synthesis: steps are searched by the latter, and held
//! against both. Of signals it is the root mean square error over the sphere, exact by Parseval's identity, each
//! channel divided by its standard deviation over the sphere.

use std::f64::consts::PI;

use ndarray::{Array2, ArrayView1, ArrayView2};
use spharm_harmonics::{Coefficients, Directions, basis_size};
use spharm_monitor::{Monitor, OnlyCancel, Silent};
use spharm_surface::Mesh;
use spharm_surface::generate::icosphere;
use spharm_surface::geometry::{add, dot, face_normal, sub};
use spharm_surface::metrics::{SurfaceDistanceParams, bounding_box_scale, surface_distance};
use spharm_transform::{Transform, TransformParams};

use super::error::CodecError;

/// Vertices of the icosphere, and points on each surface, for each basis function.
const VERTICES_PER_FUNCTION: usize = 8;
const POINTS_PER_FUNCTION: usize = 24;

/// Least and most subdivisions: 2,562 and 655,362 vertices.
const LEVELS: [u32; 2] = [4, 8];

/// Accuracy of the surfaces, relative to their size.
const ACCURACY: f64 = 1e-11;

/// Measures models against one.
pub(super) enum Reference<'a> {
    Surface(Box<Surface>),
    Signal(ArrayView2<'a, f64>),
}

/// A surface on its icosphere.
pub(super) struct Surface {
    transform: Transform,
    mesh: Mesh,
    /// At each vertex the normal, as long as six times its share of the area.
    normals: Vec<[f64; 3]>,
    scale: f64,
    points: usize,
}

impl<'a> Reference<'a> {
    /// Prepares for coefficients, (K, c).
    pub(super) fn new(coefficients: &'a Coefficients, surface: bool) -> Result<Self, CodecError> {
        if !surface {
            return Ok(Self::Signal(coefficients.values().view()));
        }
        let max_degree = coefficients.max_degree();
        let functions = basis_size(max_degree);
        let enough = |&level: &u32| 10 * 4usize.pow(level) + 2 >= VERTICES_PER_FUNCTION * functions;
        let sphere = icosphere((LEVELS[0]..LEVELS[1]).find(enough).unwrap_or(LEVELS[1]));
        let params = TransformParams { max_degree, accuracy: ACCURACY, channels: 3 };
        let directions = Directions::from_vertices(&sphere.vertices).map_err(spharm_transform::TransformError::from)?;
        let transform = Transform::new(&directions, &params)?;
        let mesh = evaluate(&transform, &sphere, coefficients.values().view())?;
        let scale = bounding_box_scale(&mesh.vertices)?;
        let points = POINTS_PER_FUNCTION * functions;
        let normals = normals(&mesh);
        Ok(Self::Surface(Box::new(Surface { transform, mesh, normals, scale, points })))
    }

    /// Returns what a relative step or distance of 1 is in the model's unit: of a surface, one for all channels.
    pub(super) fn scales(&self) -> Vec<f64> {
        match self {
            Self::Surface(surface) => vec![surface.scale],
            Self::Signal(values) => values.columns().into_iter().map(deviation).collect(),
        }
    }

    /// Returns the part of [`distance`](Self::distance) that takes a fraction of the time.
    pub(super) fn estimate(&self, coefficients: &Array2<f64>) -> Result<f64, CodecError> {
        match self {
            Self::Surface(surface) => surface.estimate(coefficients),
            Self::Signal(_) => self.distance(coefficients, &Silent),
        }
    }

    /// Returns the relative distance of coefficients, (K, c); infinity where they are those of a point.
    pub(super) fn distance(&self, coefficients: &Array2<f64>, monitor: &dyn Monitor) -> Result<f64, CodecError> {
        match self {
            Self::Surface(surface) => surface.distance(coefficients, monitor),
            Self::Signal(values) => {
                let squares = values.columns().into_iter().zip(coefficients.columns()).map(|(a, b)| {
                    let square: f64 = a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum();
                    square / (4.0 * PI) / deviation(a).powi(2)
                });
                Ok((squares.sum::<f64>() / values.ncols() as f64).sqrt())
            }
        }
    }
}

/// The standard deviation of a function over the sphere; of a constant its magnitude, and 1 of 0.
fn deviation(column: ArrayView1<'_, f64>) -> f64 {
    let norm = |skip: usize| {
        let values = || column.iter().skip(skip);
        // Without overflow, as a unit may be any.
        let largest = values().fold(0.0, |largest: f64, value| largest.max(value.abs()));
        let scaled: f64 = values().map(|value| (value / largest).powi(2)).sum();
        if largest > 0.0 { largest * (scaled / (4.0 * PI)).sqrt() } else { 0.0 }
    };
    [norm(1), norm(0)].into_iter().find(|&norm| norm > 0.0).unwrap_or(1.0)
}

fn normals(mesh: &Mesh) -> Vec<[f64; 3]> {
    let mut normals = vec![[0.0; 3]; mesh.vertices.len()];
    for face in &mesh.faces {
        let normal = face_normal(face.map(|v| mesh.vertices[v as usize]));
        for &v in face {
            normals[v as usize] = add(normals[v as usize], normal);
        }
    }
    normals
}

impl Surface {
    fn estimate(&self, coefficients: &Array2<f64>) -> Result<f64, CodecError> {
        Ok(self.displacement(&evaluate(&self.transform, &self.mesh, coefficients.view())?))
    }

    /// The root mean square displacement along the normal, relative to the scale.
    fn displacement(&self, moved: &Mesh) -> f64 {
        let (mut sum, mut area) = (0.0, 0.0);
        for ((&normal, &from), &to) in self.normals.iter().zip(&self.mesh.vertices).zip(&moved.vertices) {
            let length = dot(normal, normal).sqrt();
            if length > 0.0 {
                sum += dot(normal, sub(to, from)).powi(2) / length;
                area += length;
            }
        }
        (sum / area).sqrt() / self.scale
    }

    fn distance(&self, coefficients: &Array2<f64>, monitor: &dyn Monitor) -> Result<f64, CodecError> {
        if coefficients.iter().skip(3).all(|&value| value == 0.0) {
            return Ok(f64::INFINITY);
        }
        let mesh = evaluate(&self.transform, &self.mesh, coefficients.view())?;
        let params = SurfaceDistanceParams { samples: self.points };
        let between = surface_distance(&self.mesh, &mesh, &params, &OnlyCancel(monitor))?.rms / self.scale;
        Ok(between.max(self.displacement(&mesh)))
    }
}

fn evaluate(transform: &Transform, mesh: &Mesh, coefficients: ArrayView2<'_, f64>) -> Result<Mesh, CodecError> {
    let values = transform.synthesis(coefficients)?;
    Ok(mesh.with_vertices(values.rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect()))
}
