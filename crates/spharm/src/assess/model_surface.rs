//! Measures the distances between a model and its surface as distances between two surfaces, for which no corresponding
//! points are needed.
//!
//! The measures msd and xsd (mean and maximum squared distance at the vertices) compare each vertex with the model's
//! value in that vertex's direction. Finely meshed parts of a surface have more vertices and therefore more influence.
//! For a shape, the relevant quantity is the distance between two surfaces, which doesn't depend on corresponding
//! points. Here the model is evaluated on an icosphere with about twice as many vertices as a fit of the model's degree
//! has samples. Distances are measured both ways: from points spread over each surface to the nearest point of the
//! other surface.

use std::f64::consts::PI;

use ndarray::ArrayView2;
use serde::Serialize;
use spharm_harmonics::{Directions, basis_size};
use spharm_monitor::{Monitor, OnlyCancel};
use spharm_surface::generate::icosphere;
use spharm_surface::metrics::{SurfaceDistanceParams, surface_distance};
use spharm_surface::{Mesh, Sphere, SurfaceError};
use spharm_transform::{Transform, TransformParams};

use crate::Error;

/// Distances from the model to its surface and from the surface to the model, taken over each one's area. If weights of
/// 0 exclude a part of the surface, only distances from the remaining surface to the model are measured.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct SurfaceDistances {
    /// Root mean square distance, with the surface's bounding box scaled to volume 1.
    pub rms: f64,
    /// 95th percentile of the distance over the area, with the bounding box scaled to volume 1.
    pub percentile95: f64,
    /// Hausdorff distance, the largest distance, with the bounding box scaled to volume 1.
    pub hausdorff: f64,
    /// Root mean square distance in the surface's own unit.
    pub rms_raw: f64,
    /// 95th percentile of the distance in the surface's own unit.
    pub percentile95_raw: f64,
    /// Hausdorff distance in the surface's own unit.
    pub hausdorff_raw: f64,
    /// Number of points inside triangles from which distances were measured, in addition to the vertices.
    pub points: usize,
    /// Number of vertices of the model's icosphere.
    pub model_vertices: usize,
}

/// Triangles of a surface that are compared with the surface's model.
pub(crate) struct ReadSurface {
    faces: Vec<[u32; 3]>,
    /// Whether `faces` contains all triangles of the surface.
    whole: bool,
}

impl ReadSurface {
    /// Selects the triangles of a sphere that have no corner marked in `unread`.
    pub(crate) fn new(sphere: &Sphere, unread: Option<&[bool]>) -> Self {
        let is_read = |face: &&[u32; 3]| {
            unread.is_none_or(|unread| face.iter().all(|&v| !unread.get(v as usize).copied().unwrap_or(false)))
        };
        let faces: Vec<[u32; 3]> = sphere.faces.iter().filter(is_read).copied().collect();
        Self { whole: faces.len() == sphere.faces.len(), faces }
    }
}

/// Minimum number of icosphere vertices per basis function. With this number, the edges of the icosphere are a sixth of
/// the shortest wavelength of the basis functions.
const VERTICES_PER_FUNCTION: usize = 12;

/// Number of points on each surface, per basis function, from which distances are measured. A fit uses a quarter as
/// many samples.
const POINTS_PER_FUNCTION: usize = 24;

/// Minimum and maximum number of subdivisions of the icosphere, which give 2,562 and 655,362 vertices.
const LEVELS: [u32; 2] = [4, 8];

/// Accuracy of the model's values on the icosphere, relative to its coefficients.
const ACCURACY: f64 = 1e-9;

/// Before distances are measured, a model's mean position is subtracted along each axis on which it is farther from the
/// origin than this multiple of the bounding box's size.
const FAR: f64 = 1000.0;

/// An icosphere on which models of one degree are evaluated, to compare the models with their surfaces.
pub(crate) struct ModelSurface {
    sphere: Mesh,
    transform: Transform,
    points: usize,
}

fn params(max_degree: usize) -> TransformParams {
    TransformParams { max_degree, accuracy: ACCURACY, channels: 3 }
}

fn vertices(level: u32) -> usize {
    10 * 4usize.pow(level) + 2
}

impl ModelSurface {
    /// Returns the number of subdivisions of the icosphere for models of degree `max_degree`, reduced if necessary so
    /// that `bytes` bytes of memory suffice. Returns `None` if they don't suffice for the smallest number.
    pub(crate) fn level(max_degree: usize, faces: usize, bytes: usize) -> Option<u32> {
        let wanted = VERTICES_PER_FUNCTION * basis_size(max_degree);
        let level = (LEVELS[0]..LEVELS[1]).find(|&level| vertices(level) >= wanted).unwrap_or(LEVELS[1]);
        (LEVELS[0]..=level)
            .rev()
            .find(|&level| Self::bytes(max_degree, level, faces).is_some_and(|needed| needed <= bytes))
    }

    /// Returns the number of bytes that a comparison with a surface of `faces` triangles needs.
    fn bytes(max_degree: usize, level: u32, faces: usize) -> Option<usize> {
        /// Bytes per triangle and per point, as in [`spharm_surface::metrics::surface_distance_bytes`].
        const TRIANGLE: usize = 370;
        const POINT: usize = 136;
        let nodes = vertices(level);
        let transform = Transform::bytes(&params(max_degree), nodes, 3).ok()?;
        let triangles = faces.max(2 * nodes);
        // There is one point at each vertex (about half as many vertices as triangles), at least one point in each
        // triangle, and more points in large triangles.
        let points = POINTS_PER_FUNCTION * basis_size(max_degree) + triangles + triangles / 2;
        // A mesh takes 48 bytes per vertex. The memory holds the icosphere, the model's mesh and its values, and the
        // surface.
        let meshes = (48 + 48 + 24) * nodes + 24 * faces;
        Some(transform + TRIANGLE * triangles + POINT * points + meshes)
    }

    /// Prepares comparisons on an icosphere.
    pub(crate) fn new(max_degree: usize, level: u32) -> Result<Self, Error> {
        let sphere = icosphere(level);
        let directions = Directions::from_vertices(&sphere.vertices)?;
        let transform = Transform::new(&directions, &params(max_degree))?;
        Ok(Self { sphere, transform, points: POINTS_PER_FUNCTION * basis_size(max_degree) })
    }

    /// Returns the distances between the model with the given coefficients and the surface with the given vertices and
    /// the triangles selected in `read`. Returns `None` if the surface has no area or its bounding box has no volume.
    pub(crate) fn assess(
        &self,
        coefficients: ArrayView2<'_, f64>,
        vertices: ArrayView2<'_, f64>,
        read: &ReadSurface,
        scale: Option<f64>,
        monitor: &dyn Monitor,
    ) -> Result<Option<SurfaceDistances>, Error> {
        let Some(scale) = scale else { return Ok(None) };
        // The transform's errors are proportional to the largest coefficients. If the model is far from the origin, the
        // largest coefficients are those of its position. Therefore the mean position is subtracted from both the model
        // and the surface before distances are measured.
        let mean: [f64; 3] = std::array::from_fn(|k| {
            let value = coefficients[[0, k]] / (4.0 * PI).sqrt();
            if value.abs() > FAR * scale { value } else { 0.0 }
        });
        let mut centred = coefficients.to_owned();
        centred.row_mut(0).iter_mut().zip(mean).for_each(|(value, mean)| *value -= mean * (4.0 * PI).sqrt());
        let points = |rows: ArrayView2<'_, f64>, mean: [f64; 3]| -> Vec<[f64; 3]> {
            rows.rows().into_iter().map(|row| std::array::from_fn(|k| row[k] - mean[k])).collect()
        };
        let surface = Mesh::new(points(vertices, mean), read.faces.clone());
        let model = self.sphere.with_vertices(points(self.transform.synthesis(centred.view())?.view(), [0.0; 3]));
        let params = SurfaceDistanceParams { samples: self.points };
        let found = match surface_distance(&surface, &model, &params, &OnlyCancel(monitor)) {
            // The surface has no area in floating point, for example because one vertex is 1e300 times as far away as
            // the others.
            Err(SurfaceError::Argument { .. }) => return Ok(None),
            found => found?,
        };
        // If a part of the surface is excluded, the model can't be compared with it, so only distances from the surface
        // to the model are used.
        let (rms, percentile95, hausdorff, points) = if read.whole {
            let points = found.forward.samples + found.backward.samples;
            (found.rms, found.percentile95, found.hausdorff, points)
        } else {
            let there = &found.forward;
            (there.rms, there.percentile95, there.max, there.samples)
        };
        Ok(Some(SurfaceDistances {
            rms: rms / scale,
            percentile95: percentile95 / scale,
            hausdorff: hausdorff / scale,
            rms_raw: rms,
            percentile95_raw: percentile95,
            hausdorff_raw: hausdorff,
            points,
            model_vertices: self.sphere.vertices.len(),
        }))
    }
}

#[cfg(test)]
mod tests {
    use spharm_surface::metrics::surface_distance_bytes;

    use super::*;

    #[test]
    fn the_memory_of_a_comparison_is_within_its_estimate() {
        for (max_degree, subdivisions) in [(8, 3), (20, 5), (40, 4)] {
            let surface = icosphere(subdivisions);
            let faces = surface.faces.len();
            let level = ModelSurface::level(max_degree, faces, usize::MAX).expect("a level");
            let model = icosphere(level);
            let sampling = SurfaceDistanceParams { samples: POINTS_PER_FUNCTION * basis_size(max_degree) };
            let bytes = |mesh: &Mesh| (24 * mesh.vertices.len() + 12 * mesh.faces.len()) as u64;
            let needed = surface_distance_bytes(&surface, &model, &sampling) + 2 * bytes(&model) + bytes(&surface);
            let transform = Transform::bytes(&params(max_degree), vertices(level), 3).expect("a degree in range");
            let planned = ModelSurface::bytes(max_degree, level, faces).expect("a degree in range") - transform;
            assert!(planned as u64 >= needed, "degree {max_degree}: {planned} of {needed} bytes");
        }
    }
}
