//! Estimates of the methods' memory, for planning.
//!
//! All of it is linear in the number of vertices, except for the model whose residual the areas adapt to: its samples
//! and the tables of its transform grow with the square of its degree.

use spharm_surface::generate::icosphere_counts;

use crate::cald::CaldParams;
use crate::method::{Method, Source};
use crate::residual_areas::degree_for;

/// For any method: the hierarchy, triangles and their energies, the blocks of the Newton steps and their two grids.
/// Measured: cald 2.1 to 2.9 kB for 655,362 to 40,962 vertices, conformal and stretch 2.1 kB.
const BYTES_PER_VERTEX: u64 = 3000;

/// Samples and transform of a model of degree L, per L^2. Measured: 2.8 to 5.3 kB for L = 100 to 34.
const BYTES_PER_SQUARED_DEGREE: u64 = 5500;

/// Independent of the surface.
const FIXED: u64 = 4 << 20;

impl Method {
    /// Returns an estimate of the most bytes needed to map a surface of `vertices` vertices, including the result.
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
                // Rings around the vertices, the tree of the surface, and the vectors of the steps.
                adapting(map) + 2 * FIXED + 1500 * icosphere_counts(subdivisions)[0]
            }
        })
    }
}

impl Source<'_> {
    /// Returns the number of vertices.
    #[must_use]
    pub fn vertices(&self) -> usize {
        match self {
            Self::Mesh(mesh) => mesh.vertices.len(),
            Self::Quads(quads) => quads.vertices.len(),
        }
    }
}

/// Returns the number of subdivisions that deform ends with by default.
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
        // A degree that the vertices don't determine isn't taken.
        assert_eq!(auto(Some(1000)).bytes(642), auto(Some(2000)).bytes(642));
        let deform = |subdivisions| Method::Deform {
            params: DeformParams { subdivisions, ..DeformParams::default() },
            map: CaldParams::default(),
        };
        assert_eq!(deform(None).bytes(2562), deform(Some(4)).bytes(2562));
        assert!(deform(Some(8)).bytes(2562) > deform(None).bytes(2562) + (900 << 20));
    }
}
