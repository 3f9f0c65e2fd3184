//! Finds the point of a triangle mesh that is nearest to a given point.
//!
//! A bounding-volume hierarchy over the triangles (parry3d's) is searched best first. The result is the exact minimum
//! over all triangles, although only O(log n) of them are visited. In meshes of slivers, each box is rotated to its
//! triangle's orientation. Memory: about 160 bytes per triangle, 310 for slivers.

use parry3d_f64::bounding_volume::Aabb;
use parry3d_f64::math::Vector;
use parry3d_f64::partitioning::{Bvh, BvhBuildStrategy, BvhNode};
use parry3d_f64::query::{PointQuery, PointQueryWithLocation};
use parry3d_f64::shape::Triangle;

use crate::geometry::{Vec3, dot, sub};
use crate::mesh::Mesh;
use crate::sliver_tree::{SliverTree, is_of_slivers};

/// A search tree over a mesh's triangles.
pub struct TriangleTree {
    tree: Bvh,
    triangles: Vec<[Vec3; 3]>,
    slivers: Option<SliverTree>,
}

/// The point of a mesh that is nearest to a given point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nearest {
    /// Index of the triangle that contains the nearest point, counted from 0.
    pub triangle: u32,
    /// Weights of that triangle's corners, in the order of the corners: nonnegative, with sum 1.
    pub barycentric: [f64; 3],
    /// The nearest point.
    pub point: [f64; 3],
    /// Distance between the given and the nearest point, in the coordinates' unit.
    pub distance: f64,
}

impl TriangleTree {
    /// Builds the search tree of a mesh in O(n log n) time.
    ///
    /// # Panics
    ///
    /// Panics if a triangle's index is out of range.
    #[must_use]
    pub fn new(mesh: &Mesh) -> Self {
        let triangles: Vec<[Vec3; 3]> = mesh.faces.iter().map(|face| face.map(|v| mesh.vertices[v as usize])).collect();
        let boxes: Vec<Aabb> = triangles.iter().map(bounding_box).collect();
        let slivers = is_of_slivers(&triangles).then(|| SliverTree::new(&triangles));
        Self { tree: Bvh::from_leaves(BvhBuildStrategy::Binned, &boxes), triangles, slivers }
    }

    /// Returns the point of the mesh that is nearest to `point`; `None` if the mesh has no triangles or the point isn't
    /// finite.
    #[must_use]
    pub fn nearest(&self, point: [f64; 3]) -> Option<Nearest> {
        if let Some(slivers) = &self.slivers {
            let on = |triangle: u32| {
                let found = self.on_triangle(triangle, point);
                (found.distance, found)
            };
            return slivers.nearest(point, on).map(|(_, (_, found))| found);
        }
        let (triangle, _) = self.search(point, f64::MAX)?;
        Some(self.on_triangle(triangle, point))
    }

    /// Returns the nearest triangle and its distance from `point`, or `None` in the same cases as
    /// [`nearest`](Self::nearest). The search is fast if `near`, a triangle close to the nearest one, is given.
    ///
    /// # Panics
    ///
    /// Panics if `near` is out of range.
    #[must_use]
    pub fn distance(&self, point: [f64; 3], near: Option<u32>) -> Option<(u32, f64)> {
        if self.slivers.is_some() {
            return self.nearest(point).map(|found| (found.triangle, found.distance));
        }
        let known = near.map(|triangle| (triangle, self.square(triangle, Vector::from(point))));
        let known = known.filter(|(_, square)| square.is_finite());
        let better = self.search(point, known.map_or(f64::MAX, |(_, square)| square));
        better.or(known).map(|(triangle, square)| (triangle, square.sqrt()))
    }

    /// Returns the nearest triangle and its squared distance; `None` if every squared distance is at least `most`.
    fn search(&self, point: Vec3, most: f64) -> Option<(u32, f64)> {
        let p = Vector::from(point);
        if !p.is_finite() {
            return None;
        }
        let to_box = |node: &BvhNode, _| {
            let own = node.aabb();
            (own.mins - p).max(p - own.maxs).max(Vector::ZERO).length_squared()
        };
        let found = self.tree.find_best(most, to_box, |triangle, _| Some(self.square(triangle, p)));
        found.filter(|(_, square)| square.is_finite())
    }

    /// Returns the squared distance of `point` from a triangle.
    fn square(&self, triangle: u32, point: Vector) -> f64 {
        let found = self.triangle(triangle).project_local_point(point, false);
        (found.point - point).length_squared()
    }

    /// Returns the point of a triangle that is nearest to `point`.
    pub(crate) fn on_triangle(&self, triangle: u32, point: Vec3) -> Nearest {
        let (found, place) = self.triangle(triangle).project_local_point_and_get_location(Vector::from(point), false);
        let nearest = found.point.to_array();
        let off = sub(nearest, point);
        let barycentric = place.barycentric_coordinates().unwrap_or([1.0, 0.0, 0.0]);
        Nearest { triangle, barycentric, point: nearest, distance: dot(off, off).sqrt() }
    }

    /// Returns the triangles whose bounding boxes intersect the box from `low` to `high`, in an unspecified but
    /// reproducible order.
    pub fn meeting_box(&self, low: [f64; 3], high: [f64; 3]) -> impl Iterator<Item = u32> {
        let wanted = Aabb::new(Vector::from(low), Vector::from(high));
        self.tree.leaves(move |node| {
            let own = node.aabb();
            own.mins.cmple(wanted.maxs).all() && own.maxs.cmpge(wanted.mins).all()
        })
    }

    fn triangle(&self, index: u32) -> Triangle {
        let [a, b, c] = self.triangles[index as usize].map(Vector::from);
        Triangle::new(a, b, c)
    }
}

fn bounding_box(corners: &[Vec3; 3]) -> Aabb {
    let (low, high) = crate::geometry::bounds(corners.iter().copied());
    Aabb::new(Vector::from(low), Vector::from(high))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::icosphere;

    #[test]
    fn the_tree_finds_what_looking_at_every_triangle_finds() {
        let mesh = icosphere(3);
        let tree = TriangleTree::new(&mesh);
        for k in 0..200_u32 {
            let t = f64::from(k);
            let point = [1.7 * (0.9 * t).sin(), 1.3 * (1.7 * t).cos(), (2.3 * t).sin()];
            let found = tree.nearest(point).unwrap();
            let all = (0..mesh.faces.len() as u32)
                .map(|f| tree.triangle(f).distance_to_local_point(Vector::from(point), false));
            let least = all.fold(f64::INFINITY, f64::min);
            assert!((found.distance - least).abs() < 1e-14, "{point:?}: {found:?}, {least}");
            for near in [None, Some(found.triangle), Some(k)] {
                let (_, distance) = tree.distance(point, near).unwrap();
                assert_eq!(distance.to_bits(), found.distance.to_bits(), "from {near:?}");
            }
            let corners = mesh.faces[found.triangle as usize].map(|v| mesh.vertices[v as usize]);
            let point: [f64; 3] = std::array::from_fn(|k| (0..3).map(|i| found.barycentric[i] * corners[i][k]).sum());
            assert!(dot(sub(point, found.point), sub(point, found.point)).sqrt() < 1e-14);
        }
        assert_eq!(TriangleTree::new(&Mesh::default()).nearest([0.0; 3]), None);
        assert_eq!(tree.nearest([f64::NAN; 3]), None);
        assert_eq!(tree.distance([0.0, f64::INFINITY, 0.0], Some(3)), None);
    }
}
