//! Generates icospheres: subdivided icosahedra.

use crate::geometry::{add, unit};
use crate::mesh::Mesh;

use super::subdivide::split;

/// Splits each triangle of an icosahedron in four, `subdivisions` times, and returns the mesh with all vertices on the
/// unit sphere.
///
/// The result of s subdivisions has 10 * 4^s + 2 vertices and 20 * 4^s triangles, which are wound outwards. For
/// example, s = 6 gives 40,962 vertices, and s = 7 gives 163,842. The order of the vertices is fixed: the first 10 *
/// 4^k + 2 vertices are those of the icosphere with k subdivisions, as in FreeSurfer's icospheres.
///
/// # Panics
///
/// Panics for more than 14 subdivisions, because the number of half-edges would exceed 32 bits.
#[must_use]
pub fn icosphere(subdivisions: u32) -> Mesh {
    assert!(subdivisions <= 14, "expected at most 14 subdivisions of the icosahedron, found {subdivisions}");
    let mut mesh = icosahedron();
    for _ in 0..subdivisions {
        mesh = split(&mesh, |a, b| unit(add(a, b)));
    }
    mesh
}

/// Returns the number of vertices and the number of triangles of an [`icosphere`].
///
/// # Panics
///
/// Panics for more than 29 subdivisions, because the number of vertices would exceed 64 bits.
#[must_use]
pub fn icosphere_counts(subdivisions: u32) -> [u64; 2] {
    assert!(subdivisions <= 29, "expected at most 29 subdivisions of the icosahedron, found {subdivisions}");
    let quarter = 1 << (2 * subdivisions);
    [10 * quarter + 2, 20 * quarter]
}

/// Returns the number of bytes that [`icosphere`] needs: per vertex, 48 for the mesh, 12 for the mesh with one
/// subdivision less, and up to 26 for the table of that smaller mesh's edges.
///
/// # Panics
///
/// Panics in the same cases as [`icosphere_counts`].
#[must_use]
pub fn icosphere_bytes(subdivisions: u32) -> u64 {
    86 * icosphere_counts(subdivisions)[0]
}

/// Returns the icosahedron: a pole, a ring of five vertices, another ring rotated by a tenth of a turn, the other pole.
fn icosahedron() -> Mesh {
    let z = 1.0 / 5.0_f64.sqrt();
    let r = 2.0 * z;
    let ring = |turn: f64, z: f64| {
        (0..5).map(move |k| {
            let phi = (f64::from(k) + turn) * std::f64::consts::TAU / 5.0;
            unit([r * phi.cos(), r * phi.sin(), z])
        })
    };
    let mut vertices = vec![[0.0, 0.0, 1.0]];
    vertices.extend(ring(0.0, z));
    vertices.extend(ring(0.5, -z));
    vertices.push([0.0, 0.0, -1.0]);
    let mut faces = Vec::with_capacity(20);
    for k in 0..5 {
        let (upper, upper_next) = (1 + k, 1 + (k + 1) % 5);
        let (lower, lower_next) = (6 + k, 6 + (k + 1) % 5);
        faces.extend([
            [0, upper, upper_next],
            [upper, lower, upper_next],
            [upper_next, lower, lower_next],
            [11, lower_next, lower],
        ]);
    }
    Mesh::new(vertices, faces)
}
