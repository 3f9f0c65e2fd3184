//! Finds the pairs of intersecting triangles of a mesh.
//!
//! Two triangles without a common vertex intersect if an edge of one triangle passes through the other triangle. Two
//! triangles with one common vertex intersect if an edge opposite the common vertex passes through the other triangle.
//! All tests use the signs of exact determinants. Triangles with a common edge, and triangles in the same plane, are
//! never treated as intersecting. A surface that is folded flat onto itself is therefore not detected.

use rayon::prelude::*;
use spharm_monitor::{Interrupted, Monitor};
use spharm_surface::Mesh;
use spharm_surface::nearest::TriangleTree;

use crate::geometry::Vec3;

/// Number of triangles between checks of the monitor.
const CHUNK: usize = 4096;

/// Returns the pairs of intersecting triangles in ascending order, each with the smaller index first.
pub(crate) fn self_intersections(mesh: &Mesh, monitor: &dyn Monitor) -> Result<Vec<[u32; 2]>, Interrupted> {
    let tree = TriangleTree::new(mesh);
    let corners = |face: u32| mesh.faces[face as usize].map(|v| mesh.vertices[v as usize]);
    let with = |face: u32| {
        let own = corners(face);
        let low: Vec3 = std::array::from_fn(|k| own.iter().map(|v| v[k]).fold(f64::INFINITY, f64::min));
        let high: Vec3 = std::array::from_fn(|k| own.iter().map(|v| v[k]).fold(f64::NEG_INFINITY, f64::max));
        let mut others: Vec<u32> = tree.meeting_box(low, high).filter(|&other| other > face).collect();
        others.sort_unstable();
        others.retain(|&other| intersect(mesh, face, other));
        others.into_iter().map(move |other| [face, other]).collect::<Vec<_>>()
    };
    let mut pairs = Vec::new();
    let faces: Vec<u32> = (0..mesh.faces.len() as u32).collect();
    for chunk in faces.chunks(CHUNK) {
        monitor.check()?;
        let found: Vec<Vec<[u32; 2]>> = chunk.par_iter().with_min_len(64).map(|&face| with(face)).collect();
        pairs.extend(found.into_iter().flatten());
    }
    Ok(pairs)
}

fn intersect(mesh: &Mesh, one: u32, two: u32) -> bool {
    let (a, b) = (mesh.faces[one as usize], mesh.faces[two as usize]);
    let shared = a.iter().filter(|v| b.contains(v)).count();
    let at = |v: u32| mesh.vertices[v as usize];
    // Edges that end at a vertex of the other triangle are skipped, since they only touch that triangle at the vertex.
    let through = |edges: [u32; 3], triangle: [u32; 3]| {
        (0..3).any(|k| {
            let (u, v) = (edges[k], edges[(k + 1) % 3]);
            !triangle.contains(&u) && !triangle.contains(&v) && passes(at(u), at(v), triangle.map(at))
        })
    };
    shared < 2 && (through(a, b) || through(b, a))
}

/// Returns whether a segment passes through or touches a triangle; false for a segment in the triangle's plane.
fn passes(p: Vec3, q: Vec3, [a, b, c]: [Vec3; 3]) -> bool {
    let (above, below) = (side(a, b, c, p), side(a, b, c, q));
    if above * below > 0.0 || (above == 0.0 && below == 0.0) {
        return false;
    }
    let turns = [side(p, q, a, b), side(p, q, b, c), side(p, q, c, a)];
    turns.iter().all(|&t| t >= 0.0) || turns.iter().all(|&t| t <= 0.0)
}

/// Returns the sign of the exact determinant. Signs are returned because products of determinants could underflow.
fn side(a: Vec3, b: Vec3, c: Vec3, d: Vec3) -> f64 {
    let coord = |[x, y, z]: Vec3| robust::Coord3D { x, y, z };
    let value = robust::orient3d(coord(a), coord(b), coord(c), coord(d));
    if value == 0.0 { 0.0 } else { value.signum() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use spharm_monitor::Silent;
    use spharm_surface::generate::icosphere;

    fn found(mesh: &Mesh) -> Vec<[u32; 2]> {
        self_intersections(mesh, &Silent).unwrap()
    }

    #[test]
    fn spheres_that_meet_intersect_along_a_circle_and_a_sphere_nowhere() {
        let one = icosphere(3);
        assert!(found(&one).is_empty());
        let mut two = one.clone();
        let n = one.vertices.len() as u32;
        two.vertices.extend(one.vertices.iter().map(|&[x, y, z]| [x + 1.013, y + 0.01, z]));
        two.faces.extend(one.faces.iter().map(|face| face.map(|v| v + n)));
        let pairs = found(&two);
        assert!(pairs.len() > 40 && pairs.iter().all(|[a, b]| *a < 1280 && *b >= 1280), "{}", pairs.len());
        let mut apart = two;
        apart.vertices[n as usize..].iter_mut().for_each(|v| v[0] += 1.1);
        assert!(found(&apart).is_empty());
    }

    #[test]
    fn a_spike_through_the_other_side_is_found() {
        let mut pierced = icosphere(2);
        pierced.vertices[0] = pierced.vertices[0].map(|x| -1.5 * x);
        assert!(!found(&pierced).is_empty());
    }
}
