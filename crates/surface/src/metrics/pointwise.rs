//! A distance for each vertex of a reconstruction, to be shown in colour.

use rayon::prelude::*;

use super::vertexwise::squared_distances;
use crate::error::SurfaceError;
use crate::mesh::Mesh;
use crate::nearest::TriangleTree;
use crate::topology::different_triangles;

/// Returns whether two meshes have as many vertices and the same triangles, so that their vertices correspond.
#[must_use]
pub fn correspond(a: &Mesh, b: &Mesh) -> bool {
    a.vertices.len() == b.vertices.len() && different_triangles(&a.faces, &b.faces) == 0
}

/// Returns the distance of each vertex of a reconstruction from the original's vertex of the same number, in the
/// coordinates' unit.
///
/// # Errors
///
/// [`LengthMismatch`](SurfaceError::LengthMismatch) where the numbers of vertices differ.
pub fn vertex_distances(original: &[[f64; 3]], reconstruction: &[[f64; 3]]) -> Result<Vec<f64>, SurfaceError> {
    Ok(squared_distances(original, reconstruction)?.into_iter().map(f64::sqrt).collect())
}

/// Returns the distance of each point from the nearest point of a surface, in the coordinates' unit.
///
/// # Errors
///
/// [`Argument`](SurfaceError::Argument) for a point that isn't finite, or a surface without triangles.
///
/// # Panics
///
/// When a triangle names a vertex that isn't there.
pub fn distances_to_surface(surface: &Mesh, points: &[[f64; 3]]) -> Result<Vec<f64>, SurfaceError> {
    let tree = TriangleTree::new(surface);
    let distance = |point: &[f64; 3]| {
        tree.nearest(*point).map(|nearest| nearest.distance).ok_or_else(|| SurfaceError::Argument {
            what: "point to measure the distance of a surface from",
            expected: "finite coordinates, and a surface with triangles",
            found: format!("{point:?}, and {} triangles", surface.faces.len()),
        })
    };
    points.par_iter().map(distance).collect()
}
