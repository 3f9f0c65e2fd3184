//! Represents a surface by points, each of which stands for a disk-shaped piece of the surface, and finds the point
//! nearest to a position.

use kiddo::{ImmutableKdTree, SquaredEuclidean};

use crate::geometry::Vec3;

/// Points on a surface. Each point stands for a disk that has the point's share of the area.
pub(super) struct Level {
    pub(super) points: Vec<Vec3>,
    pub(super) normals: Vec<Vec3>,
    /// Radius of each point's disk in the tangent plane: the square root of the point's share of the area.
    pub(super) radius: f64,
    tree: ImmutableKdTree<f64, 3>,
}

impl Level {
    pub(super) fn new(points: Vec<Vec3>, normals: Vec<Vec3>, area: f64) -> Option<Self> {
        let tree = ImmutableKdTree::new_from_slice(&points).ok()?;
        let radius = (area / points.len() as f64).sqrt();
        Some(Self { points, normals, radius, tree })
    }

    /// Returns the index of the point nearest to `p`. The coordinates of `p` must be finite.
    pub(super) fn nearest(&self, p: Vec3) -> usize {
        self.tree.query(&p).nearest_one::<SquaredEuclidean<f64>>().execute().item as usize
    }
}
