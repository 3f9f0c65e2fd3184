//! Estimates the memory that each mapping method needs.
//!
//! The memory is linear in the number of vertices, except for the model that adapts the areas. The memory for this
//! model's samples and for the tables of its transform grows with the square of the model's degree.

use spharm_surface::generate::icosphere_counts;

use crate::cald::CaldParams;
use crate::method::{Method, Source};
use crate::residual_areas::degree_for;

/// Number of bytes per vertex that any method needs for the hierarchy, the triangles and their derivatives, and the
/// matrices of the Newton steps. Measured: cald 2.1 kB (655,362 vertices) to 2.9 kB (40,962 vertices), conformal and
/// stretch 2.1 kB.
const BYTES_PER_VERTEX: u64 = 3000;

/// Number of bytes for the samples and the transform of a model of degree L, divided by L^2. Measured: 2.8 kB (L = 100)
/// to 5.3 kB (L = 34).
const BYTES_PER_SQUARED_DEGREE: u64 = 5500;

/// Number of bytes that any method needs independently of the surface.
const FIXED: u64 = 4 << 20;

impl Method {
    /// Returns an estimate of the largest number of bytes in use while a surface of `vertices` vertices is mapped,
    /// including the result.
    #[must_use]
    pub fn bytes(&self, vertices: usize) -> u64 {
        let adapting = |params: &CaldParams| {
            let degree = degree_for(vertices, params.degree) as u64;
            BYTES_PER_SQUARED_DEGREE.saturating_mul(degree * degree)
        };
        let of_surface = FIXED + BYTES_PER_VERTEX.saturating_mul(vertices as u64);
        of_surface.saturating_add(match self {
            Self::Auto(params) | Self::Cald(params) => adapting(params),
            Self::Conformal(_) | Self::Stretch(_) | Self::EqualArea(_) => 0,
            Self::Deform { params, map } => {
                let subdivisions = params.subdivisions.unwrap_or_else(|| next_icosphere(vertices as u64));
                // The 1500 bytes per vertex cover the neighbours of the vertices, the search tree of the surface, and
                // the vectors of the sweeps.
                adapting(map) + 2 * FIXED + 1500 * icosphere_counts(subdivisions)[0]
            }
        })
    }
}

impl Source<'_> {
    /// Returns the surface's number of vertices.
    #[must_use]
    pub fn vertices(&self) -> usize {
        match self {
            Self::Mesh(mesh) => mesh.vertices.len(),
            Self::Quads(quads) => quads.vertices.len(),
        }
    }
}

/// Returns the default number of subdivisions of `deform` for a surface.
fn next_icosphere(vertices: u64) -> u32 {
    (0..7).find(|&subdivisions| icosphere_counts(subdivisions)[0] >= vertices).unwrap_or(7)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deform::DeformParams;

    #[test]
    fn figures_grow_with_vertices_degree_and_subdivisions() {
        let auto = |degree| Method::Auto(CaldParams { degree, ..CaldParams::default() });
        assert!(auto(None).bytes(10_242) > auto(Some(5)).bytes(10_242));
        assert!(auto(Some(5)).bytes(40_962) > 3 * auto(Some(5)).bytes(10_242));
        // Both degrees are lowered to the same degree: the largest that this number of vertices determines.
        assert_eq!(auto(Some(1000)).bytes(642), auto(Some(2000)).bytes(642));
        let deform = |subdivisions| Method::Deform {
            params: DeformParams { subdivisions, ..DeformParams::default() },
            map: CaldParams::default(),
        };
        assert_eq!(deform(None).bytes(2562), deform(Some(4)).bytes(2562));
        assert!(deform(Some(8)).bytes(2562) > deform(None).bytes(2562) + (900 << 20));
    }
}
