//! Points that each represent a disk of a surface's area, and the search for the nearest one.

use kiddo::{ImmutableKdTree, SquaredEuclidean};

use crate::geometry::Vec3;

/// Points that each represent a disk, which is the point's share of the area.
pub(super) struct Level {
    pub(super) points: Vec<Vec3>,
    pub(super) normals: Vec<Vec3>,
    /// Radius of the disk that a point represents, along the surface.
    pub(super) radius: f64,
    tree: ImmutableKdTree<f64, 3>,
}

impl Level {
    pub(super) fn new(points: Vec<Vec3>, normals: Vec<Vec3>, area: f64) -> Option<Self> {
        let tree = ImmutableKdTree::new_from_slice(&points).ok()?;
        let radius = (area / points.len() as f64).sqrt();
        Some(Self { points, normals, radius, tree })
    }

    /// Returns the index of the point nearest to `p`, which must be finite.
    pub(super) fn nearest(&self, p: Vec3) -> usize {
        self.tree.query(&p).nearest_one::<SquaredEuclidean<f64>>().execute().item as usize
    }
}
