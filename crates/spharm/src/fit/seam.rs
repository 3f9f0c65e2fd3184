//! Includes the seams in the fit of a surface whose handles were cut.
//!
//! A vertex of a seam occurs twice on the cut surface, at unrelated positions on the sphere. The fit has a different
//! error at each of these positions, and the difference is a gap between the two sides of the seam. A line has no
//! area, so the integral over the sphere ignores the seam. Therefore a sum over the vertices of the seams is added to
//! that integral,
//!
//! ```text
//! integral over the surface  +  density (L / 6)^2 (pi / L)  sum over the seams' vertices  s |f(u) - x|^2
//! ```
//!
//! with f(u) the model's value in a vertex's direction u, x the vertex's position, s half the length on the sphere of
//! the vertex's edges along the seam, and the density equal to the surface's weight per steradian. The sum corresponds
//! to a strip along the seam with weight (L / 6)^2. The strip is as wide as the resolution pi / L of a model of degree
//! L. At low degrees, a seam takes up a larger part of a model's degrees of freedom, so it gets a smaller weight. A
//! model of degree 60 has enough functions that are large only at the seam. For such a model of a double torus, the gap
//! between the sides is 4.4e-3 of the bounding box's size without the added vertices and 6.0e-4 with them. The root
//! mean square error at all vertices is 1.24e-3 without and 1.26e-3 with them.
//!
//! Points between the vertices aren't added. Triangles are chords of the surface, and a loop of their edges has a
//! corner at each vertex. No model can follow these corners. If points between the vertices are added, the gap is
//! 2.9e-3.

use std::collections::BTreeMap;
use std::collections::HashSet;
use std::f64::consts::PI;

use ndarray::{Array2, ArrayView2, Axis};
use spharm_surface::geometry::{dot, sub};
use spharm_surface::{Seam, Sphere};

/// Degree at which the strip along a seam has weight 1. In a fit of degree L, the strip has width pi / L and weight
/// (L / 6)^2.
const ONCE: f64 = 6.0;

/// The vertices of a sphere's seams.
pub(crate) struct SeamVertices {
    vertices: Vec<usize>,
    /// Weight of each vertex for a surface of weight 1 per steradian. The weight is proportional to the total length of
    /// the vertex's edges along the seams.
    lengths: Vec<f64>,
}

impl SeamVertices {
    /// Returns the seams' vertices for models of a degree, or `None` for a sphere without a seam.
    pub(crate) fn of(sphere: &Sphere, max_degree: usize) -> Option<Self> {
        let (at, degree) = (sphere.directions.as_slice(), max_degree as f64);
        let mut lengths: BTreeMap<usize, f64> = BTreeMap::new();
        for edge in edges(sphere.seam.as_ref()?, &sphere.faces) {
            let [a, b] = edge.map(|v| v as usize);
            let along = sub(at[a], at[b]);
            let length = PI * degree / (ONCE * ONCE) * dot(along, along).sqrt();
            for vertex in [a, b] {
                *lengths.entry(vertex).or_default() += 0.5 * length;
            }
        }
        let (vertices, lengths): (Vec<usize>, Vec<f64>) = lengths.into_iter().unzip();
        (!vertices.is_empty()).then_some(Self { vertices, lengths })
    }

    /// Returns the weight of each vertex of the seams, for a surface of weight `density` per steradian. `of_vertices`
    /// are weights of the sphere's vertices. If they are given, each result is multiplied by the weight of its vertex.
    pub(crate) fn weights(&self, density: f64, of_vertices: Option<&[f64]>) -> Vec<f64> {
        let times = |&vertex: &usize| of_vertices.map_or(1.0, |weights| weights[vertex]);
        self.lengths.iter().zip(&self.vertices).map(|(length, vertex)| density * length * times(vertex)).collect()
    }

    /// Returns the indices of the seams' vertices, ascending.
    pub(crate) fn vertices(&self) -> &[usize] {
        &self.vertices
    }

    /// Returns the directions of the seams' vertices.
    pub(crate) fn directions(&self, sphere: &Sphere) -> Vec<[f64; 3]> {
        self.vertices.iter().map(|&vertex| sphere.directions.as_slice()[vertex]).collect()
    }

    /// Returns the rows of `values` (vertices x channels) at the seams' vertices.
    pub(crate) fn rows_of(&self, values: ArrayView2<'_, f64>) -> Array2<f64> {
        values.select(Axis(0), &self.vertices)
    }
}

/// Returns the edges between the given surface and the triangles that fill its cuts.
fn edges(seam: &Seam, faces: &[[u32; 3]]) -> Vec<[u32; 2]> {
    let (own, filling) = faces.split_at(seam.faces.min(faces.len()));
    let of = |face: &[u32; 3]| [[face[0], face[1]], [face[1], face[2]], [face[2], face[0]]];
    let of_fillings: HashSet<[u32; 2]> = filling.iter().flat_map(of).map(|[a, b]| [b, a]).collect();
    own.iter().flat_map(of).filter(|edge| of_fillings.contains(edge)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The sphere is an icosahedron whose last triangle is treated as a filling, so the triangle's three edges are the
    /// seam.
    #[test]
    fn a_vertex_counts_by_its_share_of_the_seam() {
        let mut sphere = Sphere::icosphere(0);
        assert!(SeamVertices::of(&sphere, 4).is_none());
        sphere.seam = Some(Seam { vertices: 12, faces: 20, copies: Vec::new() });
        assert!(SeamVertices::of(&sphere, 4).is_none(), "nothing was filled");
        sphere.seam = Some(Seam { vertices: 12, faces: 19, copies: Vec::new() });
        let edge = 1.051_462_224_238_267;
        let mut corners: Vec<usize> = sphere.faces[19].iter().map(|&v| v as usize).collect();
        corners.sort_unstable();
        for degree in [6, 60] {
            let seam = SeamVertices::of(&sphere, degree).unwrap();
            assert_eq!(seam.vertices, corners);
            // The expected weight is (L / 6)^2 pi / L times half the length of each of the two edges that meet in the
            // vertex.
            let expected = (degree as f64 / 6.0).powi(2) * PI / degree as f64 * edge;
            assert!(seam.weights(1.0, None).iter().all(|weight| (weight / expected - 1.0).abs() < 1e-12));
            let of_vertices: Vec<f64> = (0..12).map(f64::from).collect();
            for (weight, &vertex) in seam.weights(2.0, Some(&of_vertices)).iter().zip(&corners) {
                assert!((weight - 2.0 * expected * vertex as f64).abs() < 1e-12);
            }
            let values = Array2::from_shape_fn((12, 2), |(row, column)| (10 * row + column) as f64);
            assert_eq!(
                seam.rows_of(values.view()).column(1).to_vec(),
                corners.iter().map(|&v| (10 * v + 1) as f64).collect::<Vec<_>>()
            );
            assert_eq!(seam.directions(&sphere)[2], sphere.directions.as_slice()[corners[2]]);
        }
    }
}
