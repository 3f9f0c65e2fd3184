//! Generates double pyramids.

use std::f64::consts::TAU;

use crate::mesh::Mesh;

/// Returns a double pyramid over a regular polygon of `sides` vertices, wound outwards. The polygon's vertices come
/// first and lie on the unit circle of the xy-plane. The poles (0, 0, 1) and (0, 0, -1) follow, and each pole belongs
/// to `sides` triangles. If `sides` is large, all triangles are slivers, like those around the poles of a
/// latitude-longitude grid or of a surface of revolution.
#[must_use]
pub fn bipyramid(sides: u32) -> Mesh {
    let round = |k: u32| f64::from(k) * TAU / f64::from(sides);
    let mut vertices: Vec<[f64; 3]> = (0..sides).map(|k| [round(k).cos(), round(k).sin(), 0.0]).collect();
    vertices.extend([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]);
    let next = |k: u32| (k + 1) % sides;
    let faces = (0..sides).flat_map(|k| [[k, next(k), sides], [next(k), k, sides + 1]]).collect();
    Mesh::new(vertices, faces)
}
