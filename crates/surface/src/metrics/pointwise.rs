//! Measures the distance between a surface and its reconstruction at each vertex, for display in colour.

use rayon::prelude::*;
use spharm_monitor::{Monitor, Stage};

use super::vertexwise::squared_distances;
use crate::error::SurfaceError;
use crate::geometry::Vec3;
use crate::mesh::Mesh;
use crate::nearest::TriangleTree;
use crate::range::{exponent, scale_all, scaled_points};
use crate::topology::different_triangles;

/// Returns whether two meshes have the same number of vertices and the same triangles, in any order. In this case,
/// their vertices correspond.
#[must_use]
pub fn correspond(a: &Mesh, b: &Mesh) -> bool {
    a.vertices.len() == b.vertices.len() && different_triangles(&a.faces, &b.faces) == 0
}

/// Returns the distance of each vertex of a reconstruction from the original's vertex of the same index, in the
/// coordinates' unit.
///
/// # Errors
///
/// [`LengthMismatch`](SurfaceError::LengthMismatch) if the numbers of vertices differ.
pub fn vertex_distances(original: &[[f64; 3]], reconstruction: &[[f64; 3]]) -> Result<Vec<f64>, SurfaceError> {
    let exponent = exponent(original.iter().chain(reconstruction).flatten().copied());
    if exponent == 0 {
        return Ok(squared_distances(original, reconstruction)?.into_iter().map(f64::sqrt).collect());
    }
    let [original, reconstruction] = [original, reconstruction].map(|points| scaled_points(points, exponent));
    let mut distances = vertex_distances(&original, &reconstruction)?;
    scale_all(&mut distances, exponent);
    Ok(distances)
}

/// Returns the distance of each point from the nearest point of a surface, in the coordinates' unit.
///
/// # Errors
///
/// [`Argument`](SurfaceError::Argument) for a point that isn't finite, or a surface without triangles;
/// [`Interrupted`](SurfaceError::Interrupted) if the monitor asks to stop.
///
/// # Panics
///
/// Panics if a triangle's index is out of range.
pub fn distances_to_surface(
    surface: &Mesh,
    points: &[[f64; 3]],
    monitor: &dyn Monitor,
) -> Result<Vec<f64>, SurfaceError> {
    let exponent = exponent(surface.vertices.iter().chain(points).flatten().copied());
    if exponent != 0 {
        let surface = surface.with_vertices(scaled_points(&surface.vertices, exponent));
        let mut distances = distances_to_surface(&surface, &scaled_points(points, exponent), monitor)?;
        scale_all(&mut distances, exponent);
        return Ok(distances);
    }
    let tree = TriangleTree::new(surface);
    let none = |point: Vec3| SurfaceError::Argument {
        what: "point whose distance from a surface is measured",
        expected: "finite coordinates and a surface with triangles",
        found: format!("the point {point:?} and a surface with {} triangles", surface.faces.len()),
    };
    nearest_distances(&tree, points, none, monitor)
}

/// Returns the number of bytes that [`distances_to_surface`] needs for a surface of `faces` triangles and `points`
/// points: 250 per triangle for the search tree while it is built, and 8 per point.
#[must_use]
pub fn distances_to_surface_bytes(faces: usize, points: usize) -> u64 {
    250 * faces as u64 + 8 * points as u64
}

/// Returns the distance of each point from the nearest triangle. For a point that has no nearest triangle, returns the
/// error that `none` creates.
pub(super) fn nearest_distances(
    tree: &TriangleTree,
    points: &[Vec3],
    none: impl Fn(Vec3) -> SurfaceError + Sync,
    monitor: &dyn Monitor,
) -> Result<Vec<f64>, SurfaceError> {
    /// Number of points between checks of the monitor. The number is small, because the search takes milliseconds for a
    /// point in the middle of a sphere, which is equally near to all triangles.
    const CHUNK: usize = 16;
    /// Number of points that are searched one after another. Each search starts from the triangle nearest to the
    /// previous point, since consecutive points are mostly close. If several triangles are equally near up to rounding,
    /// the order of points can change the last digit of a distance.
    const RUN: usize = 16 * CHUNK;
    monitor.begin(Stage::counted("distance", "points"), points.len() as u64);
    let mut distances = vec![0.0; points.len()];
    distances.par_chunks_mut(RUN).zip(points.par_chunks(RUN)).try_for_each(|(distances, points)| {
        let mut near = None;
        for (distances, points) in distances.chunks_mut(CHUNK).zip(points.chunks(CHUNK)) {
            monitor.check()?;
            for (distance, &point) in distances.iter_mut().zip(points) {
                let (triangle, found) = tree.distance(point, near).ok_or_else(|| none(point))?;
                (*distance, near) = (found, Some(triangle));
            }
            monitor.step(points.len() as u64);
        }
        Ok::<_, SurfaceError>(())
    })?;
    monitor.end();
    Ok(distances)
}
