//! Measures the distance between a compressed model and the original.
//!
//! For surfaces the distance is the larger of two lengths, divided by the cube root of the bounding box's volume:
//!
//! - the root mean square distance from points all over each surface to the nearest point of the other surface, in both
//!   directions ([`surface_distance`]), regardless of which points correspond;
//! - the root mean square displacement of the surface's points along its normal, over the surface's area. To first
//!   order, it equals the distance above.
//!
//! Both lengths are measured on the same icosphere, which has at least 8 vertices per basis function. The flat
//! triangles smooth out some of the error at the vertices. The distances are therefore up to 7 % below the
//! displacements. With 4 vertices per basis function, the difference would be 8 % at degree 100. If a surface folds,
//! the displacements may be smaller than the distances.
//!
//! At degree 100, computing the distances takes seconds, but computing the displacements takes only one synthesis.
//! Therefore the search for the step uses only displacements, and its result is verified by both lengths. For signals
//! the distance is the root mean square error over the sphere, with each channel divided by its standard deviation over
//! the sphere. It is computed exactly by Parseval's identity.

use std::f64::consts::PI;

use ndarray::{Array2, ArrayView1, ArrayView2};
use spharm_harmonics::{Coefficients, Directions, basis_size};
use spharm_monitor::{Monitor, OnlyCancel, Silent};
use spharm_surface::Mesh;
use spharm_surface::generate::icosphere;
use spharm_surface::geometry::{dot, sub, vertex_normals};
use spharm_surface::metrics::{SurfaceDistanceParams, bounding_box_scale, surface_distance};
use spharm_transform::{Transform, TransformParams};

use super::error::CodecError;

/// Minimum number of vertices of the icosphere per basis function.
const VERTICES_PER_FUNCTION: usize = 8;
/// Number of sampled points on each surface per basis function.
const POINTS_PER_FUNCTION: usize = 24;

/// Minimum and maximum number of subdivisions of the icosphere: 2,562 and 655,362 vertices.
const LEVELS: [u32; 2] = [4, 8];

/// Accuracy of the evaluated vertices, relative to the surface's size.
const ACCURACY: f64 = 1e-11;

/// The original model, with which compressed models are compared.
pub(super) enum Reference<'a> {
    /// A surface, evaluated on an icosphere.
    Surface(Box<Surface>),
    /// The coefficients (K, c) of a signal.
    Signal(ArrayView2<'a, f64>),
}

/// A surface evaluated on its icosphere.
pub(super) struct Surface {
    transform: Transform,
    mesh: Mesh,
    /// Normal at each vertex. The length of the normal is six times the area that belongs to the vertex.
    normals: Vec<[f64; 3]>,
    scale: f64,
    points: usize,
}

impl<'a> Reference<'a> {
    /// Prepares the original model, given its coefficients (K, c).
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
        let normals = vertex_normals(&mesh.vertices, &mesh.faces);
        Ok(Self::Surface(Box::new(Surface { transform, mesh, normals, scale, points })))
    }

    /// Returns the length, in the model's unit, of a relative step or distance of 1: one value per channel of a signal,
    /// or a single value for a surface.
    pub(super) fn scales(&self) -> Vec<f64> {
        match self {
            Self::Surface(surface) => vec![surface.scale],
            Self::Signal(values) => values.columns().into_iter().map(deviation).collect(),
        }
    }

    /// Returns a cheap estimate of [`distance`](Self::distance): the displacement of a surface, or the error of a
    /// signal.
    pub(super) fn estimate(&self, coefficients: &Array2<f64>) -> Result<f64, CodecError> {
        match self {
            Self::Surface(surface) => surface.estimate(coefficients),
            Self::Signal(_) => self.distance(coefficients, &Silent),
        }
    }

    /// Returns the relative distance between the original and the model with the given coefficients (K, c); infinity if
    /// this model's surface is a point.
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

/// Returns the standard deviation over the sphere of the function with the given coefficients. For a constant function,
/// returns its magnitude; for the zero function, returns 1.
fn deviation(column: ArrayView1<'_, f64>) -> f64 {
    let norm = |skip: usize| {
        let values = || column.iter().skip(skip);
        // Values are scaled to avoid overflow, because the model's unit is arbitrary.
        let largest = values().fold(0.0, |largest: f64, value| largest.max(value.abs()));
        let scaled: f64 = values().map(|value| (value / largest).powi(2)).sum();
        if largest > 0.0 { largest * (scaled / (4.0 * PI)).sqrt() } else { 0.0 }
    };
    [norm(1), norm(0)].into_iter().find(|&norm| norm > 0.0).unwrap_or(1.0)
}

impl Surface {
    fn estimate(&self, coefficients: &Array2<f64>) -> Result<f64, CodecError> {
        Ok(self.displacement(&evaluate(&self.transform, &self.mesh, coefficients.view())?))
    }

    /// Returns the root mean square displacement from the original surface to `moved` along the original's normals,
    /// relative to the scale.
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
