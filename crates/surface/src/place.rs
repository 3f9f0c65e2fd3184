//! Represents a point within a triangle of a mesh, independently of the vertices' positions.

use crate::geometry::Vec3;
use crate::mesh::Mesh;
use crate::nearest::TriangleTree;

/// A point within a triangle, given by weights of the triangle's corners. On meshes with the same triangles, equal
/// places are corresponding points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// The vertices of the triangle.
    pub corners: [u32; 3],
    /// Weights of the corners, which sum to 1.
    pub shares: [f64; 3],
}

impl Place {
    /// Returns, for each of the given points, the place on a mesh that is nearest to it. Returns `None` if any point
    /// isn't finite or the mesh has no triangles.
    #[must_use]
    pub fn nearest(mesh: &Mesh, points: &[Vec3]) -> Option<Vec<Self>> {
        let tree = TriangleTree::new(mesh);
        let of = |point: &Vec3| {
            let found = tree.nearest(*point)?;
            Some(Self { corners: mesh.faces[found.triangle as usize], shares: found.barycentric })
        };
        points.iter().map(of).collect()
    }

    /// Returns the position of the place on a mesh whose vertices have the given positions.
    #[must_use]
    pub fn of(&self, vertices: &[Vec3]) -> Vec3 {
        let [a, b, c] = self.corners.map(|v| vertices[v as usize]);
        std::array::from_fn(|k| self.shares[0] * a[k] + self.shares[1] * b[k] + self.shares[2] * c[k])
    }

    /// Returns whether the indices of all corners are below `vertices`.
    #[must_use]
    pub fn is_within(&self, vertices: usize) -> bool {
        self.corners.iter().all(|v| (*v as usize) < vertices)
    }

    /// Returns the weighted mean of the corners' rows in `rows`, a row-major matrix of shape (vertices, width).
    #[must_use]
    pub fn row(&self, rows: &[f64], width: usize) -> Vec<f64> {
        let own = |k: usize| {
            self.corners.iter().zip(self.shares).map(|(v, share)| share * rows[*v as usize * width + k]).sum()
        };
        (0..width).map(own).collect()
    }

    /// Returns the row of the corner with the largest weight, or of the first such corner in case of ties. Unlike
    /// [`row`](Self::row), this function doesn't average, so it is suitable for labels, whose mean has no meaning.
    #[must_use]
    pub fn largest_row(&self, rows: &[f64], width: usize) -> Vec<f64> {
        let largest = (1..3).fold(0, |best, k| if self.shares[k] > self.shares[best] { k } else { best });
        rows[self.corners[largest] as usize * width..][..width].to_vec()
    }
}
