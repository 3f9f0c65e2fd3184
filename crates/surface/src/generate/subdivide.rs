//! Splits triangles in four at the midpoints of their edges.

use std::collections::HashMap;

use crate::geometry::{Vec3, add, scale, unit};
use crate::mesh::Mesh;

/// Splits each triangle in four at the midpoints of its edges. The surface as a set of points doesn't change.
///
/// The vertices of `mesh` come first, in their original order, followed by a midpoint for each edge, in the order in
/// which the triangles first use the edges. The order depends only on the triangles. If a surface is split by this
/// function and its sphere by [`subdivide_sphere`], the results therefore correspond vertex by vertex.
///
/// For a closed surface of genus zero with n vertices, the result has 4 n - 6 vertices.
///
/// # Panics
///
/// Panics if a triangle's index is out of range, or the number of vertices exceeds 32 bits.
#[must_use]
pub fn subdivide(mesh: &Mesh) -> Mesh {
    split(mesh, |a, b| scale(add(a, b), 0.5))
}

/// Splits the sphere of a surface as [`subdivide`] splits the surface, and scales all vertices to length 1.
///
/// # Panics
///
/// Panics in the same cases as [`subdivide`].
#[must_use]
pub fn subdivide_sphere(sphere: &Mesh) -> Mesh {
    let unit_sphere = sphere.with_vertices(sphere.vertices.iter().map(|&v| unit(v)).collect());
    split(&unit_sphere, |a, b| unit(add(a, b)))
}

/// Splits each triangle in four. `middle` returns the new vertex of an edge from the edge's two ends.
pub(super) fn split(mesh: &Mesh, middle: impl Fn(Vec3, Vec3) -> Vec3) -> Mesh {
    let edges = mesh.faces.len() * 3 / 2;
    let mut vertices = mesh.vertices.clone();
    vertices.reserve(edges);
    let mut midpoints: HashMap<(u32, u32), u32> = HashMap::with_capacity(edges);
    let mut midpoint = |a: u32, b: u32| {
        *midpoints.entry((a.min(b), a.max(b))).or_insert_with(|| {
            let next = u32::try_from(vertices.len()).expect("the mesh has more vertices than 32-bit indices allow");
            vertices.push(middle(vertices[a as usize], vertices[b as usize]));
            next
        })
    };
    let faces = mesh.faces.iter().flat_map(|&[a, b, c]| {
        let (ab, bc, ca) = (midpoint(a, b), midpoint(b, c), midpoint(c, a));
        [[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]
    });
    let faces = faces.collect();
    Mesh { vertices, faces, meta: mesh.meta.clone() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::{Cortex, cortex, icosphere};
    use crate::topology::{Topology, area, is_outward};

    #[test]
    fn the_surface_stays_and_corresponds_to_its_sphere() {
        let (surface, sphere) = cortex(&Cortex { subdivisions: 3, variant: 1 });
        let (fine, fine_sphere) = (subdivide(&surface), subdivide_sphere(&sphere));
        assert_eq!(fine.vertices.len(), 4 * surface.vertices.len() - 6);
        assert_eq!(fine.vertices[..surface.vertices.len()], surface.vertices[..]);
        assert_eq!(fine.faces, fine_sphere.faces);
        assert_eq!(fine.meta, surface.meta);
        assert!(Topology::of(&fine).is_sphere() && is_outward(&fine));
        assert!((area(&fine) / area(&surface) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn spheres_of_any_radius_become_the_next_icosphere() {
        let coarse = icosphere(2);
        let scaled = coarse.with_vertices(coarse.vertices.iter().map(|&v| scale(v, 100.0)).collect());
        let (found, expected) = (subdivide_sphere(&scaled), icosphere(3));
        assert_eq!(found.faces, expected.faces);
        let off = |(a, b): (&Vec3, &Vec3)| (0..3).map(|i| (a[i] - b[i]).abs()).fold(0.0, f64::max);
        assert!(found.vertices.iter().zip(&expected.vertices).map(off).all(|off| off < 1e-15));
    }
}
