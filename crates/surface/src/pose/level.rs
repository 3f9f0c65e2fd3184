//! Points that each stand for a disk of their share of a surface, and the nearest of them.

use kiddo::{ImmutableKdTree, SquaredEuclidean};

use crate::geometry::Vec3;

/// Points that each stand for a disk of their share of the area.
pub(super) struct Level {
    pub(super) points: Vec<Vec3>,
    pub(super) normals: Vec<Vec3>,
    /// How far from its point a piece of the surface reaches, along itself.
    pub(super) radius: f64,
    tree: ImmutableKdTree<f64, 3>,
}

impl Level {
    pub(super) fn new(points: Vec<Vec3>, normals: Vec<Vec3>, area: f64) -> Option<Self> {
        let tree = ImmutableKdTree::new_from_slice(&points).ok()?;
        let radius = (area / points.len() as f64).sqrt();
        Some(Self { points, normals, radius, tree })
    }

    /// The index of the point nearest to `p`, which is finite.
    pub(super) fn nearest(&self, p: Vec3) -> usize {
        self.tree.query(&p).nearest_one::<SquaredEuclidean<f64>>().execute().item as usize
    }
}
