//! Prepares a subject's surface for searches of nearest points.

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use spharm_surface::geometry::Vec3;
use spharm_surface::nearest::TriangleTree;
use spharm_surface::topology::area;
use spharm_surface::{Mesh, SpreadPoints, topology};

use crate::error::RegisterError;

/// A surface of any topology, in the template's pose.
pub struct Subject {
    pub(crate) mesh: Mesh,
    pub(crate) tree: TriangleTree,
    /// For each corner of each of the m triangles, whether the edge opposite the corner belongs to no other triangle.
    pub(crate) open: Vec<[bool; 3]>,
}

impl Subject {
    /// Builds the search tree of a surface. A surface that is inside out is reversed.
    ///
    /// # Errors
    ///
    /// [`RegisterError::NoArea`] if the area isn't positive and finite.
    pub fn new(mesh: &Mesh) -> Result<Self, RegisterError> {
        let total = area(mesh);
        if !(total > 0.0 && total.is_finite()) {
            return Err(RegisterError::NoArea { what: "the subject" });
        }
        let mut mesh = Mesh::new(mesh.vertices.clone(), mesh.faces.clone());
        if topology::signed_volume(&mesh) < 0.0 {
            mesh.faces.iter_mut().for_each(|face| face.swap(1, 2));
        }
        let open = open_edges(&mesh);
        Ok(Self { tree: TriangleTree::new(&mesh), mesh, open })
    }

    pub(crate) fn spread(&self, count: usize, seed: usize) -> SpreadPoints {
        SpreadPoints::new(&self.mesh, count, seed)
    }
}

/// Finds the edges that belong to a single triangle. They form the border of an open surface.
fn open_edges(mesh: &Mesh) -> Vec<[bool; 3]> {
    let edge = |face: &[u32; 3], corner: usize| {
        let (a, b) = (face[(corner + 1) % 3], face[(corner + 2) % 3]);
        (a.min(b), a.max(b))
    };
    let mut all: Vec<((u32, u32), usize)> = Vec::with_capacity(3 * mesh.faces.len());
    for (index, face) in mesh.faces.iter().enumerate() {
        all.extend((0..3).map(|corner| (edge(face, corner), 3 * index + corner)));
    }
    all.sort_unstable();
    let mut open = vec![[false; 3]; mesh.faces.len()];
    for run in all.chunk_by(|a, b| a.0 == b.0) {
        if let [(_, at)] = run {
            open[at / 3][at % 3] = true;
        }
    }
    open
}

/// A search tree over points and their normals. The normals are multiplied by a length, so that they are comparable
/// with distances.
pub(crate) struct PointTree {
    tree: ImmutableKdTree<f64, 6>,
    normal: f64,
}

impl PointTree {
    pub(crate) fn new(spread: &SpreadPoints, normal: f64) -> Result<Self, RegisterError> {
        let places = spread.points.iter().zip(&spread.normals);
        let places: Vec<[f64; 6]> = places.map(|(point, of)| place(*point, *of, normal)).collect();
        let tree = ImmutableKdTree::new_from_slice(&places).map_err(|_| RegisterError::Singular)?;
        Ok(Self { tree, normal })
    }

    /// Returns the index of the point in the tree that is nearest to `point` and `normal`, in position and normal
    /// together.
    pub(crate) fn nearest(&self, point: Vec3, normal: Vec3) -> usize {
        let place = place(point, normal, self.normal);
        self.tree.query(&place).nearest_one::<SquaredEuclidean<f64>>().execute().item as usize
    }
}

fn place(point: Vec3, normal: Vec3, weight: f64) -> [f64; 6] {
    [point[0], point[1], point[2], weight * normal[0], weight * normal[1], weight * normal[2]]
}
