//! Checks that a mesh is a closed surface of genus zero, and gives reasons if it isn't.
//!
//! SPHARM describes surfaces that can be mapped one to one to the sphere. [`Topology::of`] counts everything that could
//! prevent such a map. [`Topology::problems`] describes the problems in sentences.
//!
//! The counts take two passes over the mesh in O(vertices + faces) time, and a sort of the coordinates. Half-edges are
//! sorted into one bucket per vertex, by the smaller of their two vertices (a counting sort), so half-edges of the same
//! edge are next to each other. Corners at the same end of an edge are joined (union-find), which reveals vertices
//! where two fans of triangles touch. 40,962 vertices take 9 ms. 10.5 million vertices take 4.7 s on one core of a
//! small server, and 1.3 GB of memory for the mesh and the computation.

mod edges;
mod union_find;

use crate::geometry::{cross, dot, face_normal, sub};
use crate::mesh::Mesh;
pub use union_find::UnionFind;

/// The counts that determine the topology of a mesh.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Topology {
    /// Number of vertices, including those that no triangle uses.
    pub vertices: usize,
    /// Number of edges. Degenerate faces contribute none.
    pub edges: usize,
    /// Number of triangles.
    pub faces: usize,
    /// Number of edges with only one triangle, which form the rims of holes.
    pub boundary_edges: usize,
    /// Number of edges with more than two triangles.
    pub non_manifold_edges: usize,
    /// Number of vertices whose triangles form more than one fan, such as a point where two cones touch.
    pub non_manifold_vertices: usize,
    /// Number of edges that run in the same direction in both of their triangles, so one of the triangles is reversed.
    pub inconsistent_edges: usize,
    /// Whether the surface has only one side. In a one-sided surface, turning triangles can't make all edges
    /// consistent.
    pub one_sided: bool,
    /// Number of separate pieces. Different pieces have no vertex in common. Unreferenced vertices don't count as
    /// pieces.
    pub components: usize,
    /// Number of vertices that no triangle uses.
    pub unreferenced_vertices: usize,
    /// Number of triangles with the same three vertices as an earlier triangle, in any order.
    pub duplicate_faces: usize,
    /// Number of triangles that use a vertex twice.
    pub degenerate_faces: usize,
    /// Number of vertices at exactly the same position as an earlier vertex. Such vertices are allowed. They occur at
    /// seams, and in meshes whose corners aren't welded.
    pub duplicate_vertices: usize,
    /// The Euler characteristic: referenced vertices - edges + non-degenerate faces.
    pub euler_characteristic: i64,
}

impl Topology {
    /// Computes all counts. Meshes read by this crate never cause a panic.
    ///
    /// # Panics
    ///
    /// Panics if a triangle's index is out of range.
    #[must_use]
    pub fn of(mesh: &Mesh) -> Self {
        let vertices = mesh.vertices.len();
        let mut referenced = vec![false; vertices];
        let mut pieces = UnionFind::new(vertices);
        let mut degenerate_faces = 0;
        for (i, &[a, b, c]) in mesh.faces.iter().enumerate() {
            let last = a.max(b).max(c);
            assert!(
                (last as usize) < vertices,
                "triangle {i} refers to vertex {last} (both counted from 0), but the mesh has {vertices} vertices"
            );
            for v in [a, b, c] {
                referenced[v as usize] = true;
            }
            pieces.join(a, b);
            pieces.join(b, c);
            degenerate_faces += usize::from(is_degenerate([a, b, c]));
        }
        let unreferenced_vertices = referenced.iter().filter(|&&used| !used).count();
        // Each unreferenced vertex is a separate set that doesn't count as a component.
        let components = pieces.sets() - unreferenced_vertices;
        drop(pieces);
        let edges = edges::count(mesh);

        let referenced = vertices - unreferenced_vertices;
        let faces = mesh.faces.len();
        Self {
            vertices,
            edges: edges.edges,
            faces,
            boundary_edges: edges.boundary,
            non_manifold_edges: edges.non_manifold,
            non_manifold_vertices: edges.non_manifold_vertices,
            inconsistent_edges: edges.inconsistent,
            one_sided: edges.inconsistent > 0 && edges::is_one_sided(mesh),
            components,
            unreferenced_vertices,
            duplicate_faces: edges::duplicate_faces(mesh),
            degenerate_faces,
            duplicate_vertices: duplicate_vertices(&mesh.vertices),
            euler_characteristic: referenced as i64 - edges.edges as i64 + (faces - degenerate_faces) as i64,
        }
    }

    /// Returns whether the mesh is one closed, orientable, consistently wound surface of genus zero, without
    /// unreferenced vertices.
    #[must_use]
    pub fn is_sphere(&self) -> bool {
        self.genus() == Some(0) && self.unreferenced_vertices == 0
    }

    /// Returns the number of handles; `None` unless the mesh is one closed, consistently wound manifold.
    #[must_use]
    pub fn genus(&self) -> Option<i64> {
        let closed = self.faces > 0
            && self.components == 1
            && self.boundary_edges == 0
            && self.non_manifold_edges == 0
            && self.non_manifold_vertices == 0
            && self.inconsistent_edges == 0
            && self.duplicate_faces == 0
            && self.degenerate_faces == 0;
        // The Euler characteristic of a closed orientable surface is even.
        closed.then_some((2 - self.euler_characteristic) / 2)
    }

    /// Returns the reasons, one sentence each, why the mesh isn't a closed surface of genus zero. The list is empty for
    /// a closed surface of genus zero.
    #[must_use]
    pub fn problems(&self) -> Vec<String> {
        let counted = |n: usize, one: &str, many: &str| match n {
            0 => None,
            1 => Some(format!("1 {one}")),
            n => Some(format!("{n} {many}")),
        };
        let mut problems: Vec<String> = [
            counted(
                self.boundary_edges,
                "edge belongs to one triangle only: the surface has a hole",
                "edges belong to one triangle only: the surface has holes",
            ),
            counted(
                self.non_manifold_edges,
                "edge is shared by more than two triangles",
                "edges are shared by more than two triangles",
            ),
            counted(
                self.non_manifold_vertices,
                "vertex joins parts that touch only at this vertex",
                "vertices join parts that touch only at these vertices",
            ),
            counted(
                if self.one_sided { 0 } else { self.inconsistent_edges },
                "edge joins triangles of opposite orientation",
                "edges join triangles of opposite orientation",
            ),
            counted(self.degenerate_faces, "triangle uses a vertex twice", "triangles use a vertex twice"),
            counted(self.duplicate_faces, "triangle repeats another one", "triangles repeat others"),
            counted(self.unreferenced_vertices, "vertex belongs to no triangle", "vertices belong to no triangle"),
        ]
        .into_iter()
        .flatten()
        .collect();
        if self.faces == 0 {
            problems.push("there are no triangles".to_owned());
        }
        if self.one_sided {
            problems.push("the surface has one side only, like a Möbius strip".to_owned());
        }
        if self.components > 1 {
            problems.push(format!("the surface consists of {} separate pieces", self.components));
        }
        match self.genus() {
            Some(0) | None => {}
            Some(1) => problems.push("the surface has a handle (genus 1)".to_owned()),
            Some(genus) => problems.push(format!("the surface has {genus} handles (genus {genus})")),
        }
        if self.boundary_edges > 0 && self.duplicate_vertices > 0 {
            problems.push(format!(
                "{} vertices lie exactly on others: welding them may close the surface",
                self.duplicate_vertices
            ));
        }
        problems
    }
}

/// Returns the number of triangles that occur in only one of two lists. The triangles' order, first corner and winding
/// are ignored.
#[must_use]
pub fn different_triangles(a: &[[u32; 3]], b: &[[u32; 3]]) -> usize {
    let sorted = |faces: &[[u32; 3]]| {
        let mut faces: Vec<[u32; 3]> = faces.to_vec();
        faces.iter_mut().for_each(|face| face.sort_unstable());
        faces.sort_unstable();
        faces
    };
    let (a, b) = (sorted(a), sorted(b));
    let (mut i, mut j, mut differ) = (0, 0, 0);
    while i < a.len() && j < b.len() {
        match a[i].cmp(&b[j]) {
            std::cmp::Ordering::Equal => (i, j) = (i + 1, j + 1),
            std::cmp::Ordering::Less => (i, differ) = (i + 1, differ + 1),
            std::cmp::Ordering::Greater => (j, differ) = (j + 1, differ + 1),
        }
    }
    differ + (a.len() - i) + (b.len() - j)
}

/// Returns the volume enclosed by a closed surface, in cubed units of the coordinates. It is positive if the triangles
/// wind counter-clockwise seen from outside.
///
/// # Panics
///
/// Panics if a triangle's index is out of range.
#[must_use]
pub fn signed_volume(mesh: &Mesh) -> f64 {
    signed_volume_of(&mesh.vertices, &mesh.faces)
}

/// Returns the volume enclosed by triangles over the given positions, like [`signed_volume`].
pub(crate) fn signed_volume_of(vertices: &[[f64; 3]], faces: &[[u32; 3]]) -> f64 {
    // Positions are taken relative to a point of the surface, so that surfaces far from the origin lose no digits.
    let origin = vertices.first().copied().unwrap_or_default();
    let six_volumes: f64 = faces
        .iter()
        .map(|face| {
            let [a, b, c] = face.map(|i| sub(vertices[i as usize], origin));
            dot(a, cross(b, c))
        })
        .sum();
    six_volumes / 6.0
}

/// Returns the area of a mesh, in squared units of the coordinates.
///
/// # Panics
///
/// Panics if a triangle's index is out of range.
#[must_use]
pub fn area(mesh: &Mesh) -> f64 {
    let normals = mesh.faces.iter().map(|face| face_normal(face.map(|v| mesh.vertices[v as usize])));
    0.5 * normals.map(|normal| dot(normal, normal).sqrt()).sum::<f64>()
}

/// Returns whether the triangles of a closed surface wind counter-clockwise seen from outside.
///
/// # Panics
///
/// Panics in the same cases as [`signed_volume`].
#[must_use]
pub fn is_outward(mesh: &Mesh) -> bool {
    signed_volume(mesh) > 0.0
}

fn is_degenerate([a, b, c]: [u32; 3]) -> bool {
    a == b || b == c || c == a
}

/// Returns the number of vertices at the same position as an earlier vertex. -0 and +0 are equal.
fn duplicate_vertices(vertices: &[[f64; 3]]) -> usize {
    let bits = |v: &[f64; 3]| v.map(|x| (x + 0.0).to_bits());
    // Short hashes are sorted, and coordinates are compared only if hashes agree. This is faster than sorting
    // coordinates.
    let mut keys: Vec<(u64, u32)> =
        vertices.iter().zip(0..).map(|(v, i)| (bits(v).iter().fold(0, |hash, &x| mix(hash ^ x)), i)).collect();
    keys.sort_unstable();
    let mut duplicates = 0;
    for run in keys.chunk_by(|a, b| a.0 == b.0).filter(|run| run.len() > 1) {
        let mut places: Vec<_> = run.iter().map(|&(_, i)| bits(&vertices[i as usize])).collect();
        places.sort_unstable();
        places.dedup();
        duplicates += run.len() - places.len();
    }
    duplicates
}

/// Mixes all bits of a number by a bijection, the finaliser of SplitMix64.
fn mix(mut x: u64) -> u64 {
    x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn triangles_compare_as_sets() {
        let a = [[0, 1, 2], [3, 2, 1]];
        assert_eq!(different_triangles(&a, &[[1, 2, 3], [2, 0, 1]]), 0);
        assert_eq!(different_triangles(&a, &[[1, 2, 3]]), 1);
        assert_eq!(different_triangles(&a, &[[1, 2, 3], [0, 1, 3]]), 2);
    }
}
